"""Only as many Gaussians as a scene requires: dropped, merged and measured, without training.

Importing it loads numba, so commands import it when they use it.
"""

from styl3r_cli.compaction.compaction import DROPPED, Compaction, everything
from styl3r_cli.compaction.search import Compactor, keep_count, keep_decibels, measured
from styl3r_cli.compaction.witnesses import in_between, witnesses

__all__ = [
    "DROPPED",
    "Compaction",
    "Compactor",
    "everything",
    "in_between",
    "keep_count",
    "keep_decibels",
    "measured",
    "witnesses",
]
