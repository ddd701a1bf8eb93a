"""Tires as programs that a browser runs, with measured rows: :func:`explore`."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from tirefit import __version__
from tirefit.data.accept import DataLike, as_data
from tirefit.data.table import TireData
from tirefit.display import Record
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.solve.inference import half_width_95
from tirefit.fitting.source import GivenTire, given_tire
from tirefit.fitting.tir import TIR_SIGNS
from tirefit.models.mf import MFTire
from tirefit.params import parameter_values, with_values
from tirefit.results import DataError, InputProblem, UsageError
from tirefit.slip import kappa_from_sigma
from tirefit.targets.code import C, body, results
from tirefit.targets.program import Program, traced
from tirefit.targets.tire import ALWAYS, INPUTS, Tire, sign_of, tire_of, turned_range

SCHEMA = "tirefit.explore/1"
MOST = 6
"""Tires over each other that a reader can tell apart by colour."""
_ROWS = 5000  # measured rows on a page, at most: 300 kB
_STEP = 1e-4
"""Step of the central differences for the bands, in standard errors, as in `fitting.bands`."""
_MARGIN = 0.25  # range of a slider beyond that of the data, as a share of it
_FORCES = ("fx", "fy", "mz")
_USUAL = {"kappa": (-0.3, 0.3), "alpha": (-0.25, 0.25), "gamma": (-0.1, 0.1), "v": (1.0, 40.0)}
"""Range of an input [SI] without data: up to 30 % of slip, 14 degrees, 6 degrees, 144 km/h."""
_POSSIBLE = {"kappa": (-2.0, 0.98), "alpha": (-1.4, 1.4), "gamma": (-1.4, 1.4)}
"""Values of an input [SI, canonical] at which the forces are defined; others are positive."""

JAVASCRIPT = C._replace(
    usual="Math.{}",
    calls={**C.calls, "abs": "Math.abs", "cos": "Math.cos", "sign": "Math.sign"},
    number=lambda value: repr(value).replace("inf", "Infinity").replace("nan", "NaN"),
    line="const {name} = {value};",
)


@dataclass(frozen=True)
class Shown:
    """A tire on a page."""

    label: str  # model and place of the file
    origin: tuple[str, ...]  # sentences on where it comes from
    outputs: tuple[str, ...]  # of fx, fy and mz, those that the model gives
    fitted: tuple[str, ...]  # those of them that were fitted; empty without a fit
    program: str  # JavaScript function of :data:`INPUTS` and of the parameters ``p``
    theta: Sequence[float]  # values of the parameters (n,); empty without standard errors
    steps: Sequence[Sequence[float]]  # (r, n) changes of ``theta`` along independent directions
    scale: float
    """The half width of a 95 % interval over the root of the sum of squares of the differences
    between both sides of each step."""
    ranges: Mapping[str, tuple[float, float]]
    """Input -> least and largest value in the data; empty if not known."""


@dataclass(frozen=True, repr=False)
class Explored(Record):
    """The result of :func:`explore`: :meth:`save` writes the page."""

    text_by: ClassVar[str] = "tirefit.report.explore:explore_text"
    plot_by: ClassVar[str] = "tirefit.report.explore:explore_figure"
    page_by: ClassVar[str] = "tirefit.report.explore:explore_page"
    save_by: ClassVar[str] = "tirefit.report.explore:save_page"
    convention: str  # signs of all values, which are in SI units
    inputs: Mapping[str, tuple[float, float, float]]
    """Input -> least, largest and first value of its slider."""
    tires: tuple[Shown, ...]  # at most :data:`MOST`
    rows: Mapping[str, Sequence[float | None]] = field(default_factory=dict)
    """Column -> values of measured rows, None where not measured."""
    data: str = ""  # the file of the rows, and their number
    warned: tuple[str, ...] = ()  # sentences on how it was read

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know of the measured rows."""
        return (*super().warnings, *self.warned)

    def to_dict(self) -> dict[str, Any]:
        """All content of the page."""
        return {"schema": SCHEMA, "version": __version__, **asdict(self)}


