"""What a format can hold comes back: each format against its own stated precision."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.stored import cameras_from_metadata, cameras_to_metadata
from styl3r_cli.errors import InputError, OutputError, UsageError
from styl3r_cli.formats import (
    MODULES,
    encode_scene,
    read_scene,
    recognise,
    scene_suffix,
    write_scene,
)
from styl3r_cli.formats.quantise import morton_order
from styl3r_cli.gaussians import Gaussians

READABLE = [suffix for suffix in MODULES if suffix != ".points.glb"]
SORTED = (".compressed.ply", ".sog")
WITH_METADATA = (".ply", ".compressed.ply", ".sog", ".glb")
EPS = 1e-6  # float32 arithmetic on top of the rounding itself


@dataclass(frozen=True)
class Precision:
    """The largest errors: of means absolute, of scales relative, of the others absolute."""

    means: float
    scales: float
    rotations: float
    opacities: float
    colours: float


BYTE = 0.5 / 255
# Of a rotation's three stored parts each is off by half a step; the fourth, which is the largest
# and follows from them, by up to three times as much.
TURN_10_BITS, TURN_8_BITS = 3 * 2**0.5 / 1023 / 2, 3 * 2**0.5 / 255 / 2
# For scenes within +-4 units whose scales span e^-6..e^-1 and whose colours are in 0..1.
PRECISION = {
    ".ply": Precision(0, 3e-6, 1e-7, 1e-6, 1e-6),
    # half a step of 10 bits of a chunk's range (here at most 8), and of 10 bits of 5 in logarithms
    ".compressed.ply": Precision(8 / 1023 / 2, 5 / 1023 / 2, TURN_10_BITS, BYTE, BYTE),
    # a byte has 128 steps; one clipped at 255 is a whole step off, spread by normalisation
    ".splat": Precision(0, 0, 1.2e-2, BYTE, BYTE),
    # 1/4096 of a unit; 1/16 of a logarithm; 9 bits and a sign; a byte over 1.881
    ".spz": Precision(1 / 8192, 0.0318, TURN_10_BITS, BYTE, 1.881 * BYTE),
    # 16 bits of the range of ln(1 + |x|), widened by 1 + |x|; codebooks of 256 over 5 and over 1
    ".sog": Precision(5 * 2 * 1.61 / 65535 / 2, 0.02, TURN_8_BITS, BYTE, 0.004),
    ".glb": Precision(0, 0, 0, 0, 2e-7),
}


def scene_of(count: int, seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)
    rotations = rng.normal(size=(count, 4))
    return Gaussians(
        means=rng.uniform(-4, 4, (count, 3)),
        scales=np.exp(rng.uniform(-6, -1, (count, 3))),
        rotations=rotations / np.linalg.norm(rotations, axis=1, keepdims=True),
        opacities=rng.uniform(0, 1, count),
        colours=rng.uniform(0, 1, (count, 3)),
    )


def cameras() -> dict[str, str]:
    extrinsics = np.eye(4)
    extrinsics[:3, 3] = 0.1, -0.2, 0.3
    views = [Camera(extrinsics, 200.0, 201.0, 128.0, 127.0, 256, 254)] * 2
    return cameras_to_metadata(views)


def rotation_error(one: Gaussians, other: Gaussians) -> float:
    """The larger part's difference; q and -q are one rotation."""
    near, far = one.rotations - other.rotations, one.rotations + other.rotations
    return float(np.minimum(np.abs(near).max(axis=1), np.abs(far).max(axis=1)).max(initial=0))


def check(suffix: str, back: Gaussians, scene: Gaussians) -> None:
    wanted = scene.select(morton_order(scene.means)) if suffix in SORTED else scene
    bar = PRECISION[suffix]
    np.testing.assert_allclose(back.means, wanted.means, rtol=0, atol=bar.means + EPS)
    np.testing.assert_allclose(back.scales, wanted.scales, rtol=bar.scales + EPS)
    assert rotation_error(back, wanted) <= bar.rotations + EPS
    np.testing.assert_allclose(back.opacities, wanted.opacities, rtol=0, atol=bar.opacities + EPS)
    np.testing.assert_allclose(back.colours, wanted.colours, rtol=0, atol=bar.colours + EPS)


