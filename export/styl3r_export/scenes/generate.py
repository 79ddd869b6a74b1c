"""A seed becomes a scene, cameras in it that overlap, and its photographs with exact depth."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes import indoors, outdoors
from styl3r_export.scenes.builder import Scene, SceneBuilder, Stage
from styl3r_export.scenes.lighting import light_maps, look_at
from styl3r_export.scenes.paths import (
    MIN_OVERLAP,
    camera_path,
    draw_baseline,
    draw_field_of_view,
    overlap,
)
from styl3r_export.scenes.photometry import Shot, develop, draw_shots, exposure
from styl3r_export.scenes.render import render
from styl3r_export.scenes.textures import TextureBank
from styl3r_export.scenes.visibility import first_hits, to_camera

#: Kinds of scenes and how often each is made.
KINDS: dict[str, tuple[Callable[[SceneBuilder], Stage], float]] = {
    "room": (indoors.room, 0.34),
    "tabletop": (indoors.tabletop, 0.24),
    "street": (outdoors.street, 0.14),
    "garden": (outdoors.garden, 0.13),
    "relief": (outdoors.relief, 0.08),
    "clutter": (indoors.clutter, 0.07),
}
#: Odds of scenes with pictures everywhere, with some plain surfaces, with mostly plain ones.
CALM_ODDS = (0.55, 0.33, 0.12)
#: Side of the depth maps that decide whether a path is any good.
SCOUT_SIDE = 40
#: Nothing may be nearer than this share of the median depth (2nd percentile).
NEAREST = 0.12
#: A first view that shows fewer parts is a bare wall; only a tenth of those is kept.
MIN_PARTS = 4
#: Paths tried in one scene, and scenes tried for one seed.
PATH_TRIES = 60
SCENE_TRIES = 20
#: After this many failures a path is shortened by this factor.
SHORTEN_AFTER, SHORTER = 12, 0.7


@dataclass(frozen=True)
class SceneViews:
    """V photographs of one static scene, ordered along the camera's movement.

    Attributes:
        images: (V, 3, H, W) float32 sRGB in [0, 1].
        depth: (V, H, W) float32 camera z depth, scene units (about metres), of pixel centres.
        sky: (V, H, W) bool, where depth is a backdrop's.
        extrinsics: (V, 4, 4) float64 world-to-camera, OpenCV axes; view 0 is the identity.
        intrinsics: (V, 3, 3) float64, normalised by width and height.
        kind: which kind of scene.
    """

    images: NDArray[np.float32]
    depth: NDArray[np.float32]
    sky: NDArray[np.bool_]
    extrinsics: NDArray[np.float64]
    intrinsics: NDArray[np.float64]
    kind: str


class _Scout:
    """Quick small depth maps of a scene."""

    def __init__(self, scene: Scene, focal: float) -> None:
        self.scene, self.focal = scene, focal
        self.hits = np.empty((SCOUT_SIDE, SCOUT_SIDE), np.int32)

    def depth(self, extrinsics: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n, n) depth, huge where nothing is hit."""
        inverse = np.empty((SCOUT_SIDE, SCOUT_SIDE), np.float32)
        lens = (self.focal, self.focal, SCOUT_SIDE / 2, SCOUT_SIDE / 2)
        first_hits(to_camera(self.scene.vertices, extrinsics), lens, inverse, self.hits)
        return np.reciprocal(np.maximum(inverse, 1e-6))

    def parts_in_sight(self, extrinsics: NDArray[np.float64]) -> int:
        """How many parts of the scene can be made out."""
        self.depth(extrinsics)
        seen = np.bincount(self.scene.parts[self.hits[self.hits >= 0]])
        return int((seen >= 4).sum())

    def ahead(self, eye: NDArray[np.float64], target: NDArray[np.float64]) -> float:
        """Median depth from a viewpoint; 0 if something blocks it."""
        depth = self.depth(look_at(eye, target))
        middle = float(np.median(depth))
        return 0.0 if np.percentile(depth, 2) < NEAREST * middle else middle


