"""The numbers of ``expected.toml``: the same fits by SciPy on S's closed forms."""

from pathlib import Path

import numpy as np

from fits import formulas
from fits.formulas import fit_scipy

HERE = Path(__file__).parent

# model -> (formula, names, bounds of the third parameter, its starts)
MODELS = {
    "brush": (formulas.brush, ("cpa2", "mu"), None, [None]),
    "brush-d": (formulas.brush_d, ("cpa2", "mu", "d"), (-1 / 3, 1), [-0.2, 0.1, 0.6]),
    "brush-m": (formulas.brush_m, ("cpa2", "mu", "m"), (0, 1), [0.5, 0.9]),
    "brush-m-peak": (formulas.brush_m_peak, ("cpa2", "mu_peak", "m"), (0, 1), [0.5, 0.9]),
    "brush-n": (formulas.brush_n, ("cpa2", "mu", "n"), (-0.2, 0.2), [0.0, 0.02]),
    "brush-h": (formulas.brush_h, ("cpa2", "mu", "h"), (0, 1), [0.3, 0.8]),
}


def curve_numbers() -> dict[str, float]:
    """Numbers of the figures of draw.py that have no closed form."""
    from fits.magic_formula_curve.make_data import truck

    tire, load, c, v = truck(), 27e3, 2.5e5, 20.0
    kappa = np.linspace(0, 0.999, 999_001)
    curve = formulas.magic_formula(kappa, **tire)
    found = {"kappa of the peak": kappa[np.argmax(curve)]}
    kappa, curve = kappa[kappa < 0.3], curve[kappa < 0.3]
    sigma = kappa / (1 - kappa)
    ahead = formulas.brush(sigma, load, v, c, tire["D"]) - curve
    found["lead"] = ahead.max() / (tire["D"] * load)
    found["passes"] = kappa[np.flatnonzero((ahead[1:] > 0) & (ahead[:-1] <= 0))[-1]]
    mu_n = 1.05 - 0.0075 * v * kappa
    mu_h = 1.3 * (0.4 + 0.6 * np.exp(-np.sqrt(v * kappa / 30)))
    for law, mu, mu_k in (("n", 1.05, mu_n), ("h", 1.3, mu_h)):
        constant = formulas.two_levels(sigma, load, c, mu, mu_k)
        following = formulas.two_levels(sigma, load, c, mu_k, mu_k)
        found[f"gap {law}"] = np.abs(constant - following).max() / constant.max()
        found[f"peak {law}"] = constant.max() / load
    return {name: float(value) for name, value in found.items()}


def reference() -> dict[str, float]:
    """``figure10 brush-d d`` -> value, ``... d std`` as if rows were independent,
    ``... rmse``."""
    found = curve_numbers()
    for curve in ("figure10", "truck"):
        sigma, force, fz, v = np.loadtxt(
            HERE / f"{curve}.csv", delimiter=",", skiprows=1, unpack=True
        )
        first = [force[0] / sigma[0] / 2, force.max() / fz[0]]
        for model, (formula, names, bounds, thirds) in MODELS.items():
            third = bounds is not None
            values, stds, rmse = fit_scipy(
                lambda *p, f=formula, s=sigma, z=fz, w=v: f(s, z, w, *p),
                force,
                [np.array(first + ([x] if third else [])) for x in thirds],
                [1.0, 0.01, *([bounds[0]] if third else [])],
                [1e9, 5.0, *([bounds[1]] if third else [])],
            )
            for name, value, std in zip(names, values, stds, strict=True):
                found[f"{curve} {model} {name}"] = float(value)
                found[f"{curve} {model} {name} std"] = float(std)
            found[f"{curve} {model} rmse"] = rmse
    return found


if __name__ == "__main__":
    for key, value in reference().items():
        print(f"{key:32s} {value:.8g}")
