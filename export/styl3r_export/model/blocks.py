"""Transformer parts: rotary positions, attention, encoder and decoder blocks (spec section 2)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional as F

# All LayerNorms of the published network; torch's default of 1e-5 shows in the parity figures.
NORM_EPS = 1e-6
# Base of the rotary frequencies (CroCo's choice for grids of some tens of patches).
ROPE_BASE = 100.0


class Rope(NamedTuple):
    """Cosines and sines of the rotary angles of a sequence, shared by all heads and layers."""

    cos: Float[Tensor, "tokens channels"]
    sin: Float[Tensor, "tokens channels"]


def grid_positions(
    rows: int, columns: int, device: torch.device, *, camera_token: bool
) -> Int[Tensor, "tokens 2"]:
    """Integer (y, x) of each patch, row-major; the intrinsics token sits at (rows, 0)."""
    y = torch.arange(rows, device=device)[:, None].expand(rows, columns)
    x = torch.arange(columns, device=device)[None, :].expand(rows, columns)
    positions = torch.stack((y, x), dim=-1).reshape(rows * columns, 2)
    if camera_token:
        last = torch.cat((y[-1:, :1] + 1, x[-1:, :1]), dim=-1)
        positions = torch.cat((positions, last))
    return positions


def rope_table(positions: Int[Tensor, "tokens 2"], head_dim: int) -> Rope:
    """Angles for `head_dim` channels: the first half turns with y, the second with x.

    Inside a half of D channels, channel k pairs with k + D/2 at frequency 100^(-2k/D).
    """
    quarter = head_dim // 4
    exponent = torch.arange(quarter, device=positions.device, dtype=torch.float32) / quarter
    frequency = ROPE_BASE**-exponent
    angle = positions.float()[:, :, None] * frequency  # (tokens, 2, quarter)
    angle = torch.cat((angle, angle), dim=-1).reshape(-1, head_dim)
    return Rope(angle.cos(), angle.sin())


def rotate(x: Float[Tensor, "*batch tokens channels"], rope: Rope) -> Tensor:
    """Apply the rotary embedding to queries or keys.

    The rotate-half permutation is a product with a signed permutation matrix: exact in any
    precision, and faster than the slices, negations and concatenations it stands for.
    """
    turned = x @ quarter_turn(x.shape[-1], x.device, x.dtype)
    return x * rope.cos.to(x.dtype) + turned * rope.sin.to(x.dtype)


def quarter_turn(
    channels: int, device: torch.device, dtype: torch.dtype
) -> Float[Tensor, "channels channels"]:
    """Matrix M with (a, b, c, d) M = (-b, a, -d, c), each letter a quarter of the channels."""
    eye = torch.eye(channels // 4, device=device, dtype=dtype)
    return torch.block_diag(*2 * (torch.kron(torch.tensor([[0, 1], [-1, 0]]).to(eye), eye),))


def split_heads(x: Tensor, head_dim: int) -> Float[Tensor, "*batch heads tokens channels"]:
    """(..., tokens, heads * head_dim) to (..., heads, tokens, head_dim)."""
    return x.unflatten(-1, (-1, head_dim)).transpose(-3, -2)


def merge_heads(x: Float[Tensor, "*batch heads tokens channels"]) -> Tensor:
    """The inverse of `split_heads`."""
    return x.transpose(-3, -2).flatten(-2)


def attend(
    q: Float[Tensor, "*batch queries channels"],
    k: Float[Tensor, "*batch keys channels"],
    v: Float[Tensor, "*batch keys channels"],
) -> Float[Tensor, "*batch queries channels"]:
    """softmax(q k^T / sqrt(channels)) v, without mask or dropout."""
    if q.requires_grad and q.device.type == "cpu":
        # Going back through torch's fused CPU kernel takes 2 to 5 times as long as this.
        weights = (q * q.shape[-1] ** -0.5) @ k.transpose(-1, -2)
        return weights.softmax(dim=-1).to(v.dtype) @ v
    return F.scaled_dot_product_attention(q, k, v)


class SelfAttention(nn.Module):
    """Multi-head self-attention with rotary positions."""

    def __init__(self, dim: int, head_dim: int) -> None:
        super().__init__()
        self.head_dim = head_dim
        self.qkv = nn.Linear(dim, 3 * dim)
        self.proj = nn.Linear(dim, dim)

    def forward(self, x: Float[Tensor, "batch tokens dim"], rope: Rope) -> Tensor:
        """Attend within each sequence of the batch."""
        q, k, v = (split_heads(part, self.head_dim) for part in self.qkv(x).chunk(3, dim=-1))
        return self.proj(merge_heads(attend(rotate(q, rope), rotate(k, rope), v)))


class CrossAttention(nn.Module):
    """Multi-head attention from one sequence to a memory; both have rotary positions."""

    def __init__(self, dim: int, head_dim: int) -> None:
        super().__init__()
        self.head_dim = head_dim
        self.projq = nn.Linear(dim, dim)
        self.projk = nn.Linear(dim, dim)
        self.projv = nn.Linear(dim, dim)
        self.proj = nn.Linear(dim, dim)

    def memory(self, m: Float[Tensor, "batch tokens dim"], rope: Rope) -> tuple[Tensor, Tensor]:
        """Keys (rotated) and values of a memory, (batch, heads, tokens, head_dim) each."""
        k = rotate(split_heads(self.projk(m), self.head_dim), rope)
        return k, split_heads(self.projv(m), self.head_dim)

    def forward(
        self, x: Float[Tensor, "batch queries dim"], rope: Rope, k: Tensor, v: Tensor
    ) -> Tensor:
        """Attend to keys and values that `memory` made."""
        q = rotate(split_heads(self.projq(x), self.head_dim), rope)
        return self.proj(merge_heads(attend(q, k, v)))


class Mlp(nn.Module):
    """Two linear layers around an exact (erf) GELU."""

    def __init__(self, dim: int, ratio: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(dim, ratio * dim)
        self.fc2 = nn.Linear(ratio * dim, dim)

    def forward(self, x: Float[Tensor, "*batch dim"]) -> Float[Tensor, "*batch dim"]:
        """Token by token."""
        return self.fc2(F.gelu(self.fc1(x)))


class EncoderBlock(nn.Module):
    """Pre-norm self-attention and MLP."""

    def __init__(self, dim: int, head_dim: int, mlp_ratio: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(dim, NORM_EPS)
        self.attn = SelfAttention(dim, head_dim)
        self.norm2 = nn.LayerNorm(dim, NORM_EPS)
        self.mlp = Mlp(dim, mlp_ratio)

    def forward(self, x: Float[Tensor, "batch tokens dim"], rope: Rope) -> Tensor:
        """Transform each sequence of the batch on its own."""
        x = x + self.attn(self.norm1(x), rope)
        return x + self.mlp(self.norm2(x))


class DecoderBlock(nn.Module):
    """Pre-norm self-attention, cross-attention to a memory, MLP."""

    def __init__(self, dim: int, head_dim: int, mlp_ratio: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(dim, NORM_EPS)
        self.attn = SelfAttention(dim, head_dim)
        self.cross_attn = CrossAttention(dim, head_dim)
        self.norm2 = nn.LayerNorm(dim, NORM_EPS)
        self.norm3 = nn.LayerNorm(dim, NORM_EPS)
        self.mlp = Mlp(dim, mlp_ratio)
        self.norm_y = nn.LayerNorm(dim, NORM_EPS)

    def memory(self, m: Float[Tensor, "batch tokens dim"], rope: Rope) -> tuple[Tensor, Tensor]:
        """Keys and values that this block reads from a memory (normalised by the block)."""
        return self.cross_attn.memory(self.norm_y(m), rope)

    def forward(
        self, x: Float[Tensor, "batch tokens dim"], rope: Rope, k: Tensor, v: Tensor
    ) -> Tensor:
        """Transform x with the memory's keys and values."""
        x = x + self.attn(self.norm1(x), rope)
        x = x + self.cross_attn(self.norm2(x), rope, k, v)
        return x + self.mlp(self.norm3(x))
