"""The evaluation's loop: scenes, groups of photos, rows."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import torch

from styl3r_cli.gaussians import Gaussians
from styl3r_cli.painter import Painter
from styl3r_cli.photos.load import STYLE_SIDE
from styl3r_cli.pipeline import Stylizer
from styl3r_export.evaluate.consistency import consistency_values
from styl3r_export.evaluate.depth import depth_values
from styl3r_export.evaluate.groups import Group, pick
from styl3r_export.evaluate.novel_views import novel_view_values
from styl3r_export.evaluate.poses import camera_values
from styl3r_export.evaluate.predict import Prediction, assumed_focal, load_stylizer, predict
from styl3r_export.evaluate.records import Record, Values
from styl3r_export.evaluate.settings import NEED_STYLES, Settings, choose_rows
from styl3r_export.evaluate.sources import Case, find_cases
from styl3r_export.evaluate.style import (
    Painting,
    choose_style,
    held_out_styles,
    load_painting,
    style_values,
)
from styl3r_export.evaluate.teachers import Teachers


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
        painter = Painter(
            self.stylizer, prediction.scene, prediction.recovered, self.settings.threads
        )
        values: Values = {}
        known = all(len(view.truth[1]) for view in group.views)
        if "depth" in self.rows and known:
            cameras = prediction.recovered.cameras
            values |= depth_values(group, prediction.scene.means, cameras)
        if "cameras" in self.rows:
            focal = assumed_focal(group.views[0])
            values |= camera_values(group, prediction.recovered, prediction.given, focal)
        draws = "views" in self.rows and bool(group.targets)
        moves = "consistency" in self.rows and painting is not None
        if draws or moves:
            own, _ = painter(strength=0.0)
        if draws:
            values |= self._novel_view(group, prediction, own)
        if painting is not None:
            stylized, _ = painter([painting.image])
            if "style" in self.rows:
                values |= self._style(group, prediction, stylized, painting)
            if moves:
                values |= self._consistency(group, prediction, own, stylized, painting)
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
        self,
        group: Group,
        prediction: Prediction,
        own: Gaussians,
        stylized: Gaussians,
        painting: Painting,
    ) -> Values:
        assert self.teachers is not None
        cameras, threads = prediction.recovered.cameras, self.settings.threads
        first, last = (group.views[k].pixels / np.float32(255) for k in (0, len(group.inputs) - 1))
        how = (cameras, painting, self.teachers, threads, (first, last))
        return consistency_values(own, stylized, *how)

    def case(self, case: Case) -> Iterator[Record]:
        """The numbers of each group of a scene."""
        for groups in case.groups():
            paintings = self.paintings(case.name, len(groups))
            for group, painting in zip(groups, paintings, strict=True):
                yield Record.of(case.kind, group, self.values(group, painting))


def measure(settings: Settings) -> Iterator[Record]:
    """The numbers of each group of each scene.

    Raises:
        Styl3rError: see Evaluator and find_cases.
    """
    torch.set_num_threads(settings.threads)
    cv2.setNumThreads(settings.threads)
    cases, evaluator, empty = find_cases(settings), Evaluator(settings), 0
    for done, case in enumerate(cases, 1):
        records = list(evaluator.case(case))
        yield from records
        empty += not records
        if sys.stderr.isatty():
            end = "\n" if done == len(cases) else ""
            print(f"\r{done}/{len(cases)} scenes", end=end, file=sys.stderr)
    if empty:
        note = "too few photos that overlap, or too wide a lens"
        print(f"Note: {empty} of {len(cases)} scenes have no group: {note}", file=sys.stderr)
