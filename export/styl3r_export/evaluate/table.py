"""The evaluation's table: one line a measure, the model first, every baseline beside it."""

from __future__ import annotations

from collections.abc import Sequence

from styl3r_export.evaluate.poses import area_under_recall
from styl3r_export.evaluate.records import MODEL, Record, Summary, pooled, summarise

AUC_LIMITS = (5, 10, 20)  # degrees
AUC_OF = ("cameras", "larger of both (deg)")

# In which order the rows come, whatever the first group had.
ORDER = ("depth", "cameras", "novel view", "style", "content", "consistency")

# Which way is better, for whoever reads the table.
HIGHER = ("AUC", "delta", "PSNR", "SSIM", "share of pixels")


def sections(records: Sequence[Record]) -> list[tuple[str, int]]:
    """Kinds of scenes and numbers of views that were evaluated, validation first."""
    found = {(record.kind, len(record.inputs)) for record in records}
    return sorted(found, key=lambda section: (section[0] != "validation", section))


def areas(records: Sequence[Record], kind: str, views: int) -> dict[str, dict[str, float]]:
    """AUC by limit ("AUC@5", ...) and method, in percent."""
    chosen = [r for r in records if r.kind == kind and len(r.inputs) == views]
    errors = {
        method: [number for _, number in numbers]
        for (what, measure, method), numbers in pooled(chosen).items()
        if (what, measure) == AUC_OF
    }
    if not errors:
        return {}
    return {
        f"AUC@{limit} (%)": {m: 100 * area_under_recall(e, limit) for m, e in errors.items()}
        for limit in AUC_LIMITS
    }


def format_table(records: Sequence[Record]) -> str:
    """All sections as Markdown, aligned for reading as plain text."""
    return "\n\n".join(_section(records, *section) for section in sections(records)) + "\n"


def _section(records: Sequence[Record], kind: str, views: int) -> str:
    chosen = [r for r in records if r.kind == kind and len(r.inputs) == views]
    scenes = len({record.scene for record in chosen})
    title = f"{kind} scenes, {views} views: {scenes} scenes, {len(chosen)} groups"
    by_measure: dict[tuple[str, str], list[Summary]] = {}
    for summary in summarise(records, kind, views):
        by_measure.setdefault((summary.what, summary.measure), []).append(summary)
    rows = []
    for what, measure in sorted(by_measure, key=lambda key: ORDER.index(key[0])):
        summaries = by_measure[what, measure]
        cells = [_cell(summary) for summary in summaries]
        count = [str(summaries[0].count), str(summaries[0].scenes)]
        rows.append([what, _arrow(measure), *count, *cells])
        if (what, measure) == AUC_OF:
            for name, methods in areas(records, kind, views).items():
                cells = [_named(m, f"{value:.1f}") for m, value in methods.items()]
                rows.append([what, _arrow(name), *count, *cells])
    head = ["what", "measure", "n", "scenes", MODEL, "baselines"]
    return f"{title}\n\n{_grid(head, rows)}"


def _cell(summary: Summary) -> str:
    low, high = summary.quartiles
    text = f"{_number(summary.median)} [{_number(low)}, {_number(high)}]"
    return _named(summary.method, text)


def _named(method: str, text: str) -> str:
    return text if method == MODEL else f"{method} {text}"


def _number(value: float) -> str:
    """Three digits that count."""
    return f"{value:.3f}" if abs(value) < 9.9995 else f"{value:.1f}"


def _arrow(measure: str) -> str:
    return f"{measure} {'↑' if any(word in measure for word in HIGHER) else '↓'}"


def _grid(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table with padded columns."""
    columns = max([len(head), *(len(row) for row in rows)])
    lines = [row + [""] * (columns - len(row)) for row in [head, *rows]]
    widths = [max(len(line[c]) for line in lines) for c in range(columns)]
    lines.insert(1, ["-" * width for width in widths])
    return "\n".join(
        "| " + " | ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)) + " |"
        for line in lines
    )
