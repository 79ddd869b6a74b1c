"""The evaluation's loop: scenes, groups of photos, rows."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import torch

from styl3r_cli.errors import UsageError
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.photos.load import STYLE_SIDE
from styl3r_cli.photos.resize import PATCH
from styl3r_cli.pipeline import Stylizer
from styl3r_export.evaluate.consistency import consistency_values
from styl3r_export.evaluate.depth import depth_values
from styl3r_export.evaluate.groups import Group, choose_groups, pick
from styl3r_export.evaluate.novel_views import novel_view_values
from styl3r_export.evaluate.poses import camera_values
from styl3r_export.evaluate.predict import (
    Intrinsics,
    Prediction,
    assumed_focal,
    load_stylizer,
    predict,
)
from styl3r_export.evaluate.raft import SMALLEST_SIDE
from styl3r_export.evaluate.records import Record, Values
from styl3r_export.evaluate.scenes import TrueScene, load_scene, scene_folders
from styl3r_export.evaluate.style import (
    Painting,
    choose_style,
    held_out_styles,
    load_painting,
    style_values,
)
from styl3r_export.evaluate.teachers import Teachers

ROWS = ("depth", "cameras", "views", "style", "consistency")
NEED_STYLES = ("style", "consistency")


@dataclass(frozen=True)
class Settings:
    """What is asked for.

    Attributes:
        model: model folder, bundled name, or checkpoint.
        scenes: folder of scene folders.
        teachers: folder of networks to measure with; LPIPS and stylized rows need it.
        styles: folder of paintings; stylized rows need it.
        only: names of scenes; none for all.
        rows: of ROWS; None for all that the folders allow.
        views: how many photos to give.
        per_scene: groups of photos for each scene and number of views.
        styled_per_scene: how many of these are stylized as well, each in another painting.
        size: side of the crops.
        intrinsics: what the network is given.
        pose_steps: for the targets' cameras (see novel_views); 0 for none.
        training_scenes: reported apart.
        threads: for everything.
    """

    model: Path
    scenes: Path
    teachers: Path | None
    styles: Path | None
    only: tuple[str, ...]
    rows: list[str] | None
    views: list[int]
    per_scene: int
    styled_per_scene: int
    size: int
    intrinsics: Intrinsics
    pose_steps: int
    training_scenes: tuple[str, ...]
    threads: int

    def to_dict(self) -> dict[str, Any]:
        """For JSON, without the paths' folders: the same run elsewhere gives the same file."""
        paths = {"model": self.model.name, "scenes": self.scenes.name}
        paths["teachers"] = "" if self.teachers is None else self.teachers.name
        paths["styles"] = "" if self.styles is None else self.styles.name
        return asdict(self) | paths


