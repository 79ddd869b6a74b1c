"""What several tests of exports need."""

import pytest
import torch
from small_checkpoints import TINY

from styl3r_export import checkpoints
from styl3r_export.model import Styl3r, build


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> Styl3r:
    """A model of the published layout, small; loaders take its sizes for the published ones."""
    monkeypatch.setattr(checkpoints, "FULL", TINY)
    torch.manual_seed(0)
    return build(TINY)
