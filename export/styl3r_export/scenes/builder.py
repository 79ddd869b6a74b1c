"""Collects textured parts into one scene that can be rendered from any camera."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.meshes import Mesh
from styl3r_export.scenes.patterns import colour
from styl3r_export.scenes.textures import TextureBank, pyramids


@dataclass(frozen=True)
class Material:
    """How a surface looks. Lengths are in scene units (about metres).

    Attributes:
        tint: linear RGB factor (the albedo itself where there is no texture).
        texture: index into the scene's textures, -1 for none.
        scale: length that one texture covers.
        triplanar: projected along world axes instead of by the mesh's coordinates.
        mirrored: neighbouring copies are mirrored, so photos have no seams.
        gloss: strength of highlights and sheen.
        sharpness: exponent of the highlight.
        stain: strength of slow brightness noise.
        stain_scale: its wavelength.
        bump: strength of the normals' noise.
        bump_scale: its wavelength.
        glow: radiates its own colour and takes no light.
        sky: a backdrop that stands for infinity.
        casts: throws shadows.
    """

    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: int = -1
    scale: float = 1.0
    triplanar: bool = False
    mirrored: bool = True
    gloss: float = 0.0
    sharpness: float = 20.0
    stain: float = 0.0
    stain_scale: float = 1.0
    bump: float = 0.0
    bump_scale: float = 0.1
    glow: bool = False
    sky: bool = False
    casts: bool = True


@dataclass(frozen=True)
class Light:
    """A lamp or the sun, with its own shadows.

    Attributes:
        position: (3,) where it stands (far away for the sun).
        target: (3,) what it points at.
        spread: full angle of its cone, radians.
        colour: linear RGB irradiance at the target.
        falls_off: brightness sinks with the square of the distance.
        softness: width of the shadows' edges, in texels of its shadow map.
    """

    position: NDArray[np.float64]
    target: NDArray[np.float64]
    spread: float
    colour: NDArray[np.float64]
    falls_off: bool
    softness: float


@dataclass(frozen=True)
class Stage:
    """Where a camera may stand in a scene and what it looks at.

    Attributes:
        viewpoint: draws an (eye, target) pair, each (3,), z up.
        low: (3,) lower corner of the space that eyes stay in.
        high: (3,) upper corner.
        orbit: probability that the camera circles its target.
    """

    viewpoint: Callable[[np.random.Generator], tuple[NDArray[np.float64], NDArray[np.float64]]]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    orbit: float = 0.5


@dataclass(frozen=True)
class Scene:
    """Everything the renderer reads.

    Attributes:
        vertices: (T, 3, 3) world positions, z up.
        normals: (T, 3, 3).
        uvs: (T, 3, 2) in lengths.
        parts: (T,) index of the material.
        materials: the table.
        textures: (K, texels, 3) mip pyramids.
        lights: with shadows.
        ambient: (2, 3) linear RGB from above and from below.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    uvs: NDArray[np.float32]
    parts: NDArray[np.int32]
    materials: list[Material]
    textures: NDArray[np.uint8]
    lights: list[Light]
    ambient: NDArray[np.float64]


#: Pictures one scene draws from its bank; parts share them at different scales.
TEXTURES_PER_SCENE = 18


@dataclass
class SceneBuilder:
    """A scene in the making.

    Attributes:
        rng: random source.
        bank: where pictures come from.
        photo: share of photos among the pictures.
        calm: 0 covers nearly everything with pictures, 1 leaves most surfaces plain.
    """

    rng: np.random.Generator
    bank: TextureBank
    photo: float = 0.65
    calm: float = 0.0
    meshes: list[Mesh] = field(default_factory=list)
    materials: list[Material] = field(default_factory=list)
    pictures: list[NDArray[np.uint8]] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    ambient: NDArray[np.float64] = field(default_factory=lambda: np.full((2, 3), 0.3))

    def add(self, mesh: Mesh, material: Material) -> None:
        """Put a mesh into the scene as it stands."""
        self.meshes.append(mesh)
        self.materials.append(material)

    def picture(self) -> int:
        """A texture index: a new picture while there is room, else one already in use."""
        if len(self.pictures) < TEXTURES_PER_SCENE:
            self.pictures.append(self.bank.draw(self.rng, self.photo))
            return len(self.pictures) - 1
        return int(self.rng.integers(len(self.pictures)))

    def material(self, size: float, plain: float = 0.25, **fixed: object) -> Material:
        """A random material for a part of a given size.

        Args:
            size: extent of the part, which the texture's scale follows.
            plain: probability of one colour without texture.
            fixed: fields to set as given.
        """
        rng = self.rng
        if 0.0 < plain < 1.0:
            plain = plain + self.calm * max(0.8 - plain, 0.0)
        is_plain = rng.random() < plain
        tint = colour(rng) ** 2.2 if is_plain else np.exp(rng.normal(0, 0.12, 3))
        values: dict[str, object] = {
            "tint": tuple(float(v) for v in tint),
            "texture": -1 if is_plain else self.picture(),
            "scale": float(size * np.exp(rng.uniform(np.log(0.25), np.log(1.6)))),
            "gloss": float(rng.choice([0.0, 0.0, rng.uniform(0, 0.25), rng.uniform(0.1, 0.8)])),
            "sharpness": float(np.exp(rng.uniform(1.6, 5.0))),
            "stain": float(rng.choice([0.0, rng.uniform(0, 0.25)])),
            "stain_scale": float(size * rng.uniform(0.5, 4)),
            "bump": float(rng.choice([0.0, 0.0, rng.uniform(0, 0.5)])),
            "bump_scale": float(size * np.exp(rng.uniform(-2.0, 0.7))),
        }
        return Material(**{**values, **fixed})  # type: ignore[arg-type]

    def finished(self) -> Scene:
        """The scene as arrays."""
        counts = [len(m.vertices) for m in self.meshes]
        return Scene(
            np.concatenate([m.vertices for m in self.meshes], dtype=np.float32),
            np.concatenate([m.normals for m in self.meshes], dtype=np.float32),
            np.concatenate([m.uvs for m in self.meshes], dtype=np.float32),
            np.repeat(np.arange(len(counts), dtype=np.int32), counts),
            self.materials,
            pyramids(self.pictures),
            self.lights,
            self.ambient,
        )
