"""Fits and data as self-contained fragments of HTML for notebooks."""

import base64
import html
from collections.abc import Sequence

import numpy as np

from tirefit.data.table import CANONICAL, TireData
from tirefit.fitting.result import FitResult
from tirefit.report.numbers import format_interval, format_number
from tirefit.report.text import note_on, value_text, verdict_line

__all__ = ["data_fragment", "fit_fragment", "html_table"]

# Colours that hold on white and on black: the text's own, and translucent lines.
_CELL = "padding:2px 10px;text-align:left;border-bottom:1px solid rgba(128,128,128,.3)"
_TABLE = "border-collapse:collapse;margin:4px 0;color:inherit;background:transparent"
_MARK = {True: "#009E73", False: "#D55E00"}


def html_table(rows: Sequence[Sequence[str]]) -> str:
    """A small table; the first row is its header. Every cell is escaped."""
    lines = []
    for i, row in enumerate(rows):
        tag = "th" if i == 0 else "td"
        cells = "".join(
            f'<{tag} style="{_CELL}">{html.escape(str(cell))}</{tag}>' for cell in row
        )
        lines.append(f'<tr style="background:transparent">{cells}</tr>')
    return f'<table style="{_TABLE}">{"".join(lines)}</table>'


def _verdict(result: FitResult) -> str:
    ok = result.verdict.get("status") == "ok"
    sentences = result.verdict.get("sentences", [])
    rest = sentences if ok else sentences[1:]
    items = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in rest)
    more = f'<ul style="margin:2px 0">{items}</ul>' if items else ""
    return (
        f'<div style="border-left:4px solid {_MARK[ok]};padding:2px 8px;margin:4px 0">'
        f"<b>Verdict</b> {html.escape(verdict_line(result))}{more}</div>"
    )


def _figure(result: FitResult) -> str:
    if result.problem is None:
        return ""
    from tirefit.report.draw import fit_figure

    picture = fit_figure(result)
    picture.set_dpi(90)
    text = base64.b64encode(picture._repr_png_()).decode("ascii")
    return (
        f'<img alt="measured points and fitted curve" style="max-width:100%;'
        f'border-radius:4px" src="data:image/png;base64,{text}">'
    )


def fit_fragment(result: FitResult) -> str:
    """Parameters, verdict and the fitted curve; no script, no external resource."""
    rows = [("parameter", "value ± std", "unit", "95 % interval", "")]
    for name, estimate in result.parameters.items():
        rows.append(
            (
                name, value_text(estimate), estimate.unit,
                format_interval(estimate.ci95, estimate.std), note_on(result, name),
            )
        )  # fmt: skip
    head = (
        f"<b>{html.escape(result.model)}</b> fitted to"
        f" {html.escape(result.data['file'])}, {result.statistics.n} rows;"
        f" {result.source}"
    )
    parts = (head, html_table(rows), _verdict(result), _figure(result))
    return f"<div>{''.join(parts)}</div>"


def _range_row(data: TireData, name: str) -> tuple[str, ...]:
    values = np.asarray(data.usable(name), float)
    values = values[np.isfinite(values)]
    base = name.removesuffix("_std")
    unit = CANONICAL.get(base, ("", ""))[0]
    header = data.source.columns.get(name, "")
    if len(values) == 0:
        return (name, header, unit, "-", "-", "-")
    spread = (np.min(values), np.median(values), np.max(values))
    return (name, header, unit, *(format_number(float(v)) for v in spread))


def data_fragment(data: TireData) -> str:
    """Columns with their ranges over the used rows, and what was assumed."""
    source = data.source
    masked = len(data) - data.n
    head = f"<b>{html.escape(source.path or data.name)}</b>: {data.n} rows"
    if masked:
        head += f" ({masked} more masked)"
    if len(data.runs) > 1:
        head += f", {len(data.runs)} runs"
    rows = [("column", "in the file", "unit", "min", "median", "max")]
    rows += [_range_row(data, name) for name in data.columns]
    notes = [*source.notes, *(str(problem) for problem in source.masked[:5])]
    items = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
    more = f'<ul style="margin:2px 0">{items}</ul>' if items else ""
    return f"<div>{head}{html_table(rows)}{more}</div>"
