"""Forces that a fit or a model predicts, row by row, with standard deviations."""

import os
from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tirefit.compiled import BRIEF
from tirefit.data.accept import DataLike, as_data
from tirefit.data.read import require
from tirefit.data.table import CANONICAL, TireData
from tirefit.data.tir.tir import read_tir
from tirefit.data.tir.tire_file import tire_kind
from tirefit.fitting.mf.parts import SLIPS_OF
from tirefit.fitting.mf.result import MagicFormulaFit, TireLike, magic_formula_forces
from tirefit.fitting.problem.build import check_time_series, find_model, inputs_of
from tirefit.fitting.problem.layout import Layout
from tirefit.fitting.problem.likelihood import row_forces
from tirefit.fitting.problem.noise import noise_std
from tirefit.fitting.result import FitResult
from tirefit.fitting.store import StoredFit, load_fit
from tirefit.fitting.tir import TIR_SIGNS, beyond, tire_of
from tirefit.models import AbstractTire, TireInputs, forces, modelled
from tirefit.models.mf import MFTire
from tirefit.params import Values, check_values, with_values
from tirefit.precision import require_x64
from tirefit.results import DataError, UsageError


@partial(jax.jit, static_argnames=("layout",), compiler_options=BRIEF)
def predict_forces(
    model: AbstractTire,
    layout: Layout,
    z: Float[Values, " p"],
    covariance: Float[Values, "p p"],
    inputs: TireInputs,
    run: Int[Values, " n"],
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Forces and their variance due to the uncertainty of the parameters.

    Args:
        model: template with the fixed parameters.
        layout, z, covariance: estimate in the unconstrained space.
        inputs: ``TireInputs`` of arrays (n,).
        run: run of each row, (n,).

    Returns:
        (force, variance): dicts of arrays (n,) for each force that is modelled.
    """

    def force(z: Values) -> dict[str, Array]:
        each = row_forces(model, layout, z, inputs, run)
        return {name: value for name, value in each.items() if value is not None}

    slope = jax.jacfwd(force)(z)
    return force(z), {k: jnp.sum(g @ covariance * g, axis=1) for k, g in slope.items()}


def _check_needs(data: TireData, tire: AbstractTire, name: str) -> None:
    """Raises DataError if the data lack an input of the tire."""
    require(data, ("fz", *tire.needs), f"the model {name}")
    if tire.transient:
        check_time_series(data, name)


def predict(
    source: FitResult | MagicFormulaFit | StoredFit | AbstractTire | str | os.PathLike[str],
    data: DataLike,
    values: Mapping[str, float] | None = None,
) -> dict[str, np.ndarray]:
    """Return forces row by row, canonical, with a predictive standard deviation for a fit.

    Args:
        source: a fit, a ``fit.json``, a ``.tir`` file, a tire, or the name of a model.
        data: rows with slip, load and, where the model needs it, speed: what
            ``tirefit.read`` gave, a frame, a mapping of column to array, or a path. A file
            that declares no convention is read in that of the fit's data, or of ``.tir``.
        values: parameter values of a tire, which otherwise has its own; not for a fit.

    Returns:
        (n,) arrays. For a tire or a named model: ``fx`` if the data have sigma_x; ``fy``,
        ``mz`` and, if modelled, ``mx`` if they have alpha; ``my`` if they have either.
        For a fit: the forces that it fitted, each with a ``<force>_std`` of parameter
        uncertainty and the noise of one measurement. Masked rows are NaN.

    Raises:
        UsageError: unknown model or parameter, value out of bounds, values with a fit,
            32-bit floats.
        DataError: the data lack an input, or have runs that the fit lacks; a ``fit.json``
            or ``.tir`` file that cannot be read.

    Example:
        >>> rows = {"sigma_x": [0.01, 0.5], "fz": [4000.0, 4000.0]}
        >>> predict("brush", rows, {"mu": 0.9})["fx"].round()
        array([ 910., 3600.])
    """
    require_x64("a prediction")
    given, name, signs = _opened(source)
    data = as_data(data, forces=False, otherwise=signs)
    if isinstance(given, AbstractTire):
        return _of_model(given, name, data, values or {})
    if values:
        raise UsageError("values together with a fit, which has its own", "leave them out")
    fit = given if isinstance(given, StoredFit) else given.stored
    tire, layout, noise, inputs = fit.tire, fit.layout, fit.noise, inputs_of(data)
    _check_needs(data, tire, name)
    force: Mapping[str, Any]
    variance: Mapping[str, Any]
    if isinstance(tire, MFTire):
        force, variance = magic_formula_forces(fit, tuple(noise), inputs)
    else:
        codes = data.run[data.used]
        if layout.is_sparse:
            if unknown := [run for run in data.runs if run not in layout.runs]:
                reason = f"the fit has no parameters for the runs {', '.join(unknown)}"
                raise DataError(reason, f"it knows {', '.join(layout.runs)}", data.file)
            codes = np.array([layout.runs.index(run) for run in data.runs])[codes]
        force, variance = predict_forces(tire, layout, fit.z, fit.covariance, inputs, codes)
    out, names = {}, np.array(data.runs)[data.run[data.used]]
    fitted = [channel for channel in _channels(data, force) if channel in noise]
    if not fitted:
        needs = " and ".join(dict.fromkeys(SLIPS_OF[channel][0] for channel in noise))
        raise DataError(
            f"the fit is of {', '.join(noise)}: the data need {needs}",
            "name the column with --column",
            data.file,
        )
    for channel in fitted:
        out[channel] = np.asarray(force[channel])
        if f"{channel}_std" in data:
            std = data.usable(f"{channel}_std")
        else:
            at = data.usable("fz"), out[channel], names, fit.content["reference"]["fz"]
            std = noise_std(noise[channel], *at)
        spread = np.sqrt(np.maximum(variance[channel], 0.0))  # by rounding below it
        out[f"{channel}_std"] = np.hypot(spread, std)
    return _all_rows(data, out)


def _opened(
    source: TireLike,
) -> tuple[FitResult | MagicFormulaFit | StoredFit | AbstractTire, str, tuple[str, str] | None]:
    """The fit or the tire, its name, and the convention of data that declare none, with
    the name that a message gives it."""
    if isinstance(source, str | os.PathLike):
        text = os.fspath(source)
        kind = tire_kind(text)
        if kind == "tir":
            return tire_of(read_tir(text)), text, (TIR_SIGNS, ".tir files")
        if not kind:
            return find_model(text), text, None
        source = load_fit(text)
    if isinstance(source, AbstractTire):
        return source, type(source).__name__, None
    data = source.content["data"] if isinstance(source, StoredFit) else source.data
    return source, source.model, (data["convention"], "the fit's data")


def outside_fit(fit: StoredFit, data: TireData) -> list[str]:
    """Sentences on used rows outside the fitted ranges of load, slips and what else the
    tire depends on, canonical."""
    acting = {"fz", "sigma_x", "alpha", *fit.tire.needs}
    acting |= {"gamma", "pressure"} if isinstance(fit.tire, MFTire) else set()
    messages = []
    for name, (low, high) in fit.content["data"].get("range", {}).items():
        if name in acting and name in data:
            ends = f"the fitted {name} = {low:.4g} to {high:.4g} {CANONICAL[name][0]}"
            messages += beyond(data.usable(name), low, high, ends)
    return messages


def _channels(data: TireData, force: Mapping[str, Any]) -> list[str]:
    return [
        channel
        for channel, slips in SLIPS_OF.items()
        if any(slip in data for slip in slips) and force.get(channel) is not None
    ]


def _all_rows(data: TireData, out: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Arrays over the used rows as arrays over all rows, NaN where masked."""
    full = {channel: np.full(len(data), np.nan) for channel in out}
    for channel, values in out.items():
        full[channel][data.used] = values
    return full


def _of_model(
    template: AbstractTire, name: str, data: TireData, values: Mapping[str, float]
) -> dict[str, np.ndarray]:
    check_values(template, name, values)
    tire = with_values(template, values)
    _check_needs(data, tire, name)
    given = forces(tire, inputs_of(data), data.run[data.used])._asdict()
    channels = _channels(data, given)
    if not channels:
        has = " and ".join(modelled(tire))
        reason = f"{name} computes only {has}, and the data do not have its slip"
        remedy = "name the column with --column, or choose another tire"
        raise DataError(reason, remedy, data.file)
    return _all_rows(data, {c: given[c] for c in channels})
