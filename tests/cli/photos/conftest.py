"""Pictures to decode, and the reference data where it is at hand."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with reference data and real photos, or a skip."""
    checkout = Path(__file__).resolve().parents[3]
    folder = Path(os.environ.get("STYL3R_SHARED", checkout.parent / "shared"))
    if not (folder / "reference").is_dir():
        pytest.skip("no reference data: set STYL3R_SHARED to its folder")
    return folder


@pytest.fixture
def picture() -> NDArray[np.uint8]:
    """(48, 64, 3): smooth colours, no two corners alike."""
    y, x = np.mgrid[0:48, 0:64]
    return np.stack([x * 4, y * 5, 255 - 2 * x - 2 * y], axis=-1).clip(0, 255).astype(np.uint8)
