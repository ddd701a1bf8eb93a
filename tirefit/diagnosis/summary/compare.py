"""Fits, tires and diagnoses side by side: :func:`compare`."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.special import chdtrc

from tirefit import __version__
from tirefit.data.run_names import LONGEST, clipped
from tirefit.diagnosis.engine.decide import UNKNOWN
from tirefit.diagnosis.extended import SCHEMA as DIAGNOSIS
from tirefit.diagnosis.extended import AnyDocument, read_checked
from tirefit.diagnosis.summary.forces import ForceDifference, differing_forces
from tirefit.diagnosis.summary.result import mappings
from tirefit.display import Record
from tirefit.door import RECORD, content_of
from tirefit.files import json_safe
from tirefit.fitting.result import SCHEMA as FIT
from tirefit.fitting.result import TRAJECTORY, FitResult, information
from tirefit.fitting.source import GivenTire, given_tire
from tirefit.results import DataError, TirefitError, UsageError

SCHEMA = "tirefit.comparison/1"

LEVEL = 0.01
"""Probability that a comparison of equal tires claims a difference of any parameter; the same
for the forces, and for the sizes of effects."""

_REMEDY = "give a fit.json, a trajectory.json, a diagnosis, or a .tir file"


class Number(NamedTuple):
    """A value, and its standard error; None if it is not known."""

    value: float
    std: float | None
    unit: str


class Source(NamedTuple):
    """One of the things compared.

    Attributes:
        name: short, unlike the others.
        kind: ``fit``, ``tir``, ``trajectory``, ``diagnosis``, ``description`` or ``states``.
        file: its path, or that of its data.
        model: of the tire or the car.
        rows: identifies the rows that it was found from; empty if not known.
        numbers: parameters by name; ``derived`` those that follow from them.
        effects: ``effect: amplitude`` -> size of the effects that help.
        standing: effect -> ``named``, ``acts like one``, ``possible`` or ``untestable``.
        tire: that gives forces; None without.
        content: of its document.
    """

    name: str
    kind: str
    file: str = ""
    model: str = ""
    rows: str = ""
    numbers: Mapping[str, Number] = {}
    derived: Mapping[str, Number] = {}
    effects: Mapping[str, Number] = {}
    standing: Mapping[str, str] = {}
    tire: GivenTire | None = None
    content: Mapping[str, Any] = {}

    def as_json(self) -> Mapping[str, Any]:
        """Without the document."""
        return {k: getattr(self, k) for k in ("name", "kind", "file", "model", "standing")}


class Apart(NamedTuple):
    """A number of several sources, and the one that is the farthest from the others.

    ``difference`` is its value less the weighted mean of the others (of two sources: the
    second less the first), with the standard error ``std``; ``p`` is the probability of
    so large a scatter (chi-square) if all are equal. None where fewer than two are known.
    """

    name: str
    unit: str
    values: Mapping[str, Number]
    farthest: str = ""
    difference: float | None = None
    std: float | None = None
    p: float | None = None
    differs: bool = False

    @property
    def errors(self) -> float | None:
        """The difference in standard errors, without sign."""
        return abs(self.difference) / self.std if self.difference is not None else None  # type: ignore[operator]


class Ranked(NamedTuple):
    """A model fitted to the same rows as the others; information counts the same rows."""

    model: str
    unknowns: int
    rmse: float
    aicc: float
    bic: float
    n_effective: float
    status: str
    name: str  # of its source


@dataclass(frozen=True, repr=False, kw_only=True)
class Comparison(Record):
    """Sources side by side: what differs beyond its error.

    ``models`` ranks fits of the same rows, the lowest AICc first; it is empty for others,
    and their numbers and forces are then compared. ``shared`` names sources of the same rows,
    whose errors are not independent, so that nothing is tested. ``meanings`` are sentences on
    what differences mean together.
    """

    text_by: ClassVar[str] = "tirefit.report.compare:comparison_text"
    plot_by: ClassVar[str] = "tirefit.report.compare:plot_comparison"
    html_by: ClassVar[str] = "tirefit.report.compare:comparison_fragment"
    page_by: ClassVar[str] = "tirefit.report.compare:comparison_page"
    internal: ClassVar[tuple[str, ...]] = ("sources",)

    sources: tuple[Source, ...]
    numbers: tuple[Apart, ...] = ()
    forces: tuple[ForceDifference, ...] = ()
    effects: tuple[Apart, ...] = ()
    models: tuple[Ranked, ...] = ()
    shared: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    meanings: tuple[str, ...] = ()
    level: float = LEVEL
    version: str = field(default=__version__)

    def to_dict(self) -> dict[str, Any]:
        """Content of ``comparison.json``."""
        return json_safe({"schema": SCHEMA} | mappings(self))

    def files(self, name: str = "") -> dict[str, str]:
        """``comparison.json``."""
        return {"comparison.json": self.to_json()}


def compare(
    sources: "Iterable[Record | GivenTire | str | PathLike[str]]", names: Sequence[str] = ()
) -> Comparison:
    """Compare fits, ``.tir`` files or diagnoses: what differs beyond its standard error.

    Fits of the same rows are ranked by AICc instead, with the same effective number of rows.

    Args:
        sources: two or more results, or paths of ``fit.json``, ``trajectory.json``,
            diagnoses, or ``.tir`` files, in any mixture.
        names: of the sources, in their order; by default from their files.

    Returns:
        Parameters, forces over the common range, and effects of all; prints as a table.

    Raises:
        UsageError: fewer than two sources.
        DataError: files that cannot be read; all of them.

    Example:
        >>> days = [simulate("rig", values={"mu": mu}, seed=k) for k, mu in enumerate((0.9, 0.8))]
        >>> both = compare([fit(day.columns, "brush") for day in days], ["Monday", "Tuesday"])
        >>> [(number.name, number.differs) for number in both.numbers]
        [('cpa2', False), ('mu', True)]
    """
    opened, problems = [], []
    for k, source in enumerate(sources):
        try:
            opened.append(_opened(source)._replace(name=names[k] if k < len(names) else ""))
        except TirefitError as error:
            file = fspath(source) if isinstance(source, str | PathLike) else ""
            problems += [x if x.file else replace(x, file=file) for x in error.problems]
    DataError.raise_for(problems)
    if len(opened) < 2:
        raise UsageError("nothing to compare: give two or more fits, .tir files or diagnoses")
    return compared(_with_names(opened))


def compared(opened: Sequence[Source]) -> Comparison:
    """The comparison of sources that were read."""
    rows = [source.rows for source in opened]
    shared = tuple(x.name for x in opened if x.rows and rows.count(x.rows) > 1)
    fits = [source for source in opened if source.kind == "fit"]
    if rows[0] and len({*rows}) == 1 and all("fit" in source.content for source in opened):
        return Comparison(sources=tuple(opened), models=_ranked(opened), shared=shared)
    same = len({(fit.model, *fit.numbers) for fit in fits}) < 2
    of = {x.name: x.numbers if same or x.kind != "fit" else x.derived for x in opened}
    notes = [] if same else ["fits of several models: compared by what follows from all of them"]
    forces, more = differing_forces({x.name: x.tire for x in opened if x.tire}, LEVEL)
    effects = {x.name: x.effects for x in opened if x.kind != "fit"}
    if shared:
        # Without claims, as the errors are not independent.
        forces = tuple(
            force._replace(
                curves={k: x._replace(error=None, differs=False) for k, x in force.curves.items()}
            )
            for force in forces
        )
        notes.append(f"{', '.join(shared)} are of the same rows: their errors are not independent")
    return Comparison(
        sources=tuple(opened),
        numbers=_apart(of, shared),
        forces=forces,
        effects=_apart(effects, shared, 1),
        shared=shared,
        notes=(*notes, *more),
    )


def _apart(
    of: Mapping[str, Mapping[str, Number]], shared: Sequence[str], least: int = 2
) -> tuple[Apart, ...]:
    """The numbers that at least ``least`` sources have, those of the first source first; those
    that are tested share the level."""
    numbers = []
    for name in dict.fromkeys(name for numbers_of in of.values() for name in numbers_of):
        values = {source: x[name] for source, x in of.items() if name in x}
        if len(values) >= least:
            unit = next(iter(values.values())).unit
            numbers.append(_farthest(Apart(name, unit, values)))
    if shared:
        return tuple(number._replace(p=None) for number in numbers)
    each = LEVEL / max(sum(number.p is not None for number in numbers), 1)
    return tuple(x._replace(differs=x.p is not None and x.p < each) for x in numbers)


def _farthest(number: Apart) -> Apart:
    """With the difference of the source that is the farthest from the others, in errors."""
    known = {k: x for k, x in number.values.items() if x.std is not None}
    if len(known) < 2:
        return number
    value = np.array([x.value for x in known.values()])
    std = np.array([x.std for x in known.values()], float)
    weight = np.maximum(std, 1e-9 * np.max(np.abs([*value, *std])) + 1e-300) ** -2
    rest = weight.sum() - weight
    away = value - (weight @ value - weight * value) / rest
    error = np.sqrt(1 / weight + 1 / rest)
    # Of two sources, the differences are opposite: the second less the first.
    last = len(value) - 1 - int(np.argmax(np.round(np.abs(away / error), 6)[::-1]))
    scatter = float(weight @ (value - weight @ value / weight.sum()) ** 2)
    return number._replace(
        farthest=[*known][last],
        difference=float(away[last]),
        std=float(error[last]),
        p=float(chdtrc(len(value) - 1, scatter)),
    )


def _ranked(fits: Sequence[Source]) -> tuple[Ranked, ...]:
    """Models of the same rows, lowest AICc first."""
    best = min((fit.content["fit"] for fit in fits), key=lambda s: s["rmse"])
    rows, models = best["n"] * len(fits[0].content["forces"]), []
    for fit in fits:
        s, likelihood = fit.content["fit"], fit.content["fit"]["minus_two_log_likelihood"]
        scores = information(likelihood, rows, best["n_effective"], s["unknowns"])
        free, status = len(fit.content["prediction"]["labels"]), fit.content["verdict"]["status"]
        numbers = free, s["rmse"], *scores, s["n_effective"]
        models.append(Ranked(fit.model, *numbers, status, fit.name))
    return tuple(sorted(models, key=lambda model: model.aicc))


# --- reading --------------------------------------------------------------------------


def _numbers(given: Mapping[str, Mapping[str, Any]], value: str = "value") -> dict[str, Number]:
    """Numbers of a document, except those that are fixed, not known, or have several values."""
    numbers = {}
    for name, x in given.items():
        if isinstance(x[value], float | int) and not x.get("fixed"):
            std = None if x["std"] is None else abs(float(x["std"]))
            numbers[name] = Number(float(x[value]), std, str(x.get("unit", "")))
    return numbers


def standing_of(verdict: Any, untestable: Iterable[str]) -> dict[str, str]:
    """The standing of each effect that a verdict mentions."""
    return {
        **dict.fromkeys(untestable, "untestable"),
        **dict.fromkeys(verdict.also_possible, "possible"),
        **dict.fromkeys(verdict.acts_like, "acts like one"),
        **{effect: "named" for effect in verdict.effects if effect != UNKNOWN},
    }


def _opened(source: Any) -> Source:
    """A source from a result or a file; raises DataError or UsageError."""
    file = fspath(source) if isinstance(source, str | PathLike) else ""
    content: Any = source.to_dict() if hasattr(source, "to_dict") else None
    if file:
        raw = content_of(file, RECORD, DataError, _REMEDY)
        try:
            content = json.loads(raw.decode("utf-8"))
        except (ValueError, RecursionError):
            pass  # not JSON, or damaged: given_tire tells
    schema = content.get("schema") if isinstance(content, dict) else None
    try:
        if schema == TRAJECTORY:
            numbers = _numbers(content["parameters"])
            logs = content["logs"]
            return Source("", "trajectory", file or logs[0], "car", "\n".join(logs), numbers)
        if schema == DIAGNOSIS:
            return _of_diagnosis(content, source, file)
    except (LookupError, TypeError, AttributeError) as error:
        raise DataError(f"damaged: {error!r:.200}", "write it again", file) from None
    if isinstance(schema, str) and schema != FIT:
        known = f"{FIT}, {TRAJECTORY} and {DIAGNOSIS} are read"
        raise DataError(f"its schema is {schema}; {known}", _REMEDY, file)
    given = given_tire(file or source)  # raises for other files
    if not (given.tir or given.content or not file):
        raise DataError("neither a fit, a diagnosis nor a .tir file", _REMEDY, file)
    return _of_tire(given, file, source)


def _of_diagnosis(content: Mapping[str, Any], source: Any, file: str) -> Source:
    read = read_checked(source, AnyDocument, "NAME.json", "tirefit diagnose")
    numbers = _numbers(content["verdict"]["parameters"], "measured")
    if read.simulator is None:  # fitted without standard errors
        numbers = {k: Number(x, None, "") for k, x in read.extended_parameters.items()}
    is_of_forces = (read.simulator or {}).get("kind") == "columns"
    return Source(
        "",
        "diagnosis",
        file or read.data.name,
        "forces of a simulator" if is_of_forces else read.model,
        read.data.sha256,
        numbers,
        effects={k: Number(x.value, x.std, x.unit) for k, x in read.amplitudes.items()},
        standing=standing_of(read.verdict, [x["effect"] for x in content["untestable"]]),
    )


def _of_tire(given: GivenTire, file: str, source: Any) -> Source:
    if not given.content:
        return Source("", "tir" if given.tir else "tire", file, given.name, tire=given)
    content, rows = given.content, given.content["data"]
    key = rows["sha256"]
    if isinstance(source, FitResult) and not key:  # rows in memory have no file
        key = str(hash(tuple(x.tobytes() for x in source.table.columns.values())))
    key = key and f"{key} {rows['used']} {rows['runs']} {content['forces']}"
    fitted = content.get("parameters") or content["coefficients"]
    numbers, derived = _numbers(fitted), _numbers(content.get("derived", {}))
    return Source(
        "", "fit", file or rows["file"], given.name, key, numbers, derived, tire=given,
        content=content,
    )  # fmt: skip


def _with_names(opened: Sequence[Source]) -> list[Source]:
    """Each with its own name: the given one; else its file, its folder, or both, whichever is
    the first that tells all apart; numbers if none does."""
    files = [Path(source.file or source.model) for source in opened]
    for short in (lambda x: x.stem, lambda x: x.parent.name, lambda x: f"{x.parent.name}/{x.stem}"):
        names = [clipped(short(x), LONGEST) for x in files]
        if len({*names}) == len(names):
            break
    else:
        names = [f"{file.stem} ({k})" for k, file in enumerate(files, 1)]
    return [x._replace(name=x.name or names[k]) for k, x in enumerate(opened)]