@pytest.mark.parametrize("count", [1, 255, 256, 257, 3000])
@pytest.mark.parametrize("suffix", READABLE)
def test_all_values_come_back_within_the_stated_precision(suffix: str, count: int) -> None:
    scene = scene_of(count)
    encoded = encode_scene(scene, {}, suffix)
    assert encoded.count == count
    check(suffix, read_scene(encoded.data, suffix).gaussians, scene)


@pytest.mark.parametrize("suffix", READABLE)
def test_a_second_round_trip_loses_hardly_more(suffix: str) -> None:
    """What was rounded once is on the grid already, or nearly (ranges and codebooks move)."""
    once = read_scene(encode_scene(scene_of(600), {}, suffix).data, suffix).gaussians
    twice = read_scene(encode_scene(once, {}, suffix).data, suffix).gaussians
    check(suffix, twice, once)


@pytest.mark.parametrize("suffix", MODULES)
def test_the_same_scene_gives_the_same_bytes(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix.upper()}"
    write_scene(path, scene_of(300), cameras())
    assert path.read_bytes() == encode_scene(scene_of(300), cameras(), suffix).data


@pytest.mark.parametrize("suffix", READABLE)
def test_formats_are_recognised_in_a_pipe(suffix: str) -> None:
    data = encode_scene(scene_of(300), {}, suffix).data
    assert recognise(data) == (".ply" if suffix == ".compressed.ply" else suffix)
    check(suffix, read_scene(data).gaussians, scene_of(300))


def test_noise_is_no_splat() -> None:
    noise = np.random.default_rng(0).integers(0, 256, 32 * 100, np.uint8).tobytes()
    assert recognise(noise) is None
    assert recognise(bytes(320)) is None
    assert recognise(b"") is None


@pytest.mark.parametrize("suffix", READABLE)
def test_cameras_and_text_come_back_or_are_named(suffix: str) -> None:
    metadata = {"generator": "styl3r 0.1", "styles": 'Brücke, 北斎 "\\\n', **cameras()}
    encoded = encode_scene(scene_of(20), metadata, suffix)
    back = read_scene(encoded.data, suffix)
    if suffix in WITH_METADATA:
        assert back.metadata == metadata
        assert len(cameras_from_metadata(back.metadata)) == 2
        assert not any("left out" in note for note in encoded.notes)
    else:
        assert back.metadata == {}
        assert f"{suffix} has no place for cameras: 2 are left out" in encoded.notes
        assert "left out" in encode_scene(scene_of(2), {"a": "b"}, suffix).notes[-1]


@pytest.mark.parametrize("suffix", READABLE)
def test_a_scene_of_nothing(suffix: str) -> None:
    if suffix == ".splat":  # cannot say so: an empty file is taken for a lost one
        with pytest.raises(OutputError, match="empty"):
            encode_scene(scene_of(0), cameras(), suffix)
        return
    encoded = encode_scene(scene_of(0), cameras(), suffix)
    back = read_scene(encoded.data, suffix)
    assert len(back.gaussians) == encoded.count == 0
    assert len(cameras_from_metadata(back.metadata)) == (2 if suffix in WITH_METADATA else 0)


@pytest.mark.parametrize("suffix", MODULES)
def test_gaussians_that_are_not_finite_are_left_out_and_told(suffix: str) -> None:
    arrays = {name: getattr(scene_of(50), name).copy() for name in Gaussians.__dataclass_fields__}
    for row, (name, bad) in enumerate(
        zip(arrays, [np.nan, np.inf, np.nan, -np.inf, np.nan], strict=True)
    ):
        arrays[name][row] = bad
    encoded = encode_scene(Gaussians(**arrays), {}, suffix)
    assert encoded.dropped == 5
    assert encoded.notes[0] == "5 of 50 Gaussians were not finite and left out"
    if suffix in READABLE:
        kept = scene_of(50).select(np.arange(5, 50))
        check(suffix, read_scene(encoded.data, suffix).gaussians, kept)


@pytest.mark.parametrize("suffix", [".compressed.ply", ".splat", ".spz", ".sog"])
def test_rounding_is_said(suffix: str) -> None:
    assert any("rounds" in note for note in encode_scene(scene_of(3), {}, suffix).notes)


def test_colours_that_are_clipped_are_counted() -> None:
    scene = scene_of(10)
    colours = scene.colours.copy()
    colours[:3] = 1.2, 0.5, 0.5
    bright = scene.with_colours(colours)
    told = "3 Gaussians had colours outside 0..1: clipped"
    assert told in encode_scene(bright, {}, ".splat").notes
    assert not any("clipped" in note for note in encode_scene(bright, {}, ".spz").notes)
    np.testing.assert_allclose(
        read_scene(encode_scene(bright, {}, ".spz").data).gaussians.colours, colours, atol=0.004
    )


