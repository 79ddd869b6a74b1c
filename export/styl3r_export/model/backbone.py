"""Content encoder and structure decoder (spec sections 2.1 to 2.6)."""

from __future__ import annotations

from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from styl3r_export.model.blocks import (
    NORM_EPS,
    DecoderBlock,
    EncoderBlock,
    Rope,
    grid_positions,
    rope_table,
)
from styl3r_export.model.config import PATCH, ModelConfig
from styl3r_export.model.stem import PyramidStem

Hooks = tuple[Tensor, Tensor, Tensor, Tensor]


class PatchEmbed(nn.Module):
    """One token a 16x16 patch: a strided convolution of the picture, or of the stem's map."""

    def __init__(self, in_channels: int, dim: int, stride: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(in_channels, dim, stride, stride)

    def forward(self, x: Float[Tensor, "batch channels height width"]) -> Tensor:
        """(batch, patches, dim), patches row-major."""
        return self.proj(x).flatten(2).transpose(1, 2)


class Backbone(nn.Module):
    """Shared content encoder, and the decoder that lets every view see all others."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        c = config
        self.config = config
        self.mask_token = nn.Parameter(torch.zeros(1, 1, c.decoder_dim))  # in every checkpoint
        if c.stem == "pyramid":
            self.stem = PyramidStem()
            self.patch_embed = PatchEmbed(PyramidStem.CHANNELS[2], c.encoder_dim, PATCH // 8)
        else:
            self.patch_embed = PatchEmbed(3, c.encoder_dim, PATCH)
        self.intrinsic_encoder = nn.Linear(9, c.encoder_dim)
        encoder = (c.encoder_dim, c.head_dim, c.mlp_ratio)
        decoder = (c.decoder_dim, c.head_dim, c.mlp_ratio)
        self.enc_blocks = nn.ModuleList(EncoderBlock(*encoder) for _ in range(c.encoder_depth))
        self.enc_norm = nn.LayerNorm(c.encoder_dim, NORM_EPS)
        self.decoder_embed = nn.Linear(c.encoder_dim, c.decoder_dim)
        self.dec_blocks = nn.ModuleList(DecoderBlock(*decoder) for _ in range(c.decoder_depth))
        self.dec_blocks2 = nn.ModuleList(DecoderBlock(*decoder) for _ in range(c.decoder_depth))
        self.dec_norm = nn.LayerNorm(c.decoder_dim, NORM_EPS)

    def encode(
        self,
        maps: Float[Tensor, "batch channels height width"],
        intrinsics: Float[Tensor, "batch 3 3"],
        rows: int,
        columns: int,
    ) -> Float[Tensor, "batch tokens dim"]:
        """Content tokens, patches first and the intrinsics token last.

        Args:
            maps: what `patch_embed` reads: pictures in [-1, 1], or the stem's 1/8 maps.
            intrinsics: normalised by width and height.
            rows: rows of the patch grid.
            columns: columns of the patch grid.
        """
        camera = self.intrinsic_encoder(intrinsics.flatten(1))[:, None]
        x = torch.cat((self.patch_embed(maps), camera), dim=1)
        positions = grid_positions(rows, columns, x.device, camera_token=True)
        rope = rope_table(positions, self.config.head_dim)
        for block in self.enc_blocks:
            x = block(x, rope)
        return self.enc_norm(x)

    def decode(
        self,
        content: Float[Tensor, "batch views tokens dim"],
        rows: int,
        columns: int,
        matches: Float[Tensor, "batch views tokens decoder_dim"] | None = None,
    ) -> tuple[Hooks, Float[Tensor, "batch views decoder_dim"]]:
        """The four hooked token maps (patches only), and each view's camera token.

        All views are decoded layer by layer from the previous layer's tokens: the first by
        `dec_blocks`, the others by `dec_blocks2`; a view's memory is every other view.
        """
        positions = grid_positions(rows, columns, content.device, camera_token=True)
        rope = rope_table(positions, self.config.head_dim)
        tokens = self.decoder_embed(content)
        if matches is not None:
            tokens = tokens + matches
        hooked = [content[:, :, :-1]]
        last = self.config.decoder_depth
        for layer, (first, rest) in enumerate(
            zip(self.dec_blocks, self.dec_blocks2, strict=True), start=1
        ):
            tokens = decode_layer(cast(DecoderBlock, first), cast(DecoderBlock, rest), tokens, rope)
            if layer in self.config.hooks:
                out = self.dec_norm(tokens) if layer == last else tokens
                hooked.append(out[:, :, :-1])
        a, b, c, d = hooked
        return (a, b, c, d), self.dec_norm(tokens)[:, :, -1]


def decode_layer(
    first: DecoderBlock,
    rest: DecoderBlock,
    tokens: Float[Tensor, "batch views tokens dim"],
    rope: Rope,
) -> Float[Tensor, "batch views tokens dim"]:
    """One decoder layer of all views, each reading every other view's previous tokens."""
    batch, views = tokens.shape[:2]
    others = tokens[:, 1:]
    # The first view reads the others, in one sequence.
    k, v = first.memory(others.flatten(0, 1), rope)
    k0, v0 = (t.unflatten(0, (batch, views - 1)).transpose(1, 2).flatten(2, 3) for t in (k, v))
    out0 = first(tokens[:, 0], rope, k0, v0)
    # Every other view reads all views but itself: j runs over 0..views-2, skipping the view.
    k, v = rest.memory(tokens.flatten(0, 1), rope)
    skip = torch.arange(1, views, device=tokens.device)[:, None]
    j = torch.arange(views - 1, device=tokens.device)[None, :]
    index = j + (j >= skip).long()  # (views-1, views-1)
    k, v = (gather_views(t.unflatten(0, (batch, views)), index) for t in (k, v))
    out = rest(others.flatten(0, 1), rope, k, v).unflatten(0, (batch, views - 1))
    return torch.cat((out0[:, None], out), dim=1)


def gather_views(
    x: Float[Tensor, "batch views heads tokens channels"], index: Tensor
) -> Float[Tensor, "batch_readers heads memory channels"]:
    """For each reading view, the keys or values of the views it reads, as one sequence."""
    readers, read = index.shape
    x = x.index_select(1, index.flatten()).unflatten(1, (readers, read))
    x = x.transpose(2, 3)  # (batch, readers, heads, read, tokens, channels)
    return x.flatten(3, 4).flatten(0, 1)
