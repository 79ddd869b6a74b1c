"""More than two views are matched with the middle one; the world stays the first one's camera."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from styl3r_export.model import Styl3r, build
from styl3r_export.model.network import middle_first

SIDE = 64


@pytest.fixture(scope="module")
def model() -> Styl3r:
    """A network whose cameras differ from view to view."""
    torch.manual_seed(0)
    model = build("mini")
    with torch.no_grad():
        model.camera_head.out.weight.normal_(0, 0.02)
    return model


@pytest.mark.parametrize("count", range(2, 9))
def test_the_middle_comes_first_and_back_again(count: int) -> None:
    order, back = middle_first(torch.zeros(count, 3))
    middle = (count - 1) // 2
    assert order.tolist() == [middle, *range(middle), *range(middle + 1, count)]
    assert order[back].tolist() == list(range(count))


@pytest.mark.parametrize("count", [2, 3, 4])
def test_the_world_is_the_first_views_camera(model: Styl3r, count: int) -> None:
    generator = torch.Generator().manual_seed(count)
    images = torch.rand((count, 3, SIDE, SIDE), generator=generator)
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]).expand(count, 3, 3)
    with torch.inference_mode():
        found = model.structure(images, lens)
        order, back = middle_first(images)
        content = model.encode(images[order][None], lens[None])
        plain = model.decode_structure(content, images[order][None], lens[None])
    assert plain.rays is not None
    geometry = [t[0][back].numpy() for t in plain.geometry]
    pose = [t[0][back][0].double().numpy() for t in plain.rays.pose]
    world = Rotation.from_quat(pose[0], scalar_first=True)
    means = world.inv().apply(geometry[0].reshape(-1, 3) - pose[1])
    np.testing.assert_allclose(found.means.reshape(-1, 3), means, rtol=1e-4, atol=1e-5)
    turned = world.inv() * Rotation.from_quat(geometry[2].reshape(-1, 4), scalar_first=True)
    given = Rotation.from_quat(found.rotations.reshape(-1, 4).numpy(), scalar_first=True)
    assert (turned.inv() * given).magnitude().max() < 1e-4
    np.testing.assert_array_equal(found.scales, geometry[1])
    np.testing.assert_array_equal(found.opacities, geometry[3])
    np.testing.assert_array_equal(found.content_tokens, content.tokens[0][back])
    # The first view's points lie on its own rays.
    y, x = (np.mgrid[:SIDE, :SIDE] + 0.5) / SIDE - 0.5
    first = found.means[0].numpy()
    np.testing.assert_allclose(first[..., 0] / first[..., 2], x, atol=1e-4)
    np.testing.assert_allclose(first[..., 1] / first[..., 2], y, atol=1e-4)