def test_scales_that_are_clipped_are_counted() -> None:
    """A byte of .spz ends at 379 units; what other formats store is as large as before."""
    scene = scene_of(10)
    scales = scene.scales.copy()
    scales[:3], scales[3] = 1e4, 378
    large = replace(scene, scales=scales)
    for suffix in (".ply", ".compressed.ply", ".splat", ".sog", ".glb", ".spz"):
        encoded = encode_scene(large, {}, suffix)
        found = np.sort(read_scene(encoded.data, suffix).gaussians.scales.max(axis=1))
        clipped = suffix == ".spz"
        assert ("3 Gaussians were thicker than 379 and made so thin" in encoded.notes) is clipped
        np.testing.assert_allclose(found[-3:], 379 if clipped else 1e4, rtol=0.05)
        np.testing.assert_allclose(found[-4], 378, rtol=0.05)


def test_the_longest_suffix_wins() -> None:
    for name, suffix in {
        "a.ply": ".ply",
        "a.b.PLY": ".ply",
        "a.Compressed.Ply": ".compressed.ply",
        "a.points.glb": ".points.glb",
        "points.glb": ".glb",
    }.items():
        assert scene_suffix(Path(name)) == suffix
    for name in ("ply", ".ply", "a.ply.gz", "a"):
        with pytest.raises(UsageError, match="unknown scene format"):
            scene_suffix(Path(name))


def test_a_compressed_ply_may_be_called_ply_and_the_other_way_round(tmp_path: Path) -> None:
    scene = scene_of(40)
    for suffix, name in ((".compressed.ply", "a.ply"), (".ply", "a.compressed.ply")):
        (tmp_path / name).write_bytes(encode_scene(scene, {}, suffix).data)
        check(suffix, read_scene(tmp_path / name).gaussians, scene)


def test_points_cannot_be_read_back() -> None:
    data = encode_scene(scene_of(9), {}, ".points.glb").data
    for suffix in (".glb", ".points.glb", None):
        with pytest.raises(InputError, match=r"points and frusta|without Gaussians"):
            read_scene(data, suffix)


HUGE = float(np.float32(1e30))
wide = st.floats(-HUGE, HUGE, width=32)


@st.composite
def any_scenes(draw: st.DrawFn) -> Gaussians:
    count = draw(st.integers(1, 5))
    array = lambda *shape, of: draw(hnp.arrays(np.float32, (count, *shape), elements=of))  # noqa: E731
    return Gaussians(
        means=array(3, of=wide),
        scales=array(3, of=st.floats(0, HUGE, width=32)),
        rotations=array(4, of=st.floats(-1e3, 1e3, width=32)),
        opacities=array(of=st.floats(0, 1, width=32)),
        colours=array(3, of=st.floats(-1e6, 1e6, width=32)),
    )


@given(any_scenes())
@settings(max_examples=60, deadline=None)
def test_what_is_stored_as_it_is_comes_back_to_the_last_bit(scene: Gaussians) -> None:
    splat = read_scene(encode_scene(scene, {}, ".splat").data, ".splat").gaussians
    glb = read_scene(encode_scene(scene, {}, ".glb").data).gaussians
    for back in (splat, glb):
        np.testing.assert_array_equal(back.means, scene.means)
        np.testing.assert_array_equal(back.scales, scene.scales)
    np.testing.assert_array_equal(glb.opacities, scene.opacities)
    again = read_scene(encode_scene(glb, {}, ".glb").data).gaussians
    np.testing.assert_array_equal(again.rotations, glb.rotations)


@given(any_scenes(), st.sampled_from(READABLE))
@settings(max_examples=120, deadline=None)
def test_any_finite_scene_is_stored_and_stays_finite(scene: Gaussians, suffix: str) -> None:
    back = read_scene(encode_scene(scene, {}, suffix).data, suffix)
    assert back.dropped == 0
    assert len(back.gaussians) == len(scene)
    assert (back.gaussians.scales >= 0).all()
    assert ((back.gaussians.opacities >= 0) & (back.gaussians.opacities <= 1)).all()
    lengths = np.linalg.norm(back.gaussians.rotations, axis=1)
    np.testing.assert_allclose(lengths, 1, rtol=1e-6)
