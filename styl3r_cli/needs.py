"""How much memory each kind of work takes at least; `limits` checks it.

Measured as the largest that a process had without limits (VmPeak, and VmData every 5 ms), of mini
at --size 64 to 512 with 2 to 8 photos, on two cores; by cores, with 1 to 16 worth of threads.
Memory is what the largest resident size grows by, and a quarter more, which is the system's.
"""

from __future__ import annotations

from styl3r_cli.limits import MEGABYTE, Need, available_cores

CORES = 2  # of the machine that this was measured on
# Bytes that each further core takes: the stacks of its threads, and what they reserve.
BLAS_CORE = (80, 80)  # numpy's, and scipy's that trimesh and numba bring
NETWORK_CORE, DRAWING_CORE, SCENE_CORE = (190, 80), (150, 90), (270, 110)

TO_START = Need(40 * MEGABYTE, 20 * MEGABYTE)  # `--version`: 24 and 11


def _need(fixed: tuple[int, int], core: tuple[int, int] = (0, 0), *parts: tuple[int, Need]) -> Need:
    """Fixed megabytes, megabytes a core, and for so many things bytes a thing."""
    more = max(available_cores() - CORES, 0)
    addresses, data = (
        (fixed[i] + more * core[i]) * MEGABYTE + sum(count * each[i] for count, each in parts)
        for i in range(len(fixed))
    )
    return Need(addresses, data, sum(count * each.memory for count, each in parts))


def at_all() -> Need:
    """What any command takes that reads a scene: 207 and 139 MB."""
    return _need((220, 150), (40, 40))


def points() -> Need:
    """What a .points.glb takes, which trimesh writes: 401 and 268 MB."""
    return _need((420, 280), BLAS_CORE)


def network(pixels: int = 0, shown: bool = False) -> Need:
    """What the network takes.

    Args:
        pixels: of all its views together. 1412 and 858 MB for 2 of 256x256, 2894 and 2379 MB for
            4 of 512x512.
        shown: whether its scene is drawn afterwards: 1979 and 1093 MB for the former.
    """
    fixed = (1950, 960) if shown else (1350, 700)
    return _need(fixed, SCENE_CORE if shown else NETWORK_CORE, (pixels, Need(1600, 1750, 2100)))


def scene(pixels: int) -> Need:
    """What the network takes and then a scene's colours and Gaussians, fitted to its views.

    Args:
        pixels: of all views together. 2434 and 1477 MB for 2 of 256x256 whose kernels are not
            compiled yet, 3225 and 2002 for 4, 4897 and 3344 for 8, 7316 and 6500 for 8 of 384x384.
    """
    return _need((1750, 900), SCENE_CORE, (pixels, Need(6400, 5000, 2500)))


def drawing(pixels: int = 0, gaussians: int = 0, film: bool = False) -> Need:
    """What frames take: 1035 and 492 MB for 64x64 and hardly a Gaussian.

    Args:
        pixels: of a frame: 1252 and 652 MB for 1920x1080.
        gaussians: of the scene: 1655 and 1048 MB for 3 million and 512x384.
        film: whether they are encoded together: 1450 and 765 MB for an .mp4 of 1920x1080.
    """
    fixed = (1300, 600) if film else (1060, 500)
    a_pixel, a_gaussian = Need(100, 100, 100), Need(200, 200, 200)
    return _need(fixed, DRAWING_CORE, (pixels, a_pixel), (gaussians, a_gaussian))
