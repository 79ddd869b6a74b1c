"""The splat renderer: Gaussians and a camera become a frame, on the CPU.

Importing it loads numba (a third of a second), so commands import it when they draw.
"""

from styl3r_cli import limits, needs

limits.check(needs.drawing())  # under less, numba is imported in part, or never ends

from styl3r_cli.splatting.numba_library import check_environment  # noqa: E402

check_environment()

from styl3r_cli.splatting.renderer import Frame, render  # noqa: E402

__all__ = ["Frame", "render"]
