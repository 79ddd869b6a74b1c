"""What the command line asks of `stylize` and `reconstruct`: checked, and its inputs loaded."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from styl3r_cli import limits, needs
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.commands.checks import check_outputs, check_stdout, check_suffix, make_folder
from styl3r_cli.commands.each import check_each, one_by_one, outputs_of
from styl3r_cli.commands.options import STDOUT, WeightedStyle
from styl3r_cli.console import Console
from styl3r_cli.errors import InputError, UsageError
from styl3r_cli.files import read_stdin
from styl3r_cli.formats import scene_suffix
from styl3r_cli.manifest import MANIFEST
from styl3r_cli.movies import FILES as MOVIES
from styl3r_cli.names import real_path, user_path
from styl3r_cli.painter import warm_up
from styl3r_cli.photos import Photos, Style, expand, load_photos, load_style
from styl3r_cli.photos.focal import focal_from_fov
from styl3r_cli.photos.listing import NAMES, parse_list
from styl3r_cli.photos.load import DEFAULT_SIZE, MAX_VIEWS
from styl3r_cli.pipeline import Stylizer, style_shares
from styl3r_cli.pipes import is_pipe
from styl3r_cli.quality import BEST, COMPACTED, FITTED, KEPT_DECIBELS, network_size


@dataclass(frozen=True)
class SceneRequest:
    """The options of `stylize` and `reconstruct`, as the command line gave them.

    `size` is (width, height), as people say it; `output` may be "-". With `each`, every style has
    a scene of its own, and outputs are patterns (see `commands.each`).
    """

    command: str
    photos: tuple[str, ...]
    null: bool
    styles: tuple[WeightedStyle, ...]
    strength: float
    output: str
    video: Path | None
    preview: Path | None
    cameras_out: Path | None
    cameras: Path | None
    fov: float | None
    size: tuple[int, int] | None
    model: str
    device: str
    threads: int | None
    json: bool
    quiet: bool
    each: bool = False
    quality: str = BEST
    keep_db: float | None = None
    keep_all: bool = False

    @property
    def decibels(self) -> float | None:
        """What the scene is compacted to; None for not at all."""
        if self.keep_all:
            return None
        asked = KEPT_DECIBELS if COMPACTED[self.quality] else None
        return asked if self.keep_db is None else self.keep_db

    @property
    def scene_path(self) -> Path | None:
        """Where the scene goes; None for standard output."""
        return None if self.output == STDOUT else user_path(self.output)

    @property
    def suffix(self) -> str:
        """The scene's format; a pipe's name says none, and gets what standard output gets."""
        if self.scene_path is None or is_pipe(self.scene_path):
            return ".ply"
        return scene_suffix(self.scene_path)


@dataclass(frozen=True)
class Inputs:
    """Everything that is read before the network runs.

    `styles` has None where `each` is asked for and a picture cannot be used; `left_out` says why.
    """

    stylizer: Stylizer
    photos: Photos
    styles: list[Style | None]
    left_out: list[str]

    @property
    def usable_styles(self) -> list[Style]:
        """Those that could be read."""
        return [style for style in self.styles if style is not None]


def load_inputs(request: SceneRequest, console: Console) -> Inputs:
    """Check the request, and load model, photos and styles (the model in a thread of its own).

    Raises:
        Styl3rError: whatever is wrong with the request or its files.
    """
    notes: list[str] = []
    listed = _listed(request)
    paths = _without_styles(request, expand(request.photos, notes, listed), notes)
    _check(request, paths)
    known = _known_cameras(request, paths, notes)
    size = request.size[::-1] if request.size else network_size(request.quality, DEFAULT_SIZE)
    _check_limits(request, paths, size)
    if FITTED[request.quality]:
        warm_up(compact=request.decibels is not None)
    for note in notes:
        console.note(note)

    def load(size: tuple[int, int]) -> Photos:
        return load_photos(paths, size, request.fov, known)

    with ThreadPoolExecutor(1) as pool:
        settings = request.model, request.device, request.threads
        loading = pool.submit(Stylizer, *settings, one_scene=True)
        with console.stage("photos"):
            styles, left_out = _load_styles(request)
            photos = load(size)
        with console.stage("model"):
            stylizer = loading.result()
    wanted = network_size(request.quality, stylizer.model.input_size)
    if request.size is None and wanted != size:
        _check_limits(request, paths, wanted)
        with console.stage("photos"):
            photos = load(wanted)
    for note in [*photos.notes, *(note for style in styles if style for note in style.notes)]:
        console.note(note)
    if request.each:
        for path in outputs_of(request):
            make_folder(path.parent)
    return Inputs(stylizer, photos, styles, left_out)


def _check_limits(request: SceneRequest, photos: list[Path], size: tuple[int, int]) -> None:
    """Refuse limits under which the scene could not be made, before the work.

    Raises:
        OutOfMemoryError: a limit is too low for it.
    """
    draws = FITTED[request.quality] or request.decibels is not None
    pixels = min(len(photos), MAX_VIEWS) * math.prod(size)
    shown = request.video is not None or request.preview is not None
    limits.check(needs.scene(pixels) if draws else needs.network(pixels, shown))


def _load_styles(request: SceneRequest) -> tuple[list[Style | None], list[str]]:
    """The styles; of a batch of scenes, those that can be used, and what is wrong with others.

    Raises:
        InputError: a style that is needed cannot be used; of a batch, every one.
    """
    if not request.each:
        return [load_style(style.path) for style in request.styles], []
    styles: list[Style | None] = []
    errors: list[InputError] = []
    for style in request.styles:
        try:
            styles.append(load_style(style.path))
        except InputError as error:
            styles.append(None)
            errors.append(error)
    if len(errors) == len(styles):
        raise errors[0]
    return styles, [str(error) for error in errors]


def _listed(request: SceneRequest) -> list[str]:
    """The photos that are named on standard input, for the argument "-"."""
    if STDOUT in request.photos:
        return parse_list(read_stdin(NAMES), request.null)
    if request.null:
        raise UsageError("-0 is for photos that are named on standard input; add the argument -")
    return []


def _without_styles(request: SceneRequest, photos: list[Path], notes: list[str]) -> list[Path]:
    """The photos, without style pictures that lie in their folder or match their glob.

    A file that is named as both is both.
    """
    styles = {real_path(style.path) for style in request.styles}
    styles -= {real_path(user_path(name)) for name in request.photos}
    both = [path for path in photos if real_path(path) in styles]
    notes += [f"{path} is a style, so it is not used as a photo" for path in both]
    return [path for path in photos if path not in both]


def _check(request: SceneRequest, photos: list[Path]) -> None:
    """Refuse what could not end well, before any work."""
    if request.keep_all and request.keep_db is not None:
        raise UsageError("--keep-db and --all exclude each other; give one")
    style_shares(len(request.styles), [style.weight for style in request.styles])
    if request.fov is not None:
        focal_from_fov(request.fov, 1)
    scene = request.scene_path
    if scene is not None:
        _ = request.suffix  # a name that says no format is refused
    elif request.json:
        raise UsageError("--json and -o - both want standard output; give -o a file's name")
    else:
        check_stdout("-o -")
    for option, path, suffix in (
        ("--preview", request.preview, ".png"),
        ("--cameras-out", request.cameras_out, ".json"),
    ):
        if path is not None:
            check_suffix(path, suffix, option)
    if request.video is not None and request.video.suffix.lower()[1:] not in MOVIES:
        known = ", ".join(f".{kind}" for kind in MOVIES)
        raise UsageError(f"--video {request.video}: the file's name must end in one of {known}")
    read = [*photos, *(style.path for style in request.styles)]
    if request.cameras is not None:
        read.append(request.cameras)
    read.append(user_path(request.model) / MANIFEST)
    check_each(request)
    makes = [path.parent for path in outputs_of(request)] if request.each else []
    outputs = [path for one in one_by_one(request) for path in outputs_of(one)]
    if request.each and request.cameras_out:  # one file for all of them
        outputs.append(request.cameras_out)
    check_outputs(outputs, read, prints=request.json, makes=makes)
    for style in request.styles:
        if not style.path.exists():
            raise InputError(f"{style.path}: no such style picture")


def _known_cameras(
    request: SceneRequest, photos: list[Path], notes: list[str]
) -> dict[Path, Camera] | None:
    """The photos' intrinsics from a camera file, if one was given."""
    if request.cameras is None:
        return None
    from styl3r_cli.cameras.photo_frames import known_cameras

    found, told = known_cameras(request.cameras, photos)
    notes += told
    return found