def _cameras(
    rng: np.random.Generator, scene: Scene, stage: Stage, views: int, focal: float
) -> NDArray[np.float64] | None:
    """A path whose views are unblocked and overlap with the first, or None."""
    scout = _Scout(scene, focal * SCOUT_SIDE)
    # The length is drawn once: drawing it anew after each failure would favour short ones.
    baseline = draw_baseline(rng)
    for attempt in range(PATH_TRIES):
        if attempt and attempt % SHORTEN_AFTER == 0:
            baseline *= SHORTER
        path = camera_path(rng, stage, scout.ahead, baseline, views)
        if path is None:
            continue
        depths = np.stack([scout.depth(e) for e in path])
        if scout.parts_in_sight(path[0]) < MIN_PARTS and rng.random() < 0.9:
            continue
        middles = np.median(depths, axis=(1, 2))
        blocked = np.percentile(depths, 2, axis=(1, 2)) < NEAREST * middles
        if blocked.any() or middles.max() > 60 or middles.max() > 4 * middles.min():
            continue
        # A margin over the promise, since the small maps are coarse.
        if overlap(depths, path, focal * SCOUT_SIDE).min() >= MIN_OVERLAP + 0.03:
            return path
    return None


def generate(
    seed: int,
    views: int,
    size: tuple[int, int] = (256, 256),
    textures: TextureBank | None = None,
    kind: str | None = None,
    photometric: bool = True,
) -> SceneViews:
    """Make one scene.

    Args:
        seed: the same seed, sizes and bank give the same scene, bit for bit.
        views: how many photographs, 1 or more.
        size: height and width in pixels.
        textures: what surfaces are covered with; None draws patterns.
        kind: a key of KINDS; None draws one.
        photometric: vary exposure, white balance, noise, blur and JPEG per view.

    Raises:
        RuntimeError: no scene with overlapping views was found for this seed.
    """
    bank = TextureBank.procedural(0) if textures is None else textures
    odds = np.array([share for _, share in KINDS.values()])
    drawn = np.random.default_rng(seed).choice(len(KINDS), p=odds / odds.sum())
    name = kind or list(KINDS)[int(drawn)]
    for attempt in range(SCENE_TRIES):
        rng = np.random.default_rng([seed, attempt])
        calm = float(rng.choice([0.0, 0.4, 0.9], p=CALM_ODDS))
        builder = SceneBuilder(rng, bank, calm=calm)
        stage = KINDS[name][0](builder)
        scene = builder.finished()
        focal = 0.5 / np.tan(draw_field_of_view(rng) / 2)
        path = _cameras(rng, scene, stage, views, focal)
        if path is not None:
            return _photographed(rng, scene, stage, path, focal, size, name, photometric)
    raise RuntimeError(f"seed {seed}: no overlapping views in {SCENE_TRIES} scenes")


def _photographed(
    rng: np.random.Generator, scene: Scene, stage: Stage, path: NDArray[np.float64], focal: float,
    size: tuple[int, int], name: str, photometric: bool,
) -> SceneViews:  # fmt: skip
    height, width = size
    shorter = min(size)  # the field of view is the square crop's
    lens = (focal * shorter, focal * shorter, width / 2, height / 2)
    maps = light_maps(scene, stage.low, stage.high)
    rendered = [render(scene, maps, extrinsics, lens, size) for extrinsics in path]
    factor = exposure(rendered[0][0], rng)
    focus = float(np.median(rendered[0][1]))
    shots = draw_shots(rng, len(path), focus) if photometric else [Shot()] * len(path)
    images = [
        develop(factor * linear, shot, rng, depth)
        for (linear, depth, _), shot in zip(rendered, shots, strict=True)
    ]
    backdrop = np.array([m.sky for m in scene.materials] + [True])  # index -1: nothing hit
    intrinsics = np.array(
        [[lens[0] / width, 0, 0.5], [0, lens[1] / height, 0.5], [0, 0, 1]], np.float64
    )
    relative = path @ np.linalg.inv(path[0])
    relative[0] = np.eye(4)  # exactly
    return SceneViews(
        np.stack(images).transpose(0, 3, 1, 2),
        np.stack([depth for _, depth, _ in rendered]),
        backdrop[np.stack([parts for _, _, parts in rendered])],
        relative,
        np.tile(intrinsics, (len(path), 1, 1)),
        name,
    )
