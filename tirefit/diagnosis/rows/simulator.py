"""A given simulator: its forces for the measured rows, and a check of its signs. A
hypothesis predicts simulated force + tire(changed) - tire(as simulated)."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import jax
import numpy as np

from tirefit.data.table import CANONICAL, SIMULATED, TireData
from tirefit.data.tir.tir import read_tir
from tirefit.data.tir.tire_file import tire_kind
from tirefit.data.units import sign_of
from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.engine import NONZERO
from tirefit.diagnosis.rows.forces import Tire
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.rig import unfit
from tirefit.fitting.mf.result import MagicFormulaFit
from tirefit.fitting.predict import predict
from tirefit.fitting.problem.build import find_model
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.problem.layout import FreeParameter, Layout, choose_layout
from tirefit.fitting.result import FitResult
from tirefit.fitting.store import StoredFit, load_fit
from tirefit.fitting.tir import TIR_SIGNS, remarks, tire_of
from tirefit.models import AbstractTire, TireInputs, forces
from tirefit.models import modelled as forces_modelled
from tirefit.models.mf import OTHER_SIDE, MFTire
from tirefit.models.mf.tire import turned_forces, turned_inputs
from tirefit.padding import pad_rows, padded_size
from tirefit.params import check_values, parameter_values, specs, with_values
from tirefit.results import InputProblem, UsageError
from tirefit.slip import CONVENTIONS

STAND_INS = ("brush", "mf61")
"""Models that approximate a simulator by default if only its forces are known."""

_SCALING = {
    "x": (("LMUX", "friction (longitudinal)"), ("LKX", "slip stiffness")),
    "y": (("LMUY", "friction (lateral)"), ("LKY", "cornering stiffness")),
}
"""Scaling factors of a Magic Formula tire that are adapted, by slip."""

_FACTOR = 50.0
"""Largest scaling factor that is adapted; the smallest is its reciprocal."""

_FELT = 0.1
"""Share of its squared misfit by which signs change a force whose misfit they may explain."""


@dataclass(frozen=True, kw_only=True)
class GivenSimulator:
    """A given simulator.

    ``kind`` is columns, model, fit or tir; ``source`` its name or file, ``sha256`` of
    the file. ``tire`` is None if only its forces are known; ``layout`` and ``z`` are
    those of a fit. ``forces`` gives canonical forces (n,) for data, None for columns of
    the data; ``remarks`` gives sentences. ``otherwise`` is the convention assumed for
    data that declare none, and its origin; ``signs`` the declared convention.
    """

    kind: str
    source: str
    sha256: str | None = None
    tire: AbstractTire | None = None
    layout: Layout | None = None
    z: np.ndarray | None = None
    otherwise: tuple[str, str] | None = None
    signs: str | None = None
    forces: Callable[[TireData], Mapping[str, np.ndarray]] | None = None
    remarks: Callable[[TireData], list[str]] | None = None

    def channels(self, data: TireData, modelled: Sequence[str]) -> tuple[str, ...]:
        """Its forces in ``data`` returned by :meth:`beside`, among those ``modelled``."""
        channels = modelled if self.tire is None else forces_modelled(self.tire)
        return tuple(c for c in channels if f"{c}_sim" in data)

    def beside(self, data: TireData, other: bool = False) -> TireData:
        """The data with the simulated forces as columns ``fx_sim``, ...; rows without
        them are masked. Raises DataError if no measured force is simulated, or for zeros.

        Args:
            other: whether these are other data than those it was given for: arrays are
                then ignored, and the columns of the data are used.
        """
        columns = {k: v for k, v in data.columns.items() if k not in SIMULATED}
        simulated = self._forces(data, other)
        if not simulated:
            reason = "no measured force has a simulated one (fx_sim, fy_sim)"
            remedy = (
                "write its force for every row into a column fx_sim or fy_sim, in the"
                " unit and sign of fx or fy; `tirefit predict ... --beside` does so"
            )
            raise unfit(data, reason, remedy)
        known = np.all([np.isfinite(force) for force in simulated.values()], axis=0)
        for name, force in simulated.items():
            _check_size(force, data, name, known & data.used)
        messages = [] if self.remarks is None else self.remarks(data)
        if self.forces is not None and (lost := int(np.sum(data.used & ~known))):
            text = f"{lost} of {len(data)} rows without a simulated force are left out"
            messages = [*messages, text]
        source = replace(data.source, warnings=(*data.source.warnings, *messages))
        return replace(data, columns=columns | simulated, source=source).where(known)

    def _forces(self, data: TireData, other: bool) -> dict[str, np.ndarray]:
        """Its forces (n,) beside the measured ones, by column."""
        simulated = {k: v for k, v in data.columns.items() if k in SIMULATED}
        if self.forces is not None and not (other and self.tire is None):
            simulated = {f"{c}_sim": force for c, force in self.forces(data).items()}
        if self.tire is None and self.signs is not None:
            conventions = (self.signs, data.source.convention)
            for k in simulated:
                simulated[k] = simulated[k] * np.prod([sign_of(name, k) for name in conventions])
        # A force that is not measured has no gap.
        simulated = {k: v for k, v in simulated.items() if k.removesuffix("_sim") in data}
        silent = [k for k, v in simulated.items() if not np.any(np.nan_to_num(v))]
        if silent and self.tire is None:
            there = bool(np.any(np.isfinite(simulated[silent[0]])))
            what = "zero" if there else "no number"
            reason = f"{what} in every row: no force of a simulator"
            remedy = "write the simulated force into it, or leave the column out"
            raise unfit(data, reason, remedy, silent[0])
        # A tire without coefficients of M_z has no moment.
        return {k: v for k, v in simulated.items() if k not in silent}

    def tire_for(
        self, prepared: Prepared, effects: Sequence[Effect]
    ) -> tuple[Tire, np.ndarray, Any]:
        """Its tire with a layout of the parameters that may be adapted; their values as
        z, and the same as the first guess."""
        tire, layout, z = self.tire, self.layout, self.z
        assert tire is not None, "only its forces are known: no tire to adapt"
        if layout is None:
            values = parameter_values(tire)
            if "LMUX" in values:
                known, free = specs(tire), []
                for name, text in (item for mode in prepared.mode for item in _SCALING[mode]):
                    spec = known[name]._replace(
                        meaning=text, scale="log", lower=1 / _FACTOR, upper=_FACTOR
                    )
                    free.append(FreeParameter(name, spec))
                layout = Layout(tuple(free))
            else:
                held = {name: {"value": float(value)} for name, value in values.items()}
                config = parse_config({"parameters": held})
                tire, layout, *_ = choose_layout(tire, config, ("run",), prepared.channels)
            z = np.asarray(layout.unconstrained(values))
        z = np.asarray(z)
        return Tire(tire, layout, tuple(effects), prepared.mode), z, z


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """A simulator in a diagnosis: parameters z of its tire, the name of the model that
    stands in for a missing one, and a remark on its signs."""

    given: GivenSimulator
    z: np.ndarray
    stand_in: str = ""
    remark_on_signs: str = ""


def _check_size(force: np.ndarray, data: TireData, name: str, rows: np.ndarray) -> None:
    """Raises DataError if simulated and measured force (n,) differ much in size."""
    measured = data[name.removesuffix("_sim")]
    rows = rows & np.isfinite(measured)
    if not rows.any():
        return
    simulated, size = (float(np.mean(np.abs(part[rows]))) for part in (force, measured))
    ratio = simulated / max(size, NONZERO)
    if not 1 / _FACTOR < ratio < _FACTOR:
        reason = f"its mean size is {ratio:.3g} times that of the measured force"
        remedy = f"check unit and rows of {name}: no tire differs by that much"
        if 0.5 < 1000 * ratio < 2 and name != "mz_sim":
            remedy += f"; --unit {name}=kN, if it is in kN"
        raise unfit(data, reason, remedy, name)


def given_simulator(sim: Any, data: TireData, signs: str | None = None) -> GivenSimulator:
    """The simulator of an argument ``sim`` of :func:`tirefit.diagnose`; ``signs`` is
    that of columns ``fx_sim``, ... Raises UsageError."""
    if isinstance(sim, GivenSimulator):
        return sim
    if sim is True:
        source = f"columns in signs {signs}" if signs else "columns"
        return GivenSimulator(kind="columns", source=source, signs=signs)
    if isinstance(sim, MagicFormulaFit):
        return _of_tire(sim.tire, "fit", f"{sim.model} fitted to {sim.data['file']}")
    if isinstance(sim, FitResult | StoredFit):
        return _of_fit(sim if isinstance(sim, StoredFit) else sim.stored, sim.model)
    if isinstance(sim, AbstractTire):
        return _of_tire(sim, "model", type(sim).__name__)
    if not isinstance(sim, Mapping):
        measured = [c for c in ("fx", "fy") if c in data]
        if len(measured) != 1:
            reason = f"one array, and {' and '.join(measured) or 'no force'} measured"
            remedy = "give arrays by name: sim={'fx': ..., 'fy': ...}"
            raise UsageError(InputProblem(reason, remedy))
        sim = {measured[0]: sim}
    arrays = _arrays(sim, len(data))
    return GivenSimulator(kind="columns", source="arrays", forces=lambda _: arrays)


def _arrays(sim: Mapping[str, Any], n: int) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    for name, values in sim.items():
        channel, reason = str(name).removesuffix("_sim"), ""
        try:
            if np.iscomplexobj(values):
                raise TypeError
            # Masked elements are unknown, like empty cells.
            array: np.ndarray = np.ma.filled(np.ma.asarray(values, float), np.nan)
        except (TypeError, ValueError):
            reason = f"sim is of type {type(values).__name__}"
            remedy = "give a tire model, a fit, a file, True, or arrays of forces"
            raise UsageError(InputProblem(reason, remedy)) from None
        if f"{channel}_sim" not in SIMULATED or array.shape != (n,):
            reason = f"sim: {name} of shape {array.shape}"
            remedy = f"give fx, fy or mz with one value for each of {n} rows"
        elif channel in arrays:
            reason = f"sim: {channel} and {channel}_sim are the same force"
            remedy = "give one of them"
        if reason:
            raise UsageError(InputProblem(reason, remedy))
        arrays[channel] = array
    return arrays


def _of_fit(fit: StoredFit, source: str, sha256: str | None = None) -> GivenSimulator:
    if any(parameter.per_run for parameter in fit.layout.free):
        reason = f"{source}: a fit with parameters for each run is not one simulator"
        remedy = "write its forces into the data (`tirefit predict --beside`), and use --sim"
        raise UsageError(InputProblem(reason, remedy))
    if isinstance(fit.tire, MFTire):
        # Only the scaling factors of a Magic Formula are adapted.
        return _of_tire(fit.at_estimate(), "fit", source, sha256)
    given = _of_tire(fit.tire, "fit", source, sha256)
    z, predicted = np.asarray(fit.z), partial(_predicted, fit)
    return replace(given, layout=fit.layout, z=z, forces=predicted)


def _of_tire(
    tire: AbstractTire, kind: str, source: str, sha256: str | None = None
) -> GivenSimulator:
    predicted = partial(_predicted, tire)
    return GivenSimulator(kind=kind, source=source, sha256=sha256, tire=tire, forces=predicted)


def _predicted(model: Any, data: TireData) -> dict[str, np.ndarray]:
    return {c: v for c, v in predict(model, data).items() if f"{c}_sim" in SIMULATED}


def simulator_at(
    text: str, values: Mapping[str, float] | None = None, **of_tir: str | None
) -> GivenSimulator:
    """The simulator of a name or a file. Raises UsageError, or DataError for the file.

    Args:
        text: a ``fit.json``, a ``.tir`` file, or the name of a model.
        values: parameter values of a named model or of a ``.tir`` file.
        of_tir: ``side``, ``signs`` and ``combination`` for a ``.tir`` file, see
            :func:`tirefit.fitting.tir.tire_of`.
    """
    values, kind = dict(values or {}), tire_kind(text)
    if kind == "tir":
        tir, signs = read_tir(text), of_tir.get("signs")
        options: dict[str, Any] = of_tir
        tire = tire_of(tir, values=values, **options)
        check_values(tire, text, values)
        tire, sha256 = with_values(tire, values), _digest(text)
        remarks_of_file = partial(remarks, tir, tire, signs=signs)
        text += "".join(f", {name} = {value:g}" for name, value in values.items())
        text += "".join(f", {k} {v}" for k, v in of_tir.items() if v)
        given = _of_tire(tire, "tir", text, sha256)
        return replace(
            given, otherwise=(TIR_SIGNS, ".tir files"), signs=signs, remarks=remarks_of_file
        )
    if kind == "fit":
        if values:
            reason, remedy = "--set with a fit.json", "use it with the name of a model"
            raise UsageError(InputProblem(reason, remedy))
        fit = load_fit(text)
        given = _of_fit(fit, text, _digest(text))
        return replace(given, otherwise=(fit.content["data"]["convention"], text))
    template = find_model(text)
    check_values(template, text, values)
    whole, known = parameter_values(template) | values, specs(template)
    for k in (name for name in whole if name in values or known[name].free):
        text += f", {k} = {float(whole[k]):g}{'' if k in values else ' (default)'}"
    return _of_tire(with_values(template, whole), "model", text)


def _digest(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def check_signs(prepared: Prepared, tire: Tire, z: np.ndarray, given: GivenSimulator) -> str:
    """A sentence if a simulator fits better with some signs reversed, as a tire written
    in other axes or for the other side of the vehicle does; else an empty text. Raises
    DataError for a file or columns without declared signs, as the diagnosis would name
    an effect instead of the wrong signs. ``tire`` may be the stand-in."""
    size = padded_size(prepared.n)
    inputs = {name: np.zeros(size) for name in TireInputs._fields}
    for name in (name for name in inputs if name in prepared.data):
        inputs[name] = pad_rows(np.nan_to_num(prepared.column(name)), size)
    misfits = partial(_misfits, prepared, tire, np.asarray(z, float), TireInputs(**inputs))
    columns = {"slip": "sigma_x", "alpha": "alpha", "gamma": "gamma"}
    moved = [field for field, name in columns.items() if np.any(inputs[name])]
    there, left = frozenset((*moved, *prepared.channels)), {}
    # Differences of conventions, the other side of the vehicle, and single fields.
    sets = [first.turned(second) for first, second in combinations(CONVENTIONS.values(), 2)]
    sets += [OTHER_SIDE, *(frozenset((name,)) for name in ("gamma", "fx", "fy", "mz"))]
    rms, square, *_ = misfits(frozenset())
    for turned in dict.fromkeys(turned & there for turned in sets):
        if not turned:
            continue
        _, after, change, factor = misfits(turned)
        share, felt = after / square, change > _FELT * square
        # For each force that is changed, the change fits best at a factor within 0.2 of 1, as an
        # offset of the slip has the same shape at any factor; half of the misfit may remain.
        near = (np.abs(factor - 1) < 0.2) & (share < 1)
        if felt.any() and near[felt].all() and np.mean(share[felt]) < 0.5:
            left[turned] = float(np.sum(share))
    if not left:
        return ""
    alike = [h for h in left if left[h] <= 1.02 * min(left.values())]  # equally good fits
    left_rms, after, change, _ = misfits(alike[0])
    better = ", ".join(
        f"{c} {rms[k]:.3g} -> {left_rms[k]:.3g} {CANONICAL[c][0]} rms"
        f" ({square[k] ** 0.5:.3g} -> {after[k] ** 0.5:.3g} if adapted too)"
        for k, c in enumerate(prepared.channels)
        if change[k] > _FELT * square[k]
    )
    fields = CONVENTIONS[TIR_SIGNS]._fields
    names = {f: "sigma_x" if f == "slip" else f for f in fields}
    ways = (" and ".join(names[f] for f in fields if f in turned) for turned in alike)
    reason = f"the simulator {given.source} fits if it is mirrored in"
    reason += f" {' or '.join(ways)}: {better}"
    remedy = "; ".join(_remedies(alike, there, prepared, given))
    if given.signs or given.kind not in ("tir", "columns"):
        return f"{reason}. It is used as given: {remedy}"
    raise unfit(prepared.data, reason, remedy)


def _misfits(
    prepared: Prepared, tire: Tire, z: np.ndarray, inputs: TireInputs, turned: frozenset[str]
) -> tuple[np.ndarray, ...]:
    """For each channel (C,), with the signs of ``turned`` reversed: the rms misfit, its mean
    square with adapted parameters, the mean square change of the force by the signs, and the
    factor of this change that fits best."""
    n, channels = prepared.n, prepared.channels
    run, values = pad_rows(prepared.run, padded_size(n)), tire.layout.vector(z)

    def of(z: np.ndarray, turned: frozenset[str] = turned) -> np.ndarray:
        model = with_values(tire.model, tire.layout.natural(z))
        predicted = jax.tree.map(np.asarray, forces(model, turned_inputs(inputs, turned), run))
        every = turned_forces(predicted, turned)._asdict()
        return np.array([every[c][:n] for c in channels])

    def adapted(gap: np.ndarray, columns: np.ndarray) -> float:
        """Mean square of a gap (n,) after fitting bounded changes of the parameters."""
        best = np.linalg.lstsq(columns, gap, rcond=None)[0]
        best /= max(1.0, np.max(abs(best), initial=0.0))
        return float(np.mean((gap - columns @ best) ** 2))

    here = of(z)
    change = here - of(z, frozenset())
    # A misfit that 30 % of the parameters explain does not come from signs.
    slopes = np.zeros((len(z), *here.shape))
    for i, step in enumerate(1e-4 * np.eye(len(z))):
        moved = abs(tire.layout.vector(z + step) - values)[i]
        unit = 0.3 * abs(values[i]) / max(moved, NONZERO)
        slopes[i] = unit * (of(z + step) - here)
    gap = [prepared.observed[c] - prepared.column(f"{c}_sim") for c in channels]
    none, once, twice = (
        np.array([*map(adapted, gap - k * change, np.moveaxis(slopes, 0, -1))]) for k in (0, 1, 2)
    )
    # Minimum of the parabola through the three mean squares.
    bend, top = 2 * (none - 2 * once + twice), 3 * none - 4 * once + twice
    factor = np.where(bend > 0, top / np.where(bend > 0, bend, 1.0), 0.0)
    rms = np.sqrt(np.mean((gap - change) ** 2, axis=1))
    return rms, np.maximum(once, NONZERO), np.mean(change**2, axis=1), factor


def _remedies(
    alike: Sequence[frozenset[str]],
    there: frozenset[str],
    prepared: Prepared,
    given: GivenSimulator,
) -> list[str]:
    """Ways to declare the signs of a hypothesis, or the present signs."""
    source, tir = prepared.data.source, given.kind == "tir"
    now, read = CONVENTIONS[given.signs or TIR_SIGNS], CONVENTIONS[source.convention]
    ways, assumed = [], source.convention_from.startswith("assumed")
    for name, other in CONVENTIONS.items():
        if tir and now.turned(other) & there in alike:
            ways.append(f"--signs {name} reads the file in these signs")
    if tir and OTHER_SIDE & there in alike:
        ways.append("--side, if it is a tire of the other side of the vehicle")
    for name, other in CONVENTIONS.items():
        if assumed and other.fz == read.fz and read.turned(other) & there in alike:
            ways.append(f"--convention {name} does so for the data, which declare none")
    for (name,) in (h for h in alike if len(h) == 1):
        column = "sigma_x" if name == "slip" else name
        unit = source.units.get(name, CANONICAL[column][0]).replace(" ", "")
        ways.append(f"--unit {column}=-{unit}, if only that column has the wrong sign")
    ways = ways or ["reverse these signs in the simulator, or in the data"]
    kept = given.signs or (TIR_SIGNS if tir else source.convention)
    return [*ways, f"--signs {kept} confirms the present signs"]