class Evaluator:
    """A model and everything that it is measured with."""

    def __init__(self, settings: Settings) -> None:
        """Load the model and the teachers.

        Raises:
            InputError: a folder does not hold what it should.
            ModelError: the model cannot be loaded.
            UsageError: a row is asked for that cannot be measured, or the size is impossible.
        """
        self.settings = settings
        self.stylizer: Stylizer = load_stylizer(settings.model, settings.threads)
        self.rows = choose_rows(settings)
        self.teachers: Teachers | None = None
        if settings.teachers is not None and {"views", *NEED_STYLES} & set(self.rows):
            self.teachers = Teachers.load(settings.teachers, settings.threads)
        self.styles: list[Path] = []
        if settings.styles is not None and set(NEED_STYLES) & set(self.rows):
            self.styles = held_out_styles(settings.styles)

    def values(self, group: Group, painting: Painting | None) -> Values:
        """All rows of a group, the stylized ones if there is a painting."""
        prediction = predict(self.stylizer, group, self.settings.intrinsics)
        values: Values = {}
        if "depth" in self.rows:
            cameras = prediction.recovered.cameras
            values |= depth_values(group, prediction.scene.means, cameras)
        if "cameras" in self.rows:
            focal = assumed_focal(group.views[0])
            values |= camera_values(group, prediction.recovered, prediction.given, focal)
        draws = "views" in self.rows and group.target is not None
        moves = "consistency" in self.rows and painting is not None
        if draws or moves:
            own, _ = self.stylizer.gaussians(prediction.scene, strength=0.0)
        if draws:
            values |= self._novel_view(group, prediction, own)
        if painting is not None:
            stylized, _ = self.stylizer.gaussians(prediction.scene, [painting.image])
            if "style" in self.rows:
                values |= self._style(group, prediction, stylized, painting)
            if moves:
                values |= self._consistency(prediction, own, stylized, painting)
        return values

    def paintings(self, scene: str, groups: int) -> list[Painting | None]:
        """For each of a scene's groups the painting to stylize it with, if it is to be."""
        if not self.styles:
            return [None] * groups
        assert self.teachers is not None
        styled = set(pick(range(groups), self.settings.styled_per_scene))
        return [
            load_painting(choose_style(self.styles, scene, k), STYLE_SIDE, self.teachers)
            if k in styled
            else None
            for k in range(groups)
        ]

    def _novel_view(self, group: Group, prediction: Prediction, own: Gaussians) -> Values:
        settings, lpips = self.settings, None if self.teachers is None else self.teachers.lpips
        how = (settings.intrinsics, lpips, settings.threads, settings.pose_steps)
        return novel_view_values(group, prediction, own, *how)

    def _style(
        self, group: Group, prediction: Prediction, stylized: Gaussians, painting: Painting
    ) -> Values:
        assert self.teachers is not None
        cameras, threads = prediction.recovered.cameras, self.settings.threads
        return style_values(group, stylized, cameras, painting, self.teachers, threads)

    def _consistency(
        self, prediction: Prediction, own: Gaussians, stylized: Gaussians, painting: Painting
    ) -> Values:
        assert self.teachers is not None
        cameras, threads = prediction.recovered.cameras, self.settings.threads
        return consistency_values(own, stylized, cameras, painting, self.teachers, threads)

    def scene(self, scene: TrueScene) -> Iterator[Record]:
        """The numbers of each group of a scene."""
        trained = scene.name in self.settings.training_scenes
        kind = "training" if trained else "validation"
        for count in self.settings.views:
            groups = choose_groups(scene, count, self.settings.per_scene)
            paintings = self.paintings(scene.name, len(groups))
            for group, painting in zip(groups, paintings, strict=True):
                yield Record.of(kind, group, self.values(group, painting))


def choose_rows(settings: Settings) -> list[str]:
    """The rows asked for, or all that the folders and the size allow.

    Raises:
        UsageError: a row is asked for that cannot be measured, or the size is impossible.
    """
    if settings.size < PATCH or settings.size % PATCH:
        raise UsageError(f"--size {settings.size}: must be a multiple of {PATCH}")
    lacking: dict[str, str] = {}
    if settings.teachers is None or settings.styles is None:
        lacking |= dict.fromkeys(NEED_STYLES, "needs --teachers and --styles")
    elif settings.size < SMALLEST_SIDE:
        lacking["consistency"] = f"needs --size {SMALLEST_SIDE} or more, for the optical flow"
    for row in settings.rows or ():
        if row in lacking:
            raise UsageError(f"--rows {row}: {lacking[row]}")
    return settings.rows or [row for row in ROWS if row not in lacking]


def measure(settings: Settings) -> Iterator[Record]:
    """The numbers of each group of each scene.

    Raises:
        Styl3rError: see Evaluator and load_scene.
    """
    torch.set_num_threads(settings.threads)
    cv2.setNumThreads(settings.threads)
    folders = scene_folders(settings.scenes)
    unknown = set(settings.only) - {path.name for path in folders}
    if unknown:
        raise UsageError(f"--only {sorted(unknown)[0]}: no such scene in {settings.scenes}")
    chosen = [path for path in folders if not settings.only or path.name in settings.only]
    evaluator = Evaluator(settings)
    for done, folder in enumerate(chosen, 1):
        yield from evaluator.scene(load_scene(folder, settings.size))
        if sys.stderr.isatty():
            end = "\n" if done == len(chosen) else ""
            print(f"\r{done}/{len(chosen)} scenes", end=end, file=sys.stderr)
