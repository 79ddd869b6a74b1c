"""A real scene beside gsplat's pure-torch reference (Apache-2.0), which nobody here wrote.

gsplat projects, computes alphas and sums colours. Two things it leaves to CUDA are done here: to
say which Gaussians each pixel meets, and nerfacc's product of transmittances along a ray.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.formats import read_scene
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.main import run
from styl3r_cli.splatting import render
from styl3r_cli.splatting.projection import near_plane

torch = pytest.importorskip("torch")
gsplat = pytest.importorskip(
    "gsplat.cuda._torch_impl", reason="gsplat is not installed (pip install gsplat)"
)

EXAMPLES = Path(__file__).parents[3] / "examples"
NEEDED_DECIBELS = 50

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Gaussians:
    path = tmp_path_factory.mktemp("scene") / "room.ply"
    photos = [str(EXAMPLES / "room" / f"photo_{n}.jpg") for n in (1, 2)]
    style = str(EXAMPLES / "styles" / "wave.jpg")
    assert run(["stylize", *photos, "--style", style, "-o", str(path), "--quiet"]) == 0
    return read_scene(path).gaussians


def stand_in_for_nerfacc() -> ModuleType:
    """The two functions that gsplat's reference asks of it, for rays in order."""
    module = ModuleType("nerfacc")

    def render_weight_from_alpha(alphas, ray_indices, n_rays):
        logs = torch.log1p(-alphas.double())
        before = torch.cumsum(logs, 0) - logs
        counts = torch.bincount(ray_indices, minlength=n_rays)
        first = (torch.cumsum(counts, 0) - counts).clamp(max=len(alphas) - 1)
        transmittance = torch.exp(before - before[first][ray_indices])
        return (alphas * transmittance).float(), transmittance.float()

    def accumulate_along_rays(weights, values, ray_indices, n_rays):
        weighted = weights[:, None] * (1 if values is None else values)
        return torch.zeros(n_rays, weighted.shape[1]).index_add_(0, ray_indices, weighted)

    module.render_weight_from_alpha = render_weight_from_alpha
    module.accumulate_along_rays = accumulate_along_rays
    return module


def meetings(means, conics, opacities, depths, radii, width, height):
    """(Gaussian, pixel) pairs where alpha counts, pixel by pixel and nearest first."""
    low = (means - radii).floor().long()
    wide = 2 * radii.long() + 2
    counts = torch.where(radii.min(1).values > 0, wide[:, 0] * wide[:, 1], 0)
    ids = torch.repeat_interleave(torch.arange(len(means)), counts)
    within = torch.arange(len(ids)) - torch.repeat_interleave(counts.cumsum(0) - counts, counts)
    x, y = low[ids, 0] + within % wide[ids, 0], low[ids, 1] + within // wide[ids, 0]
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    ids, x, y = ids[inside], x[inside], y[inside]
    d = torch.stack([x, y], 1) + 0.5 - means[ids]
    c = conics[ids]
    sigma = 0.5 * (c[:, 0] * d[:, 0] ** 2 + c[:, 2] * d[:, 1] ** 2) + c[:, 1] * d[:, 0] * d[:, 1]
    alphas = (opacities[ids] * torch.exp(-sigma)).clamp(max=0.99)
    seen = alphas >= 1 / 255
    ids, pixels, alphas = ids[seen], (y * width + x)[seen], alphas[seen]
    rank = torch.argsort(torch.argsort(depths, stable=True))
    order = torch.argsort(pixels * len(means) + rank[ids])
    ids, pixels, logs = ids[order], pixels[order], torch.log1p(-alphas[order].double())
    after = torch.cumsum(logs, 0)
    counts = torch.bincount(pixels, minlength=width * height)
    base = torch.cat([torch.zeros(1).double(), after])[counts.cumsum(0) - counts]
    kept = after - base[pixels] >= np.log(1e-4)
    return ids[kept], pixels[kept]


def gsplat_picture(scene: Gaussians, camera: Camera, antialias: bool):
    tensors = (scene.means, scene.scales, scene.rotations, scene.opacities, scene.colours)
    means, scales, rotations, opacities, colours = map(torch.from_numpy, tensors)
    covariances, _ = gsplat._quat_scale_to_covar_preci(rotations, scales, True, False)
    view, lens = (torch.from_numpy(m).float()[None] for m in (camera.extrinsics, camera.intrinsics))
    radii, centres, depths, conics, compensations = gsplat._fully_fused_projection(
        means, covariances, view, lens, camera.width, camera.height,
        near_plane=near_plane(scene.means), calc_compensations=True,
    )  # fmt: skip
    if antialias:
        opacities = opacities * compensations[0]
    ids, pixels = meetings(
        centres[0], conics[0], opacities, depths[0], radii[0], camera.width, camera.height
    )
    picture, alpha = gsplat.accumulate(
        centres, conics, opacities[None], colours.clamp(min=0)[None], ids, pixels,
        torch.zeros_like(ids), camera.width, camera.height,
    )  # fmt: skip
    return picture[0].numpy(), alpha[0, ..., 0].numpy()


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize(
    ("width", "height", "focal", "shift"),
    [(256, 256, 220.0, 0.0), (200, 120, 160.0, 0.15), (64, 80, 60.0, -0.1)],
)
def test_the_picture_is_gsplats(monkeypatch, scene, width, height, focal, shift, antialias):
    monkeypatch.setitem(sys.modules, "nerfacc", stand_in_for_nerfacc())
    view = np.eye(4)
    view[0, 3] = shift
    camera = Camera(view, focal, 1.05 * focal, 0.45 * width, 0.52 * height, width, height)
    expected, alpha = gsplat_picture(scene, camera, antialias)
    frame = render(scene, camera, None, antialias=antialias)
    assert frame.alpha.mean() > 0.2  # the scene is in the picture
    error = np.mean((frame.colour - expected) ** 2)
    decibels = -10 * np.log10(error)
    print(f"{width}x{height} antialias={antialias}: {decibels:.1f} dB")
    assert decibels > NEEDED_DECIBELS
    assert np.abs(frame.alpha - alpha).mean() < 1e-4
