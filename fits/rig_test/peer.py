"""An independent fit of the Magic Formula by the method of MATLAB's fitters.

SciPy minimises the sum of squares stage by stage: F_x, F_y and M_z in pure slip, then
each force in combined slip with the coefficients of pure slip held. There are no
priors, weights or standard errors. The archived magic-formula-tyre-library fits F_x and
F_y in pure slip in this way (``fmincon``).
"""

from collections.abc import Callable, Sequence

import jax
import numpy as np
from scipy.optimize import least_squares

from fits.rig_test.tire import NOMINAL
from tirefit.data.table import TireData
from tirefit.fitting.mf.parts import coefficients_of
from tirefit.models import TireInputs, forces
from tirefit.models.mf import mf_tire
from tirefit.params import with_values

__all__ = ["staged_fit"]

_START = {
    "PCX1": 1.5, "PDX1": 1.5, "PKX1": 30.0, "PCY1": 1.3, "PDY1": 1.5, "PKY1": -30.0,
    "PKY2": 1.5, "PKY4": 2.0, "QBZ1": 10.0, "QCZ1": 1.1, "QDZ1": 0.1, "QEZ1": -1.0,
    "QBZ9": 10.0, "RBX1": 10.0, "RBX2": 10.0, "RCX1": 1.0, "RBY1": 10.0, "RBY2": 10.0,
    "RCY1": 1.0, "RVY4": 10.0, "RVY5": 1.9, "RVY6": 10.0,
}  # fmt: skip
"""First values of a textbook tire; the other coefficients start at zero."""
_PURE = 0.01
_COMBINED = {"fx": ("RBX", "RCX", "REX", "RHX"), "mz": ("SSZ",)}
_COMBINED["fy"] = ("RBY", "RCY", "REY", "RHY", "RVY")


def staged_fit(rows: Sequence[tuple[TireInputs, TireData]]) -> Callable:
    """Fit a tire; returns its forces as a function of inputs.

    Args:
        rows: inputs and table of each recording.
    """
    columns = zip(*(one for one, _ in rows), strict=True)
    inputs = TireInputs(*map(np.concatenate, columns))
    observed = {
        force: np.concatenate([data.usable(force) for _, data in rows])
        for force in ("fx", "fy", "mz")
    }
    kappa = np.asarray(inputs.sigma_x) / (1 + np.asarray(inputs.sigma_x))
    pure = {"fx": np.abs(inputs.alpha) <= _PURE, "fy": np.abs(kappa) <= _PURE}
    pure["mz"] = pure["fy"]
    of_part = coefficients_of("6.1")
    values = dict(NOMINAL) | {name: _START.get(name, 0.0) for name in of_part}
    for force in ("fx", "fy", "mz"):
        own = [name for name, part in of_part.items() if part == force]
        _fit(values, own, force, inputs, observed[force], pure[force])
    for force in ("fx", "fy", "mz"):
        own = [name for name in of_part if name.startswith(_COMBINED[force])]
        _fit(values, own, force, inputs, observed[force], np.full(len(kappa), True))
    return lambda at: {
        force: np.asarray(value)
        for force, value in forces(mf_tire("6.1", values), at)._asdict().items()
        if value is not None
    }


def _fit(values, names, force: str, inputs, observed, chosen: np.ndarray) -> None:
    """Fit the named coefficients to the chosen rows; changes ``values``."""
    at = TireInputs(*(np.asarray(column)[chosen] for column in inputs))
    seen = observed[chosen]
    held = mf_tire("6.1", values)

    def missed(x):
        tire = with_values(held, dict(zip(names, x, strict=True)))
        return getattr(forces(tire, at), force) - seen

    first = np.array([values[name] for name in names])
    scale = np.maximum(np.abs(first), 0.1)
    slope = jax.jit(jax.jacfwd(missed))
    found = least_squares(jax.jit(missed), first, jac=slope, x_scale=scale)
    values.update(zip(names, found.x.tolist(), strict=True))
