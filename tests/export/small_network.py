"""The published network, small, and an export's other ingredients."""

from __future__ import annotations

from dataclasses import replace

import torch

from styl3r_export.graphs_metadata import Provenance
from styl3r_export.model import FULL, ModelConfig, Styl3r, build
from styl3r_export.verify import Case

# The published network, small, with a few weights that are large enough to be halved.
SMALL = replace(
    FULL,
    head_dim=32,
    encoder_dim=96,
    encoder_depth=1,
    style_depth=1,
    decoder_dim=64,
    decoder_depth=3,
    stylizer_depth=3,
    hooks=(1, 2, 3),
    head_maps=(4, 6, 8, 10),
    head_features=8,
    point_features=6,
)
# Views, styles and sizes that neither the trace nor the export's own verification sees.
UNSEEN = (
    Case(2, 2, (16, 32), (16, 16)),
    Case(5, 1, (80, 48), (48, 80)),
    Case(8, 4, (32, 32), (32, 16)),
)
PROVENANCE = Provenance("test", "CC0-1.0", "5ha")


def small_model(config: ModelConfig = SMALL) -> Styl3r:
    torch.manual_seed(3)
    return build(config)
