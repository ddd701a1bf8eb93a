"""The online methods by name: one visible dict."""

from collections.abc import Mapping

from tirefit.online.base import AbstractEstimator
from tirefit.online.braking.xbs import Xbs, XbsBraking
from tirefit.online.cubic import Cubic
from tirefit.online.ekf import Ekf
from tirefit.online.force_filter import ForceFilter
from tirefit.online.lugre_observer import LuGreObserver
from tirefit.online.path import Path
from tirefit.online.position import Position
from tirefit.online.rls import Mit, Rls
from tirefit.online.slip_slope import SlipSlope, SlipSlopeBraking
from tirefit.online.tire_sensor import TireSensor
from tirefit.params import check_values, specs, with_values

METHODS: dict[str, type[AbstractEstimator]] = {
    kind.method.name: kind
    for kind in (
        Rls, Mit, Ekf, Cubic, SlipSlope, SlipSlopeBraking, TireSensor, Position, Path,
        ForceFilter, LuGreObserver, Xbs, XbsBraking,
    )
}  # fmt: skip
"""Method name -> its record."""
STIFFNESS_OF_LOAD = 250 / 27
"""Default of the expected c_p a^2 over the load [-]: the truck tire of S section 5 (C_x =
5e5 N at 27 kN); car tires have 8 to 15."""


def estimator_of(
    name: str, load: float, settings: Mapping[str, float] | None = None
) -> AbstractEstimator:
    """The record of a method, ready to run.

    Args:
        name: a key of :data:`METHODS`.
        load: usual load [N], which gives the expected stiffness where none is set.
        settings: values of the fields of the method.

    Raises:
        UsageError: unknown settings, or values out of bounds.
    """
    template = METHODS[name]()
    known, values = specs(template), dict(settings or {})
    check_values(template, f"method {name!r}", values, noun="setting")
    if "cpa2" in known and "cpa2" not in values:
        values["cpa2"] = STIFFNESS_OF_LOAD * float(load)
        if "cpa2_std" in known:
            # Relative std of that default: the axles of the f1tenth car have 0.14 to 0.54 of it.
            values.setdefault("cpa2_std", 0.7)
    return with_values(template, {key: float(value) for key, value in values.items()})
