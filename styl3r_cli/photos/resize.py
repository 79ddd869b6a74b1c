"""The paper's resize and centre crop, for photos and for style pictures, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

PATCH = 16  # the network's patch size; both sides of its pictures are multiples of it
# A photo that would have more pixels when it covers the frame is cropped as it is scaled: a frame
# that is a sliver of it would take gigabytes.
MOST_WHOLE_PIXELS = 1 << 26
# Features are sought in twice the network's size: there are twice as many right matches (32 pairs
# of real photos of at most 640 pixels). Beyond 1024 pixels, finding them takes long.
DETAIL, MOST_DETAIL = 2.0, 1024


def fit_photo(image: Image.Image, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Scale a photo until it just covers `size`, then crop its centre.

    LANCZOS on 8-bit values, as the published network was trained (Styl3R, arXiv 2505.21060).
    Smaller photos are enlarged. Where the whole scaled photo would be absurdly large, only the crop
    is made, which differs from it by rounding.

    Args:
        image: RGB.
        size: (height, width) of the result.

    Returns:
        (height, width, 3) uint8.
    """
    height, width = size
    resized_height, resized_width = _covering(image.size, size)
    top, left = (resized_height - height) // 2, (resized_width - width) // 2
    if resized_height * resized_width > MOST_WHOLE_PIXELS:
        crop = (left, top, left + width, top + height)
        scales = image.width / resized_width, image.height / resized_height
        ends = [min(end * scales[i % 2], image.size[i % 2]) for i, end in enumerate(crop)]
        box = (ends[0], ends[1], ends[2], ends[3])
        return np.asarray(image.resize((width, height), Image.Resampling.LANCZOS, box))
    resized = image.resize((resized_width, resized_height), Image.Resampling.LANCZOS)
    return np.asarray(resized)[top : top + height, left : left + width]


def detail_size(photo_size: tuple[int, int], size: tuple[int, int]) -> tuple[int, int]:
    """(height, width) in which a photo's crop is looked at for features: no more than it has.

    Args:
        photo_size: (width, height) of the photo.
        size: (height, width) of the network's crop of it.
    """
    height, width = size
    given = min(photo_size[1] / height, photo_size[0] / width)
    factor = max(1.0, min(DETAIL, given, MOST_DETAIL / max(size)))
    return round(height * factor), round(width * factor)


def fit_intrinsics(
    intrinsics: NDArray[np.float64], photo_size: tuple[int, int], size: tuple[int, int]
) -> NDArray[np.float32]:
    """Intrinsics of a photo after `fit_photo`, normalised by the result's width and height.

    Distances from the picture's centre are scaled like the picture, the principal point's
    included; the half pixel that an odd margin shifts the crop by is ignored, so a principal point
    in the photo's centre stays in the crop's centre, as in the network's training.

    Args:
        intrinsics: (3, 3) in the photo's pixels.
        photo_size: (width, height) of the photo before `fit_photo`.
        size: (height, width) of the result.

    Returns:
        (3, 3) float32.
    """
    (height, width), (resized_height, resized_width) = size, _covering(photo_size, size)
    centre = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    normalised = intrinsics / np.array([[photo_size[0]], [photo_size[1]], [1.0]])
    magnified = np.array([[resized_width / width], [resized_height / height], [1.0]])
    return ((normalised - centre) * magnified + centre).astype(np.float32)


def fit_map(
    values: NDArray[Any], photo_size: tuple[int, int], size: tuple[int, int]
) -> NDArray[Any]:
    """What lies over a photo, as `fit_photo` shows the photo; the nearest value for each pixel.

    Args:
        values: (h, w) over the whole photo, in any resolution.
        photo_size: (width, height) of the photo before `fit_photo`.
        size: (height, width) of the result.
    """
    rows, columns = (
        ((np.arange(side) + (whole - side) // 2 + 0.5) / whole * given).astype(np.intp)
        for side, whole, given in zip(size, _covering(photo_size, size), values.shape, strict=True)
    )
    return values[np.ix_(rows, columns)]


def fit_style(image: Image.Image, side: int) -> NDArray[np.uint8]:
    """Scale a style picture's shorter side to `side`, then crop the centre square.

    The longer side is truncated and the crop's corner rounded half to even, as the published
    network's styles are prepared.

    Args:
        image: RGB.
        side: height and width of the result.

    Returns:
        (side, side, 3) uint8.
    """
    shorter, longer = sorted(image.size)
    scaled = int(side * longer / shorter)
    width, height = (side, scaled) if image.width <= image.height else (scaled, side)
    resized = image.resize((width, height), Image.Resampling.LANCZOS)
    top, left = round((height - side) / 2), round((width - side) / 2)
    return np.asarray(resized)[top : top + side, left : left + side]


def _covering(photo_size: tuple[int, int], size: tuple[int, int]) -> tuple[int, int]:
    """(height, width) of a (width, height) photo scaled so that it just covers `size`."""
    width, height = photo_size
    factor = max(size[0] / height, size[1] / width)
    return round(height * factor), round(width * factor)
