"""glTF's scene tree: which primitives there are, and where their nodes place them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.poses import to_quaternions
from styl3r_cli.formats.values import in_float32
from styl3r_cli.gaussians import Gaussians

DEEPEST = 64  # nodes below nodes; more is a circle


@dataclass(frozen=True)
class Placed:
    """A primitive and its (4, 4) float64 matrix, from its own space to the scene's."""

    primitive: dict[str, Any]
    matrix: NDArray[np.float64]

    def moved(self, gaussians: Gaussians) -> Gaussians:
        """The Gaussians where the nodes place them; any linear map makes ellipsoids of ellipsoids.

        A covariance (R S)(R S)^T becomes (M R S)(M R S)^T, whose axes and lengths are the left
        singular vectors and the singular values of M R S.
        """
        linear, offset = self.matrix[:3, :3], self.matrix[:3, 3]
        if np.array_equal(self.matrix, np.eye(4)) or not len(gaussians):
            return gaussians
        axes = to_matrices(gaussians.rotations) * gaussians.scales[:, None, :]
        stretched = linear @ axes
        bad = ~np.isfinite(stretched.reshape(-1, 9)).all(axis=1)
        stretched[bad] = 0
        left, scales, _ = np.linalg.svd(stretched)
        scales[bad] = np.nan  # for the reader to drop
        left[:, :, 2] *= np.linalg.det(left)[:, None]  # a turn, not a mirror image
        return in_float32(
            means=gaussians.means @ linear.T + offset,
            scales=scales,
            rotations=to_quaternions(left),
            opacities=gaussians.opacities,
            colours=gaussians.colours,
        )


def placed(document: dict[str, Any]) -> Iterator[Placed]:
    """Every primitive of the default scene; of all meshes, where there is no scene.

    Raises:
        ValueError, KeyError, TypeError, IndexError: the tree is damaged.
    """
    scenes = document.get("scenes", [])
    if not scenes:
        for mesh in document.get("meshes", []):
            yield from _of_mesh(mesh, np.eye(4))
        return
    roots = scenes[document.get("scene", 0)].get("nodes", [])
    seen: set[int] = set()
    waiting = [(root, np.eye(4), 0) for root in roots]
    while waiting:
        index, outer, depth = waiting.pop()
        if type(index) is not int or index < 0 or index in seen or depth > DEEPEST:
            raise ValueError("its nodes are no tree")
        seen.add(index)
        node = document["nodes"][index]
        with np.errstate(over="ignore", invalid="ignore"):  # Gaussians there are dropped as such
            matrix = outer @ _matrix(node)
        if "mesh" in node:
            yield from _of_mesh(document["meshes"][node["mesh"]], matrix)
        waiting += [(child, matrix, depth + 1) for child in node.get("children", [])]


def _of_mesh(mesh: dict[str, Any], matrix: NDArray[np.float64]) -> Iterator[Placed]:
    for primitive in mesh["primitives"]:
        yield Placed(primitive, matrix)


def _matrix(node: dict[str, Any]) -> NDArray[np.float64]:
    """A node's own (4, 4): given, or translation after rotation after scale."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), np.float64)
    matrix = np.eye(4)
    turn = to_matrices(np.array([[w, x, y, z]]))[0]
    matrix[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]), np.float64).reshape(3)
    matrix[:3, 3] = np.array(node.get("translation", [0, 0, 0]), np.float64).reshape(3)
    return matrix


def to_matrices(quaternions: NDArray[np.floating]) -> NDArray[np.float64]:
    """(G, 3, 3) rotation matrices of (G, 4) unit quaternions w x y z."""
    w, x, y, z = quaternions.astype(np.float64).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)
