"""The one place where `full` and `mini` differ: a configuration and its two instances."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal, get_args, get_type_hints

# One view in, one patch row or column a 16 px square: every size is a multiple of this.
PATCH = 16
# Far beyond any network, and built in a moment: what a damaged file asks for may take for ever.
MOST_LAYERS, WIDEST = 256, 1 << 14
# Names are put into messages, into graphs and into what they are called.
NAME = re.compile(r"\w[\w.-]{0,63}", re.ASCII)


@dataclass(frozen=True)
class ModelConfig:
    """Sizes and switches of the network; the defaults are the published ones."""

    name: str = "full"

    # Channels of one attention head, the same everywhere; RoPE splits it between y and x.
    head_dim: int = 64
    # MLP width over token width.
    mlp_ratio: int = 4

    # Content encoder: token width and number of blocks (ViT-Large in the published network).
    encoder_dim: int = 1024
    encoder_depth: int = 24
    # Style encoder: the same shape, its own weights.
    style_depth: int = 24
    # Structure and stylization decoders.
    decoder_dim: int = 768
    decoder_depth: int = 12
    stylizer_depth: int = 12
    # The decoder layers that the dense heads read, besides the encoder's tokens.
    hooks: tuple[int, int, int] = (6, 9, 12)

    # Dense heads: channels of the four reassembled maps, of the fusion path, and of the last
    # convolutions of the point head.
    head_maps: tuple[int, int, int, int] = (96, 192, 384, 768)
    head_features: int = 256
    point_features: int = 128

    # "patchify": one 16x16 convolution. "pyramid": a convolutional stem to 1/8, whose maps at
    # 1/2, 1/4 and 1/8 also reach the structure heads (fine edges that 16 px tokens lose).
    stem: Literal["patchify", "pyramid"] = "patchify"
    # Rounds of the recurrent flow on the stem's maps that matches the first view with every other
    # one, where points lie on rays: attention need not invent matching. On real pairs 6 found
    # slightly worse cameras, and each takes a twentieth of the structure graph's time.
    flow_rounds: int = 7
    # "free": the point head gives points in the first view's frame (published).
    # "rays": it gives depth along each pixel's ray, cameras come from matches by bundle adjustment
    # and the intrinsics token, and matches pull depths to where the views' points meet.
    points: Literal["free", "rays"] = "free"
    # Colours: "tokens": the stylization decoder's tokens give the SH DC coefficient (published).
    # "strokes": local convolutions in a style's statistics draw the photos anew, which learn from
    # pictures alone and carry brush strokes that 16 px tokens lose.
    colours: Literal["tokens", "strokes"] = "tokens"
    # Whether maps of strokes are blurred as they are enlarged: without it (published) strokes hang
    # on the grid of the maps, and a picture moved by a pixel is drawn otherwise.
    smooth_strokes: bool = False
    # Range of a content photo that stands in for a style; paintings are always in [0, 1]
    # (spec section 7: the published network reads the two differently).
    photo_as_style: Literal["signed", "unit"] = "signed"

    @property
    def camera_head(self) -> bool:
        """Whether the intrinsics token is read as the view's camera."""
        return self.points == "rays"

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as the graphs' metadata stores them."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> ModelConfig:
        """The inverse of `to_dict` (lists from JSON become tuples again).

        Raises:
            ValueError: fields are unknown, of another kind, or no network's sizes.
        """
        known = {f.name for f in fields(cls)}
        unknown = sorted(str(name) for name in set(values) - known)
        if unknown:
            raise ValueError(f"unknown configuration fields: {', '.join(unknown)}")
        plain: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in values.items()
        }
        config = cls(**plain)
        _check_fields(config)
        _check_sizes(config)
        return config


def _check_fields(config: ModelConfig) -> None:
    """Make sure that every field is of its kind, each number alone a possible one.

    Raises:
        ValueError: one is not.
    """
    kinds = get_type_hints(ModelConfig)
    usual: Any  # the default's kind is the field's
    for field in fields(ModelConfig):
        value, usual = getattr(config, field.name), field.default
        allowed = get_args(kinds[field.name]) if isinstance(usual, str) else ()
        if type(value) is not type(usual) or (allowed and value not in allowed):
            raise ValueError(f"configuration field {field.name} is no {allowed or type(usual)}")
        numbers = value if isinstance(usual, tuple) else (value,) if type(usual) is int else ()
        most = MOST_LAYERS if field.name.endswith(("depth", "rounds")) else WIDEST
        if not all(type(n) is int and 1 <= n <= most for n in numbers):
            raise ValueError(f"configuration field {field.name} is outside 1 to {most}")
        if isinstance(usual, tuple) and len(value) != len(usual):
            raise ValueError(f"configuration field {field.name} has not {len(usual)} values")
    if not NAME.fullmatch(config.name):
        raise ValueError("the configuration's name is no name")


def _check_sizes(config: ModelConfig) -> None:
    """Make sure that sizes belong together.

    Raises:
        ValueError: they do not.
    """
    if config.head_dim % 4:  # pairs of channels for y, as many for x
        raise ValueError(f"head_dim {config.head_dim} is no multiple of 4")
    for width in (config.encoder_dim, config.decoder_dim):
        if width % config.head_dim:
            raise ValueError(f"width {width} is no multiple of head_dim {config.head_dim}")
    depths = [config.decoder_depth]
    if config.colours == "tokens":
        depths.append(config.stylizer_depth)
    for depth in depths:
        # Hooks of the stylization decoder are the structure decoder's, scaled to its depth.
        read = [hook * depth // config.decoder_depth for hook in config.hooks]
        if len({0, *read}) != 1 + len(read) or read != sorted(read) or read[-1] > depth:
            raise ValueError(f"hooks {config.hooks} are not in order within {depth} layers")


FULL = ModelConfig()

MINI = ModelConfig(
    name="mini",
    head_dim=32,
    encoder_dim=192,
    encoder_depth=4,
    decoder_dim=192,
    decoder_depth=6,
    hooks=(2, 4, 6),
    head_maps=(32, 48, 96, 96),
    head_features=48,
    point_features=32,
    stem="pyramid",
    points="rays",
    colours="strokes",
    smooth_strokes=True,
    photo_as_style="unit",
)

# Beside it, to measure what its size is worth: 0.4 and 1.3 times its parameters.
MINI_SMALL = replace(
    MINI,
    name="mini-small",
    encoder_dim=128,
    encoder_depth=2,
    decoder_dim=128,
    decoder_depth=4,
    hooks=(1, 2, 4),
    head_maps=(32, 32, 64, 64),
    head_features=32,
    point_features=32,
)
MINI_LARGE = replace(
    MINI,
    name="mini-large",
    encoder_dim=224,
    decoder_dim=224,
)

CONFIGS = {config.name: config for config in (FULL, MINI, MINI_SMALL, MINI_LARGE)}
