"""Photos to pixels in float64, and what each stage in float32 takes away from that.

`pytest -m slow -s tests/numerics/test_forward_error.py` prints the tables of docs/numerics.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from float64_frame import draw_in_float64
from hostile_pictures import HOSTILE, ORDINARY, SIDE, photos_of, wall
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.recover import recover
from styl3r_cli.formats import encode_scene, read_scene
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.graphs import find
from styl3r_cli.photos import Photos
from styl3r_cli.picture_metrics import psnr
from styl3r_cli.pipeline import Stylizer
from styl3r_cli.splatting import render
from styl3r_cli.splatting.projection import near_plane

torch = pytest.importorskip("torch", reason="the float64 network is torch's")
from torch.overrides import TorchFunctionMode  # noqa: E402

ATTRIBUTES = ("means", "scales", "rotations", "opacities", "colours")
STYLE = wall(64, 64, seed=3)[:1]
Arrays = dict[str, NDArray[Any]]


class InFloat64(TorchFunctionMode):
    """Whatever asks for float32 gets float64, and no float32 comes out of anything."""

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None):
        kwargs = dict(kwargs or {})
        if function is torch.Tensor.float:
            return args[0].double()
        if kwargs.get("dtype") is torch.float32:
            kwargs["dtype"] = torch.float64
        out = function(*args, **kwargs)
        assert not (isinstance(out, torch.Tensor) and out.dtype is torch.float32), function
        return out


@torch.no_grad()
def in_torch(model: Any, photos: Photos, dtype: torch.dtype) -> Arrays:
    """One scene's Gaussians, flat, computed in that precision."""
    images, intrinsics, style = (
        torch.as_tensor(np.rint(a * 255) / 255 if a.ndim == 4 else a, dtype=dtype)
        for a in (photos.images, photos.intrinsics, STYLE)
    )
    out = model.structure(images, intrinsics)
    weights = torch.ones(1, dtype=dtype)
    colours = model.appearance(out.content_tokens, style, weights, images)
    return flat({**out._asdict(), "colours": colours})


def flat(outputs: dict[str, Any]) -> Arrays:
    arrays = {name: np.asarray(outputs[name]) for name in ATTRIBUTES}
    return {n: a.reshape(-1, a.shape[-1]) if a.ndim == 4 else a.ravel() for n, a in arrays.items()}


def in_float64(model: Any, photos: Photos) -> Arrays:
    torch.set_default_dtype(torch.float64)
    try:
        with InFloat64():
            return in_torch(model.double(), photos, torch.float64)
    finally:
        torch.set_default_dtype(torch.float32)
        model.float()


def wide(arrays: Arrays | Gaussians) -> dict[str, NDArray[np.float64]]:
    get = arrays.__getitem__ if isinstance(arrays, dict) else arrays.__getattribute__
    return {name: np.asarray(get(name), np.float64) for name in ATTRIBUTES}


