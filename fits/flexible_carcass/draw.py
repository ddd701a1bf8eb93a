"""The misfit with a flexible carcass, and the asserted numbers of the curves.

``python -m fits.flexible_carcass.draw`` writes the figure to this folder.
"""

from pathlib import Path

import jax
import numpy as np
from scipy.optimize import least_squares

import tirefit
from fits.flexible_carcass.make_data import CURVES
from fits.flexible_carcass.patch import slopes_at_rest
from fits.flexible_carcass.reference import HELD, bend, read
from tirefit.report.canvas import COLORS, DARK, Picture, tidy

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent
BEST = {
    "beam": (114809.15, 0.6482934, 0.37288425),
    "parabola": (117877.77, 0.64778035, 0.062514051),
}
"""c_p a^2 [N], mu and flexibility of g275_95psi, by reference.py."""
SOFTER = (0.01, 0.1, 0.4)
"""Shares of the flexibilities HELD."""
LINES = {"thread": "-", "beam": "--", "parabola": ":"}


def force(kind, alpha, fz, cpa2, mu, flexibility):
    """F_y [N], (n,), of a registered model."""
    values = {"cpa2": cpa2, "mu": mu, "flexibility": flexibility}
    tire = tirefit.with_values(tirefit.MODELS[f"carcass-{kind}"], values)
    return np.asarray(tirefit.forces(tire, tirefit.TireInputs(0.0, alpha, fz)).fy)


def held_fit(curve, kind, flexibility):
    """Residual [N], (n,), with the best c_p a^2 and mu for a flexibility."""
    alpha, observed, fz = read(curve)
    share = slopes_at_rest(kind, flexibility)[0] if flexibility else 1.0
    start = [observed[0] / alpha[0] / 2 / share, observed.max() / fz]
    return least_squares(
        lambda p: force(kind, alpha, fz, *p, flexibility) - observed,
        start,
        x_scale=start,
        xtol=1e-10,
        ftol=1e-13,
    ).fun


def rmse(misfit) -> float:
    return float(np.sqrt(np.mean(misfit**2)))


def properties() -> dict[str, float]:
    """Numbers of the curves by name, as explained in expected.toml."""
    found = {}
    for curve in CURVES:
        for kind, held in HELD.items():
            found[f"{curve}: RMSE [N], {kind} held"] = rmse(held_fit(curve, kind, held))
    for curve in ("figure10", "g275_70psi"):
        rigid = rmse(held_fit(curve, "thread", 0.0))
        for kind, held in HELD.items():
            softer = [rmse(held_fit(curve, kind, part * held)) for part in SOFTER]
            least = min(softer) / rigid
            found[f"{curve}: least RMSE of a flexible {kind} over the brush's"] = least
    alpha, observed, fz = read("g275_95psi")
    for kind, values in BEST.items():
        found[f"g275_95psi: RMSE [N], best {kind}"] = rmse(
            force(kind, alpha, fz, *values) - observed
        )
    for kind, held in HELD.items():
        found[f"bend at rest, {kind} held"] = bend(
            lambda a, k=kind, h=held: force(k, a, 1.0, 1.0, 1.0, h)
        )
    return {name: float(value) for name, value in found.items()}


def main() -> None:
    picture = Picture(figsize=(7.0, 3.2), layout="constrained")
    left, right = picture.subplots(1, 2)
    for i, curve in enumerate(CURVES):
        top = read(curve)[1].max()
        for kind, held in HELD.items():
            sizes = np.r_[0.0, np.geomspace(0.02, 1.5, 12)] * held
            shares = [slopes_at_rest(kind, x)[0] if x else 1.0 for x in sizes]
            misfits = [100 * rmse(held_fit(curve, kind, x)) / top for x in sizes]
            label = curve if kind == "thread" else None
            left.plot(shares, misfits, LINES[kind], color=COLORS[i], label=label)
    left.invert_xaxis()
    left.set_ylim(bottom=0)
    left.legend(fontsize=7, frameon=False)
    tidy(left, r"$C_α\, /\, 2 c_p a^2$ (1: rigid)", "RMSE [% of largest force]")
    alpha, observed, _ = read("g275_70psi")
    right.axhline(0, color=DARK, linewidth=0.8)
    cases = {"brush": ("thread", 0.0), **{k: (k, held) for k, held in HELD.items()}}
    for i, (name, (kind, held)) in enumerate(cases.items()):
        misfit = 100 * held_fit("g275_70psi", kind, held) / observed.max()
        label = f"{name}, λ = {held:g}" if held else "brush"
        right.plot(
            np.rad2deg(alpha),
            misfit,
            LINES[kind],
            label=label,
            color=DARK if name == "brush" else COLORS[3 + i % 3],
        )
    right.margins(x=0)
    right.legend(fontsize=7, frameon=False)
    right.set_title("g275_70psi, best $c_p a^2$ and µ", fontsize=9)
    left.set_title("thread —, beam - -, parabola ⋅⋅⋅", fontsize=9)
    tidy(right, "slip angle α [°]", "misfit [% of largest force]")
    picture.savefig(HERE / "figure_13_lateral.png")


if __name__ == "__main__":
    main()
    for name, value in properties().items():
        print(f"{name:45s} {value:.8g}")
