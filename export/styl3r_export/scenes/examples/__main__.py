"""Command line: `python -m styl3r_export.scenes.examples --out examples` makes all of them."""

import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from styl3r_export.scenes.examples.dots import pointillist
from styl3r_export.scenes.examples.facets import cubist
from styl3r_export.scenes.examples.ink import ink_wash
from styl3r_export.scenes.examples.mosaic import roman
from styl3r_export.scenes.examples.oils import night, poppies
from styl3r_export.scenes.examples.room import FOCAL_35MM, photographs
from styl3r_export.scenes.examples.woodcut import great_wave

#: File names of the style pictures and what paints them.
STYLES: dict[str, Callable[[], NDArray[np.uint8]]] = {
    "night": night,
    "poppies": poppies,
    "shards": cubist,
    "dots": pointillist,
    "ink": ink_wash,
    "mosaic": roman,
    "wave": great_wave,
}
#: JPEG qualities tried from the best, and the largest file they may give: the repository stays
#: small.
QUALITIES, LARGEST_STYLE, LARGEST_PHOTO = (92, 89, 86, 83, 80), 118_000, 140_000
#: EXIF tag of the 35 mm equivalent focal length, as cameras write it.
FOCAL_TAG, EXIF_FOLDER = 0xA405, 0x8769


def jpeg(picture: NDArray[np.uint8], largest: int, focal: float | None = None) -> bytes:
    """A picture (H, W, 3) as the best JPEG below a size in bytes (the last quality if none is)."""
    exif = Image.Exif()
    if focal is not None:
        exif.get_ifd(EXIF_FOLDER)[FOCAL_TAG] = round(focal)
    for quality in QUALITIES:
        out = BytesIO()
        image = Image.fromarray(picture)
        image.save(out, "JPEG", quality=quality, optimize=True, exif=exif)
        if out.tell() <= largest:
            break
    return out.getvalue()


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.part")
    partial.write_bytes(data)
    partial.replace(path)
    print(f"{path}  {len(data) / 1000:.0f} kB", file=sys.stderr)


@click.command(help="Make the example photographs and style pictures.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder to write to.")
@click.option("--only", multiple=True, type=click.Choice(["room", *STYLES]), help="Some of them.")
def main(out: Path, only: tuple[str, ...]) -> None:
    """Write room/photo_1.jpg, ... and styles/*.jpg."""
    if not only or "room" in only:
        for k, photo in enumerate(photographs(), 1):
            _write(out / "room" / f"photo_{k}.jpg", jpeg(photo, LARGEST_PHOTO, FOCAL_35MM))
    for name, make in STYLES.items():
        if not only or name in only:
            _write(out / "styles" / f"{name}.jpg", jpeg(make(), LARGEST_STYLE))


if __name__ == "__main__":
    main()
