"""The report of a fit as plain text, at most 88 columns wide."""

import re
import textwrap
from collections.abc import Sequence

from tirefit.data.records import FileRecord, Row
from tirefit.data.run_names import run_names
from tirefit.fitting.result import FitResult
from tirefit.report.fit_tables import (
    FORCE_UNIT,
    chain_rows,
    correlation_lines,
    derived_by_run,
    derived_rows,
    far_lines,
    parameter_rows,
    posterior_lines,
    quality_items,
    reference_text,
    route_rows,
    rows_text,
    run_rows,
)
from tirefit.report.labels import fit_files, run_lines
from tirefit.report.numbers import format_estimate, format_number

WIDTH = 88
_FAR_ROWS = 8  # outliers that the full report lists one by one
_AS_NAMED = re.compile(
    r"(?:\d+ files: )?column '(.+)' read as (\w+)( in (.+?))?( \(stated in the file\))?"
)
"""Assumption on one column: header, quantity and unit."""


def table(rows: list[list[str]], right: tuple[int, ...] = ()) -> list[str]:
    """Lines of a table whose first row is the header, indented by two.

    Args:
        rows: cells of equal number.
        right: columns to align to the right.
    """
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            cell.rjust(width) if i in right else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append(("  " + "  ".join(cells)).rstrip())
    rule = ("  " + "  ".join("-" * width for width in widths)).rstrip()
    return [line[:WIDTH] for line in (lines[0], rule, *lines[1:])]


def table_parts(rows: list[list[str]]) -> list[str]:
    """A table in as many parts as the width requires, each with the first column."""
    lines, first = [], 1
    widths = [max(len(row[i]) for row in rows) + 2 for i in range(len(rows[0]))]
    while first < len(widths):
        last = first + 1
        while last < len(widths) and widths[0] + sum(widths[first : last + 1]) <= WIDTH:
            last += 1
        lines += ["", *table([[row[0], *row[first:last]] for row in rows])]
        first = last
    return lines[1:]


def indented(text: str) -> list[str]:
    """A sentence as lines of a section."""
    return textwrap.wrap(text, WIDTH, initial_indent="  ", subsequent_indent=" " * 6)


def wrapped(name: str, text: str) -> list[str]:
    """Lines of a text after its name, within the width."""
    lead = f"  {name:<13}"
    return textwrap.wrap(text, WIDTH, initial_indent=lead, subsequent_indent=" " * len(lead)) or [
        lead.rstrip()
    ]


def _files(result: FitResult) -> str:
    """The file as it was given; for several, their number and common name."""
    several = len(result.data["runs"]) > 1 and ", " in result.data["file"]
    return fit_files(result) if several else result.data["file"]


def column_texts(notes: Sequence[str]) -> tuple[str, list[str]]:
    """One line for all columns that were read, and the other assumptions."""
    found = [(note, _AS_NAMED.fullmatch(note)) for note in notes]
    columns = [
        m[2] + f" [{m[4]}]" * bool(m[4]) + f" from {m[1]!r}" * (m[1].partition(" [")[0] != m[2])
        for _, m in found
        if m
    ]
    return ", ".join(columns), [note for note, m in found if not m]


def _noise_notes(result: FitResult, full: bool) -> list[str]:
    """Notes on the noise; in short, without its sources, which QUALITY states."""
    notes = result.noise.get("notes", ())
    return [note for note in notes if full or not note.startswith("noise of")]


def _header(result: FitResult, full: bool) -> list[str]:
    data, forces = result.data, " and ".join(result.forces)
    title = f"tirefit {result.version}: {result.model} fitted to {forces} of"
    lines = textwrap.wrap(f"{title} {_files(result)}", WIDTH)
    lines += wrapped("rows", rows_text(result))
    for i, line in enumerate(run_lines(result)):
        lines += wrapped("runs" if i == 0 else "", line)
    columns, others = column_texts(data["assumptions"])
    lines += wrapped("columns", columns) if columns else []
    lines += wrapped(
        "convention",
        f"braking positive, SI (file: {data['convention']}, slip {data['slip_definition']})",
    )
    for i, note in enumerate([*others, *_noise_notes(result, full)]):
        lines += wrapped("assumptions" if i == 0 else "", note)
    for i, problem in enumerate(data["masked"][:5]):
        lines += wrapped("masked" if i == 0 else "", str(problem).replace("\n", " "))
    if len(data["masked"]) > 5:
        lines += wrapped("", f"and {len(data['masked']) - 5} more")
    for i, line in enumerate(far_lines(result, _FAR_ROWS) if full else ()):
        lines += wrapped("outliers" if i == 0 else "", line)
    return lines


