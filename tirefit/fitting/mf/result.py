"""The result of a fit of a whole Magic Formula: :class:`MagicFormulaFit`, its files and forces."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from tirefit.data.accept import DataLike
from tirefit.data.records import Row, frame
from tirefit.data.tir.tir import new_tir
from tirefit.data.tir.tir_file import TirFile
from tirefit.display import ByName, Record
from tirefit.door import sealed
from tirefit.files import json_safe, json_text
from tirefit.fitting.mf.bins import SlipBins
from tirefit.fitting.mf.guards import Guard
from tirefit.fitting.mf.left_out import LeftOut
from tirefit.fitting.mf.parts import VERSIONS, coefficients_of
from tirefit.fitting.mf.solve import Problem, blocks_of, propagated
from tirefit.fitting.problem.layout import FreeParameter, Layout
from tirefit.fitting.problem.noise import NoiseLaw
from tirefit.fitting.result import SCHEMA, FitResult, layout_record
from tirefit.fitting.store import StoredFit
from tirefit.models import AbstractTire, TireInputs
from tirefit.models.mf import MAGIC_FORMULAS, MFTire
from tirefit.params import parameter_values, specs, with_values
from tirefit.results import Outcome

if TYPE_CHECKING:
    import pandas


ORIGINS = {
    "fitted": "the data determine it more than its prior",
    "prior": "determined by the prior at least as much as by the data",
    "held": "not identified, held at its default; the uncertainty is the prior's",
    "borrowed": "taken from the tire of `like`, as the data do not determine it",
    "given": "given, not fitted",
}
"""Origin of the value of a coefficient -> its meaning."""

_REACH = 200.0
"""Half width of the bounds in ``fit.json``, in standard deviations of the prior: within
ten of them the map to the unconstrained space is linear to one part in a thousand."""


@dataclass(frozen=True)
class Coefficient:
    """One coefficient and its prior."""

    value: float
    std: float  # standard error, 0 if given
    origin: str  # a key of :data:`ORIGINS`
    part: str  # that estimates it
    prior_mean: float
    prior_std: float


@dataclass(frozen=True, repr=False)
class MagicFormulaFit(Record):
    """A Magic Formula fitted to measured rows; mappings are by force unless noted.
    ``binned`` holds the rows by setting and slip, for figures of a fresh fit."""

    text_by: ClassVar[str] = "tirefit.report.fit.magic_formula:magic_formula_report"
    plot_by: ClassVar[str] = "tirefit.report.fit.mf_figures:plot_magic_formula"
    page_by: ClassVar[str] = "tirefit.report.fit.magic_formula:magic_formula_page"

    model: str
    parts: tuple[str, ...]  # the stages
    forces: tuple[str, ...]  # fitted ones
    coefficients: Mapping[str, Coefficient]  # in the order of the equations
    covariance: np.ndarray  # (p, p), with ``wider``
    tire: MFTire
    noise: Mapping[str, NoiseLaw]  # of a measurement, from rows left out
    wider: Mapping[str, float]  # factor of the standard errors
    inflation: Mapping[str, float]  # rows per independent row
    fitted: Mapping[str, tuple[float, int]]  # rms residual [N, N m], number of rows
    stages: Mapping[str, bool]  # stage -> whether it converged
    left_out: tuple[LeftOut, ...]  # predictions of parts that were left out
    guards: tuple[Guard, ...]  # checks of the curves within and beyond ``ranges``
    ranges: Mapping[str, tuple[float, float]]  # (least, largest) input, ISO-W axes
    reference: Mapping[str, float]
    data: Mapping[str, Any]
    notes: tuple[str, ...]
    version: str
    binned: Mapping[str, tuple[SlipBins, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", ByName(self.coefficients))

    def __repr__(self) -> str:
        return f"MagicFormulaFit({self.model!r}, {self.data['file']!r})"

    def predict(self, data: DataLike) -> dict[str, np.ndarray]:
        """Forces row by row with their standard deviations, as :func:`tirefit.predict`.

        Args:
            data: rows with slip and load.

        Returns:
            (n,) arrays of each fitted force and of its ``<force>_std``.
        """
        from tirefit.fitting.predict import predict  # it imports this module

        return predict(self, data)

    def to_frame(self) -> "pandas.DataFrame":
        """The coefficients as a pandas data frame: columns name, value, std, identified
        (whether the data determine it more than its prior)."""
        each = self.coefficients.items()
        rows = [
            Row("parameter", k, c.value, c.std, identified=c.origin == "fitted") for k, c in each
        ]
        return frame(rows).drop(columns=["low", "high", "unit"])

    @property
    def limits(self) -> dict[Outcome, str]:
        """Outcome -> its message with the stages, guards or coefficients concerned."""
        concerned = {
            Outcome.NOT_CONVERGED: [name for name, ended in self.stages.items() if not ended],
            Outcome.GUARD_FAILED: [guard.name for guard in self.guards if not guard.holds_inside],
            Outcome.NOT_IDENTIFIED: [k for k, c in self.coefficients.items() if c.origin == "held"],
        }
        return {o: f"{o.message}: {', '.join(names)}" for o, names in concerned.items() if names}

    @property
    def stored(self) -> StoredFit:
        """The fit in the form of one read from a file, for predictions."""
        known, free = specs(self.tire), []
        for name, coefficient in self.coefficients.items():
            if coefficient.origin != "given":
                half = _REACH * coefficient.prior_std
                low, high = coefficient.value - half, coefficient.value + half
                free.append(FreeParameter(name, known[name]._replace(lower=low, upper=high)))
        # At z = 0 a parameter is in the middle of its bounds.
        slope = np.array([(parameter.spec.upper - parameter.spec.lower) / 4 for parameter in free])
        names = [parameter.name for parameter in free]
        at = [list(self.coefficients).index(name) for name in names]
        values = {k: v for k, v in parameter_values(self.tire).items() if k not in names}
        noise = {
            force: {
                "median_std": float(law.std(self.reference["fz"], self.reference[force])),
                "constant": law.constant,
                "share_of_load": law.share,
                "share_of_force": law.of_force,
                "share_beyond": law.beyond,
                "loads": law.loads,
                "source": "estimated",
            }
            for force, law in self.noise.items()
        }
        return StoredFit(
            self.model,
            with_values(MAGIC_FORMULAS[self.model], values),
            Layout(tuple(free)),
            np.zeros(len(free)),
            self.covariance[np.ix_(at, at)] / np.outer(slope, slope),
            noise,
            {"reference": dict(self.reference), "data": dict(self.data)},
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-able content of ``fit.json``."""
        stored, known = self.stored, specs(self.tire)
        names = "version model parts forces data ranges reference stages notes outcomes"
        content = {name: getattr(self, name) for name in names.split()} | {
            "schema": SCHEMA,
            "noise": {**stored.noise, "inflation": self.inflation, "wider": self.wider},
            "coefficients": {
                name: asdict(coefficient) | {"unit": "-", "meaning": known[name].meaning}
                for name, coefficient in self.coefficients.items()
            },
            "origins": ORIGINS,
            "guards": [guard._asdict() for guard in self.guards],
            "left_out": [part._asdict() for part in self.left_out],
            "fit": {f: {"rmse": r, "n": n} for f, (r, n) in self.fitted.items()},
            "prediction": {
                "labels": stored.layout.labels,
                "z": stored.z,
                "covariance": stored.covariance,
                "layout": layout_record(stored.layout, self.tire),
            },
        }
        return json_safe(content)

    def to_json(self) -> str:
        """Text of ``fit.json``, with a checksum."""
        return json_text(sealed(self.to_dict()))

    def files(self, name: str) -> dict[str, str]:
        """``fit.tir`` and ``fit.json`` with their texts."""
        return {"fit.tir": tir_of(self).text, "fit.json": self.to_json()}


