"""Style encoder and stylization decoder (spec section 2.7; paper, appearance branch)."""

from __future__ import annotations

from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from styl3r_export.model.backbone import Hooks, PatchEmbed
from styl3r_export.model.blocks import (
    NORM_EPS,
    DecoderBlock,
    EncoderBlock,
    Rope,
    grid_positions,
    rope_table,
)
from styl3r_export.model.config import PATCH, ModelConfig


class TokenStylizer(nn.Module):
    """Content tokens of all views, seen through the tokens of a style."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        c = config
        self.config = config
        self.mask_token = nn.Parameter(torch.zeros(1, 1, c.decoder_dim))  # in every checkpoint
        self.patch_embed = PatchEmbed(3, c.encoder_dim, PATCH)
        self.enc_blocks = nn.ModuleList(
            EncoderBlock(c.encoder_dim, c.head_dim, c.mlp_ratio) for _ in range(c.style_depth)
        )
        self.enc_norm = nn.LayerNorm(c.encoder_dim, NORM_EPS)
        self.decoder_embed = nn.Linear(c.encoder_dim, c.decoder_dim)
        self.dec_blocks = nn.ModuleList(
            DecoderBlock(c.decoder_dim, c.head_dim, c.mlp_ratio) for _ in range(c.stylizer_depth)
        )
        self.dec_norm = nn.LayerNorm(c.decoder_dim, NORM_EPS)

    def encode(
        self, style: Float[Tensor, "batch 3 h w"]
    ) -> tuple[Float[Tensor, "batch tokens dim"], Rope]:
        """Style tokens, and the rotary angles of their grid."""
        rows, columns = style.shape[-2] // PATCH, style.shape[-1] // PATCH
        positions = grid_positions(rows, columns, style.device, camera_token=False)
        rope = rope_table(positions, self.config.head_dim)
        x = self.patch_embed(style)
        for block in self.enc_blocks:
            x = block(x, rope)
        return self.enc_norm(x), rope

    def decode(
        self,
        content: Float[Tensor, "batch views tokens dim"],
        style: Float[Tensor, "batch style_tokens dim"],
        style_rope: Rope,
        rows: int,
        columns: int,
    ) -> Hooks:
        """The four hooked token maps of each view, patches only.

        All views form one sequence; the views' positions repeat, so nothing tells them apart.
        The memory is the style's tokens, the same in every layer.
        """
        views, length = content.shape[1:3]
        positions = grid_positions(rows, columns, content.device, camera_token=True)
        rope = rope_table(positions.repeat(views, 1), self.config.head_dim)
        x = self.decoder_embed(content.flatten(1, 2))
        memory = self.decoder_embed(style)
        hooked = [content[:, :, :-1]]
        for layer, module in enumerate(self.dec_blocks, start=1):
            block = cast(DecoderBlock, module)
            x = block(x, rope, *block.memory(memory, style_rope))
            if layer in stylizer_hooks(self.config):
                out = self.dec_norm(x) if layer == self.config.stylizer_depth else x
                hooked.append(out.unflatten(1, (views, length))[:, :, :-1])
        a, b, c, d = hooked
        return a, b, c, d


def stylizer_hooks(config: ModelConfig) -> tuple[int, int, int]:
    """The structure decoder's hooks, scaled to this decoder's depth (equal when published)."""
    first, second, last = (h * config.stylizer_depth // config.decoder_depth for h in config.hooks)
    return first, second, last
