"""Fits and data as self-contained fragments of HTML for notebooks."""

import base64
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

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


class Section(NamedTuple):
    """A part of a report: title, lines, a table under its header, pictures (for templates, or
    names of panels), a note in small print, a text as it is printed, and whether a page shows
    only its title until it is opened."""

    title: str
    lines: Sequence[str] = ()
    table: Sequence[Sequence[str]] = ()
    pictures: Sequence = ()
    note: str = ""
    text: str = ""
    folded: bool = False


def page(
    title: str,
    sections: Sequence[Section],
    verdict: Mapping[str, Any] | None = None,
    subtitle: str = "",
    record: str = "",
) -> str:
    """One HTML document, without script or external resource; every value is escaped.

    Args:
        verdict: its ``sentence``, ``lines`` and ``color``.
        record: the whole result as JSON.
    """
    return _templates().get_template("page.html").render(vars())


def fragment(
    title: str,
    sections: Sequence[Section],
    verdict: Mapping[str, Any] | None = None,
    subtitle: str = "",
) -> str:
    """The same as a part of a document, for notebooks."""
    return _templates().get_template("fragment.html").render(vars())


def png_text(picture) -> str:
    """A picture as the text of a data URL."""
    return base64.b64encode(picture._repr_png_()).decode("ascii")


def image_of(picture, alternative: str, least: int = 0) -> dict:
    """A picture for the templates, with its description and smallest width [px]."""
    return {"png": png_text(picture), "alternative": alternative, "least": least}


def record_fragment(record: Record) -> str:
    """The text and the figure of any record as a fragment of HTML, for notebooks."""
    pictures = []
    with suppress(UsageError):  # a fit of another process has no data to draw
        pictures.append(image_of(record.plot(), ""))
    return fragment("", [Section("", text=record.summary(), pictures=pictures)])


def record_page(record: Record) -> str:
    """The notebook form of a record as a page that needs no other file."""
    pictures = [image_of(record.plot(), "")]
    return page(type(record).__name__, [Section("", text=record.summary(), pictures=pictures)])


def verdict_parts(result: FitResult) -> dict:
    """Sentence, further lines and colour of the verdict."""
    return {
        "sentence": f"Verdict: {verdict_line(result)}",
        "lines": result.warnings[bool(result.outcomes) :],
        "color": OPEN if result.outcomes else GOOD,
    }


def fit_fragment(result: FitResult) -> str:
    """Parameters, verdict and the fitted curve; no script, no external resource."""
    from tirefit.report.fit_panels import figure_of  # Matplotlib, for a fit with its data

    picture = figure_of(result, "fit")
    picture.set_dpi(90)
    image = image_of(picture, "measured points and fitted curve")
    return fragment(
        result.model,
        [Section("", table=parameter_rows(result), pictures=[image])],
        verdict_parts(result),
        f"fitted to {fit_files(result)}, {result.statistics.n} rows; {result.source}",
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
    notes = [*source.notes, *(str(problem) for problem in source.masked[:5])]
    return fragment(data.file, [Section("", notes, rows)], subtitle=used)
