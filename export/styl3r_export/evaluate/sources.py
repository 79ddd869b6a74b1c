"""Where scenes to evaluate on come from; each is read when its turn comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from styl3r_cli.errors import UsageError
from styl3r_export.evaluate.colmap_scenes import colmap_folders, load_colmap
from styl3r_export.evaluate.generated import generated_scenes
from styl3r_export.evaluate.groups import Group, choose_groups, pick
from styl3r_export.evaluate.scenes import TrueScene, load_scene, scene_folders
from styl3r_export.evaluate.settings import SOURCES, Settings
from styl3r_export.evaluate.videos import video_groups


@dataclass(frozen=True)
class Case:
    """One scene that is to be measured.

    Attributes:
        kind: what it is reported under (see Record).
        name: of the scene.
        groups: reads it, and gives its groups for each number of views that is asked for.
    """

    kind: str
    name: str
    groups: Callable[[], list[list[Group]]]


def find_cases(settings: Settings) -> list[Case]:
    """All scenes that the settings name.

    Raises:
        InputError: a folder does not hold what it should.
        UsageError: no folder is named, or a scene that is not in them.
    """
    if all(getattr(settings, source) is None for source in SOURCES):
        options = ", ".join(f"--{source}" for source in SOURCES)
        raise UsageError(f"no scenes; name a folder with one of {options}")
    if (settings.re10k is None) != (settings.index is None):
        raise UsageError("--re10k and --index go together: chunks, and which frames to use")
    sources = [list(source(settings)) for source in (_stored, _generated, _videos, _colmap)]
    unknown = set(settings.only) - {case.name for cases in sources for case in cases}
    if unknown:
        raise UsageError(f"--only {sorted(unknown)[0]}: no such scene in the folders given")
    chosen = []
    for cases in sources:
        cases = [case for case in cases if not settings.only or case.name in settings.only]
        chosen += cases if settings.most is None else pick(cases, settings.most)
    return chosen


def _stored(settings: Settings) -> Iterator[Case]:
    for folder in [] if settings.scenes is None else scene_folders(settings.scenes):
        kind = "training" if folder.name in settings.training_scenes else "validation"
        read = partial(load_scene, folder, settings.size)
        yield Case(kind, folder.name, partial(_neighbours, read, settings))


def _generated(settings: Settings) -> Iterator[Case]:
    if settings.shards is not None:
        for name, read in generated_scenes(settings.shards, settings.size):
            yield Case("generated", name, partial(_neighbours, read, settings))


def _videos(settings: Settings) -> Iterator[Case]:
    if settings.re10k is not None and settings.index is not None:
        arguments = (settings.re10k, settings.index, settings.views, settings.size)
        for name, groups in video_groups(*arguments):
            yield Case("RE10K", name, groups)


def _colmap(settings: Settings) -> Iterator[Case]:
    for folder in [] if settings.colmap is None else colmap_folders(settings.colmap):
        read = partial(load_colmap, folder, settings.size)
        yield Case("COLMAP", folder.name, partial(_neighbours, read, settings))


def _neighbours(read: Callable[[], TrueScene], settings: Settings) -> list[list[Group]]:
    scene = read()
    return [choose_groups(scene, count, settings.per_scene) for count in settings.views]
