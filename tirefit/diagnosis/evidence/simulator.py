"""Somebody's simulator as it is: its forces beside the measured ones, and the tire that
stands in for it where a hypothesis changes it.

A hypothesis predicts the simulator's force + tire(changed) - tire(as simulated):
whatever the simulator has that the tire lacks stays in.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from tirefit.data.table import CANONICAL, SIMULATED, TireData
from tirefit.data.tir import read_tir
from tirefit.data.units import sign_of
from tirefit.diagnosis.negligible import NONZERO
from tirefit.fitting.config import parse_config
from tirefit.fitting.layout import FreeParameter, Layout, choose_layout
from tirefit.fitting.mf.result import MagicFormulaFit
from tirefit.fitting.predict import predict
from tirefit.fitting.problem import find_model
from tirefit.fitting.result import FitResult
from tirefit.fitting.store import StoredFit, load_fit
from tirefit.fitting.tir import TIR_SIGNS, remarks, tire_of
from tirefit.models import AbstractTire
from tirefit.models import modelled as forces_modelled
from tirefit.models.mf import MFTire
from tirefit.params import check_values, parameter_values, specs, with_values
from tirefit.results import DataError, InputProblem, UsageError

_FARTHEST_OFF = 0.2
"""Share of the simulated force (rms) that the tire which stands in for a simulator may
miss. Its slopes share out the gap, and a tire that is off by a fifth of the force is
off by as much in its slopes: parts of the budget then err by a fifth of themselves. The
gap is no yardstick: a simulator near the truth has a small one, and its slopes are
needed then as ever."""

STAND_INS = ("brush", "mf61")
"""Models that may stand in for a simulator whose forces alone are known, where none is
asked for: the plain one, and one that follows any load, camber and curve."""

_CLOSELY = 0.01
"""Share of the simulated force (rms) up to which the plain one follows it: what it
misses of slopes is then a hundredth of the parts of a budget."""

_SCALING = {"x": ("LMUX", "LKX"), "y": ("LMUY", "LKY")}
"""Scaling factors of a Magic Formula tire's friction and stiffness, by slip."""

_MEANINGS = {
    "LMUX": "friction (longitudinal)", "LKX": "slip stiffness",
    "LMUY": "friction (lateral)", "LKY": "cornering stiffness",
}  # fmt: skip

_FACTOR = (0.02, 50.0)
"""Bounds of a scaling factor that is adapted."""


