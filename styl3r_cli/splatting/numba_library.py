"""numba, as far as its environment variables let it compile."""

from __future__ import annotations

import os

from styl3r_cli.errors import UsageError

PREFIX = "NUMBA_"


def check_environment() -> None:
    """Import numba, which reads its variables then.

    Raises:
        UsageError: one of them has a value that numba refuses, or has it compile nothing.
    """
    try:
        import numba
    except ValueError as error:  # it does not say of which variable
        given = " ".join(f"{k}={v}" for k, v in os.environ.items() if k.startswith(PREFIX))
        raise UsageError(f"{given}: numba refuses that ({error}); unset it") from error
    # In Python alone a frame would take minutes.
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        raise UsageError(
            "NUMBA_DISABLE_JIT: frames are drawn by code that numba compiles; unset it"
        )