def explore(
    source: TireLike | Sequence[TireLike], data: DataLike | None = None, **how: Any
) -> Explored:
    """Return a page on which a reader moves sliders and sees the forces of tires.

    The page evaluates the model itself, as the export does, not a table of it. Its bands
    are those of :func:`tirefit.predict` without the noise of a measurement. Its signs are
    those of the data of the first tire.

    Args:
        source: a fit, a ``fit.json``, a ``.tir`` file, a tire, the name of a model, a
            folder of ``fit.json`` or ``.tir`` files, or a list of these.
        data: measured rows to show, as for :func:`tirefit.predict`.
        how: arguments of :func:`tirefit.read` for ``data``.

    Returns:
        The content of the page; ``save("tire.html")`` writes it, which needs Plotly.

    Raises:
        UsageError: an unknown model; a fit with values by run; a model that cannot be written.
        DataError: a file that cannot be read; a folder without tires; over :data:`MOST` tires.

    Example:
        >>> explore(["brush", "brush-n"]).convention
        'iso-w'
    """
    sources = list(source) if isinstance(source, list | tuple) else [source]
    listed = [tire_source for each in sources for tire_source in _in_folder(each)]
    if not 0 < len(listed) <= MOST:
        reason = f"{len(listed)} tires: a page shows 1 to {MOST} over each other"
        raise DataError(InputProblem(reason, "name the files of those to compare"))
    given = [given_tire(tire_source) for tire_source in listed]
    convention = given[0].content.get("data", {}).get("convention", TIR_SIGNS)
    tires = [tire_of(tire_source) for tire_source in listed]
    rows: dict[str, list[float]] = {}
    rows_from, warned = "", list[str]()
    if data is not None:
        table = as_data(data, **how, forces=False, otherwise=(convention, "the tire"))
        warned += table.source.warnings
        columns = _columns(table)
        ranges = {
            k: (float(np.nanmin(v)), float(np.nanmax(v))) for k, v in columns.items() if k in INPUTS
        }
        tires = [tire if tire.measured else replace(tire, measured=ranges) for tire in tires]
        rows, rows_from = _shown_rows(columns, convention), f"{table.file}, {table.n} rows"
        rows_from += f", of which the page holds {_ROWS}" * (table.n > _ROWS)
    shown, used = [], set(INPUTS[:ALWAYS])
    for tire_source, read_tire, tire in zip(listed, given, tires, strict=True):
        program, record = _shown(_label(tire_source, read_tire), read_tire, tire, convention)
        used |= {INPUTS[a[0]] for op, a in program.operations if op == "input" and a[0] < 6}
        shown.append(record)
    inputs = {k: _slider(k, tires, given, convention) for k in INPUTS if k in used}
    return Explored(convention, inputs, tuple(shown), rows, rows_from, tuple(warned))


def _in_folder(source: Any) -> list[Any]:
    """The tires of a folder, in order of their names; another source by itself."""
    path = Path(source) if isinstance(source, str | os.PathLike) else None
    if path is None or not path.is_dir():
        return [source]
    fits = sorted(path.rglob("fit.json"))
    # A whole Magic Formula is written as both.
    alone = [tir for tir in sorted(path.rglob("*.tir")) if not (tir.parent / "fit.json").exists()]
    if not fits + alone:
        remedy = "name a folder of `tirefit fit`, or the files"
        raise DataError("neither a fit.json nor a .tir file in this folder", remedy, str(path))
    return [str(file) for file in fits + alone]


def _label(source: TireLike, given: GivenTire) -> str:
    if not isinstance(source, str | os.PathLike) or not (given.tir or given.content):
        return given.name
    path = Path(source)
    return f"{given.name}, {path.absolute().parent.name if path.name == 'fit.json' else path.stem}"


def _shown(label: str, given: GivenTire, tire: Tire, convention: str) -> tuple[Program, Shown]:
    """The program of a tire, and its record."""
    outputs = tuple(force for force in _FORCES if force in tire.modelled)
    tire = replace(tire, asked=outputs)
    values, half_width = dict[str, float](), half_width_95(False, 0)
    steps = np.zeros((0, 0))
    if given.fit is not None:
        values, steps = _directions(given, tire)
        noise, dof = given.content["noise"], given.content["fit"].get("dof")
        if dof is not None:
            sources = {noise[force].get("source") for force in given.content["forces"]}
            half_width = half_width_95("estimated" in sources, dof)

    def forces(*arguments: Any) -> tuple[Any, ...]:
        fitted = dict(zip(values, arguments[len(INPUTS) :], strict=True))
        changed = replace(tire, model=with_values(tire.model, fitted))
        return changed.function(convention)(*arguments[: len(INPUTS)])

    names = (*INPUTS, *(f"p[{k}]" for k in range(len(values))))
    try:
        program = traced(forces, names, outputs)
    except NotImplementedError as error:
        reason = f"{tire.name} cannot be written for a browser: {error}"
        raise UsageError(reason, "fit another model to its curve: `tirefit convert`") from None
    returned = ", ".join(results(program, JAVASCRIPT))
    lines = [*body(program, JAVASCRIPT, ""), f"return [{returned}];"]
    text = f"function({', '.join(INPUTS)}, p) {{\n" + "\n".join(lines) + "\n}"
    ranges = turned_range(tire.measured, convention)
    if ranges:  # an angle or a slip that was not measured was zero
        ranges = {"kappa": (0.0, 0.0), "alpha": (0.0, 0.0), "gamma": (0.0, 0.0), **ranges}
    origin = [tire.origin, *tire.notes]
    if outcomes := given.content.get("outcomes"):
        origin.append(f"verdict of the fit: {', '.join(outcomes).replace('_', ' ')}")
    shown = (label, tuple(origin), outputs, tire.fitted, text, [*values.values()], steps.tolist())
    return program, Shown(*shown, half_width / (2 * _STEP), ranges)


