"""Fits and data as self-contained fragments of HTML for notebooks."""

import base64
from contextlib import suppress
from functools import cache
from pathlib import Path

import jinja2
import numpy as np

from tirefit.data.table import CANONICAL, TireData
from tirefit.display import Record
from tirefit.fitting.result import FitResult
from tirefit.report.fit_tables import parameter_rows
from tirefit.report.labels import fit_files
from tirefit.report.numbers import format_number
from tirefit.report.text import verdict_line
from tirefit.results import UsageError

GOOD, OPEN = "#009E73", "#D55E00"
"""Colours of a verdict without and with reservations."""


@cache
def _templates() -> jinja2.Environment:
    """The templates of the reports. Every value is escaped, and none may be missing."""
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=False,
    )


def rendered(template: str, **values) -> str:
    """A template of ``tirefit/report/templates`` with its values put in, escaped."""
    return _templates().get_template(template).render(values)


def png_text(picture) -> str:
    """A picture as the text of a data URL."""
    return base64.b64encode(picture._repr_png_()).decode("ascii")


def image_of(picture, alternative: str, least: int = 0) -> dict:
    """A picture for the templates, with its description and smallest width [px]."""
    return {"png": png_text(picture), "alternative": alternative, "least": least}


def record_fragment(record: Record) -> str:
    """The text and the figure of any record as a fragment of HTML, for notebooks."""
    png = ""
    with suppress(UsageError):  # a fit of another process has no data to draw
        png = png_text(record.plot())
    return rendered("record_fragment.html", text=record.summary(), png=png)


def record_page(record: Record) -> str:
    """The notebook form of a record as a page that needs no other file."""
    title, fragment = type(record).__name__, record._repr_html_()
    return rendered("record_page.html", title=title, fragment=fragment)


def _figure(result: FitResult) -> str:
    from tirefit.report.draw import fit_figure  # Matplotlib, for a fit with its data

    picture = fit_figure(result)
    picture.set_dpi(90)
    return png_text(picture)


def verdict_parts(result: FitResult) -> dict:
    """Sentence, further lines and colour of the verdict."""
    return {
        "sentence": verdict_line(result),
        "lines": result.warnings[bool(result.outcomes) :],
        "color": OPEN if result.outcomes else GOOD,
    }


def fit_fragment(result: FitResult) -> str:
    """Parameters, verdict and the fitted curve; no script, no external resource."""
    return rendered(
        "fit_fragment.html",
        model=result.model,
        file=fit_files(result),
        n=result.statistics.n,
        source=result.source,
        rows=parameter_rows(result),
        verdict=verdict_parts(result),
        png=_figure(result),
    )


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
    """Columns with their ranges over the used rows, and the assumptions."""
    source, masked = data.source, len(data) - data.n
    used = f"{data.n} rows"
    if masked:
        used += f" ({masked} more masked)"
    if len(data.runs) > 1:
        used += f", {len(data.runs)} runs"
    rows: list[tuple[str, ...]]
    rows = [("column", "in the file", "unit", "min", "median", "max")]
    rows += [_range_row(data, name) for name in data.columns]
    return rendered(
        "data_fragment.html",
        name=data.file,
        rows_used=used,
        rows=rows,
        notes=[*source.notes, *(str(problem) for problem in source.masked[:5])],
    )
