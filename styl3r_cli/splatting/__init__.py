"""The splat renderer: Gaussians and a camera become a frame, on the CPU.

Importing it loads numba (a third of a second), so commands import it when they draw.
"""

from styl3r_cli.splatting.renderer import Frame, render

__all__ = ["Frame", "render"]