def _directions(given: GivenTire, tire: Tire) -> tuple[dict[str, float], np.ndarray]:
    """Fitted values (n,) by name, and steps along independent directions (r, n)."""
    assert given.fit is not None
    layout, z, covariance = given.fit
    slopes = jax.jacfwd(layout.natural)(jnp.asarray(z))
    known, values, rows = parameter_values(tire.model), dict[str, float](), []
    for name, slope in slopes.items():
        # The curve of a Magic Formula serves both axes; a relaxation length, no steady force.
        for parameter in (name, f"{name}x", f"{name}y"):
            if parameter in known:
                values[parameter] = float(known[parameter])
                rows.append(np.asarray(slope))
    square, along = np.linalg.eigh(covariance)
    std = np.sqrt(np.maximum(square, 0.0))
    return values, _STEP * (np.array(rows).reshape(-1, len(z)) @ along * std).T[std > 0]


def _columns(data: TireData) -> dict[str, np.ndarray]:
    """Measured columns of the used rows, canonical."""
    names = ("sigma_x", *INPUTS[1:], *_FORCES)
    measured = {name: data.usable(name) for name in names if name in data}
    if "sigma_x" in measured:
        measured["kappa"] = kappa_from_sigma(measured.pop("sigma_x"))
    return {k: np.asarray(v, float) for k, v in measured.items() if np.isfinite(v).any()}


def _shown_rows(columns: Mapping[str, np.ndarray], convention: str) -> dict[str, list[float]]:
    """Evenly chosen rows in the signs of a convention, to five digits."""
    count = min((len(column) for column in columns.values()), default=0)
    chosen = np.linspace(0, count - 1, min(count, _ROWS)).astype(int)
    return {
        name: [float(f"{value:.5g}") for value in sign_of(convention, name) * column[chosen]]
        for name, column in columns.items()
    }


def _slider(
    name: str, tires: Sequence[Tire], given: Sequence[GivenTire], convention: str
) -> tuple[float, float, float]:
    """Least, largest and first value of an input, in the signs of a convention."""
    first, usual = 0.0, _USUAL.get(name, (0.0, 0.0))
    # A .tir file may state that every slip is valid.
    known = [tire for tire in tires if not (tire.tir and name in INPUTS[:2])]
    ends = [tire.measured[name] for tire in known if name in tire.measured]
    if name == "fz":
        first, usual = tires[0].load, (0.5 * tires[0].load, 1.5 * tires[0].load)
    elif name == "v":
        first = tires[0].speed
    elif name == "pressure":
        models = [tire.model for tire in tires if isinstance(tire.model, MFTire)]
        first = models[0].nominal.INFLPRES if models else 0.0
        usual = (0.75 * first, 1.25 * first)
    first = given[0].content.get("reference", {}).get(name, first)
    low, high = min(e[0] for e in ends or [usual]), max(e[1] for e in ends or [usual])
    if name in _POSSIBLE:  # zero is always there
        low, high = min(low, 0.0), max(high, 0.0)
        if high == low:
            low, high = usual
    margin = _MARGIN * ((high - low) or abs(high))
    least, most = _POSSIBLE.get(name, (0.05 * high, np.inf))
    low, high = max(low - margin, least), min(high + margin, most)
    turned = turned_range({name: (min(low, first), max(high, first))}, convention)[name]
    return *turned, turned_range({name: (first, first)}, convention)[name][0] + 0.0  # no -0
