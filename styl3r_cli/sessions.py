"""One ONNX graph in onnxruntime: its session, its signature, and a run that Ctrl-C can stop."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stdout
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from styl3r_cli import memory
from styl3r_cli.errors import ModelError, OutOfMemoryError, Styl3rError, UsageError, shortened
from styl3r_cli.gaussians import FloatArray
from styl3r_cli.limits import available_cores
from styl3r_cli.onnx_library import onnxruntime

if TYPE_CHECKING:
    from onnxruntime import InferenceSession, NodeArg, SessionOptions

DEVICES = ("auto", "cpu", "cuda")
CPU, CUDA = "CPUExecutionProvider", "CUDAExecutionProvider"
SILENT = 4  # onnxruntime's severity "fatal": its other complaints are raised as errors anyway
# After each run the memory that it used goes back, or the two graphs' peaks would add up: 325
# instead of 433 MB for two views (mini), at no measurable cost in time.
SHRINK = ("memory.enable_memory_arena_shrinkage", "cpu:0")
# Threads that wait for work sleep instead of spinning: beside a busy program mini's structure graph
# takes 0.40 s instead of 0.64, and alone on two cores 0.25 s instead of 0.22.
NO_SPINNING = ("session.intra_op.allow_spinning", "0")

# What stands before each message in onnxruntime's; those of several levels are one in the other.
PREFIX = re.compile(r"\[ONNXRuntimeError\] : \d+ : \w+ : ")

_finding_cuda = Lock()


class Argument(NamedTuple):
    """What a graph says of an input or an output."""

    type: str
    rank: int


def _described(arguments: Iterable[NodeArg]) -> dict[str, Argument]:
    """By name, read at once: damaged names of axes raise here, while the graph is loaded."""
    return {found.name: Argument(found.type, len(found.shape)) for found in arguments}


class Graph:
    """One graph with a known signature; call it with named arrays, get named arrays."""

    def __init__(self, path: Path, session: InferenceSession) -> None:
        self.path = path
        self.metadata: dict[str, str] = session.get_modelmeta().custom_metadata_map
        self.device = "cuda" if session.get_providers()[0] == CUDA else "cpu"
        self._session = session
        self._inputs = _described(session.get_inputs())
        self._outputs = _described(session.get_outputs())

    @property
    def inputs(self) -> list[str]:
        """Names of what it declares to read."""
        return list(self._inputs)

    @classmethod
    def load(
        cls,
        path: Path,
        device: str = "auto",
        threads: int | None = None,
        optimise: bool = True,
    ) -> Graph:
        """Open a graph file; the weights beside it too, if they are in a file of their own.

        Args:
            path: the .onnx file.
            device: one of DEVICES.
            threads: for its runs; None for every core this process may use.
            optimise: fuse operators, which makes loading slower and runs faster.

        Raises:
            ModelError: onnxruntime cannot load it (weights outside its folder, among others).
            OutOfMemoryError: there is too little memory for it.
            UsageError: the device does not exist here.
        """
        ort = onnxruntime()
        ort.set_default_logger_severity(SILENT)
        options = ort.SessionOptions()
        options.log_severity_level = SILENT
        cores = available_cores()
        # More threads than cores only wait for each other; thousands, for minutes.
        options.intra_op_num_threads = min(threads or cores, cores)
        options.inter_op_num_threads = 1
        options.add_session_config_entry(*NO_SPINNING)
        if not optimise:
            options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
        try:
            graph = cls(path, _session(path, options, device))
        except UsageError:
            raise
        except Exception as error:  # onnxruntime's exceptions have no common base
            raise _failure(path, "cannot be loaded", error) from error
        if device == "cuda" and graph.device != "cuda":
            raise UsageError("--device cuda: onnxruntime found no working GPU, driver or library")
        return graph

    def check(
        self, inputs: Mapping[str, int], optional: Mapping[str, int], outputs: Mapping[str, int]
    ) -> None:
        """Compare names, ranks and types with what the pipeline will feed and read.

        Raises:
            ModelError: naming the first difference.
        """
        self._check_side("input", self._inputs, inputs, {**inputs, **optional})
        self._check_side("output", self._outputs, outputs, outputs)

    def _check_side(
        self,
        side: str,
        given: Mapping[str, Argument],
        required: Mapping[str, int],
        allowed: Mapping[str, int],
    ) -> None:
        for name in required:
            if name not in given:
                raise ModelError(f"{self.path}: the graph has no {side} '{name}'")
        for name, argument in given.items():
            if name not in allowed:
                raise ModelError(f"{self.path}: the graph has an unknown {side} '{name}'")
            if argument.type != "tensor(float)" or argument.rank != allowed[name]:
                raise ModelError(
                    f"{self.path}: {side} '{name}' is a {argument.type} of rank "
                    f"{argument.rank}, expected a tensor(float) of rank {allowed[name]}"
                )

    def __call__(self, feeds: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Run the graph, in a thread so that Ctrl-C reaches it.

        Args:
            feeds: arrays by name; those that the graph does not declare are left out.

        Raises:
            ModelError: onnxruntime refused or failed.
            OutOfMemoryError: there is too little memory for this size.
        """
        options = onnxruntime().RunOptions()
        options.add_run_config_entry(*SHRINK)
        names = list(self._outputs)
        declared = {
            name: np.ascontiguousarray(array, np.float32)
            for name, array in feeds.items()
            if name in self._inputs
        }
        with ThreadPoolExecutor(1) as pool:
            running = pool.submit(self._session.run, names, declared, options)
            try:
                values = running.result()
            except Exception as error:
                raise _failure(self.path, "the graph failed", error) from error
            except BaseException:
                options.terminate = True
                raise
        return dict(zip(names, values, strict=True))