@dataclass(frozen=True, kw_only=True)
class Given:
    """A simulator that was given.

    ``kind`` is columns, model, fit or tir; ``source`` its name or file, ``sha256`` of
    the file. ``tire`` is None where only its forces are known; ``layout`` and ``z`` are
    those of a fit. ``forces`` gives canonical forces (n,) of the rows of data, None
    if they are columns of the data. ``otherwise`` is the convention assumed for data
    that declare none, and its origin. ``signs`` is the declared convention of a
    ``.tir`` file or of the columns. ``remarks`` gives sentences on the file and the
    rows of data.
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
        """Forces that it gives, and its tire too: ``modelled`` where it has none.

        Args:
            data: of :meth:`beside`.
        """
        if self.tire is not None:
            modelled = forces_modelled(self.tire)
        return tuple(c for c in modelled if f"{c}_sim" in data)

    def beside(self, data: TireData, other: bool = False) -> TireData:
        """The data with the simulator's forces as their columns ``fx_sim``, ...; rows
        that it says nothing of are masked.

        Args:
            other: whether these are not the data that it was given for: arrays then
                say nothing, and the data's own columns are taken.

        Raises:
            DataError: no simulated force beside a measured one, or none but zeros; the
                data lack an input of the simulator.
        """
        columns = {k: v for k, v in data.columns.items() if k not in SIMULATED}
        forces = {k: v for k, v in data.columns.items() if k in SIMULATED}
        if self.forces is not None and not (other and self.tire is None):
            forces = {f"{c}_sim": force for c, force in self.forces(data).items()}
        if self.tire is None and self.signs is not None:
            own = (self.signs, data.source.convention)
            forces = {
                k: v * np.prod([sign_of(name, k) for name in own])
                for k, v in forces.items()
            }
        path = data.source.path or data.name
        # What is not measured has no gap.
        forces = {k: v for k, v in forces.items() if k.removesuffix("_sim") in data}
        silent = [k for k, v in forces.items() if not np.any(np.nan_to_num(v))]
        if self.tire is not None:  # as one without coefficients of M_z
            forces = {k: v for k, v in forces.items() if k not in silent}
        elif silent:
            there = bool(np.any(np.isfinite(forces[silent[0]])))
            what = "zero" if there else "no number"
            reason = f"{what} in every row: no force of a simulator"
            remedy = "write the simulated force into it, or leave the column out"
            raise DataError(InputProblem(reason, remedy, path, column=silent[0]))
        if not forces:
            reason = "no force of the simulator (fx_sim, fy_sim) beside a measured one"
            remedy = (
                "write its force for every row into a column fx_sim or fy_sim, in the"
                " unit and sign of fx or fy; `tirefit predict ... --beside` does so"
            )
            raise DataError(InputProblem(reason, remedy, path))
        known = np.all([np.isfinite(force) for force in forces.values()], axis=0)
        for name, force in forces.items():
            _check_size(force, data, name, known & data.used, path)
        source = data.source
        if self.remarks is not None:
            said = self.remarks(data)
            source = replace(source, warnings=(*source.warnings, *said))
        if self.forces is not None and (lost := int(np.sum(data.used & ~known))):
            text = f"{lost} of {len(data)} rows without a simulated force are left out"
            source = replace(source, warnings=(*source.warnings, text))
        return replace(data, columns=columns | forces, source=source).where(known)

    def tire_for(self, prepared) -> tuple[AbstractTire, Layout, np.ndarray]:
        """Its tire, which parameters of it may be adapted, and their values as z."""
        tire = self.tire
        assert tire is not None, "only its forces are known: no tire to adapt"
        if self.layout is not None:
            return tire, self.layout, np.asarray(self.z)
        values = parameter_values(tire)
        if "LMUX" in values:
            layout = _scaling_layout(tire, prepared.mode)
            return tire, layout, layout.unconstrained(values)
        held = {name: {"value": float(value)} for name, value in values.items()}
        config = parse_config({"parameters": held})
        tire, layout, _ = choose_layout(tire, config, ("run",), prepared.channels)
        return tire, layout, layout.unconstrained(values)


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """A simulator in a diagnosis: parameters z of its tire as given, the name of the
    model that replaces a missing tire, and a remark on its signs."""

    given: Given
    z: np.ndarray
    stand_in: str = ""
    doubt: str = ""


def _scaling_layout(tire: AbstractTire, mode: str) -> Layout:
    """The scaling factors of friction and stiffness as parameters."""
    known = specs(tire)
    low, high = _FACTOR
    return Layout(
        tuple(
            FreeParameter(
                name,
                known[name]._replace(
                    lower=low, upper=high, scale="log", meaning=_MEANINGS[name]
                ),
            )
            for slip in mode
            for name in _SCALING[slip]
        )
    )


def as_measured(data: TireData, channels: Sequence[str]) -> TireData:
    """The data with the simulated forces in the place of the measured ones."""
    dropped = {f"{c}_std" for c in channels}
    columns = {k: v for k, v in data.columns.items() if k not in dropped}
    return replace(data, columns=columns | {c: data[f"{c}_sim"] for c in channels})


def missed_share(prepared, channel: str, values) -> float:
    """What a tire misses of the simulated forces (n,), as a share of these, rms."""
    size = _rms(prepared.column(f"{channel}_sim"))
    return _rms(values) / max(size, NONZERO)


def closely_followed(prepared, missed: Mapping[str, np.ndarray]) -> bool:
    """Whether a tire follows the simulated forces so well that none need be better.

    Args:
        missed: simulated force less that of the tire, (n,) by channel.
    """
    shares = [missed_share(prepared, c, values) for c, values in missed.items()]
    return max(shares) <= _CLOSELY


def check_followed(prepared, missed: Mapping[str, np.ndarray], name: str) -> None:
    """Raises DataError where the tire misses the simulated forces by too much.

    Args:
        missed: simulated force less that of the tire, (n,) by channel.
        name: of the model that stands in.
    """
    for channel, values in missed.items():
        off, share = _rms(values), missed_share(prepared, channel, values)
        if share > _FARTHEST_OFF:
            data = prepared.data
            raise DataError(
                InputProblem(
                    f"the tire that stands in for the simulator does not follow it: it"
                    f" misses {channel}_sim by {off:.3g}"
                    f" {CANONICAL[channel][0]} rms,"
                    f" {100 * share:.0f} % of it"
                    f" ({100 * _FARTHEST_OFF:.0f} % at most)",
                    f"choose a base model nearer to the simulator than {name} with"
                    f" --model, and check sign, unit and row order of {channel}_sim",
                    data.source.path or data.name,
                )
            )


def _check_size(force, data: TireData, name: str, rows, path: str) -> None:
    """Raises DataError where a simulated force (n,) is not of the measured one's size:
    no parameter that is adapted bridges that."""
    measured = data[name.removesuffix("_sim")]
    rows = rows & np.isfinite(measured)
    if not rows.any():
        return
    size = float(np.mean(np.abs(measured[rows])))
    ratio = float(np.mean(np.abs(force[rows]))) / max(size, NONZERO)
    low, high = _FACTOR
    if not low < ratio < high:
        reason = f"its mean size is {ratio:.3g} times that of the measured force"
        remedy = f"check unit and rows of {name}: no tire is off by that much"
        raise DataError(InputProblem(reason, remedy, path, column=name))


_USUAL_CHANGE = 0.1
"""Share by which a hypothesis changes friction or stiffness, at least."""

_AROUND = 4
"""Rows on either side over which the slope of what a stand-in misses is taken."""


def not_followed(missed, slip, groups, changed: float) -> np.ndarray:
    """How a simulator may change where its stand-in does not: columns (n, 2), to first
    order. Where it misses e, friction times 1 + a and stiffness times 1 + b add
    a (e - slip e') + b slip e' to what the stand-in's own change is.

    Args:
        missed: simulated force less that of its stand-in, (n,).
        groups: index arrays of like rows in the order of their slip.
        changed: typical size of a and b.
    """
    steep, wide = np.zeros(len(slip)), 2 * _AROUND + 1
    for rows in groups:
        if len(rows) < wide:
            continue
        x, y = (
            np.lib.stride_tricks.sliding_window_view(np.pad(v, _AROUND, "edge"), wide)
            for v in (slip[rows], missed[rows])
        )
        x, y = (view - view.mean(axis=1, keepdims=True) for view in (x, y))
        steep[rows] = np.sum(x * y, axis=1) / np.maximum(np.sum(x * x, axis=1), NONZERO)
    size = max(changed, _USUAL_CHANGE)
    return size * np.stack([missed, slip * steep], axis=1)


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def given_simulator(sim: Any, data: TireData, signs: str | None = None) -> Given:
    """The simulator that an argument of :func:`tirefit.diagnose` means.

    Args:
        sim: True for the data's columns ``fx_sim``, ...; an array (n,) of the force
            that the data measure, or arrays by channel, canonical; a tire model, a fit,
            or what :func:`simulator_at` gives.
        signs: convention of the columns ``fx_sim``, ..., if not that of the data.

    Raises:
        UsageError: none of these, or arrays of another length.
    """
    if isinstance(sim, Given):
        return sim
    if sim is True:
        source = f"columns in signs {signs}" if signs else "columns"
        return Given(kind="columns", source=source, signs=signs)
    if isinstance(sim, MagicFormulaFit):
        return _of_tire(sim.tire, "fit", f"{sim.model} fitted to {sim.data['file']}")
    if isinstance(sim, FitResult):
        problem = sim.problem
        return _of_fit(sim, problem.model, problem.layout, sim.z, sim.model)
    if isinstance(sim, StoredFit):
        return _of_fit(sim, sim.tire, sim.layout, sim.z, sim.model)
    if isinstance(sim, AbstractTire):
        return _of_tire(sim, "model", type(sim).__name__)
    if isinstance(sim, str | PathLike):
        return simulator_at(str(sim))
    return _of_arrays(sim, data)


def _of_arrays(sim, data: TireData) -> Given:
    if not isinstance(sim, Mapping):
        measured = [c for c in ("fx", "fy") if c in data]
        if len(measured) != 1:
            reason = f"one array, and {' and '.join(measured) or 'no force'} measured"
            remedy = "give arrays by name: sim={'fx': ..., 'fy': ...}"
            raise UsageError(InputProblem(reason, remedy))
        sim = {measured[0]: sim}
    arrays = {}
    for name, values in sim.items():
        channel = str(name).removesuffix("_sim")
        try:
            if np.iscomplexobj(values):
                raise TypeError
            # What is masked is not known, as an empty cell.
            array: np.ndarray = np.ma.filled(np.ma.asarray(values, float), np.nan)
        except (TypeError, ValueError):
            reason = f"sim is of type {type(values).__name__}"
            remedy = "give a tire model, a fit, a file, True, or arrays of forces"
            raise UsageError(InputProblem(reason, remedy)) from None
        if f"{channel}_sim" not in SIMULATED or array.shape != (len(data),):
            reason = f"sim: {name} of shape {array.shape}"
            remedy = f"give fx, fy or mz with one value for each of {len(data)} rows"
            raise UsageError(InputProblem(reason, remedy))
        if channel in arrays:
            reason = f"sim: {channel} and {channel}_sim are one force"
            raise UsageError(InputProblem(reason, "give one of them"))
        arrays[channel] = array
    return Given(kind="columns", source="arrays", forces=lambda _: arrays)


def _of_fit(fit, tire, layout, z, source, sha256=None) -> Given:
    if any(parameter.per_run for parameter in layout.free):
        reason = f"{source}: a fit with parameters of each run is no one simulator"
        remedy = "write its forces beside the data (`tirefit predict --beside`), --sim"
        raise UsageError(InputProblem(reason, remedy))

    if isinstance(tire, MFTire):
        # What is adapted of a Magic Formula are its scaling factors.
        values = {k: float(v) for k, v in layout.natural(z).items()}
        return _of_tire(with_values(tire, values), "fit", source, sha256)

    def forces(data):
        return _forces_alone(predict(fit, data))

    return Given(
        kind="fit", source=source, sha256=sha256, tire=tire, layout=layout,
        z=np.asarray(z), forces=forces,
    )  # fmt: skip


def _of_tire(tire, kind: str, source: str, sha256=None) -> Given:
    def forces(data):
        return _forces_alone(predict(tire, data))

    return Given(kind=kind, source=source, sha256=sha256, tire=tire, forces=forces)


def _forces_alone(predicted: Mapping) -> dict[str, np.ndarray]:
    return {c: v for c, v in predicted.items() if f"{c}_sim" in SIMULATED}


def simulator_at(
    text: str,
    values: Mapping[str, float] | None = None,
    **of_tir: str | None,
) -> Given:
    """The simulator that a name or a file means.

    Args:
        text: a ``fit.json``, a ``.tir`` file, or the name of a model.
        values: parameter values of a named model or of a ``.tir`` file.
        of_tir: ``side``, ``signs`` and ``combination`` of the tire of a ``.tir`` file,
            see :func:`tirefit.fitting.tir.tire_of`.

    Raises:
        UsageError: no such model, parameter or convention, or values for a fit.
        DataError: the file cannot be read.
    """
    values = dict(values or {})
    if text.lower().endswith(".tir"):
        return _at_tir(text, values, of_tir)
    if text.endswith(".json"):
        return _at_fit(text, values)
    template = find_model(text)
    check_values(template, text, values)
    whole, known = parameter_values(template) | values, specs(template)
    said = [
        f"{name} = {float(value):g}{'' if name in values else ' (default)'}"
        for name, value in whole.items()
        if name in values or known[name].free
    ]
    source = ", ".join([text, *said])
    return _of_tire(with_values(template, whole), "model", source)


def _at_tir(text: str, values: dict[str, float], of_tir: dict) -> Given:
    tir, signs = read_tir(text), of_tir.get("signs")
    tire = tire_of(tir, values=values, **of_tir)
    check_values(tire, text, values)
    tire = with_values(tire, values)
    said = "".join(f", {name} = {value:g}" for name, value in values.items())
    said += "".join(f", {k} {v}" for k, v in of_tir.items() if v)
    given = _of_tire(tire, "tir", f"{text}{said}", _digest(text))
    own = partial(remarks, tir, tire, signs=signs)
    return replace(given, otherwise=(TIR_SIGNS, ".tir files"), signs=signs, remarks=own)


def _at_fit(text: str, values: dict[str, float]) -> Given:
    if values:
        reason, remedy = "--set with a fit.json", "use it with the name of a model"
        raise UsageError(InputProblem(reason, remedy))
    fit = load_fit(text)
    given = _of_fit(fit, fit.tire, fit.layout, fit.z, text, _digest(text))
    return replace(given, otherwise=(fit.content["data"]["convention"], text))


def _digest(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
