"""Options of `render` that would change nothing beside the others: refused, not ignored."""

from __future__ import annotations

from collections.abc import Set

from styl3r_cli.cameras.paths import PATHS
from styl3r_cli.commands.render_request import LINEAR, RenderRequest
from styl3r_cli.errors import UsageError

ALONE = "needs --path; a camera file alone has its own frames"
NO_STOPS = "needs --frames; without it, the frames are those of the file that --path names"
EXR = "is for EXR frames (.exr)"


def check_used(request: RenderRequest, given: Set[str]) -> None:
    """Refuse options that would be ignored.

    Args:
        request: all options.
        given: the names of those that the command line has, even with their default values.

    Raises:
        UsageError: one of them has no use beside the others.
    """
    path, made = request.path, request.path in PATHS or request.frames is not None
    moves = ALONE if path is None else None if made else NO_STOPS
    exr = None if request.kind == LINEAR else EXR
    reasons = {
        "frames": ALONE if path is None else None,
        "amplitude": moves,
        "loop": moves,
        "speed": moves,
        "arc": None if path == "orbit" else "is for --path orbit",
        "layout": None if request.compare else "is for --compare",
        "colour_map": None if request.show != "colour" else "is for --show depth and both",
        "exr_compression": exr,
        "exr_parts": exr,
    }
    for name, reason in reasons.items():
        if reason is not None and name in given:
            option = "loop/--once" if name == "loop" else name.replace("_", "-")
            raise UsageError(f"--{option} {reason}")
    if request.compare and request.show == "both":
        raise UsageError("--show both has no room for --compare; show colour or depth")
