"""Reports as lists of sections, of which the text and the page are two renderings."""

import base64
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import numpy as np

from tirefit.data.table import CANONICAL, TireData
from tirefit.display import Record
from tirefit.report.numbers import format_number
from tirefit.results import UsageError

WIDTH = 88
"""Largest number of columns of a text report."""
_HANGING = 6  # indentation of the further lines of a sentence

GOOD, OPEN = "#009E73", "#D55E00"
"""Colours of a verdict without and with reservations."""

Rows = Sequence[Sequence[str]]
"""Cells of a table, header first."""


class Section(NamedTuple):
    """A part of a report, as text and on a page; without content it is left out.

    Its content: lines, each a sentence or a pair of a name and a text (an empty name continues
    the line before); a table, with the columns that the text aligns to the right, and how many of
    the first name a row; pictures (for templates, or names of panels); a text as it is printed. A
    note explains the title; a page shows a folded section when it is opened.
    """

    title: str
    lines: Sequence[str | tuple[str, str]] = ()
    table: Rows = ()
    pictures: Sequence[Any] = ()
    note: str = ""
    text: str = ""
    folded: bool = False
    right: Sequence[int] = ()
    names: int = 1

    @property
    def items(self) -> list[tuple[str, list[str]]]:
        """The lines for a page, each with the indented ones below it."""
        items: list[tuple[str, list[str]]] = []
        for line in self.lines:
            text = line if isinstance(line, str) else ": ".join(filter(None, line))
            if text.startswith("    ") and items:
                items[-1][1].append(text.strip())
            else:
                items.append((text, []))
        return items


def table(rows: Rows, right: Sequence[int] = ()) -> list[str]:
    """Lines of a table whose first row is the header, indented by two.

    Args:
        rows: cells of equal number.
        right: columns to align to the right.
    """
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in [rows[0], ["-" * width for width in widths], *rows[1:]]:
        cells = [
            cell.rjust(width) if i in right else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append(("  " + "  ".join(cells)).rstrip()[:WIDTH])
    return lines


def table_parts(rows: Rows, right: Sequence[int] = (), names: int = 1) -> list[str]:
    """A table in as many parts as the width requires, each with the first ``names`` columns."""
    lines, first = [], names
    widths = [max(len(row[i]) for row in rows) + 2 for i in range(len(rows[0]))]
    while first < len(widths):
        last = first + 1
        columns = [*range(names), *range(first, last)]
        while last < len(widths) and sum(widths[i] for i in [*columns, last]) <= WIDTH:
            columns.append(last)
            last += 1
        aligned = [i for i, column in enumerate(columns) if column in right]
        lines += ["", *table([[row[i] for i in columns] for row in rows], aligned)]
        first = last
    return lines[1:]


def wrapped(text: str, first: str = "", more: str = "") -> list[str]:
    """Lines of a text within the width, with the indentation of the first and of the others."""
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=first,
        subsequent_indent=more,
        break_long_words=False,
        break_on_hyphens=False,
    )


def first_of(lines: Sequence[str], most: int, where: str = "") -> list[str]:
    """At most this many lines, then how many more there are, and where."""
    rest = len(lines) - most
    return [*lines[:most], *[f"and {rest} more{where}"] * (rest > 0)]


def named_lines(name: str, texts: Sequence[str]) -> list[tuple[str, str]]:
    """Texts as lines of a section, the first one beside the name."""
    return [(name if i == 0 else "", text) for i, text in enumerate(texts)]


def section_text(section: Section) -> Iterator[str]:
    """Lines of a section as text; none without lines and table."""
    has_table = len(section.table) > 1
    if section.title and (section.lines or has_table):
        title, bracket, rest = section.title.partition(" (")
        heading = title.upper() + bracket + rest + f" ({section.note})" * bool(section.note)
        yield from wrapped(heading, "", " " * _HANGING)
    if has_table:
        yield from table_parts(section.table, section.right, section.names)
    for line in section.lines:
        if isinstance(line, str):
            yield from wrapped(f"  {line}", "", " " * _HANGING)
        else:
            lead = f"  {line[0]:<13}"
            yield from wrapped(line[1], lead, " " * len(lead)) or [lead.rstrip()]


def report_text(sections: Sequence[Section], apart: bool = False) -> str:
    """Sections as text.

    Args:
        apart: with an empty line before every section but the first.
    """
    lines: list[str] = []
    for section in sections:
        text = list(section_text(section))
        lines += [""] * bool(apart and text and lines)
        lines += text
    return "\n".join(lines)


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


def template(name: str) -> jinja2.Template:
    """A template of the reports by its file name."""
    return _templates().get_template(name)


def page(
    title: str,
    sections: Sequence[Section],
    verdict: Mapping[str, Any] | None = None,
    subtitle: str = "",
    record: str = "",
    form: str = "page.html",
) -> str:
    """One HTML document, without script or external resource; every value is escaped.

    Args:
        verdict: of :func:`verdict_of`.
        record: the whole result as JSON.
        form: name of the template.
    """
    return template(form).render(vars())


fragment = partial(page, form="fragment.html")
"""The same as a part of a document, for notebooks."""


def verdict_of(sentence: str, lines: Sequence[str], is_good: bool) -> dict[str, Any]:
    """A verdict for pages and fragments."""
    items = Section("", lines).items
    return {"sentence": sentence, "points": items, "color": GOOD if is_good else OPEN}


def image_of(picture: Any, alternative: str, least: int = 0) -> dict[str, Any]:
    """A picture for the templates, with its description and smallest width [px]."""
    png = base64.b64encode(picture._repr_png_()).decode("ascii")
    return {"png": png, "alternative": alternative, "least": least}


def record_fragment(record: Record) -> str:
    """The text and the figure of any record as a fragment of HTML, for notebooks."""
    return fragment("", [_whole(record)])


def record_page(record: Record) -> str:
    """The notebook form of a record as a page that needs no other file."""
    return page(type(record).__name__, [_whole(record)])


def _whole(record: Record) -> Section:
    pictures = []
    with suppress(UsageError):  # some have no figure, as a fit of another process
        pictures.append(image_of(record.plot(), ""))
    return Section("", text=record.summary(), pictures=pictures)


def spread(values: Any) -> list[str]:
    """The smallest, the median and the largest of finite values, as cells of a table."""
    values = np.asarray(values, float)
    known = values[np.isfinite(values)]
    ends = np.quantile(known, (0, 0.5, 1)) if len(known) else [np.nan] * 3
    return [format_number(float(x)) for x in ends]


def data_fragment(data: TireData) -> str:
    """Columns with their ranges over the used rows, and the assumptions."""
    source, masked = data.source, len(data) - data.n
    used = f"{data.n} rows" + f" ({masked} more masked)" * bool(masked)
    used += f", {len(data.runs)} runs" * (len(data.runs) > 1)
    rows = [["column", "in the file", "unit", "min", "median", "max"]]
    for name in data.columns:
        unit = CANONICAL.get(name.removesuffix("_std"), ("", ""))[0]
        rows.append([name, source.columns.get(name, ""), unit, *spread(data.usable(name))])
    notes = [*source.notes, *(str(problem) for problem in source.masked[:5])]
    return fragment(data.file, [Section("", notes, rows)], subtitle=used)
