"""Depth pictures, as scanning apps put them beside their photos."""

from __future__ import annotations

import io
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as form
from numpy.typing import NDArray

from styl3r_cli.errors import InputError
from styl3r_cli.files import read_file
from styl3r_cli.photos.decode import MAX_PIXELS, failures_named, opened_picture

DEEP = ("I", "F")  # Pillow's modes of one channel with more than 8 bits begin so
ARRAY_SUFFIX = ".npy"
NUMBERS = "iuf"  # numpy's kinds of them


def read_depth(path: Path) -> NDArray[Any]:
    """A depth map, in the file's own unit of length.

    Args:
        path: a picture of one channel with 16 or 32 bits (PNG, TIFF), or numpy's .npy.

    Returns:
        (H, W) of any type of numbers; what is not above 0 is not known.

    Raises:
        InputError: the file cannot be read, is damaged, too large, or no depth picture.
    """
    if path.suffix.lower() == ARRAY_SUFFIX:
        return _read_array(path)
    with opened_picture(path) as picture:
        if not picture.mode.startswith(DEEP):
            raise InputError(f"{path}: no depth picture: one channel of 16 or 32 bits, or .npy")
        return np.asarray(picture)


def _read_array(path: Path) -> NDArray[Any]:
    with failures_named(path):
        data = read_file(path)
        try:
            with warnings.catch_warnings(action="ignore"):  # of Python 2's headers
                values = _array(io.BytesIO(data))
        except MemoryError:
            raise
        except Exception as error:  # a damaged header can raise anything in its parsers
            raise ValueError(error) from error
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    if values.ndim != 2 or values.dtype.kind not in NUMBERS or not values.size:
        what = f"{values.dtype} {values.shape}"
        raise InputError(f"{path}: no depth picture: numbers (height, width), not {what}")
    return values


def _array(file: io.BytesIO) -> NDArray[Any]:
    """What a .npy file holds; memory is set aside only for as much as the file can hold."""
    of_version = {(1, 0): form.read_array_header_1_0, (2, 0): form.read_array_header_2_0}
    shape, _, _ = of_version[form.read_magic(file)](file)
    if math.prod(shape) > MAX_PIXELS:
        raise ValueError(f"larger than {MAX_PIXELS // 10**6} megapixels")
    file.seek(0)
    return form.read_array(file, allow_pickle=False)
