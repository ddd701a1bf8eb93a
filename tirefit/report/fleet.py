"""Quantities over many files for a page: as arrays, and as figures."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.ticker import MaxNLocator

from tirefit.data.records import ResultsTable, dates_of
from tirefit.fitting.across_files import AcrossFiles, across_files
from tirefit.report.canvas import BLUE, DARK, GREY, RED, Picture, panel_title, tidy
from tirefit.report.numbers import format_number

_KINDS = ("parameter", "effect", "gap", "derived", "statistic")
"""Kinds of quantities in the order of the page, without given values (``base``)."""

_OWN_STD = ("parameter", "effect", "derived")
"""Kinds whose numbers have a standard deviation; without one a number counts as unknown."""

_FEW = 3  # smallest number of files for a quantity to be shown
_MOST = 300  # largest number of files drawn one by one; with more, as many bins of files


class Quantity(NamedTuple):
    """A quantity of n files, (n,) each."""

    kind: str
    name: str
    unit: str
    number: np.ndarray  # of the file
    when: np.ndarray
    value: np.ndarray
    std: np.ndarray
    untold: int  # number of files that have it but do not determine it
    across: AcrossFiles

    @property
    def title(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit not in ("", "-") else self.name

    @property
    def counts(self) -> bool:
        """Whether it counts something, such as rows."""
        whole = np.array_equal(self.value, np.round(self.value))
        return self.kind == "statistic" and whole


class Fleet(NamedTuple):
    """All files and their quantities."""

    files: dict[str, list]
    dates: np.ndarray | None  # (files,) from their names; None: use the order of files
    quantities: list[Quantity]


def fleet_of(path: Path) -> Fleet:
    """Files and quantities of a table of all results (``tirefit.data.records``)."""
    table = ResultsTable(path)
    files = table.files()
    dates = dates_of(files["file"])
    order = np.arange(1.0, len(files["file"]) + 1)
    when = order if dates is None else dates.astype(float) / 86400
    shown = []
    for kind, name, unit in table.quantities():
        rows = table.of(kind, name)
        if kind not in _OWN_STD:
            rows["std"] = np.zeros_like(rows["value"])
        known = np.isfinite(rows["value"] + rows["std"])
        number, value, std = (rows[c][known] for c in ("number", "value", "std"))
        if kind in _KINDS and len(value) >= min(_FEW, len(order)):
            at = when[number - 1]
            across = across_files(value, std, at)
            untold = int(np.sum(~known))
            shown.append(Quantity(kind, name, unit, number, at, value, std, untold, across))
    return Fleet(files, dates, sorted(shown, key=lambda one: _KINDS.index(one.kind)))


class Points(NamedTuple):
    """The drawn points with bars, of files or of bins of consecutive files, and the files
    that differ; all (m,) arrays."""

    when: np.ndarray
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    binned: bool
    other_when: np.ndarray
    other_value: np.ndarray
    other_bar: np.ndarray


def points(quantity: Quantity, most: int = _MOST) -> Points:
    """Files with their standard deviations; for many files, medians and the central 68 % of bins of
    equally many consecutive files. The ``most`` files that differ most are separate points."""
    apart = quantity.across.outlier
    order = np.argsort(quantity.when, kind="stable")
    order = order[~apart[order]]
    when, value, std = (one[order] for one in (quantity.when, quantity.value, quantity.std))
    binned = len(value) > most
    low, high = value - std, value + std
    if binned:
        bins = np.array_split(np.arange(len(value)), most)
        shares = [np.quantile(value[bin], (0.16, 0.5, 0.84)) for bin in bins]
        low, value, high = np.array(shares).T
        when = np.array([np.mean(when[bin]) for bin in bins])
    far = np.flatnonzero(apart)
    far = far[np.argsort(-np.abs(quantity.across.pulls[far]), kind="stable")][:most]
    return Points(
        when, value, low, high, binned, quantity.when[far], quantity.value[far], quantity.std[far]
    )


def quantity_figure(quantity: Quantity, dated: bool) -> Picture:
    """Draw a quantity over the dates or the order of files, with its regression line."""
    drawn, across = points(quantity), quantity.across
    picture = Picture(figsize=(7.0, 2.5), dpi=80)
    axes = picture.add_axes((0.12, 0.2, 0.86, 0.6))

    def at(when):
        return (when * 86400).astype("datetime64[s]") if dated else when

    bars = drawn.value - drawn.low, drawn.high - drawn.value
    style: dict[str, Any] = {"lw": 0.7, "color": BLUE, "alpha": 0.8}
    axes.errorbar(at(drawn.when), drawn.value, bars, fmt="o", ms=2.5, **style)
    others = at(drawn.other_when), drawn.other_value, drawn.other_bar
    axes.errorbar(*others, fmt="x", ms=4, lw=0.7, color=RED)
    ends = np.array([quantity.when.min(), quantity.when.max()])
    share = (ends - quantity.when.mean()) / (np.ptp(ends) or 1.0)
    line = across.middle + across.change * share
    axes.plot(at(ends), line, color=DARK, lw=1)
    low, high = line - across.scatter, line + across.scatter
    axes.fill_between(at(ends), low, high, color=GREY, alpha=0.25, lw=0)
    what = "medians and central 68 % of neighbours" if drawn.binned else "files ± std"
    text = f"{what}; grey: scatter between files {format_number(across.scatter)}"
    tidy(axes, "date in the file's name" if dated else "file", "")
    axes.tick_params(axis="x", labelrotation=0)
    counting = ([] if dated else [axes.xaxis]) + ([axes.yaxis] if quantity.counts else [])
    for axis in counting:
        # One tick is enough, as all files may have the same number of rows.
        axis.set_major_locator(MaxNLocator("auto", integer=True, min_n_ticks=1))
    panel_title(axes, quantity.title, text)
    return picture
