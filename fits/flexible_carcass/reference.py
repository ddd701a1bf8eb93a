"""The numbers of ``expected.toml``: the same fits by SciPy on the numeric patch."""

from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from fits import formulas
from fits.flexible_carcass.make_data import CURVES
from fits.flexible_carcass.patch import Tire, slopes_at_rest, solved

HERE = Path(__file__).parent
HALF = 0.1
POWER = {"thread": 2, "beam": 4, "parabola": 1}
HELD = {"thread": 1.0, "beam": 2.5, "parabola": 0.25}
"""Flexibilities that lower the cornering stiffness by about a quarter."""


def parabolic(xi):
    return 0.75 * (1 - xi**2)


def force(kind, alpha, fz, cpa2, mu, flexibility):
    """F_y [N], (n,), of the numeric patch."""
    stiffness = cpa2 / HALF**2
    carcass = stiffness * HALF ** POWER[kind] / flexibility
    tire = Tire(kind, stiffness, mu * fz, HALF, carcass, parabolic)
    return np.array([solved(tire, slip).force for slip in np.tan(alpha)])


def read(curve):
    """alpha [rad], F_y [N], F_z [N] of a curve."""
    alpha, fy, fz = np.loadtxt(HERE / f"{curve}.csv", delimiter=",", skiprows=1, unpack=True)
    return alpha, fy, fz[0]


def _least(function, observed, start, lower):
    found = least_squares(
        lambda p: (function(*p) - observed) / observed.max(),
        start,
        bounds=(lower, np.inf),
        x_scale=start,
        xtol=1e-9,
        ftol=1e-13,
        gtol=1e-9,
    )
    return found.x, float(np.sqrt(np.mean(found.fun**2)) * observed.max())


def reference() -> dict[str, float]:
    """``g275_95psi thread cpa2`` and so on, ``... rmse`` [N]; ``figure10 thread held
    rmse`` with the flexibility of ``HELD``; ``bend thread``, the term B at rest."""
    found = {}
    for curve in CURVES:
        alpha, observed, fz = read(curve)
        first = np.array([observed[0] / alpha[0] / 2, observed.max() / fz])
        (cpa2, mu), rmse = _least(
            lambda c, m, s=np.tan(alpha), z=fz: formulas.brush(s, z, 0.0, c, m),
            observed,
            first,
            [1.0, 0.01],
        )
        found |= {f"{curve} brush {k}": v for k, v in (("cpa2", cpa2), ("mu", mu), ("rmse", rmse))}
        for kind, held in HELD.items():
            start = np.array([cpa2 / slopes_at_rest(kind, held)[0], mu])
            _, rmse = _least(
                lambda c, m, k=kind, a=alpha, z=fz, h=held: force(k, a, z, c, m, h),
                observed,
                start,
                [1.0, 0.01],
            )
            found[f"{curve} {kind} held rmse"] = rmse
    alpha, observed, fz = read("g275_95psi")
    for kind, held in HELD.items():
        start = [found["g275_95psi brush cpa2"] * 1.15, found["g275_95psi brush mu"]]
        values, rmse = _least(
            lambda c, m, x, k=kind: force(k, alpha, fz, c, m, x),
            observed,
            np.array([*start, held / 2]),
            [1.0, 0.01, 1e-4],
        )
        for name, value in zip(("cpa2", "mu", "flexibility"), values, strict=True):
            found[f"g275_95psi {kind} {name}"] = value
        found[f"g275_95psi {kind} rmse"] = rmse
    for kind, held in HELD.items():
        found[f"bend {kind}"] = bend(lambda a, k=kind, h=held: force(k, a, 1.0, 1.0, 1.0, h))
    return {name: float(value) for name, value in found.items()}


def bend(force_at):
    """B of F = C sigma - B (C sigma)^2 / (mu F_z) + ... at zero slip, for mu F_z = 1 and
    c_p a^2 = 1, by Richardson extrapolation."""
    sigma = 1e-3 * np.array([1.0, 2.0, 4.0])
    per_slip = force_at(np.arctan(sigma)) / sigma
    # per_slip = C - B C^2 sigma + D sigma^2: a parabola through three points.
    square, slope, start = np.polyfit(sigma, per_slip, 2)
    return -slope / start**2


if __name__ == "__main__":
    for key, value in reference().items():
        print(f"{key:32s} {value:.8g}")
