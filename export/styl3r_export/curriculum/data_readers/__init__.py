"""Readers of the published training data: chunks of posed videos, and a folder of paintings."""

from styl3r_export.curriculum.data_readers.paintings import PaintingFolder
from styl3r_export.curriculum.data_readers.sampling import DL3DV, RE10K, DataSet, GapSchedule
from styl3r_export.curriculum.data_readers.videos import (
    VideoBatch,
    inputs_only,
    joined,
    video_batches,
)

__all__ = [
    "DL3DV",
    "RE10K",
    "DataSet",
    "GapSchedule",
    "PaintingFolder",
    "VideoBatch",
    "inputs_only",
    "joined",
    "video_batches",
]
