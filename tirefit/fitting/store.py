"""Fits on disk: ``fit.json`` and ``posterior.nc``."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat, model_validator

from tirefit.data.records import FileRecord, Row
from tirefit.door import outrageous, read_record
from tirefit.files import write_texts
from tirefit.fitting.problem.build import find_model
from tirefit.fitting.problem.layout import FreeParameter, Layout, Tie
from tirefit.fitting.result import SCHEMA, FitResult
from tirefit.models import AbstractTire
from tirefit.params import Values, specs, with_values
from tirefit.results import DataError, UsageError
from tirefit.settings import faults_in
from tirefit.slip import CONVENTIONS

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class StoredFit:
    """A fit read from a file, as predictions need it: tire, estimate and noise."""

    model: str
    tire: AbstractTire
    layout: Layout
    z: np.ndarray
    covariance: np.ndarray
    noise: Mapping[str, Mapping[str, Any]]  # record of each fitted force
    content: Mapping[str, Any]  # the whole file

    def at_estimate(self) -> AbstractTire:
        """The tire with its fitted values: see :func:`at_estimate`."""
        return at_estimate(self.tire, self.layout, self.z)


def at_estimate(template: AbstractTire, layout: Layout, z: Float[Values, " p"]) -> AbstractTire:
    """A tire with the values of an estimate ``z`` in the unconstrained space.

    Raises:
        UsageError: a parameter has a value for each run.
    """
    values = layout.natural(z)
    several = [name for name, value in values.items() if np.ndim(value)]
    if several:
        reason = f"the fit has a {several[0]} for each run: it is not one tire"
        raise UsageError(reason, "fit it with one for all runs")
    return with_values(template, {k: float(v) for k, v in values.items()})


_LARGEST = 1e20
_ROUNDING = 1e-9
"""Rounding: the smallest eigenvalue may be this share of the largest below zero."""


class _Part(BaseModel):
    """A part of ``fit.json`` that is read and checked; the rest is for people."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, defer_build=True)


class _Free(_Part):
    name: str
    per_run: bool
    lower: float
    upper: float


class _Tie(_Part):
    name: str
    other: str
    factor: float


class _Layout(_Part):
    free: list[_Free]
    ties: list[_Tie] = []
    runs: list[str]
    fixed: dict[str, float]


class _Prediction(_Part):
    z: list[float]
    covariance: list[list[float]]
    layout: _Layout

    @model_validator(mode="after")
    def _square(self) -> "_Prediction":
        size = len(self.z)
        if [len(row) for row in self.covariance] != [size] * size:
            raise ValueError(f"the covariance is not {size} x {size}")
        if size and np.max(np.abs(self.covariance)) > _LARGEST:
            raise ValueError(f"a covariance above {_LARGEST:g}")
        eigenvalues = np.linalg.eigvalsh(np.array(self.covariance)) if size else np.zeros(1)
        if eigenvalues[0] < -_ROUNDING * abs(eigenvalues[-1]):
            raise ValueError("a variance is negative")
        return self


class _Data(_Part):
    convention: Literal[tuple(CONVENTIONS)]  # type: ignore[valid-type]
    file: str
    sha256: str | None
    used: int
    runs: list[str]
    range: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]] = {}


class _Noise(_Part):
    median_std: NonNegativeFloat
    proportional_to_load: bool = False
    constant: NonNegativeFloat = 0.0
    share_of_load: NonNegativeFloat = 0.0
    share_of_force: NonNegativeFloat = 0.0
    share_beyond: NonNegativeFloat = 0.0
    loads: tuple[NonNegativeFloat, PositiveFloat] = Field((0.0, 1e300), strict=False)
    by_run: dict[str, NonNegativeFloat] = {}


class _Reference(_Part):
    fz: PositiveFloat


class _Estimate(_Part):
    value: float | list[float]
    std: NonNegativeFloat | list[NonNegativeFloat] | None
    ci95: list[float | None | list[float | None]] = Field([None, None], min_length=2)
    fixed: bool = False


class _Record(_Part):
    model: str
    forces: list[Literal["fx", "fy", "mz", "mx", "my"]]
    noise: dict[str, Any]
    data: _Data
    reference: _Reference
    prediction: _Prediction
    parameters: dict[str, _Estimate] = {}
    coefficients: dict[str, _Estimate] = {}  # of a whole Magic Formula
    seed: int | None = None
    outcomes: list[str] = []

    @model_validator(mode="after")
    def _estimated(self) -> "_Record":
        if not (self.parameters or self.coefficients):
            raise ValueError("no parameters")
        if not self.forces:
            raise ValueError("no forces")
        return self


