"""A converter that nobody here wrote (PlayCanvas's splat-transform) reads our PLY as we mean it."""

from __future__ import annotations

import csv
import os
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from styl3r_cli.formats import read_scene, write_scene
from styl3r_cli.gaussians import Gaussians

VARIABLE = "STYL3R_SPLAT_TRANSFORM"  # for example "npx --yes @playcanvas/splat-transform"


def splat_transform(*arguments: str) -> str:
    command = shlex.split(os.environ.get(VARIABLE, ""))
    if not command:
        installed = shutil.which("splat-transform")
        if installed is None:
            pytest.skip(f"no splat-transform: npm install it, or set {VARIABLE} to its command")
        command = [installed]
    result = subprocess.run(
        [*command, *arguments], capture_output=True, text=True, check=False, timeout=300
    )
    assert result.returncode == 0, result.stderr
    return result.stdout + result.stderr


def summary(path: Path) -> dict[str, list[str]]:
    """Its statistics by column: min, max, median, mean, stdDev, nans, infs, in activated units."""
    lines = splat_transform(str(path), "--summary", "null").splitlines()
    tables = [
        [cell.strip() for cell in line.strip("| ").split("|")] for line in lines if "|" in line
    ]
    return {row[0]: row[1:8] for row in tables if len(row) >= 8}


def test_statistics_agree(tmp_path: Path, scene: Gaussians) -> None:
    write_scene(tmp_path / "scene.ply", scene, {"styl3r": "0.1.0", "styles": "a, b"})
    table = summary(tmp_path / "scene.ply")
    expected = {"opacity": scene.opacities}
    for axis in range(3):
        expected["xyz"[axis]] = scene.means[:, axis]
        expected[f"scale_{axis}"] = scene.scales[:, axis]
        expected[f"f_dc_{axis}"] = scene.colours[:, axis]
    for axis in range(4):
        expected[f"rot_{axis}"] = scene.rotations[:, axis]
    for column, values in expected.items():
        least, most, *_, nans, infinities = table[column]
        assert (nans, infinities) == ("0", "0")
        np.testing.assert_allclose(float(least), values.min(), rtol=1e-4, atol=2e-6)
        np.testing.assert_allclose(float(most), values.max(), rtol=1e-4, atol=2e-6)


def test_it_copies_our_ply_and_we_read_its_copy(tmp_path: Path, scene: Gaussians) -> None:
    write_scene(tmp_path / "ours.ply", scene)
    splat_transform(str(tmp_path / "ours.ply"), str(tmp_path / "theirs.ply"))
    back = read_scene(tmp_path / "theirs.ply").gaussians
    np.testing.assert_allclose(back.means, scene.means, atol=1e-6)
    np.testing.assert_allclose(back.opacities, scene.opacities, atol=1e-6)
    np.testing.assert_allclose(back.colours, scene.colours, atol=1e-6)
    np.testing.assert_allclose(back.scales, scene.scales, rtol=1e-5)
    np.testing.assert_allclose(back.rotations, scene.rotations, atol=1e-6)


def test_the_ends_of_the_opacities_are_finite_for_it(tmp_path: Path) -> None:
    ends = np.array([0, 1], np.float32)
    rotations = np.tile([1, 0, 0, 0], (2, 1))
    scene = Gaussians(np.zeros((2, 3)), np.ones((2, 3)), rotations, ends, np.ones((2, 3)))
    write_scene(tmp_path / "ends.ply", scene)
    splat_transform(str(tmp_path / "ends.ply"), str(tmp_path / "ends.csv"))
    with (tmp_path / "ends.csv").open() as file:
        logits = [float(row["opacity"]) for row in csv.DictReader(file)]
    np.testing.assert_allclose(1 / (1 + np.exp(-np.array(logits))), ends, atol=1e-7)
