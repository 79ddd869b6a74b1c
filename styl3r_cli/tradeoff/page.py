"""The report as one HTML file that needs nothing else: table, plots, and the pictures behind."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape

import numpy as np

from styl3r_cli.frames import Picture
from styl3r_cli.tradeoff import plots
from styl3r_cli.tradeoff.agreement import ATTRIBUTES, BROKEN_DB
from styl3r_cli.tradeoff.rows import MEGABYTE, STAGES, Advice, Row, flags
from styl3r_cli.tradeoff.truth import cells, known_headings, meanings

ERROR_GAIN = 8  # differences are shown so many times enlarged, or an eye could not see most
JPEG_QUALITY = 92
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 13px }
td, th { padding: .2rem .6rem; text-align: right; border-bottom: 1px solid #ddd }
td:first-child, th:first-child { text-align: left }
tr.rejected { color: #a33; text-decoration: line-through }
.plots svg { width: 24rem; height: auto } .plots { display: flex; flex-wrap: wrap }
figure { display: inline-block; margin: .5rem } figure img { width: 15rem; display: block }
figcaption { font-size: 12px; max-width: 30rem } .scroll { overflow-x: auto }
"""


def make_page(
    title: str,
    about: Sequence[str],
    rows: Sequence[Row],
    advice: Sequence[Advice],
    pictures: Sequence[Picture | None],
) -> str:
    """The page.

    Args:
        title: its heading.
        about: lines on what was measured, where and by which command.
        rows: the measurements, the reference first.
        advice: the recommended settings.
        pictures: for each row, what its worst-agreeing view looks like, and the reference there,
            one above the other; None where there is nothing to see.
    """
    drawn = plots.draw(rows) if plots.available() else []
    without = "" if drawn else "<p>Plots need matplotlib: pip install 'styl3r[report]'.</p>"
    parts = [
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(title)}</title>",
        f"<style>{STYLE}</style><h1>{escape(title)}</h1>",
        *(f"<p>{escape(line)}</p>" for line in about),
        f"<h2>Recommended</h2>{_advice(advice, rows)}",
        f"<h2>All settings</h2><div class=scroll>{_table(rows)}</div>",
        "<p>Agreement is the PSNR of pictures against the reference's (the first row), at the "
        "photos' cameras and halfway between them; 'worst' is the view that agrees least. A "
        f"precision below {BROKEN_DB:g} dB there breaks the scene: it is struck out and never "
        "recommended. Seconds are medians of repeats after a warm-up. "
        f"{' '.join(meanings([row.errors for row in rows]))}</p>",
        f"<h2>Plots</h2>{without}<div class=plots>{''.join(drawn)}</div>",
        "<h2>Pictures</h2><p>Each setting's worst view: the setting, the reference, and their "
        f"difference {ERROR_GAIN} times enlarged.</p>",
        *(_figure(row, rows[0], seen) for row, seen in zip(rows, pictures, strict=True)),
        "</html>\n",
    ]
    return "\n".join(parts)


def _advice(advice: Sequence[Advice], rows: Sequence[Row]) -> str:
    body = "".join(
        f"<tr><td>{escape(each.accuracy)} ({each.decibels:g} dB)<td>{escape(each.name)}"
        f"<td>{each.row.seconds['scene']:.3f} s<td>{each.row.bytes / MEGABYTE:.1f} MB"
        f"<td>{each.row.worst:.1f} dB<td>{escape(flags(each.row.point, rows[0].point))}"
        for each in advice
    )
    head = "<tr><th>accuracy<th>best<th>scene<th>file<th>worst view<th>setting"
    return f"<table>{head}{body}</table>"


def _table(rows: Sequence[Row]) -> str:
    known = known_headings([row.errors for row in rows])
    names = (
        *("setting", *STAGES, "frame", "memory", "file", "model"),
        *("Gaussians", "input views", "novel views", "SSIM", *known),
        *(f"{name} error" for name in ATTRIBUTES),
    )
    head = "".join(f"<th>{name}" for name in names)
    lines = (
        f"<tr class=rejected><td>{escape(plots.turned(row, rows[0]))}"
        f"<td colspan={len(names) - 1}>{escape(row.failed)}"
        if row.failed
        else _line(row, rows[0], known)
        for row in rows
    )
    return f"<table><tr>{head}{''.join(lines)}</table>"


def _line(row: Row, reference: Row, known: Sequence[str]) -> str:
    s = row.seconds
    texts = [f"{s[stage]:.3f} s" for stage in STAGES]
    texts.append(f"{1e3 * s['frame']:.0f} ms")
    texts += [f"{size / MEGABYTE:.1f} MB" for size in (row.memory, row.bytes, row.model_bytes)]
    texts.append(f"{row.gaussians:,}")
    for novel in (False, True):
        seen = [view.psnr for view in row.views if view.novel == novel]
        texts.append(f"{min(seen):.1f} dB" if seen else "")
    texts.append(f"{min(view.ssim for view in row.views):.4f}" if row.views else "")
    texts += cells(row.errors, known)
    texts += [
        f"{row.attributes[a].relative:.1e} ({row.attributes[a].largest:.1e})"
        if row.attributes
        else ""
        for a in ATTRIBUTES
    ]
    mark = " class=rejected" if row.rejected(reference.point) else ""
    name = escape(plots.turned(row, reference))
    return f"<tr{mark}><td>{name}" + "".join(f"<td>{text}" for text in texts)


def _figure(row: Row, reference: Row, seen: Picture | None) -> str:
    if seen is None:
        return ""
    ours, theirs = np.split(seen, 2)
    difference = np.abs(ours.astype(np.int16) - theirs) * ERROR_GAIN
    strip = np.concatenate([ours, theirs, difference.clip(0, 255).astype(np.uint8)], axis=1)
    told = f"{plots.turned(row, reference)}: {row.worst:.1f} dB"
    mark = ", rejected" if row.rejected(reference.point) else ""
    return (
        f'<figure><img style="width:45rem" alt="{escape(told)}" src="{_inline(strip)}">'
        f"<figcaption>{escape(told + mark)}</figcaption></figure>"
    )


def _inline(picture: Picture) -> str:
    """A picture as a data URL."""
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(picture).save(data, format="JPEG", quality=JPEG_QUALITY)
    return f"data:image/jpeg;base64,{base64.b64encode(data.getvalue()).decode()}"
