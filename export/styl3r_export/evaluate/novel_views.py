"""Photos between the inputs, drawn from the inputs' Gaussians, beside photos moved about."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.poses import centre
from styl3r_cli.frames import Drawing
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting import render
from styl3r_export.evaluate.align import align
from styl3r_export.evaluate.groups import Group
from styl3r_export.evaluate.image_metrics import psnr, ssim
from styl3r_export.evaluate.lpips import Lpips
from styl3r_export.evaluate.pose_adjustment import adjust_pose
from styl3r_export.evaluate.predict import Intrinsics, Prediction, given_camera
from styl3r_export.evaluate.records import MODEL, Values
from styl3r_export.evaluate.scenes import TrueView

FEWEST_SHARED = 4  # points that a homography needs

Picture = NDArray[np.floating]


def novel_view_values(
    group: Group,
    prediction: Prediction,
    gaussians: Gaussians,
    intrinsics: Intrinsics,
    lpips: Lpips | None,
    threads: int,
    pose_steps: int = 0,
) -> Values:
    """PSNR, SSIM and LPIPS of each of the group's targets; nothing for a group without one.

    A target's camera is the true one, brought to the model's world by the inputs' cameras
    alone. With `pose_steps`, `model, pose adjusted` also fits that camera to the target's picture,
    as the published evaluation does. Where the scene has nothing, `model` shows its surroundings,
    as `styl3r render` does and the baselines do in their own ways; `model, on black` does not.

    Baselines: `nearest photo` is the input whose camera is closest; `homography (oracle)` warps
    it by the homography between the points that it and the target are known to share, which takes
    the target's own picture to know (left out where no points are known).
    """
    values: Values = {}
    drawing = Drawing(threads=threads)
    for target in (group.scene.views[index] for index in group.targets):
        camera = target_camera(group, prediction, target, intrinsics)
        nearest = nearest_view(group, target)
        pictures: dict[str, Picture] = {
            MODEL: drawing.frame(gaussians, camera).colour,
            "model, on black": render(gaussians, camera, threads=threads).colour,
            "nearest photo": nearest.pixels / np.float32(255),
        }
        if len(target.points):
            pictures["homography (oracle)"] = warp(nearest, target) / np.float32(255)
        truth = target.pixels / np.float32(255)
        if pose_steps:
            eyes = [centre(prediction.recovered.cameras[k].extrinsics) for k in (0, -1)]
            unit = float(np.linalg.norm(eyes[1] - eyes[0]))
            fitted = adjust_pose(gaussians, camera, truth, unit, pose_steps, threads)
            pictures["model, pose adjusted"] = drawing.frame(gaussians, fitted).colour
        for method, picture in pictures.items():
            for name, value in likeness(picture, truth, lpips).items():
                values.setdefault(("novel view", name, method), []).append(value)
    return values


def likeness(picture: Picture, truth: Picture, lpips: Lpips | None) -> dict[str, float]:
    """How like two pictures are, by name of the measure."""
    measures = {"PSNR (dB)": psnr(picture, truth), "SSIM": ssim(picture, truth)}
    return measures if lpips is None else measures | {"LPIPS": lpips(picture, truth)}


def target_camera(
    group: Group, prediction: Prediction, target: TrueView, intrinsics: Intrinsics
) -> Camera:
    """Where the target was taken from, in the model's world.

    Its intrinsics are known as well as the inputs' are, and corrected as the tool corrects those.
    """
    found = prediction.recovered.cameras
    similarity = align([view.camera for view in group.views], found)
    lens, correction = given_camera(target, intrinsics), found[0].fx / prediction.given[0].fx
    lens = replace(lens, fx=lens.fx * correction, fy=lens.fy * correction)
    return replace(lens, extrinsics=similarity.camera(target.camera).extrinsics)


def nearest_view(group: Group, target: TrueView) -> TrueView:
    """The input whose camera stands closest to the target's; the first of equals."""
    eye = centre(target.camera.extrinsics)
    distances = [np.linalg.norm(centre(v.camera.extrinsics) - eye) for v in group.views]
    return group.views[int(np.argmin(distances))]


def warp(source: TrueView, target: TrueView) -> NDArray[np.uint8]:
    """A photo as the target's camera would see it if the scene were a plane, (H, W, 3).

    Pixels that the photo does not show repeat its edge. Where no homography is found, the photo.
    """
    _, a, b = np.intersect1d(source.points, target.points, return_indices=True)
    if len(a) < FEWEST_SHARED:
        return source.pixels
    cv2.setRNGSeed(0)
    # OpenCV puts the first pixel's centre at (0, 0), this project at (0.5, 0.5). The least median
    # of squares needs no threshold, and came out ahead of RANSAC and of plain least squares.
    matrix, _ = cv2.findHomography(source.uv[a] - 0.5, target.uv[b] - 0.5, cv2.LMEDS)
    if matrix is None:
        return source.pixels
    size = (source.camera.width, source.camera.height)
    warped = cv2.warpPerspective(source.pixels, matrix, size, borderMode=cv2.BORDER_REPLICATE)
    return warped.astype(np.uint8)
