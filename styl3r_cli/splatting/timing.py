"""How fast scenes are drawn: the renderer beside the other CPU paths that are installed."""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from itertools import product

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting import ray_traced
from styl3r_cli.splatting.renderer import render
from styl3r_cli.threads import default_threads

RENDERER, TWIN = "styl3r", "torch twin"
SEED = 0
FIELD_OF_VIEW = 60.0  # degrees, across the longer side; about that of a phone's main camera
PROBE = 16  # side, in pixels, of the frame from which the twin's time on a whole one is foretold

# What a child process runs to tell the time of its first frame, compilation and all.
FIRST_FRAME = """
import time
start = time.perf_counter()
from styl3r_cli.splatting.timing import camera_of, synthetic_scene
from styl3r_cli.splatting import render
scene = synthetic_scene(131072)
begin = time.perf_counter()
render(scene, camera_of(256, 256))
print(time.perf_counter() - begin)
"""

Draw = Callable[[Gaussians, Camera, int], object]


@dataclass
class Case:
    """One way to draw one scene at one size, and what each repeat took.

    Attributes:
        renderer: its name.
        scene: what it draws.
        camera: where from.
        threads: on how many cores.
        seconds: by the clock.
        processor: seconds that the cores worked, together; on a busy machine it tells more.
        foretold: whether the seconds were scaled up from a smaller frame.
    """

    renderer: str
    scene: Gaussians
    camera: Camera
    threads: int
    seconds: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)
    foretold: bool = False

    def row(self) -> dict[str, object]:
        """The result as plain values."""
        median = statistics.median(self.seconds)
        return {
            "renderer": self.renderer,
            "gaussians": len(self.scene),
            "width": self.camera.width,
            "height": self.camera.height,
            "threads": self.threads,
            "fps": 1 / median,
            "milliseconds": 1e3 * median,
            "fastest_milliseconds": 1e3 * min(self.seconds),
            "processor_milliseconds": 1e3 * statistics.median(self.processor),
            "repeats": len(self.seconds),
            "foretold": self.foretold,
        }