def load_fit(path: str | os.PathLike[str]) -> StoredFit:
    """Read a ``fit.json``.

    Args:
        path: the file.

    Returns:
        What a prediction or an export needs of the fit.

    Raises:
        DataError: no such file, not JSON, not of this schema, or its checksum is wrong.

    Example:
        >>> _ = fit(samples / "circles.csv", "brush").save(folder)
        >>> stored = load_fit(folder / "fit.json")
        >>> stored.model, stored.layout.labels
        ('brush', ('cpa2', 'mu'))
    """
    from tirefit.models.mf import MAGIC_FORMULAS  # which those who write fits do not wait for

    remedy = "give a fit.json of `tirefit fit`"
    content = read_record(Path(path), SCHEMA, remedy)
    try:
        record = _Record.model_validate(content)
        odd = outrageous(content["prediction"], 0.0)
        if odd is not None:
            raise ValueError(f"prediction.{odd[0]}: {odd[1]}")
        template = MAGIC_FORMULAS.get(record.model) or find_model(record.model)
        stored, known, free = record.prediction.layout, specs(template), []
        for item in stored.free:
            spec = known[item.name]._replace(lower=item.lower, upper=item.upper)
            if not (0.0 if spec.scale == "log" else -_LARGEST) < spec.lower < spec.upper:
                raise ValueError(f"the bounds of {item.name} are not in order")
            free.append(FreeParameter(item.name, spec, item.per_run))
        ties = tuple(Tie(**tie.model_dump()) for tie in stored.ties)
        for tie in ties:
            if tie.name not in known or tie.other not in {item.name for item in free}:
                raise ValueError(f"{tie.name} is tied to {tie.other}: not a free parameter")
        layout = Layout(tuple(free), tuple(stored.runs), ties)
        tire = with_values(template, stored.fixed)
        noise: dict[str, Any] = {f: record.noise[f] for f in record.forces}
        for given in noise.values():
            _Noise.model_validate(given)
        if len(record.prediction.z) != layout.size:
            raise ValueError("z has another length than the layout")
    except (ValueError, KeyError, UsageError) as error:
        # The checksum is right, so another version wrote the file, or somebody by hand.
        reason = f"it does not hold a fit: {faults_in(error)}"
        raise DataError(reason, remedy, str(path)) from None
    z, covariance = (np.array(part) for part in (record.prediction.z, record.prediction.covariance))
    return StoredFit(record.model, tire, layout, z, covariance, noise, content)


def posterior_tree(result: FitResult) -> "xarray.DataTree":
    """The posterior as an xarray DataTree in the InferenceData layout.

    Every walker is a chain, as tools take the draws of a chain for a sequence.
    """
    import xarray as xr  # slow to import, and used for posteriors only

    summary, draws = result.posterior, result.walkers
    assert summary is not None and draws is not None  # both exist if it was sampled
    ensembles, walkers, steps, _ = draws.shape
    coords = {"chain": np.arange(ensembles * walkers), "draw": np.arange(steps)}
    flat = draws.reshape(ensembles * walkers, steps, -1)
    estimates = result.least_squares
    posterior = xr.Dataset(
        {
            label: (("chain", "draw"), flat[..., i], {"unit": estimates[label].unit})
            for i, label in enumerate(result.labels)
        },
        coords | {"ensemble": ("chain", np.repeat(np.arange(ensembles), walkers))},
        attrs={
            "model": result.model,
            "version": result.version,
            "seed": summary.seed,
            "sampler": summary.sampler,
            "created_by": "tirefit",
            "data_sha256": result.data["sha256"],
            "convention": "braking, SI",
        },
    )
    problem = result.problem
    parts = {"observed_data": problem.rows.observed, "constant_data": problem.rows.inputs._asdict()}
    of_rows = {
        part: xr.Dataset(
            {k: ("row", problem.used(v)) for k, v in columns.items()}, {"row": np.arange(problem.n)}
        )
        for part, columns in parts.items()
    }
    return xr.DataTree.from_dict({"posterior": posterior, **of_rows})


def posterior_content(result: FitResult) -> bytes:
    """The posterior as netCDF."""
    # Made in memory, as HDF5 ends the process if the disk is full.
    return bytes(posterior_tree(result).to_netcdf(None, engine="h5netcdf"))


def save_fit(result: FitResult, directory: str | os.PathLike[str]) -> list[Path]:
    """Write ``fit.json`` and, if sampled, ``posterior.nc``, both or none."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    document, posterior = directory / "fit.json", directory / "posterior.nc"
    sampled = {} if result.walkers is None else {posterior: posterior_content(result)}
    # The posterior of an earlier fit would be mistaken for that of this fit.json.
    write_texts({**sampled, document: result.to_json()}, [] if sampled else [posterior])
    return [document, *sampled]


_STATISTICS = ("rmse", "r2", "chi2_dof", "n", "n_effective")


def record_of_fit(content: Mapping[str, Any], result: str) -> FileRecord:
    """The record of a fit for the table of all results.

    Args:
        content: of ``fit.json``, as :meth:`FitResult.to_dict` returns it.
        result: the path of the fit.
    """
    rows = [
        Row(
            kind,
            name,
            number["value"],
            number["std"],
            low,
            high,
            number["unit"],
            number["identified"],
        )
        for kind, section in (("parameter", "parameters"), ("derived", "derived"))
        for name, number in content[section].items()
        for low, high in [number["ci95"]]
    ]
    rows += [Row("statistic", name, content["fit"][name]) for name in _STATISTICS]
    return FileRecord(
        content["data"]["file"],
        result,
        content["model"],
        content["verdict"]["status"],
        tuple(rows),
        tuple(content["outcomes"]),
        convention=content["data"]["convention"],
        seed=content["seed"],
        version=content["version"],
        sha256=content["data"]["sha256"],
    )
