"""Several fits on one page: a table, their curves, their parameters by file."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial

from tirefit.data.merged import merged
from tirefit.data.run_names import name_pattern, run_names
from tirefit.files import write_text_atomic
from tirefit.fitting.derived import quantity_of
from tirefit.fitting.result import SCHEMA, FitResult
from tirefit.report.by_name import Points, distinct, draw_by_name, points_of
from tirefit.report.fit_tables import FORCE_UNIT, Rows, rows_text, value_text
from tirefit.report.html import GOOD, OPEN, Section, page
from tirefit.report.numbers import format_number
from tirefit.report.overlay import draw_overlay, overlay_of
from tirefit.report.panels import WIDE, Panel, images_of
from tirefit.results import Outcome, UsageError

_CURVES = """with the 95 % band of each fit, over the slips of its own rows; points: rows within \
10 % of the load, and 0.01 of the other slip, of their curve"""
_BY_FILE = "values and 95 % intervals; grey: not identified"
_TOGETHER = 3  # quantities by file in one picture


def _columns(fits: Mapping[str, FitResult], part: str) -> dict[str, str]:
    """Parameters or derived quantities of any fit -> unit, without those per run."""
    return {
        name: estimate.unit
        for result in fits.values()
        for name, estimate in getattr(result, part).items()
        if name == quantity_of(name)
    }


def _table(fits: Mapping[str, FitResult], part: str) -> Rows:
    """A row per fit, a column per parameter or derived quantity."""
    names = _columns(fits, part)
    head = [name if unit == "-" else f"{name} [{unit}]" for name, unit in names.items()]
    rows = [["file", *head]]
    for file, result in fits.items():
        own = getattr(result, part)
        cells = (value_text(own[name]) if name in own else "" for name in names)
        rows.append([file, *cells])
    return rows


def _parameters(fits: Mapping[str, FitResult]) -> Rows:
    """Parameters, misfit and verdict of every fit."""
    first = next(iter(fits.values())).forces[0]
    head = [f"RMSE [{FORCE_UNIT[first]}]", "rows", "independent", "verdict"]
    rows = _table(fits, "parameters")
    rows[0] += head
    for row, result in zip(rows[1:], fits.values(), strict=True):
        s = result.statistics
        row += [
            format_number(s.rmse),
            rows_text(result),
            f"{s.n_effective:.0f}",
            str(result.status),
        ]
    return rows


def _verdict(fits: Mapping[str, FitResult], failed: Mapping[str, str]) -> Mapping:
    by_status = Counter(r.status for r in fits.values())
    parts = [f"{count} {status}" for status, count in by_status.most_common()]
    parts += [f"{len(failed)} not fitted"] if failed else []
    lines = []
    for name, result in fits.items():
        if result.outcomes:
            lines.append(f"{name}: {result.status}: {result.warnings[0]}")
    good = set(by_status) == {Outcome.OK} and not failed
    return {
        "sentence": f"Verdict: of {len(fits) + len(failed)} files: {', '.join(parts)}",
        "lines": [*lines, *(f"{k}: not fitted: {v}" for k, v in failed.items())],
        "color": GOOD if good else OPEN,
    }


def _points(fits: Mapping[str, FitResult], part: str) -> list[Points]:
    """Figures of free parameters or derived quantities by file."""
    panels = []
    for name, unit in _columns(fits, part).items():
        own = [getattr(result, part).get(name) for result in fits.values()]
        if not all(one is None or one.fixed for one in own):
            panels.append(points_of(f"{name} [{unit}]", list(fits), own))
    return panels


def _by_file(fits: Mapping[str, FitResult]) -> list[Panel]:
    points = distinct(_points(fits, "parameters"), _points(fits, "derived"))
    groups = [points[i : i + _TOGETHER] for i in range(0, len(points), _TOGETHER)]
    return [
        Panel(
            partial(draw_by_name, panels=some),
            f"{', '.join(one.label for one in some)} by file, with 95 % intervals",
            (WIDE, 1.1 + 1.3 * len(some)),
        )
        for some in groups
    ]


def _overlays(fits: Mapping[str, FitResult]) -> list[Panel]:
    return [
        Panel(
            partial(draw_overlay, overlay=overlay_of(fits, channel)),
            f"Fitted curves of {channel} of all files",
            (WIDE, 4.0),
        )
        for channel in dict.fromkeys(c for r in fits.values() for c in r.forces)
    ]


def _one_of(values) -> str:
    """The common value, or all values if they differ."""
    return ", ".join(dict.fromkeys(str(value) for value in values))


def _said(results: Sequence[FitResult]) -> list[str]:
    """The statement of signs, units and version of every output."""
    return [
        _one_of(", ".join(r.forces) for r in results),
        "braking positive, SI",
        f"seed {_one_of(r.seed for r in results)}",
        f"tirefit {_one_of(r.version for r in results)}",
    ]


def _provenance(fits: Mapping[str, FitResult]) -> list[str]:
    results = list(fits.values())
    conventions = _one_of(r.data["convention"] for r in results)
    return [
        f"models: {_one_of(r.model for r in results)}; forces:"
        f" {_one_of(', '.join(r.forces) for r in results)}",
        f"conventions of the files: {conventions}; this page is braking positive, in SI units",
        f"values: {_one_of(r.source for r in results)}",
        f"solver {_one_of(r.solver for r in results)}, seed {_one_of(r.seed for r in results)}",
        *merged((name, result.data["assumptions"]) for name, result in fits.items()),
        f"tirefit {_one_of(r.version for r in results)}, {SCHEMA}",
    ]


def _files(fits: Mapping[str, FitResult]) -> Rows:
    return [
        ["file", "path", "convention", "at F_z [N]", "sha256"],
        *(
            [
                name,
                result.data["file"],
                result.data["convention"],
                format_number(result.reference["fz"]),
                result.data["sha256"] or "-",
            ]
            for name, result in fits.items()
        ),
    ]


def fits_page(fits: Mapping[str, FitResult], failed: Mapping[str, str] | None = None) -> str:
    """Several fits as one HTML document, without script or external resource.

    Args:
        fits: file (or any other name) -> its fit, in the order of the page.
        failed: file -> reason why it could not be fitted.

    Raises:
        UsageError: there is no fit.
    """
    if not fits:
        raise UsageError("no fit for the page", "give fits by name: {'dry': fit, ...}")
    names = list(fits)
    pattern = [name_pattern(names)] if run_names(names).pattern else []
    by_name = dict(zip(run_names(names).short, fits.values(), strict=True))
    results = list(fits.values())
    per_run = sorted({quantity_of(k) for r in results for k in r.labels if "[" in k})
    of_runs = f"one for each run, on the pages of the fits: {', '.join(per_run)}"
    curves, points = images_of(_overlays(by_name)), images_of(_by_file(by_name))
    at = "at the median load and speed of each file"
    sections = [
        Section("Curves", (), (), curves, _CURVES),
        Section("Parameters and derived quantities by file", (), (), points, _BY_FILE),
        Section("Parameters", [of_runs] * bool(per_run), _parameters(by_name)),
        Section("Derived quantities", (), _table(by_name, "derived"), (), at),
        Section("Where this comes from", _provenance(fits), _files(by_name)),
    ]
    title = f"{_one_of(r.model for r in results)} fitted to {len(fits)} files"
    subtitle = "; ".join([*pattern, *_said(results)])
    return page(title, sections, _verdict(by_name, failed or {}), subtitle)


def write_fits_page(
    fits: Mapping[str, FitResult], path: str | os.PathLike, failed: Mapping[str, str] | None = None
) -> None:
    """Write the page of several fits, completely or not at all.

    Args:
        fits: file (or any other name) -> its fit, in the order of the page.
        path: of the page, such as ``fits.html``.
        failed: file -> reason why it could not be fitted.

    Raises:
        UsageError: there is no fit.
        OSError: the file cannot be written.

    Example:
        >>> names = ("circles", "free_driving")
        >>> fits = {name: fit(samples / f"{name}.csv") for name in names}
        >>> write_fits_page(fits, folder / "fits.html")
    """
    write_text_atomic(path, fits_page(fits, failed))
