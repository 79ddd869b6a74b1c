"""How large a pixel is at a Gaussian, and so how wide the Gaussian has to be to leave no gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.pipeline import Scene

# Standard deviation, pixels of the view. Renderers widen every Gaussian by DILATION, so networks
# that learn through one at the photos' size make mere points (mini: a quarter of a pixel). A frame
# of more pixels, or a viewer that makes small Gaussians as faint as they are (Spark, Babylon), then
# shows a lattice of dots. Pixels are 1 apart: from 0.5 on neighbours meet at any size. It is the
# least scale of pixelSplat (arXiv 2312.12337), and near Mip-Splatting's sqrt(0.2) (2311.16493).
# On four real scenes, 0.5 beside mini's own: coverage in frames of 1024 pixels 79 % to 98 %, frames
# at the photos' size 1.0 dB nearer to them on black, at 256 pixels 0.5 dB further off. 0.4 leaves
# gaps (94 %), 0.6 costs another 0.3 dB.
LEAST_SCALE = 0.5


def without_gaps(scene: Scene, recovered: Recovered) -> Scene:
    """The scene with every Gaussian at least LEAST_SCALE pixels of its own view wide.

    Args:
        scene: one Gaussian a pixel and view.
        recovered: the views' cameras. Views whose camera was not found stay as they are: how far
            away they saw something is not known.
    """
    scales = scene.scales.copy()
    for view in np.flatnonzero(recovered.recovered):
        camera = recovered.cameras[view]
        forward, offset = camera.extrinsics[2, :3], camera.extrinsics[2, 3]
        with np.errstate(all="ignore"):  # what is not finite is dropped later
            depth = scene.means[view] @ forward.astype(np.float32) + np.float32(offset)
            least = depth * np.float32(LEAST_SCALE / camera.fx)
        np.fmax(scales[view], least[..., None], out=scales[view])
    return replace(scene, scales=scales)
