"""Fits on disk: ``fit.json`` and ``posterior.nc``."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tirefit.files import replacing, write_text_atomic
from tirefit.fitting.layout import FreeParameter, Layout, Tie
from tirefit.fitting.problem import find_model
from tirefit.fitting.result import SCHEMA, FitResult
from tirefit.models import AbstractTire
from tirefit.params import specs, with_values
from tirefit.results import DataError, InputProblem, UsageError

__all__ = ["StoredFit", "load_fit", "save_fit", "write_posterior"]


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

    def at_estimate(self) -> AbstractTire:
        """The tire with its fitted values.

        Raises:
            UsageError: a parameter has a value for each run.
        """
        values = self.layout.natural(self.z)
        several = [name for name, value in values.items() if np.ndim(value)]
        if several:
            reason = f"the fit has a {several[0]} for each run: it is not one tire"
            raise UsageError(InputProblem(reason, "fit it with one for all runs"))
        return with_values(self.tire, {k: float(v) for k, v in values.items()})


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


def write_posterior(result: FitResult, path: str | os.PathLike) -> None:
    """Posterior as netCDF: an xarray DataTree in the InferenceData layout.

    Every walker is a chain, so that tools which assume independent draws within a
    chain do not mistake walkers for draws. Written to a temporary name, then renamed.
    """
    import xarray as xr  # slow to import, and for posteriors alone

    summary, draws = result.posterior, result.walkers
    assert summary is not None and draws is not None  # both of a fit that was sampled
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