def synthetic_scene(count: int) -> Gaussians:
    """A scene like a network's from two photos: surfaces of Gaussians about one pixel apart.

    The same for every run and machine. Two wavy sheets at depths from 1.5 to 3, seen from the
    origin by a camera of FIELD_OF_VIEW, with a third of them faint.
    """
    random = np.random.default_rng(SEED)
    side = max(1, round((count / 2) ** 0.5))
    index = np.arange(count) % (side * side)
    x, y = ((index % side + 0.5) / side - 0.5), ((index // side % side + 0.5) / side - 0.5)
    second = np.arange(count) >= side * side
    z = 2 + 0.5 * second + 0.3 * np.sin(5 * x + second) * np.cos(4 * y)
    z += 0.02 * random.standard_normal(count)
    reach = 2 * np.tan(np.radians(FIELD_OF_VIEW / 2))
    scales = reach * z[:, None] / side * np.exp(random.normal(-0.5, 0.5, (count, 3)))
    faint = random.random(count) < 1 / 3
    opacities = np.where(faint, random.uniform(0.05, 0.5, count), random.uniform(0.5, 1, count))
    return Gaussians(
        np.stack([reach * x * z, reach * y * z, z], -1).astype(np.float32),
        scales.astype(np.float32),
        random.standard_normal((count, 4)).astype(np.float32),
        opacities.astype(np.float32),
        random.random((count, 3), np.float32),
    )


def some_of(scene: Gaussians, count: int) -> Gaussians:
    """That many of a scene's Gaussians, evenly from all of it."""
    return scene.select(np.arange(count) * len(scene) // count)


def camera_of(width: int, height: int, extrinsics: np.ndarray | None = None) -> Camera:
    """A camera of FIELD_OF_VIEW with that many pixels; at the origin, by default."""
    focal = max(width, height) / (2 * np.tan(np.radians(FIELD_OF_VIEW / 2)))
    view = np.eye(4) if extrinsics is None else extrinsics
    return Camera(view, focal, focal, width / 2, height / 2, width, height)


def measure(
    scenes: list[Gaussians],
    cameras: list[Camera],
    threads: list[int],
    repeats: int,
    twin_seconds: float,
    done: Callable[[], None] = lambda: None,
    note: Callable[[str], None] = lambda _: None,
) -> Iterator[Case]:
    """Time every combination, repeats interleaved, so that a busy minute strikes all alike.

    Args:
        scenes: to draw.
        cameras: to draw them from.
        threads: numbers of threads.
        repeats: how often; results are medians.
        twin_seconds: the twin draws whole frames of at most so many seconds, once; the time of
            longer ones is foretold from a few pixels, all of which cost it the same. Mitsuba's
            repeats end then.
        done: called after each of the renderer's frames.
        note: told why another path is missing.
    """
    cases = [Case(RENDERER, *each) for each in product(scenes, cameras, threads)]
    for case in cases:
        _draw_fast(case.scene, case.camera, case.threads)  # compile; touch the memory
    for _ in range(repeats):
        for case in cases:
            _time(_draw_fast, case)
            done()
    yield from cases
    if twin_seconds > 0 and has_twin():
        for scene, camera in product(scenes, cameras):
            yield _time_twin(Case(TWIN, scene, camera, max(threads)), twin_seconds)
    if twin_seconds > 0 and ray_traced.is_installed():
        others = [Case(ray_traced.NAME, *each, max(threads)) for each in product(scenes, cameras)]
        try:
            for case in others:
                yield _time_ray_traced(case, repeats, twin_seconds)
        except ray_traced.NoFrame as error:
            note(f"without {ray_traced.NAME}: {error}")


def has_twin() -> bool:
    """Whether the extra that the torch twin comes with is installed."""
    return all(find_spec(name) is not None for name in ("torch", "jaxtyping", "styl3r_export"))


def seconds_to_first_frame() -> float:
    """From the call to the picture, in a new process that finds no compiled code."""
    with tempfile.TemporaryDirectory() as empty:
        environment = {**os.environ, "NUMBA_CACHE_DIR": empty}
        command = [sys.executable, "-c", FIRST_FRAME]
        result = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True
        )
    return float(result.stdout)


def machine() -> dict[str, object]:
    """What the times depend on besides the code."""
    return {
        "processor": _processor(),
        "cores": default_threads(),
        "system": platform.system(),
        "python": platform.python_version(),
        "numba": __import__("numba").__version__,
    }


def _processor() -> str:
    try:
        with open("/proc/cpuinfo") as lines:  # noqa: PTH123 (no file of the user's)
            names = [line.split(":", 1)[1].strip() for line in lines if "model name" in line]
        return names[0] if names else platform.machine()
    except OSError:
        return platform.processor() or platform.machine()


def _draw_fast(scene: Gaussians, camera: Camera, threads: int) -> None:
    render(scene, camera, threads=threads)


def _draw_twin(scene: Gaussians, camera: Camera, threads: int) -> None:
    from styl3r_export.splatting.twin import draw

    draw(scene, camera, threads)


def _time(draw: Draw, case: Case) -> Case:
    """One more repeat."""
    start, worked = time.perf_counter(), time.process_time()
    draw(case.scene, case.camera, case.threads)
    case.processor.append(time.process_time() - worked)
    case.seconds.append(time.perf_counter() - start)
    return case


def _time_twin(case: Case, limit: float) -> Case:
    """Draw a few pixels; then the whole frame, if it will not take too long."""
    camera = case.camera
    one, some = (
        Case(TWIN, case.scene, camera.resized(side, side), case.threads) for side in (1, PROBE)
    )
    for small in (some, one, some):  # the first call is slower
        _time(_draw_twin, small)
    pixels = (camera.width * camera.height - 1) / (PROBE * PROBE - 1)

    def foretell(base: float, probe: float) -> float:
        return base + pixels * max(probe - base, 0.0)

    foretold = foretell(one.seconds[0], some.seconds[-1])
    if foretold <= limit:
        return _time(_draw_twin, case)
    worked = foretell(one.processor[0], some.processor[-1])
    return replace(case, seconds=[foretold], processor=[worked], foretold=True)


def _time_ray_traced(case: Case, repeats: int, limit: float) -> Case:
    taken = ray_traced.frame_seconds(case.scene, case.camera, case.threads, repeats, limit)
    seconds, processor = ([*each] for each in zip(*taken, strict=True))
    return replace(case, seconds=seconds, processor=processor)