def _session(path: Path, options: SessionOptions, device: str) -> InferenceSession:
    """A session on the device; for "auto" on the CPU, if it cannot be had on anything else.

    Onnxruntime's own second attempt, switched off here, is told on standard output, where results
    may go.
    """
    opened: InferenceSession
    open_session = onnxruntime().InferenceSession
    wanted = providers(device)
    try:
        opened = open_session(path, options, providers=wanted, enable_fallback=0)
    except Exception:
        if device != "auto" or wanted == [CPU]:
            raise
        opened = open_session(path, options, providers=[CPU], enable_fallback=0)
    return opened


def providers(device: str) -> list[str]:
    """Onnxruntime's execution providers for a device, in order of preference."""
    if device not in DEVICES:
        raise UsageError(f"--device {device}: one of {', '.join(DEVICES)}")
    if device == "cpu":
        return [CPU]
    if CUDA in onnxruntime().get_available_providers():
        _find_cuda()
        return [CUDA, CPU]
    if device == "cuda":
        raise UsageError(
            "--device cuda: the installed onnxruntime runs on CPUs only; replace it: pip uninstall "
            "onnxruntime, then pip install --force-reinstall --no-deps onnxruntime-gpu"
        )
    return [CPU]


def _find_cuda() -> None:
    """Let onnxruntime find the CUDA libraries that pip installed (the extra `gpu` brings them).

    What it prints about missing ones would mix with results on standard output; the session says
    whether it works. Graphs load in threads, and only one at a time may swap standard output.
    """
    with _finding_cuda, redirect_stdout(io.StringIO()):
        onnxruntime().preload_dlls()


def _failure(path: Path, what: str, error: Exception) -> Styl3rError:
    """What onnxruntime's exception means to the user."""
    message = f"{path}: {what}: {_first_line(error)}"
    if memory.ended(error):
        return OutOfMemoryError(f"out of memory; try a smaller --size or fewer photos ({message})")
    return ModelError(message)


def _first_line(error: Exception) -> str:
    """Onnxruntime's message without its code and the lines about its sources."""
    text = str(error).strip() or type(error).__name__
    return shortened(PREFIX.split(text.splitlines()[0])[-1])
