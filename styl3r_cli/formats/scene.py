"""What scene formats take and give."""

from __future__ import annotations

from dataclasses import dataclass, field

from styl3r_cli.gaussians import Gaussians


@dataclass(frozen=True)
class Scene:
    """A scene as read from a file.

    Attributes:
        gaussians: the scene, all values finite.
        metadata: the text that styl3r wrote along with it, if it did.
        notes: one line each on what was ignored, dropped or repaired.
        dropped: Gaussians left out because they were not finite.
        non_finite: how many of those had such a value, by attribute.
    """

    gaussians: Gaussians
    metadata: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    dropped: int = 0
    non_finite: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Encoded:
    """A scene as bytes of a file.

    Attributes:
        data: the file.
        count: Gaussians in it.
        dropped: Gaussians left out because they were not finite.
        notes: one line each on what was dropped, rounded or repaired.
    """

    data: bytes
    count: int
    dropped: int = 0
    notes: list[str] = field(default_factory=list)
