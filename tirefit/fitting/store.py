"""Fits on disk: ``fit.json`` and ``posterior.nc``, and predictions from either."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tirefit.data.read import require
from tirefit.data.table import TireData
from tirefit.files import replacing, write_text_atomic
from tirefit.fitting.layout import FreeParameter, Layout, Tie
from tirefit.fitting.likelihood import CHANNEL_SLIP
from tirefit.fitting.predict import predict_forces
from tirefit.fitting.problem import find_model
from tirefit.fitting.result import SCHEMA, FitResult
from tirefit.fitting.time_series import check_time_series
from tirefit.models import AbstractTire, TireInputs
from tirefit.params import parameter_values, specs, with_values
from tirefit.results import DataError, InputProblem, UsageError

__all__ = ["StoredFit", "load_fit", "predict", "save_fit", "write_posterior"]


@dataclass(frozen=True)
class StoredFit:
    """What a prediction needs of a fit: the tire, the estimate and the noise.

    ``noise`` holds the noise record of each fitted force, ``content`` the whole file.
    """

    model: str
    tire: AbstractTire
    layout: Layout
    z: np.ndarray
    covariance: np.ndarray
    noise: Mapping[str, Mapping]
    content: Mapping


def load_fit(path: str | os.PathLike) -> StoredFit:
    """Read a ``fit.json``.

    Raises:
        DataError: no such file, not JSON, or not of this schema.
    """

    def refuse(reason: str) -> DataError:
        return DataError(
            InputProblem(reason, "give a fit.json of `tirefit fit`", str(path))
        )

    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise refuse(f"cannot read it: {error.strerror}") from None
    except ValueError as error:
        raise refuse(f"not JSON: {error}") from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise refuse(f"its schema is not {SCHEMA}")
    template = find_model(content["model"])
    known = specs(template)
    stored = content["prediction"]["layout"]
    free = tuple(
        FreeParameter(
            item["name"],
            known[item["name"]]._replace(lower=item["lower"], upper=item["upper"]),
            item["per_run"],
        )
        for item in stored["free"]
    )
    layout = Layout(
        free, tuple(Tie(**tie) for tie in stored["ties"]), tuple(stored["runs"])
    )
    noise = {force: content["noise"][force] for force in content["forces"]}
    return StoredFit(
        content["model"], with_values(template, stored["fixed"]), layout,
        np.array(content["prediction"]["z"]),
        np.array(content["prediction"]["covariance"]), noise, content,
    )  # fmt: skip


def _inputs(data: TireData) -> TireInputs:
    """The used rows: the slip of a masked one is no part of a time series."""
    zeros = np.zeros(len(data))
    columns = (data.columns.get(name, zeros) for name in TireInputs._fields)
    return TireInputs(*(np.nan_to_num(c[data.used].astype(float)) for c in columns))


def _run_codes(data: TireData, layout: Layout) -> np.ndarray:
    if not any(parameter.per_run for parameter in layout.free):
        return data.run[data.used]
    unknown = [run for run in data.runs if run not in layout.runs]
    if unknown:
        raise DataError(
            InputProblem(
                f"the fit has no parameters for the runs {', '.join(unknown)}",
                f"it knows {', '.join(layout.runs)}",
                data.source.path or data.name,
            )
        )
    return np.array([layout.runs.index(run) for run in data.runs])[data.run[data.used]]


def predict(
    source: "StoredFit | FitResult | AbstractTire | str",
    data: TireData,
    values: Mapping[str, float] | None = None,
) -> dict[str, np.ndarray]:
    """Forces row by row, canonical, with a predictive standard deviation for a fit.

    Args:
        source: a fit, a tire, or the name of a model.
        data: rows with slip, load and, where the model needs it, speed.
        values: parameter values of a tire or a named model; its own otherwise.

    Returns:
        (n,) arrays. Of a tire or a named model ``fx`` where the data have sigma_x,
        ``fy`` and ``mz`` where they have alpha; of a fit the forces that it fitted,
        each with a ``<force>_std``: parameter uncertainty and the noise of one
        measurement. Masked rows are NaN.

    Raises:
        UsageError: unknown model or parameter, or a value outside its bounds.
        DataError: the data lack an input, or have runs the fit does not know.
    """
    if isinstance(source, str):
        return _of_model(find_model(source), source, data, values or {})
    if isinstance(source, AbstractTire):
        return _of_model(source, type(source).__name__, data, values or {})
    if isinstance(source, FitResult):
        problem = source.problem
        tire, layout, name = problem.model, problem.layout, source.model
        noise = {force: source.noise[force] for force in source.forces}
        reference = source.reference
    else:
        tire, layout, name, noise = (
            source.tire, source.layout, source.model, source.noise
        )  # fmt: skip
        reference = source.content["reference"]
    require(data, ("fz", *tire.needs), f"the model {name}")
    if tire.transient:
        check_time_series(data, name)
    found = predict_forces(
        tire, layout, source.z, source.covariance, _inputs(data),
        _run_codes(data, layout),
    )  # fmt: skip
    force, variance = (_all_rows(data, part) for part in found)
    out = {}
    fitted = [channel for channel in _channels(data, force) if channel in noise]
    if not fitted:
        needs = " and ".join(CHANNEL_SLIP[channel] for channel in noise)
        raise DataError(
            InputProblem(
                f"the fit is of {', '.join(noise)}: the data need {needs}",
                "name the column with --column",
                data.source.path or data.name,
            )
        )
    for channel in fitted:
        out[channel] = force[channel]
        noise_std = _noise_std(data, channel, noise.get(channel), reference)
        out[f"{channel}_std"] = np.hypot(np.sqrt(variance[channel]), noise_std)
    return _masked(data, out)


def _noise_std(data: TireData, channel: str, record: Mapping | None, reference):
    """Noise of one measurement: the rows' own where they state it, else the fit's."""
    if f"{channel}_std" in data:
        return data[f"{channel}_std"]
    if record is None:
        return 0.0
    if record.get("proportional_to_load"):
        return record["median_std"] * data["fz"] / reference["fz"]
    return record["median_std"]


def _channels(data: TireData, force: Mapping) -> list[str]:
    return [
        channel
        for channel, slip in CHANNEL_SLIP.items()
        if slip in data and force.get(channel) is not None
    ]


def _all_rows(data: TireData, out: Mapping) -> dict[str, np.ndarray]:
    """Arrays over the used rows as arrays over all rows, NaN where masked."""
    full = {name: np.full(len(data), np.nan) for name in out}
    for name, values in out.items():
        full[name][data.used] = values
    return full


def _masked(data: TireData, out: dict) -> dict[str, np.ndarray]:
    return {k: np.where(data.used, np.asarray(v), np.nan) for k, v in out.items()}


def _of_model(
    template: AbstractTire, name: str, data: TireData, values: Mapping[str, float]
):
    from tirefit.models import forces

    known, problems = specs(template), []
    for key, value in values.items():
        if key not in known:
            problems.append(
                InputProblem(
                    f"{name} has no parameter {key!r}", f"it has {', '.join(known)}"
                )
            )
        elif not known[key].lower <= value <= known[key].upper:
            problems.append(
                InputProblem(
                    f"{key} = {value} is outside its bounds"
                    f" [{known[key].lower:.6g}, {known[key].upper:.6g}]",
                    "see `tirefit models`",
                )
            )
    if problems:
        raise UsageError(problems)
    tire = with_values(template, parameter_values(template) | dict(values))
    require(data, ("fz", *tire.needs), f"the model {name}")
    if tire.transient:
        check_time_series(data, name)
    found = forces(tire, _inputs(data), data.run[data.used])._asdict()
    return _all_rows(data, {c: found[c] for c in _channels(data, found)})


def write_posterior(result: FitResult, path: str | os.PathLike) -> None:
    """Posterior as netCDF: an xarray DataTree in the InferenceData layout.

    Every walker is a chain, so that tools which assume independent draws within a
    chain do not mistake walkers for draws. Written to a temporary name, then renamed.
    """
    import xarray as xr

    summary, draws = result.posterior, result.walkers
    ensembles, walkers, steps, _ = draws.shape
    coords = {"chain": np.arange(ensembles * walkers), "draw": np.arange(steps)}
    flat = draws.reshape(ensembles * walkers, steps, -1)
    posterior = xr.Dataset(
        {
            label: (("chain", "draw"), flat[..., i], {"unit": _unit(result, label)})
            for i, label in enumerate(result.labels)
        },
        coords | {"ensemble": ("chain", np.repeat(np.arange(ensembles), walkers))},
        attrs={
            "model": result.model, "version": result.version, "seed": summary.seed,
            "sampler": summary.sampler, "created_by": "tirefit",
            "data_sha256": result.data["sha256"], "convention": "braking, SI",
        },
    )  # fmt: skip
    problem = result.problem
    rows = {"row": np.arange(problem.n)}
    observed = xr.Dataset(
        {k: ("row", problem.used(v)) for k, v in problem.rows.observed.items()}, rows
    )
    constant = xr.Dataset(
        {k: ("row", problem.used(v)) for k, v in problem.rows.inputs._asdict().items()},
        rows,
    )
    tree = xr.DataTree.from_dict(
        {"posterior": posterior, "observed_data": observed, "constant_data": constant}
    )
    with replacing(path) as temporary:
        tree.to_netcdf(temporary, engine="h5netcdf")


def _unit(result: FitResult, label: str) -> str:
    return result.least_squares[label].unit


def save_fit(result: FitResult, directory: str | os.PathLike) -> list[Path]:
    """Write ``fit.json`` and, where it was sampled, ``posterior.nc``; whole or not."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    written = []
    if result.walkers is None:
        # A posterior of an earlier fit beside this fit.json would be taken for its own.
        (directory / "posterior.nc").unlink(missing_ok=True)
    else:
        write_posterior(result, directory / "posterior.nc")
        written.append(directory / "posterior.nc")
    write_text_atomic(directory / "fit.json", result.to_json())
    return [directory / "fit.json", *written]
