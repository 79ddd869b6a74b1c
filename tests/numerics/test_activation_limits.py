"""The heads' activations driven to float32's ends: a sound Gaussian, or one dropped and counted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from styl3r_cli.errors import ModelError
from styl3r_cli.formats import encode_scene, read_scene
from styl3r_cli.pipeline import Scene, assemble

torch = pytest.importorskip("torch", reason="the activations are torch's")

MAX = float(np.finfo(np.float32).max)
# Raw outputs of a head: everything that float32 has, and often what overflows an exponential.
raw = st.one_of(
    st.floats(-20, 20, width=32),
    st.floats(-MAX, MAX, width=32),
    st.sampled_from([0.0, -0.0, 1e-45, 11.09, 88.0, 88.72, 88.73, 104.0, -104.0, np.inf, np.nan]),
)


def heads(channels: int) -> st.SearchStrategy[Any]:
    shape = (1, 2, channels, 2, 2)
    return hnp.arrays(np.float32, shape, elements=raw).map(torch.from_numpy)


def assert_sound_or_counted(geometry: Any) -> int:
    """Repair a scene of these Gaussians as the pipeline does; how many were dropped."""
    arrays = [tensor[0].numpy() for tensor in geometry]
    colours = np.full((2, 2, 2, 3), 0.5, np.float32)
    empty = np.zeros(0, np.float32)
    try:
        gaussians, repairs = assemble(Scene(empty, empty, *arrays, empty), colours)
    except ModelError:  # nothing is left: told, not drawn
        return 8
    assert len(gaussians) + repairs.dropped_not_finite == 8
    assert np.isfinite(gaussians.means).all()
    assert np.isfinite(gaussians.scales).all()
    assert gaussians.scales.min() > 0
    assert 0 <= gaussians.opacities.min() <= gaussians.opacities.max() <= 1
    np.testing.assert_allclose(np.linalg.norm(gaussians.rotations, axis=1), 1, rtol=1e-5)
    back = read_scene(encode_scene(gaussians).data)
    assert back.dropped == 0
    return repairs.dropped_not_finite


@settings(max_examples=60, deadline=None)
@given(heads(3), heads(8))
def test_published_activations(points: Any, structure: Any) -> None:
    from styl3r_export.model.adapter import free_geometry

    with np.errstate(over="ignore"):
        assert_sound_or_counted(free_geometry(points, structure))


@settings(max_examples=60, deadline=None)
@given(heads(1), heads(8), st.floats(1e-3, 1e3))
def test_activations_along_rays(depth: Any, structure: Any, focal: float) -> None:
    from styl3r_export.model.adapter import Pose, log_depth, ray_geometry

    lens = torch.tensor([[focal, 0, 0.5], [0, focal, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3)
    pose = Pose(torch.tensor([[[1.0, 0, 0, 0]] * 2]), torch.zeros(1, 2, 3))
    depths = log_depth(depth[:, :, 0]).exp()
    known = ~torch.isnan(depth[:, :, 0])
    # Bounded for whatever number comes in, infinite ones too: 0.018 to 148 scene units.
    assert ((depths > 0.018) & (depths < 149))[known].all()
    with np.errstate(over="ignore"):
        dropped = assert_sound_or_counted(ray_geometry(depths, structure, lens, pose))
    tame = (structure.abs() < 1e18).all(dim=2) & known
    assert dropped <= int((~tame).sum())


def test_where_the_published_depth_ends() -> None:
    """Float32's exponential ends at 88.7; the direction survives down to the smallest number."""
    from styl3r_export.model.adapter import exp_points

    lengths = torch.tensor([0.0, 1e-30, 1e-8, 1.0, 11.09, 88.7, 88.8, 1e30])
    points = exp_points(lengths[:, None] * torch.tensor([0.0, 0.0, 1.0]))
    depth = points[:, 2]
    assert (points[:, :2].nan_to_num() == 0).all()
    np.testing.assert_allclose(
        depth[2:5].numpy(), np.expm1(lengths[2:5].double().numpy()), rtol=1e-5
    )
    assert torch.isfinite(depth[:6]).all()
    assert not torch.isfinite(depth[6:]).any()
    assert (depth[:2] >= 0).all()
    assert depth[5] > 3e38
