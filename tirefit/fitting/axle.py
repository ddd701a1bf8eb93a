"""The tire of an axle, of a fit or of a model, with the uncertainty that it has."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tirefit.fitting.layout import Layout
from tirefit.fitting.problem import find_model
from tirefit.fitting.result import FitResult
from tirefit.fitting.store import StoredFit, at_estimate, load_fit
from tirefit.models import AbstractTire, modelled
from tirefit.params import check_values, with_values
from tirefit.results import UsageError


@dataclass(frozen=True)
class AxleTire:
    """The tire of an axle.

    Attributes:
        name: of the model.
        tire: with its values.
        fit: layout, estimate (p,) and covariance (p, p) in the unconstrained space;
            None of a tire without a fit.
        runs: the runs that it was fitted to.
    """

    name: str
    tire: AbstractTire
    fit: tuple[Layout, np.ndarray, np.ndarray] | None = None
    runs: tuple[str, ...] = ()

    def drawn(self, generator: np.random.Generator, count: int) -> list[AbstractTire]:
        """Tires with parameters drawn from the fit's normal distribution."""
        if self.fit is None:
            return [self.tire] * count
        layout, z, covariance = self.fit
        each = generator.multivariate_normal(z, covariance, count, method="eigh")
        return [at_estimate(self.tire, layout, one) for one in each]


def axle_tire(source, values: Mapping[str, float] | None = None) -> AxleTire:
    """The same as :func:`known_tire`, of a tire with a lateral force.

    Raises:
        UsageError: it has none in steady state, or as of :func:`known_tire`.
        DataError: a file that is no fit.
    """
    axle = known_tire(source, values)
    if "fy" not in modelled(axle.tire) or axle.tire.transient:
        reason = f"{axle.name} has no lateral force in steady state"
        raise UsageError(reason, "choose a tire such as brush")
    return axle


def known_tire(
    source: FitResult | StoredFit | AbstractTire | str | os.PathLike,
    values: Mapping[str, float] | None = None,
) -> AxleTire:
    """The tire of a fit, of a ``fit.json``, or of a model.

    Args:
        values: parameter values of a model.

    Raises:
        UsageError: an unknown model or parameter, or a fit with values by run.
        DataError: a file that is no fit.
    """
    text = os.fspath(source) if isinstance(source, str | os.PathLike) else ""
    if text.endswith(".json") or text and Path(text).is_file():
        source = load_fit(text)
    if isinstance(source, StoredFit):
        layout, z, covariance = source.layout, source.z, source.covariance
        tire, content = source.at_estimate(), source.content
    elif isinstance(source, FitResult):
        layout, z, covariance = source.problem.layout, source.z, source.covariance
        tire, content = at_estimate(source.problem.model, layout, z), source.to_dict()
    else:
        tire = source if isinstance(source, AbstractTire) else find_model(text)
        name = text or type(tire).__name__
        check_values(tire, name, values or {})
        return AxleTire(name, with_values(tire, dict(values or {})))
    runs = tuple(content["data"].get("runs", ()))
    return AxleTire(source.model, tire, (layout, z, covariance), runs)