def _derived(result: FitResult) -> list[str]:
    at, lines, shared = reference_text(result), [], derived_rows(result)
    if len(shared) > 1:
        lines += ["", f"DERIVED (at {at}; {result.source})", *table(shared)]
    if len(derived_by_run(result)) > 1:
        title = f"DERIVED, BY RUN (at {at}; {result.source}; intervals in fit.json)"
        lines += ["", *textwrap.wrap(title, WIDTH), *table_parts(derived_by_run(result))]
    return lines


def _quality(result: FitResult, full: bool) -> list[str]:
    items = quality_items(result)
    lines = [
        x for name, text in items if full or name != "information" for x in wrapped(name, text)
    ]
    for i, text in enumerate(posterior_lines(result) if not full else ()):
        lines += wrapped("posterior" if i == 0 else "", text)
    return _block("QUALITY", lines)


def _posterior(result: FitResult) -> list[str]:
    lines = [line for text in posterior_lines(result) for line in textwrap.wrap(text, WIDTH - 2)]
    rows = chain_rows(result)
    chains = table(rows, right=(1, 2, 3)) if len(rows) > 1 else []
    return _block("POSTERIOR", [*(f"  {line}" for line in lines), *chains])


def _block(title: str, lines: Sequence[str]) -> list[str]:
    """Lines under their title, after an empty line; nothing without lines."""
    return ["", title, *lines] if lines else []


def verdict_line(result: FitResult) -> str:
    """The verdict in one sentence."""
    if result.outcomes:
        return f"{result.status}: {result.warnings[0]}"
    s = result.statistics
    unit = FORCE_UNIT[result.forces[0]]
    fit = f"RMSE {format_number(s.rmse, 3)} {unit}, R² {s.r2:.4f}"
    return f"{result.status}: {fit}, every free parameter identified"


def _verdict(result: FitResult) -> list[str]:
    lines = textwrap.wrap(f"VERDICT: {verdict_line(result)}", WIDTH, subsequent_indent="         ")
    for sentence in result.warnings[bool(result.outcomes) :]:
        lines += textwrap.wrap(
            sentence, WIDTH, initial_indent="       - ", subsequent_indent="         "
        )
    return ["", *lines]


def fit_report(result: FitResult, full: bool = False) -> str:
    """The report of one fit; the verdict is last.

    Args:
        full: with the intervals by every route, the misfit by run, the chains and the
            information criteria.
    """
    differ = bool(result.verdict.disagreements)
    parameters = _block(f"PARAMETERS ({result.source})", table(parameter_rows(result)))
    lines = [*_header(result, full), *parameters]
    # The short report has the intervals by each route if they disagree.
    routes = table(route_rows(result)) if full or differ else []
    lines += _block("INTERVALS BY ROUTE", routes)
    lines += [*_derived(result), *_quality(result, full)]
    if full and len(rows := run_rows(result)) > 1:
        lines += _block("BY RUN (bias: measured - fitted)", table(rows, right=(1, 2, 3)))
    lines += _posterior(result) if full else []
    pairs = [f"  {text}"[:WIDTH] for text in correlation_lines(result)]
    lines += _block("CORRELATIONS ABOVE 0.9", pairs)
    return "\n".join([*lines, *_verdict(result)]) + "\n"


def summary_table(fits: Sequence[FileRecord]) -> str:
    """Directory, parameters with standard deviations, RMSE and verdict of every fit."""
    if not fits:
        return "no file could be fitted"
    parameters = [fit.of_kind("parameter") for fit in fits]
    names = list(dict.fromkeys(name for one in parameters for name in one))
    rows = [["fit", *names, "RMSE", "verdict"]]
    directories = run_names([fit.result for fit in fits])
    for name, fit, known in zip(directories.short, fits, parameters, strict=True):
        cells = [_estimate(known[one]) if one in known else "" for one in names]
        rmse = f"{fit.of_kind('statistic')['rmse'].value:.4g}"
        rows.append([name, *cells, rmse, fit.status])
    of = f" of {directories.pattern}" if directories.pattern else ""
    return "\n".join(["", f"SUMMARY{of}", *table_parts(rows)])


def _estimate(row: Row) -> str:
    return "-" if row.value is None else format_estimate(row.value, row.std)
