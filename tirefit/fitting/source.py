"""The tire of a fit, a ``fit.json``, a ``.tir`` file or a model: :func:`given_tire`."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from tirefit.data.tir.tir import TirFile, read_tir
from tirefit.data.tir.tire_file import tire_kind
from tirefit.fitting.problem.layout import Layout
from tirefit.fitting.tir import tire_of
from tirefit.models import AbstractTire, modelled
from tirefit.models.mf import MFTire, Mirrored, Pair
from tirefit.params import check_values, with_values
from tirefit.results import InputProblem, UsageError

# The modules that read fits are slow to import, and a .tir file does not need them.
if TYPE_CHECKING:
    from tirefit.fitting.mf.result import MagicFormulaFit
    from tirefit.fitting.result import FitResult
    from tirefit.fitting.store import StoredFit

    Fit = FitResult | MagicFormulaFit | StoredFit


@dataclass(frozen=True)
class GivenTire:
    """A tire, and the fit or file that it comes from.

    Attributes:
        name: of the model.
        tire: with its values.
        fit: layout, estimate (p,) and covariance (p, p) in the unconstrained space;
            None without a fit.
        content: content of ``fit.json``; empty without a fit.
        tir: the ``.tir`` file; None for another source.
    """

    name: str
    tire: AbstractTire
    fit: tuple[Layout, np.ndarray, np.ndarray] | None = None
    content: Mapping[str, Any] = field(default_factory=dict)
    tir: TirFile | None = None

    @property
    def runs(self) -> tuple[str, ...]:
        """The runs that the tire was fitted to."""
        return tuple(self.content.get("data", {}).get("runs", ()))

    def drawn(self, generator: np.random.Generator, count: int) -> list[AbstractTire]:
        """Tires with parameters drawn from the fit's normal distribution."""
        if self.fit is None:
            return [self.tire] * count
        from tirefit.fitting.store import at_estimate

        layout, z, covariance = self.fit
        each = generator.multivariate_normal(z, covariance, count, method="eigh")
        return [at_estimate(self.tire, layout, drawn_z) for drawn_z in each]


def given_tire(
    source: "Fit | GivenTire | AbstractTire | str | os.PathLike[str]",
    values: Mapping[str, float] | None = None,
    signs: str | None = None,
) -> GivenTire:
    """The tire of a fit, of a ``fit.json``, of a ``.tir`` file, or of a model.

    Args:
        values: parameter values of a model or a ``.tir`` file.
        signs: convention in which a ``.tir`` file was written, see
            :func:`tirefit.fitting.tir.tire_of`.

    Raises:
        UsageError: an unknown model or parameter, values together with a fit, signs without a
            ``.tir`` file, or a fit with values by run.
        DataError: a file that is neither a fit nor a ``.tir`` file.
    """
    if isinstance(source, GivenTire) and not (values or signs):
        return source
    text = os.fspath(source) if isinstance(source, str | os.PathLike) else ""
    values = dict(values or {})
    kind = tire_kind(text) if text else ""
    if kind == "tir":
        tir = read_tir(text)
        tire = tire_of(tir, values=values, signs=signs)
        check_values(tire, text, values)
        return GivenTire(f"MF {tir.version}", tire, tir=tir)
    if signs:
        raise UsageError("--signs applies to .tir files only", "leave it out")
    if isinstance(source, AbstractTire) or text and not kind:
        from tirefit.fitting.problem.build import find_model

        name = text or type(source).__name__
        tire = source if isinstance(source, AbstractTire) else find_model(text)
        check_values(tire, name, values)
        return GivenTire(name, with_values(tire, values))
    if values:
        reason = "parameter values (--set) together with a fit, which has its own"
        raise UsageError(InputProblem(reason, "leave them out, or name a model"))
    from tirefit.fitting.store import load_fit

    return _of_fit(cast("Fit", load_fit(text) if text else source))  # nothing else is left


def _of_fit(fit: "Fit") -> GivenTire:
    """The tire of a fit."""
    from tirefit.fitting.mf.result import MagicFormulaFit
    from tirefit.fitting.store import StoredFit

    stored = fit if isinstance(fit, StoredFit) else fit.stored
    tire = fit.tire if isinstance(fit, MagicFormulaFit) else stored.at_estimate()
    content = fit.content if isinstance(fit, StoredFit) else fit.to_dict()
    return GivenTire(fit.model, tire, (stored.layout, stored.z, stored.covariance), content)


def axle_tire(source: "Fit | GivenTire | AbstractTire | str | os.PathLike[str]") -> GivenTire:
    """The tire of an axle, at the load of the axle.

    A Magic Formula describes one tire; the axle then has two, mirror images of each
    other, each at half the load. Every other source is assumed to describe a whole
    axle, as a fit to the log of ``tirefit derive`` does.

    Raises:
        UsageError, DataError: as :func:`given_tire`; or a tire without a lateral force
            in steady state.
    """
    given = given_tire(source)
    if "fy" not in modelled(given.tire) or given.tire.transient:
        reason = f"{given.name} has no lateral force in steady state"
        raise UsageError(reason, "choose a tire such as brush")
    if isinstance(given.tire, MFTire | Mirrored):
        return replace(given, tire=Pair(given.tire), fit=None)
    return given
