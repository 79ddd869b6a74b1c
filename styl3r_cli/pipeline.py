"""Encode a scene once, then give it any colours: the library's front door."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import ModelError, UsageError
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.graphs import Model
from styl3r_cli.photos.load import STYLE_SIDE, Photos
from styl3r_cli.photos.resize import fit_style

# Scene units: far below a pixel in any scene, and its square still a normal float32.
SMALLEST_SCALE = 1e-10
# The network's unit quaternions are off by rounding; more is damage worth telling about.
UNIT_TOLERANCE = 1e-3
LARGEST_WEIGHT = 1e9  # of a style beside others; sums of such stay finite


@dataclass(frozen=True)
class Scene:
    """What the structure graph knows of N views: geometry per pixel, and content tokens.

    Attributes:
        images: (N, 3, H, W) sRGB in [0, 1], the views themselves.
        intrinsics: (N, 3, 3), normalised by width and height.
        means: (N, H, W, 3) in the first view's frame (OpenCV axes).
        scales: (N, H, W, 3) standard deviations, linear.
        rotations: (N, H, W, 4) unit quaternions w x y z.
        opacities: (N, H, W) in [0, 1].
        content_tokens: (N, L, C), for the appearance graph.
    """

    images: FloatArray
    intrinsics: FloatArray
    means: FloatArray
    scales: FloatArray
    rotations: FloatArray
    opacities: FloatArray
    content_tokens: FloatArray


@dataclass(frozen=True)
class Repairs:
    """How many Gaussians the network gave that had to be dropped or mended."""

    dropped_not_finite: int = 0
    clamped_opacities: int = 0
    floored_scales: int = 0
    normalised_rotations: int = 0

    def to_dict(self) -> dict[str, int]:
        """Counts by name, zeros included."""
        return asdict(self)

    def __str__(self) -> str:
        """The counts that are not zero, in words; empty if nothing was repaired."""
        counts = [f"{n} {name.replace('_', ' ')}" for name, n in asdict(self).items() if n]
        return ", ".join(counts)


class Stylizer:
    """A loaded model: `encode` a scene once, then ask for as many `colours` as you like.

    Example:
        >>> stylizer = Stylizer("mini")
        >>> scene = stylizer.encode(load_photos(paths))
        >>> gaussians, repairs = stylizer.gaussians(scene, [load_style(path).image])
    """

    def __init__(
        self,
        model: Model | str = "mini",
        device: str = "auto",
        threads: int | None = None,
        one_scene: bool = False,
    ) -> None:
        """Load a model.

        Args:
            model: "mini", a model folder, or an already loaded `Model`.
            device: "cpu", "cuda" or "auto".
            threads: for the graphs; None for every core this process may use.
            one_scene: that it will encode one scene only: a small model then loads in half the
                time, and encodes a fifth slower.

        Raises:
            ModelError: the model is missing, damaged or of another kind.
        """
        if isinstance(model, str):
            model = Model.load(model, device, threads, one_scene)
        self.model = model

    def encode(self, photos: Photos) -> Scene:
        """Geometry and content tokens of a scene (the structure graph, once a scene)."""
        outputs = self.model.structure({"images": photos.images, "intrinsics": photos.intrinsics})
        return Scene(photos.images, photos.intrinsics, **outputs)

    def colours(
        self,
        scene: Scene,
        styles: Sequence[FloatArray] = (),
        weights: Sequence[float] | None = None,
        strength: float = 1.0,
    ) -> FloatArray:
        """Colours of every pixel's Gaussian (the appearance graph alone).

        The scene's own colours come from its first photo standing in for a style picture
        (content as style, paper section 3.3). `strength` weighs the styles' tokens against that
        photo's; at 0 and 1 the other side is not read at all.

        Args:
            scene: from `encode`.
            styles: style pictures (3, h, w), sRGB in [0, 1], all of one size.
            weights: one per style, not all zero; None for equal ones. Only ratios matter.
            strength: 0 for the scene's own colours, 1 for the styles'.

        Returns:
            (N, H, W, 3) sRGB, not clipped.

        Raises:
            UsageError: the weights or the strength make no sense.
            ModelError: the graph failed.
        """
        if not 0.0 <= strength <= 1.0:
            raise UsageError(f"strength {strength:g}: 0 (own colours) to 1 (the style's)")
        shares = style_shares(len(styles), weights)
        pictures = [
            (_in_range(style, self.model.style_range), strength * share)
            for style, share in zip(styles, shares, strict=True)
            if strength * share > 0
        ]
        if strength < 1:
            side = pictures[0][0].shape[-1] if pictures else STYLE_SIDE
            pictures.append((self._content(scene, side), 1.0 - strength))
        if not pictures:
            raise UsageError("no style: strength above 0 needs at least one style picture")
        feeds = {
            "content_tokens": scene.content_tokens,
            "style_images": np.stack([picture for picture, _ in pictures]),
            "style_weights": np.array([share for _, share in pictures], np.float32),
            "images": scene.images,
        }
        return self.model.appearance(feeds)["colours"]

    def gaussians(
        self,
        scene: Scene,
        styles: Sequence[FloatArray] = (),
        weights: Sequence[float] | None = None,
        strength: float = 1.0,
    ) -> tuple[Gaussians, Repairs]:
        """One Gaussian a pixel in the colours that `colours` gives, ready for a file."""
        return assemble(scene, self.colours(scene, styles, weights, strength))

    def _content(self, scene: Scene, side: int) -> FloatArray:
        """The first view as a style picture, (3, side, side)."""
        from PIL import Image

        pixels = np.rint(scene.images[0].transpose(1, 2, 0) * 255).astype(np.uint8)
        fitted = fit_style(Image.fromarray(pixels), side).transpose(2, 0, 1)
        return _in_range(fitted.astype(np.float32) / np.float32(255), self.model.content_range)


def assemble(
    scene: Scene, colours: FloatArray, wanted: NDArray[np.bool_] | None = None
) -> tuple[Gaussians, Repairs]:
    """Flatten a scene into Gaussians, views first, and mend what the network got wrong.

    A Gaussian with a value that is not finite, or without a direction, is dropped; opacities are
    clamped to [0, 1], scales floored so that their logarithm is finite, rotations normalised.

    Args:
        scene: the geometry.
        colours: (N, H, W, 3) sRGB.
        wanted: (N, H, W), the pixels whose Gaussians to take; None for all.

    Raises:
        ModelError: nothing is left.
    """
    means, scales = scene.means.reshape(-1, 3), scene.scales.reshape(-1, 3)
    rotations, opacities = scene.rotations.reshape(-1, 4), scene.opacities.reshape(-1)
    colours = colours.reshape(-1, 3)
    lengths = np.linalg.norm(rotations, axis=1)
    kept = np.isfinite(opacities) & np.isfinite(lengths) & (lengths > 0)
    for array in (means, scales, colours):
        kept &= np.isfinite(array).all(axis=1)
    chosen = np.ones_like(kept) if wanted is None else wanted.reshape(-1)
    dropped = int(np.count_nonzero(chosen & ~kept))
    kept &= chosen
    if not kept.any():
        raise ModelError("the model gave no finite Gaussian; the photos or the model are unusual")
    if not kept.all():
        means, scales, rotations = means[kept], scales[kept], rotations[kept]
        opacities, colours, lengths = opacities[kept], colours[kept], lengths[kept]
    repairs = Repairs(
        dropped_not_finite=dropped,
        clamped_opacities=int(np.count_nonzero((opacities < 0) | (opacities > 1))),
        floored_scales=int(np.count_nonzero((scales < SMALLEST_SCALE).any(axis=1))),
        normalised_rotations=int(np.count_nonzero(np.abs(lengths - 1) > UNIT_TOLERANCE)),
    )
    gaussians = Gaussians(
        means,
        np.maximum(scales, np.float32(SMALLEST_SCALE)),
        rotations / lengths[:, None],
        np.clip(opacities, 0, 1),
        colours,
    )
    return gaussians, repairs


def style_shares(count: int, weights: Sequence[float] | None) -> list[float]:
    """The weights as shares of 1.

    Raises:
        UsageError: there are not as many, one is no weight, or all are 0.
    """
    given = [1.0] * count if weights is None else [float(weight) for weight in weights]
    if len(given) != count:
        raise UsageError(f"{count} styles but {len(given)} weights")
    if not all(0 <= weight <= LARGEST_WEIGHT for weight in given):  # NaN is not, either
        raise UsageError(f"style weights must be numbers from 0 to {LARGEST_WEIGHT:g}")
    total = math.fsum(given)
    if count and total == 0:
        raise UsageError("all style weights are 0; one at least must count")
    return [weight / total for weight in given]


def _in_range(picture: FloatArray, limits: tuple[float, float]) -> FloatArray:
    """A picture in [0, 1] to the range that the style encoder reads it in."""
    low, high = limits
    return picture if limits == (0.0, 1.0) else picture * np.float32(high - low) + np.float32(low)
