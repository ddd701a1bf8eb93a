"""The report of a fit: its sections, as text, as a page and as a fragment for notebooks."""

import re
from collections.abc import Sequence
from typing import Any

from tirefit.fitting.result import SCHEMA, FitResult
from tirefit.report.fit import tables
from tirefit.report.numbers import bracketed, format_number
from tirefit.report.page import (
    Section,
    first_of,
    fragment,
    image_of,
    named_lines,
    page,
    report_text,
    verdict_of,
    wrapped,
)

Named = list[tuple[str, str]]
"""Pairs of a name and a text."""

EXPLORE = "sliders of load, camber, speed and slip: run tirefit explore fit.json in this folder"
"""Line of a page; `tirefit explore` puts a link in its place."""
_AS_NAMED = re.compile(
    r"(?:\d+ files: )?column '(.+)' read as (\w+)( in (.+?))?( \(stated in the file\))?"
)
"""Assumption on one column: header, quantity and unit."""


def verdict_line(result: FitResult) -> str:
    """The verdict in one sentence."""
    if result.outcomes:
        return f"{result.status}: {result.warnings[0]}"
    s, unit = result.statistics, tables.FORCE_UNIT[result.forces[0]]
    fit = f"RMSE {format_number(s.rmse, 3)} {unit}, R² {s.r2:.4f}"
    return f"{result.status}: {fit}, every free parameter identified"


def assumption_lines(notes: Sequence[str], also: Sequence[str] = ()) -> tuple[Named, Named]:
    """A line for all columns that were read, and lines for the other assumptions."""
    matched = [(note, _AS_NAMED.fullmatch(note)) for note in notes]
    columns = [
        m[2] + bracketed(m[4] or "") + f" from {m[1]!r}" * (m[1].partition(" [")[0] != m[2])
        for _, m in matched
        if m
    ]
    others = [*(note for note, m in matched if not m), *also]
    line = [("columns", ", ".join(columns))] * bool(columns)
    return line, named_lines("assumptions", others)


def _data(result: FitResult, full: bool) -> Section:
    """File, rows, columns, signs and assumptions."""
    data, noise = result.data, result.noise.get("notes", ())
    # In short, without the source of the noise, which the quality states.
    noise = [note for note in noise if full or not note.startswith("noise of")]
    columns, others = assumption_lines(data["assumptions"], noise)
    masked = [str(problem).replace("\n", " ") for problem in data["masked"]]
    convention = f"braking positive, SI (file: {data['convention']}, slip"
    lines = [
        ("rows", tables.rows_text(result)),
        *named_lines("runs", tables.run_lines(result)),
        *columns,
        ("convention", f"{convention} {data['slip_definition']})"),
        *others,
        *named_lines("masked", first_of(masked, 5)),
        # Outliers that the full report lists one by one.
        *named_lines("outliers", tables.far_lines(result) if full else []),
    ]
    return Section("Data and settings", lines)


def _settings(result: FitResult) -> list[tuple[str, str]]:
    """What the page says more on data and settings: parameters, file, programs."""
    lines = []
    for p in result.problem.layout.free:
        unit = "" if p.spec.unit == "-" else f" {p.spec.unit}"
        text = f"{p.name} free in [{p.spec.lower:g}, {p.spec.upper:g}]{unit}"
        text += ", one per run" if p.per_run else ""
        lines.append(text + (f", prior {p.prior[0]:g} ± {p.prior[1]:g}" if p.prior else ""))
    lines += [f"{t.name} = {t.factor:g} {t.other}" for t in result.problem.layout.ties]
    versions = ", ".join(f"{k} {v}" for k, v in result.versions.items())
    return [
        ("file", f"{result.data['file']}, sha256 {result.data['sha256'] or '-'}"),
        ("model", f"{result.model}, forces {', '.join(result.forces)}; {'; '.join(lines)}"),
        ("versions", f"tirefit {result.version}, {SCHEMA}; {versions}"),
    ]