def beside(scene: Arrays) -> Camera:
    """A novel view: to the right by a twentieth of the median depth, turned back a little."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0, -0.05, 0]).as_matrix()
    pose[:3, 3] = -pose[:3, :3] @ [0.05 * float(np.median(scene["means"][:, 2])), 0, 0]
    focal = 0.9 * SIDE
    return Camera(pose, focal, focal, SIDE / 2, SIDE / 2, SIDE, SIDE)


def scale_of(error: NDArray[np.float64]) -> tuple[float, float]:
    return float(np.abs(error).max()), float(np.sqrt(np.mean(error**2)))


@pytest.fixture(scope="module")
def model() -> Any:
    from styl3r_export.graphs_reading import load_graphs

    return load_graphs(find("mini"))[0]


@pytest.fixture(scope="module")
def stylizer() -> Stylizer:
    return Stylizer("mini", "cpu", threads=1)


def through_graphs(stylizer: Stylizer, photos: Photos) -> Arrays:
    scene = stylizer.encode(photos)
    colours = stylizer.colours(scene, [STYLE[0]])
    return flat({**vars(scene), "colours": colours})


@pytest.mark.slow
def test_photos_to_pixels(model: Any, stylizer: Stylizer) -> None:
    photos = photos_of(np.rint(wall() * 255) / np.float32(255))
    exact = in_float64(model, photos)
    single = in_torch(model, photos, torch.float32)
    graphs = through_graphs(stylizer, photos)
    camera, near = beside(exact), near_plane(np.float32(exact["means"]))
    stored = Gaussians(**exact)
    ply = read_scene(encode_scene(stored).data).gaussians
    picture = draw_in_float64(exact, camera, near)
    assert 0.05 < picture.std() < 0.5

    def drawn(arrays: Arrays | Gaussians) -> NDArray[np.float64]:
        return draw_in_float64(wide(arrays), camera, near)

    def rendered(gaussians: Gaussians) -> NDArray[np.float64]:
        return render(gaussians, camera, None, near=near, threads=1).colour.astype(np.float64)

    last = Gaussians(**graphs)
    last = read_scene(encode_scene(last).data).gaussians
    losses = {
        "network in float32, torch": drawn(single) - picture,
        "network in float32, onnxruntime": drawn(graphs) - picture,
        "Gaussians in float32": drawn(stored) - picture,
        "PLY": drawn(ply) - drawn(stored),
        "renderer": rendered(stored) - drawn(stored),
        "8-bit picture": np.rint(picture * 255) / 255 - picture,
        "photos to pixels": rendered(last) - picture,
    }
    print(f"\n{'stage':34}{'largest':>10}{'rms':>10}")
    for name, error in losses.items():
        print(f"{name:34}{scale_of(error)[0]:10.1e}{scale_of(error)[1]:10.1e}")
    print(f"\n{'attribute':34}{'largest':>10}{'rms':>10}   (relative; onnxruntime)")
    for name in ATTRIBUTES:
        truth = exact[name]
        size = float(np.sqrt(np.mean(truth**2)))
        most, rms = scale_of(graphs[name].astype(np.float64) - truth)
        print(f"{name:34}{most / size:10.1e}{rms / size:10.1e}")
    rounding = scale_of(losses["8-bit picture"])[1]
    for name, error in losses.items():
        # No stage is seen in 8 bits. The network's flat depths are drawn in an order that hangs on
        # the last bit, which differs between machines: up to twice that.
        most = 2 * rounding if name.startswith(("network", "photos")) else rounding
        assert scale_of(error)[1] <= most, name
    assert scale_of(losses["renderer"])[1] < 1e-5
    assert scale_of(losses["PLY"])[1] < 1e-5


@pytest.mark.slow
def test_cameras_from_float32_maps(model: Any, stylizer: Stylizer) -> None:
    photos = photos_of(wall())
    exact = in_float64(model, photos)
    graphs = stylizer.encode(photos)
    maps = exact["means"].reshape(graphs.means.shape)
    opacities = exact["opacities"].reshape(graphs.opacities.shape)
    kept = [True, True]
    a = recover(maps, opacities, photos.intrinsics, kept).cameras[1].extrinsics
    b = recover(graphs.means, graphs.opacities, photos.intrinsics, kept).cameras[1].extrinsics
    off = np.abs(a @ np.linalg.inv(b) - np.eye(4))
    print(f"\nsecond camera: {off[:3, :3].max():.1e} radians, {off[:3, 3].max():.1e} units")
    assert off.max() < 1e-3


@pytest.mark.slow
def test_half_precision_arithmetic_on_any_views(model: Any) -> None:
    """What no exported graph does: torch's autocast, against float64, picture by picture."""
    kinds: dict[str, Callable[[], Photos]] = {ORDINARY: lambda: photos_of(wall())}
    kinds |= {n: HOSTILE[n] for n in ("one-pixel checkers", "no overlap", "saturated noise")}
    print(f"\n{'views':26}{'float32':>12}{'bfloat16':>12}{'float16':>12}")
    for name, make in kinds.items():
        photos = make()
        exact = in_float64(model, photos)
        camera, near = beside(exact), near_plane(np.float32(exact["means"]))
        picture = draw_in_float64(exact, camera, near)
        found = []
        for dtype in (None, torch.bfloat16, torch.float16):
            with torch.autocast("cpu", dtype or torch.bfloat16, enabled=dtype is not None):
                scene = in_torch(model, photos, torch.float32)
            sound = all(np.isfinite(array).all() for array in scene.values())
            drawn = draw_in_float64(wide(scene), camera, near) if sound else picture + np.nan
            found.append(psnr(drawn, picture) if sound else float("nan"))
        print(f"{name:26}" + "".join(f"{value:9.1f} dB" for value in found))
        assert found[0] > 40 or name != ORDINARY
