"""Pictures in labelled rows on a white page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from PIL import Image, ImageDraw, ImageFont

from styl3r_cli.console import one_line
from styl3r_cli.frames import Picture

MARGIN, GAP = 24, 12  # pixels around the page and between cells
TITLE_SIZE, HEADING_SIZE, CAPTION_SIZE = 20, 16, 13  # pixels
INK, FAINT, PAPER = "#1a1a1a", "#666666", "#ffffff"
LEADING = 1.5  # height of a line of text, in units of its size


@dataclass(frozen=True)
class Cell:
    """A picture and the words under it."""

    picture: Picture
    caption: str


@dataclass(frozen=True)
class Row:
    """Cells of one kind, under a heading."""

    heading: str
    cells: Sequence[Cell]


def draw_sheet(title: str, rows: Sequence[Row]) -> Image.Image:
    """The page: a title, then the rows; all pictures in a column start at the same place.

    Args:
        title: the first line.
        rows: at least one cell in all; cells may differ in size.
    """
    cells = [cell for row in rows for cell in row.cells]
    width = max(cell.picture.shape[1] for cell in cells)
    columns = max(len(row.cells) for row in rows)
    heights = [max(cell.picture.shape[0] for cell in row.cells) for row in rows]
    heading, caption = _line(HEADING_SIZE), _line(CAPTION_SIZE)
    row_heights = [heading + height + caption + GAP for height in heights]
    page_width = 2 * MARGIN + columns * (width + GAP) - GAP
    page_height = 2 * MARGIN + _line(TITLE_SIZE) + GAP // 2 + sum(row_heights) - GAP
    page = Image.new("RGB", (page_width, page_height), PAPER)
    pen = ImageDraw.Draw(page)
    _write(pen, (MARGIN, MARGIN), title, TITLE_SIZE, INK, page_width - 2 * MARGIN)
    top = MARGIN + _line(TITLE_SIZE) + GAP // 2
    for row, height, row_height in zip(rows, heights, row_heights, strict=True):
        _write(pen, (MARGIN, top), row.heading, HEADING_SIZE, INK, page_width - 2 * MARGIN)
        for column, cell in enumerate(row.cells):
            left = MARGIN + column * (width + GAP)
            page.paste(Image.fromarray(cell.picture), (left, top + heading))
            below = (left, top + heading + height + (caption - CAPTION_SIZE) // 3)
            _write(pen, below, cell.caption, CAPTION_SIZE, FAINT, width)
        top += row_height
    return page


def _line(size: int) -> int:
    return round(size * LEADING)


def _write(
    pen: ImageDraw.ImageDraw,
    position: tuple[int, int],
    text: str,
    size: int,
    colour: str,
    width: int,
) -> None:
    """One line of text, its end cut off where it would not fit."""
    font = ImageFont.load_default(size)
    text = one_line(text)
    if font.getlength(text) > width:
        while text and font.getlength(text + "...") > width:
            text = text[:-1]
        text += "..."
    pen.text(position, text, fill=colour, font=font)
