"""Variables that libraries would end a run for, as if by a bug; none of them is this tool's."""

from __future__ import annotations

import os

# numpy's f2py, which numba brings, takes it for a number when it is loaded. Nothing here has a use
# for it: results hold no time.
EPOCH = "SOURCE_DATE_EPOCH"
# OpenCV aborts the process for a value of its own variables that it cannot read, and starts as many
# threads as one of them says. Pictures are limited, and threads counted, by this tool's options.
OPENCV, KEPT = "OPENCV_", ("OPENCV_LOG_LEVEL", "OPENCV_IO_ENABLE_OPENEXR")


def clear() -> None:
    """Take them out of this process's environment, before one of these libraries is loaded."""
    for name in list(os.environ):
        if name == EPOCH or (name.startswith(OPENCV) and name not in KEPT):
            del os.environ[name]