def tir_of(fit: MagicFormulaFit) -> TirFile:
    """The tire property file of a fit; comments give origin and standard error."""
    version, known = VERSIONS[fit.model], specs(fit.tire)
    notes = {
        name: f"{known[name].meaning}; {coefficient.origin}"
        + (f" +- {coefficient.std:.3g}" if coefficient.std else "")
        for name, coefficient in fit.coefficients.items()
    }
    comment = [
        f"Magic Formula {version} fitted by tirefit {fit.version}",
        f"to {', '.join(Path(file).name for file in fit.data['file'].split(', '))}",
        f"forces: {', '.join(fit.forces)}; ISO-W axes; standard errors after +-",
        *fit.notes,
    ]
    if missing := {"fx", "fy", "mz"} - set(fit.forces):
        comment.append(f"not fitted: {', '.join(sorted(missing))}; values of priors or borrowed")
    return new_tir(version, parameter_values(fit.tire), fit.ranges, notes, comment)


def magic_formula_forces(
    fit: StoredFit, forces: Sequence[str], inputs: TireInputs
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Forces, and their variance from the posterior of the coefficients.

    The variance is linear in the covariance of all coefficients (Laplace); coefficients
    that the data do not identify have the variance of their priors.

    Args:
        fit: of an :class:`MFTire`.
        forces: of fx, fy, mz, mx and my.
        inputs: arrays (n,).

    Returns:
        (force, variance): dicts of arrays (n,).
    """
    tire = fit.at_estimate()
    assert isinstance(tire, MFTire)
    names = tuple(coefficients_of(tire.version))
    at = [names.index(p.name) for p in fit.layout.free]
    slope = np.array([(p.spec.upper - p.spec.lower) / 4 for p in fit.layout.free])
    covariance = np.zeros((len(names), len(names)))
    covariance[np.ix_(at, at)] = fit.covariance * np.outer(slope, slope)
    centre, ones = parameter_values(tire), np.ones(len(names))
    of_names = np.array([centre[name] for name in names])
    mean, variance, zero = {}, {}, np.zeros(np.shape(inputs.fz))
    for force in forces:
        blocks = blocks_of(force, inputs, zero, zero + 1.0)
        problem = Problem(tire, names, of_names, ones, ones < 0, ones > 0, blocks)
        mean[force], variance[force] = propagated(problem, 0 * ones, covariance)
    return mean, variance


TireLike = FitResult | MagicFormulaFit | StoredFit | AbstractTire | str | os.PathLike[str]
"""What every function takes as a tire: a fit, a tire, the name of a model, or the path of
a ``fit.json`` or a ``.tir`` file."""
