"""The published network restated in float64, slowly: views in loops, attention written out.

It reads parameters by their published names and shares no code with the package, so that a
mistake in one is unlikely to be a mistake in the other. Section numbers are the paper's parts:
encoder, decoders, dense heads, activations.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

Weights = dict[str, Tensor]
Tokens = tuple[Tensor, list[tuple[int, int]]]  # (tokens, dim), and each token's (y, x)


class Oracle:
    """One scene through the published network, with a given configuration's sizes."""

    def __init__(
        self,
        weights: Weights,
        head_dim: int,
        depths: tuple[int, int, int, int],
        hooks: tuple[int, int, int],
        eps: float = 1e-6,
    ) -> None:
        """`depths`: content encoder, style encoder, structure decoder, stylization decoder."""
        self.w = {name: value.double() for name, value in weights.items()}
        self.head_dim = head_dim
        self.encoder, self.style_encoder, self.decoder, self.stylizer = depths
        self.hooks = hooks
        self.eps = eps

    # ------------------------------------------------------------------ parts

    def linear(self, name: str, x: Tensor) -> Tensor:
        """Matrix product and bias."""
        return x @ self.w[f"{name}.weight"].T + self.w[f"{name}.bias"]

    def norm(self, name: str, x: Tensor) -> Tensor:
        """LayerNorm with biased variance."""
        centred = x - x.mean(-1, keepdim=True)
        scaled = centred / torch.sqrt((centred**2).mean(-1, keepdim=True) + self.eps)
        return scaled * self.w[f"{name}.weight"] + self.w[f"{name}.bias"]

    def mlp(self, name: str, x: Tensor) -> Tensor:
        """Two layers around x Phi(x)."""
        h = self.linear(f"{name}.fc1", x)
        return self.linear(f"{name}.fc2", h * 0.5 * (1 + torch.erf(h / math.sqrt(2))))

    def turned(self, vector: Tensor, position: tuple[int, int]) -> Tensor:
        """Rotary embedding of one head's channels of one token: first half by y, second by x."""
        out = vector.clone()
        half = self.head_dim // 2
        for start, place in ((0, position[0]), (half, position[1])):
            for k in range(half // 2):
                angle = place * 100 ** (-k / (half // 2))
                a, b = vector[start + k], vector[start + k + half // 2]
                out[start + k] = a * math.cos(angle) - b * math.sin(angle)
                out[start + k + half // 2] = b * math.cos(angle) + a * math.sin(angle)
        return out

    def attend(self, q: Tokens, k: Tokens, v: Tensor) -> Tensor:
        """Softmax attention, head by head."""
        d, outs = self.head_dim, []
        for head in range(q[0].shape[-1] // d):
            part = slice(head * d, (head + 1) * d)
            queries = torch.stack([self.turned(t[part], p) for t, p in zip(*q, strict=True)])
            keys = torch.stack([self.turned(t[part], p) for t, p in zip(*k, strict=True)])
            scores = torch.exp(queries @ keys.T / math.sqrt(d))
            outs.append(scores / scores.sum(-1, keepdim=True) @ v[:, part])
        return torch.cat(outs, -1)

    def self_attention(self, name: str, x: Tensor, places: list[tuple[int, int]]) -> Tensor:
        """Rows of qkv are q, k, v; each is head-major."""
        dim = x.shape[-1]
        qkv = self.linear(f"{name}.qkv", x)
        q, k, v = qkv[:, :dim], qkv[:, dim : 2 * dim], qkv[:, 2 * dim :]
        return self.linear(f"{name}.proj", self.attend((q, places), (k, places), v))

    def encoder_block(self, name: str, x: Tensor, places: list[tuple[int, int]]) -> Tensor:
        """Pre-norm, residual."""
        x = x + self.self_attention(f"{name}.attn", self.norm(f"{name}.norm1", x), places)
        return x + self.mlp(f"{name}.mlp", self.norm(f"{name}.norm2", x))

    def decoder_block(self, name: str, tokens: Tokens, memory: Tokens) -> Tensor:
        """Self-attention, then the normalised memory, then the MLP."""
        x, places = tokens
        x = x + self.self_attention(f"{name}.attn", self.norm(f"{name}.norm1", x), places)
        m = self.norm(f"{name}.norm_y", memory[0])
        q = self.linear(f"{name}.cross_attn.projq", self.norm(f"{name}.norm2", x))
        k = self.linear(f"{name}.cross_attn.projk", m)
        v = self.linear(f"{name}.cross_attn.projv", m)
        read = self.attend((q, places), (k, memory[1]), v)
        x = x + self.linear(f"{name}.cross_attn.proj", read)
        return x + self.mlp(f"{name}.mlp", self.norm(f"{name}.norm3", x))

    def conv(self, name: str, x: Tensor, stride: int = 1, pad: int = 0) -> Tensor:
        """One picture's convolution."""
        bias = self.w.get(f"{name}.bias")
        return F.conv2d(x[None], self.w[f"{name}.weight"], bias, stride, pad)[0]

    def patches(self, name: str, picture: Tensor) -> Tokens:
        """Row-major tokens of 16 px squares, and their places."""
        x = self.conv(f"{name}.patch_embed.proj", picture, stride=16)
        rows, columns = x.shape[1:]
        places = [(r, c) for r in range(rows) for c in range(columns)]
        return torch.stack([x[:, r, c] for r, c in places]), places

    # ------------------------------------------------------------------ transformers

    def content(self, image: Tensor, k: Tensor) -> Tokens:
        """One view's tokens; the camera's own comes last, one row below the patches."""
        x, places = self.patches("backbone", image.double() * 2 - 1)
        camera = self.linear("backbone.intrinsic_encoder", k.double().reshape(9))
        x = torch.cat((x, camera[None]))
        places = [*places, (image.shape[1] // 16, 0)]
        for i in range(self.encoder):
            x = self.encoder_block(f"backbone.enc_blocks.{i}", x, places)
        return self.norm("backbone.enc_norm", x), places

    def structure_hooks(self, content: list[Tokens]) -> list[list[Tensor]]:
        """For each view, the four token maps that its heads read."""
        places = [p for _, p in content]
        layers = [[self.linear("backbone.decoder_embed", e) for e, _ in content]]
        for layer in range(self.decoder):
            before, after = layers[-1], []
            for i in range(len(content)):
                others = [j for j in range(len(content)) if j != i]
                memory = torch.cat([before[j] for j in others])
                memory_places = [p for j in others for p in places[j]]
                stack = "dec_blocks" if i == 0 else "dec_blocks2"
                name = f"backbone.{stack}.{layer}"
                after.append(
                    self.decoder_block(name, (before[i], places[i]), (memory, memory_places))
                )
            layers.append(after)
        layers[-1] = [self.norm("backbone.dec_norm", x) for x in layers[-1]]
        return [
            [e[:-1], *(layers[hook][i][:-1] for hook in self.hooks)]
            for i, (e, _) in enumerate(content)
        ]

    def style(self, picture: Tensor) -> Tokens:
        """A style picture's tokens."""
        x, places = self.patches("token_stylizer", picture.double())
        for i in range(self.style_encoder):
            x = self.encoder_block(f"token_stylizer.enc_blocks.{i}", x, places)
        return self.norm("token_stylizer.enc_norm", x), places

    def colour_hooks(self, content: list[Tokens], style: Tokens) -> list[list[Tensor]]:
        """The same as `structure_hooks` for the colour head."""
        places = [p for _, ps in content for p in ps]
        x = torch.cat([self.linear("token_stylizer.decoder_embed", e) for e, _ in content])
        memory = self.linear("token_stylizer.decoder_embed", style[0])
        layers = [x]
        for layer in range(self.stylizer):
            name = f"token_stylizer.dec_blocks.{layer}"
            layers.append(self.decoder_block(name, (layers[-1], places), (memory, style[1])))
        layers[-1] = self.norm("token_stylizer.dec_norm", layers[-1])
        length = len(content[0][1])
        return [
            [e[:-1], *(layers[h][i * length : (i + 1) * length - 1] for h in self.hooks)]
            for i, (e, _) in enumerate(content)
        ]

    # ------------------------------------------------------------------ dense heads

    def twice(self, x: Tensor) -> Tensor:
        """Bilinear, corners aligned: output pixel i reads input place i (n - 1) / (2n - 1)."""
        for axis in (1, 2):
            n = x.shape[axis]
            place = torch.arange(2 * n, dtype=torch.float64) * (n - 1) / (2 * n - 1)
            low = place.floor().long().clamp(max=n - 1)
            high = (low + 1).clamp(max=n - 1)
            t = (place - low).reshape((-1, 1) if axis == 1 else (-1,))
            x = x.index_select(axis, low) * (1 - t) + x.index_select(axis, high) * t
        return x

    def residual(self, name: str, x: Tensor) -> Tensor:
        """The skip is the raw input."""
        y = self.conv(f"{name}.conv1", x.clamp(min=0), pad=1)
        return x + self.conv(f"{name}.conv2", y.clamp(min=0), pad=1)

    def fusion(self, name: str, path: Tensor, skip: Tensor | None) -> Tensor:
        """Upsample, then the 1x1 convolution."""
        if skip is not None:
            path = path + self.residual(f"{name}.resConfUnit1", skip)
        return self.conv(
            f"{name}.out_conv", self.twice(self.residual(f"{name}.resConfUnit2", path))
        )

    def trunk(self, head: str, hooks: list[Tensor], rows: int, columns: int) -> Tensor:
        """Token maps reassembled at four scales and fused from coarse to fine."""
        maps = [h.T.reshape(-1, rows, columns) for h in hooks]
        post = f"{head}.dpt.act_postprocess"
        for k, stride in ((0, 4), (1, 2)):
            x = self.conv(f"{post}.{k}.0", maps[k])[None]
            weight, bias = self.w[f"{post}.{k}.1.weight"], self.w[f"{post}.{k}.1.bias"]
            maps[k] = F.conv_transpose2d(x, weight, bias, stride)[0]
        maps[2] = self.conv(f"{post}.2.0", maps[2])
        maps[3] = self.conv(f"{post}.3.1", self.conv(f"{post}.3.0", maps[3]), stride=2, pad=1)
        scratch = f"{head}.dpt.scratch"
        levels = [self.conv(f"{scratch}.layer{n}_rn", maps[n - 1], pad=1) for n in (1, 2, 3, 4)]
        path = self.fusion(f"{scratch}.refinenet4", levels[3], None)[:, :rows, :columns]
        for n in (3, 2, 1):
            path = self.fusion(f"{scratch}.refinenet{n}", path, levels[n - 1])
        return path

    def point_head(self, head: str, hooks: list[Tensor], rows: int, columns: int) -> Tensor:
        """Raw x y z."""
        x = self.conv(f"{head}.dpt.head.0", self.trunk(head, hooks, rows, columns), pad=1)
        x = self.conv(f"{head}.dpt.head.2", self.twice(x), pad=1)
        return self.conv(f"{head}.dpt.head.4", x.clamp(min=0))

    def gaussian_head(
        self, head: str, hooks: list[Tensor], rows: int, columns: int, image: Tensor | None
    ) -> Tensor:
        """Raw channels of structure (with the picture) or colours."""
        x = self.twice(self.trunk(head, hooks, rows, columns))
        if image is not None:
            picture = image.double() * 2 - 1
            x = x + self.conv(f"{head}.dpt.input_merger.0", picture, pad=3).clamp(min=0)
        x = self.conv(f"{head}.dpt.head.0", x, pad=1).clamp(min=0)
        return self.conv(f"{head}.dpt.head.4", x)

    # ------------------------------------------------------------------ a scene

    def structure(self, images: Tensor, intrinsics: Tensor) -> dict[str, Tensor]:
        """Means, scales, rotations (w x y z), opacities and content tokens."""
        rows, columns = images.shape[-2] // 16, images.shape[-1] // 16
        content = [self.content(i, k) for i, k in zip(images, intrinsics, strict=True)]
        out: dict[str, list[Tensor]] = {
            k: [] for k in ("means", "scales", "rotations", "opacities")
        }
        for i, hooks in enumerate(self.structure_hooks(content)):
            points, params = ("downstream_head1", "gaussian_param_head")
            if i > 0:
                points, params = ("downstream_head2", "gaussian_param_head2")
            v = self.point_head(points, hooks, rows, columns).permute(1, 2, 0)
            raw = self.gaussian_head(params, hooks, rows, columns, images[i]).permute(1, 2, 0)
            length = torch.sqrt((v**2).sum(-1, keepdim=True))
            out["means"].append(v / length.clamp(min=1e-8) * torch.expm1(length))
            out["opacities"].append(1 / (1 + torch.exp(-raw[..., 0])))
            out["scales"].append((0.001 * torch.log1p(torch.exp(raw[..., 1:4]))).clamp(max=0.3))
            xyzw = raw[..., 4:]
            xyzw = xyzw / (torch.sqrt((xyzw**2).sum(-1, keepdim=True)) + 1e-8)
            out["rotations"].append(xyzw[..., [3, 0, 1, 2]])
        result = {k: torch.stack(v) for k, v in out.items()}
        return result | {"content_tokens": torch.stack([e for e, _ in content])}

    def appearance(
        self, images: Tensor, intrinsics: Tensor, styles: Tensor, weights: Tensor
    ) -> Tensor:
        """Colours; the styles' tokens are mixed before the stylization decoder."""
        rows, columns = images.shape[-2] // 16, images.shape[-1] // 16
        content = [self.content(i, k) for i, k in zip(images, intrinsics, strict=True)]
        encoded = [self.style(s) for s in styles]
        mixed = sum(float(w) * tokens for w, (tokens, _) in zip(weights, encoded, strict=True))
        hooks = self.colour_hooks(content, (torch.as_tensor(mixed), encoded[0][1]))
        head = "gaussian_appearance_head"
        sh = [self.gaussian_head(head, h, rows, columns, None).permute(1, 2, 0) for h in hooks]
        return 0.28209479177387814 * torch.stack(sh) + 0.5