def sections_of(result: FitResult, full: bool) -> list[Section]:
    """The sections of a fit, with the names of their figures.

    Args:
        full: with the intervals by every route, the misfit by run, the chains and the
            information criteria.
    """
    source, at = result.source, f"at {tables.reference_text(result)}"
    many = len(result.parameters) > 8
    # The short report has the intervals by each route if they disagree.
    routes = tables.route_rows(result) if full or result.verdict.disagreements else ()
    quality = [item for item in tables.quality_items(result) if full or item[0] != "information"]
    posterior = tables.posterior_lines(result)
    if not full:
        quality += named_lines("posterior", posterior)
    parts = [
        Section("Parameters", (), tables.parameter_rows(result), note=source),
        Section("Intervals by route", (), routes),
        Section("Derived", (), tables.derived_rows(result), note=f"{at}; {source}"),
        Section("Parameters by run", (), (), ("runs",)),
        Section("Quality", quality, (), ("residuals",)),
    ]
    if full:
        rows, right = tables.run_rows(result), (1, 2, 3)
        bias = "bias: measured - fitted"
        parts += [
            Section("By run", (), rows, note=bias, right=right),
            Section("Profile likelihood", (), (), ("profile",), folded=many),
            Section("Posterior", posterior, tables.chain_rows(result), ("corner",), right=right),
            Section("Chains", (), (), ("trace",), folded=True),
        ]
    return [*parts, Section("Correlations above 0.9", tables.correlation_lines(result))]


def fit_report(result: FitResult, full: bool = False) -> str:
    """The report of one fit as text; the verdict is first.

    Args:
        full: with the intervals by every route, the misfit by run, the chains and the
            information criteria.
    """
    several = len(result.data["runs"]) > 1 and ", " in result.data["file"]
    files = tables.fit_files(result) if several else result.data["file"]
    title = f"tirefit {result.version}: {result.model} fitted to {' and '.join(result.forces)} of"
    data = report_text([_data(result, full)._replace(title="")])
    verdict = wrapped(f"VERDICT: {verdict_line(result)}", "", " " * 9)
    for sentence in result.warnings[bool(result.outcomes) :]:
        verdict += wrapped(sentence, "       - ", " " * 9)
    parts = report_text(sections_of(result, full), apart=True)
    return "\n".join([*wrapped(f"{title} {files}"), *verdict, data, "", parts]) + "\n"


def fit_page(result: FitResult) -> str:
    """The whole fit as one HTML document with its pictures, no script or resource."""
    from tirefit.report.fit.figures import page_pictures  # Matplotlib

    pictures = page_pictures(result)
    data = _data(result, full=True)
    sections = [
        Section("", [EXPLORE], pictures=pictures["fit"]),
        *(
            section._replace(
                pictures=[x for name in section.pictures for x in pictures.get(name, ())]
            )
            for section in sections_of(result, full=True)
        ),
        data._replace(lines=[*data.lines, *_settings(result)]),
    ]
    subtitle = f"{', '.join(result.forces)}, {result.statistics.n} rows; braking positive, SI;"
    subtitle += f" seed {result.seed}; tirefit {result.version}"
    title = f"{result.model} fitted to {tables.fit_files(result, 60)}"
    return page(title, sections, _verdict(result), subtitle, result.to_json())


def _verdict(result: FitResult) -> dict[str, Any]:
    sentence = f"Verdict: {verdict_line(result)}"
    return verdict_of(sentence, result.warnings[bool(result.outcomes) :], not result.outcomes)


def fit_fragment(result: FitResult) -> str:
    """Parameters, verdict and the fitted curve; no script, no external resource."""
    from tirefit.report.fit.figures import figure_of  # Matplotlib, for a fit with its data

    image = image_of(figure_of(result, "fit"), "measured points and fitted curve")
    sections = [Section("", table=tables.parameter_rows(result), pictures=[image])]
    subtitle = f"fitted to {tables.fit_files(result)}, {result.statistics.n} rows; {result.source}"
    return fragment(result.model, sections, _verdict(result), subtitle)
