"""What an evaluation is asked for."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from styl3r_cli.errors import UsageError
from styl3r_cli.photos.resize import PATCH
from styl3r_export.evaluate.predict import Intrinsics
from styl3r_export.evaluate.raft import SMALLEST_SIDE

ROWS = ("depth", "cameras", "views", "style", "consistency")
NEED_STYLES = ("style", "consistency")
# Scenes whose licences allow shipped weights to be trained on them.
TRAINING_SCENES = ("box_shelf", "church_door", "office_desk")
# Options that name scenes; one of them at least is needed.
SOURCES = ("scenes", "shards", "re10k", "colmap")


@dataclass(frozen=True)
class Settings:
    """What is asked for.

    Attributes:
        model: model folder, bundled name, or checkpoint.
        scenes: folder of scene folders.
        shards: folder of generated scenes that training has not seen.
        re10k: folder of chunks.
        index: which frames of them are given and drawn (JSON).
        colmap: a COLMAP folder, or a folder of such.
        teachers: folder of networks to measure with; LPIPS and stylized rows need it.
        styles: folder of paintings; stylized rows need it.
        only: names of scenes; none for all.
        most: scenes of each of the folders at most; None for all.
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
    scenes: Path | None
    shards: Path | None
    re10k: Path | None
    index: Path | None
    colmap: Path | None
    teachers: Path | None
    styles: Path | None
    only: tuple[str, ...]
    most: int | None
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
        names = ("model", *SOURCES, "index", "teachers", "styles")
        paths = {name: getattr(self, name) for name in names}
        return asdict(self) | {n: "" if path is None else path.name for n, path in paths.items()}


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
