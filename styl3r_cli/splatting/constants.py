"""The numbers that define the picture: each with its reason and where it comes from.

"INRIA" is the reference rasteriser of 3D Gaussian Splatting (Kerbl et al. 2023), "gsplat" the
library of that name. The kernels compile these in: the renderer, the differentiable twin in
torch and the tests read them from here, so that all of them draw the same picture.
"""

from __future__ import annotations

import math

DILATION = 0.3
"""Added to both variances of a projected Gaussian, px^2: a splat covers at least about one pixel
(the low-pass filter of EWA splatting; value from INRIA, and what scenes are trained with)."""

JACOBIAN_MARGIN = 0.3
"""The projection's Jacobian is taken no further outside the frame than this fraction of
tan(fov / 2): EWA's linearisation explodes there. INRIA clamps at 1.3 tan(fov / 2) of a centred
camera; measured from each edge of the frame, as in gsplat, it holds for any principal point."""

ALPHA_MAX = 0.99
"""No splat hides what is behind it completely, so gradients reach through (INRIA, gsplat)."""

ALPHA_MIN = 1.0 / 255.0
"""A splat is skipped at pixels where it is fainter: no 8-bit picture could show it (INRIA)."""

TRANSMITTANCE_MIN = 1e-4
"""A pixel is finished *before* the splat that would take its transmittance below this (INRIA)."""

PIXEL_CENTRE = 0.5
"""The first pixel's centre, measured from the frame's corner (as in Camera, and gsplat)."""

TILE = 16
"""Side of the square of pixels that shares one list of splats (INRIA). No effect on the picture."""

MEDIAN_TRANSMITTANCE = 0.5
"""The median depth is that of the splat which takes transmittance to this, or of the last one
drawn where none does (2D Gaussian Splatting, arXiv 2403.17888, section 4.2)."""

NEAR_FRACTION = 0.02
"""The near plane, as a fraction of the scene's size. INRIA culls at a fixed 0.2 units, which
empties small scenes; Styl3R's decoder enlarges the scene tenfold to get around it, which makes
0.02 units of a scene about one unit in size. Relative to the size, it holds in any unit."""

LOG2_INVERSE_ALPHA_MIN = -math.log2(ALPHA_MIN)
"""A splat of opacity o reaches as far as log2(o) plus this, in halvings of alpha. Bounds that
follow from it are exact, unlike a fixed 3 sigma (opacity-aware extents, arXiv 2402.00525 B.2)."""

LOG2_CULL_MIN = -LOG2_INVERSE_ALPHA_MIN - 1e-4
"""Pixels and tiles are passed over only where log2(alpha) is below this: lower than the cut-off
by more than float32 can err there, so that what is passed over never changes a picture."""

HALVINGS_PER_SQUARED_SIGMA = 0.5 / math.log(2.0)
"""exp(-d^2 / 2) = 2^(-d^2 * this): the kernels count in powers of two."""
