"""The rows as text: a table for people, and plain values for CSV and JSON."""

from __future__ import annotations

import csv
import io
import statistics
from collections.abc import Sequence
from typing import Any

from styl3r_cli.tradeoff.points import Point
from styl3r_cli.tradeoff.rows import MEGABYTE, Row
from styl3r_cli.tradeoff.truth import cells, known_headings

ERROR_WIDTH = 15  # characters of a column


def plain(row: Row, reference: Point) -> dict[str, Any]:
    """A row as plain values, one level deep: a line of the CSV, an entry of the JSON."""
    found: dict[str, Any] = row.point.to_dict()
    found |= {"rejected": row.rejected(reference), "failed": row.failed}
    if row.failed:
        return found
    found |= {f"seconds_{name}": round(took, 5) for name, took in row.seconds.items()}
    found |= {"memory_bytes": row.memory, "scene_bytes": row.bytes, "gaussians": row.gaussians}
    found |= {"model_bytes": row.model_bytes, "repeats": row.repeats}
    for name, off in row.attributes.items():
        found |= {f"{name}_largest_error": off.largest, f"{name}_relative_error": off.relative}
    for kind in (False, True):
        seen = [view for view in row.views if view.novel == kind]
        label = "novel" if kind else "input"
        if seen:
            found[f"{label}_psnr_worst"] = min(view.psnr for view in seen)
            found[f"{label}_psnr_median"] = statistics.median(view.psnr for view in seen)
            found[f"{label}_ssim_median"] = statistics.median(view.ssim for view in seen)
    return found | row.errors


def to_csv(rows: Sequence[Row]) -> str:
    """All rows, with every column that any of them has."""
    lines = [plain(row, rows[0].point) for row in rows]
    columns = list(dict.fromkeys(name for line in lines for name in line))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()


def to_text(rows: Sequence[Row]) -> str:
    """The table for standard output."""
    known = known_headings([row.errors for row in rows])
    head = (
        f"{'precision':12}{'size':>5}{'views':>6}{'kept':>7}{'drawn':>10}{'cores':>6}"
        f"{'colours':>8}"
        f"{'structure':>11}{'cameras':>9}{'appearance':>12}{'compact':>9}{'frame':>8}{'memory':>9}"
        f"{'scene':>9}{'worst':>9}"
    ) + "".join(f"{heading:>{ERROR_WIDTH}}" for heading in known)
    lines = [head]
    for row in rows:
        point = row.point
        start = (
            f"{point.precision:12}{point.size:5}{point.views:6}{point.budget:6g}%"
            f"{point.drawing:>10}{point.threads:6}{point.colours:>8}"
        )
        if row.failed:
            lines.append(f"{start}  failed: {row.failed}")
            continue
        s = row.seconds
        errors = "".join(f"{cell:>{ERROR_WIDTH}}" for cell in cells(row.errors, known))
        mark = "  rejected" if row.rejected(rows[0].point) else ""
        lines.append(
            f"{start}{s['structure']:9.3f} s{s['cameras']:7.3f} s{s['appearance']:10.3f} s"
            f"{s['compact']:7.2f} s"
            f"{1e3 * s['frame']:5.0f} ms{row.memory / MEGABYTE:6.0f} MB"
            f"{row.bytes / MEGABYTE:6.1f} MB{row.worst:6.1f} dB{errors}{mark}"
        )
    return "\n".join(lines)
