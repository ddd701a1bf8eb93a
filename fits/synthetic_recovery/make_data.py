"""Writes data of known truth, seed 0: ``python -m fits.synthetic_recovery.make_data``.

400 rows per file, true sigma uniform on 0.001..0.3, three speeds and loads in turn; the
forces are those of ``fits/formulas.py``, not of tirefit. Standard deviations of the
noise: ``rig`` 0.001 of slip and 1 % of the load; ``s51`` as in S section 5.1, which
gives variances: slip sqrt(0.2e-4), force sqrt(0.2e-2) of the load.
``low_utilisation`` is the brush at rig noise with less than 60 % of the friction used.
"""

from pathlib import Path

import numpy as np

from fits import formulas

HERE = Path(__file__).parent

TRUTH = {
    "brush": (formulas.brush, {"cpa2": 5e4, "mu": 0.9}),
    "brush-d": (formulas.brush_d, {"cpa2": 5e4, "mu": 0.9, "d": 0.2}),
    "brush-m": (formulas.brush_m, {"cpa2": 5e4, "mu": 0.9, "m": 0.8}),
    "brush-n": (formulas.brush_n, {"cpa2": 5e4, "mu": 1.05, "n": 0.0075}),
    "brush-h": (formulas.brush_h, {"cpa2": 5e4, "mu": 1.3, "h": 0.4}),
}
NOISE = {"rig": (0.001, 0.01), "s51": (np.sqrt(0.2e-4), np.sqrt(0.2e-2))}
FZ = np.array([3000.0, 4000.0, 5000.0])
SPEED = np.array([10.0, 20.0, 30.0])


def largest_slip(share: float, c: float, mu: float, fz: float) -> float:
    """sigma at which a brush uses a share 1 - (1 - 2rho/3)^3 of its friction."""
    return 1.5 * mu * fz / c * (1 - (1 - share) ** (1 / 3))


def rows(model: str, noise: str, largest: float = 0.3) -> np.ndarray:
    """(400, 6): sigma_x, fx, fz, v, sigma_x_std, fx_std."""
    formula, truth = TRUTH[model]
    generator = np.random.default_rng(0)
    sigma = generator.uniform(0.001, largest, 400)
    fz, v = FZ[np.arange(400) % 3], SPEED[np.arange(400) // 3 % 3]
    slip_std, relative = NOISE[noise]
    force = formula(sigma, fz, v, *truth.values())
    return np.column_stack(
        [
            sigma + slip_std * generator.normal(size=400),
            force + relative * fz * generator.normal(size=400),
            fz,
            v,
            np.full(400, slip_std),
            relative * fz,
        ]
    )


def write(name: str, table: np.ndarray) -> None:
    lines = ["sigma_x,fx,fz,v,sigma_x_std,fx_std"]
    lines += [f"{s:.7f},{f:.3f},{z:.0f},{v:.0f},{a:.7f},{b:.3f}" for s, f, z, v, a, b in table]
    (HERE / f"{name}.csv").write_text("\n".join(lines) + "\n")


def main() -> None:
    for noise in NOISE:
        for model in TRUTH:
            write(f"{model}_{noise}", rows(model, noise))
    truth = TRUTH["brush"][1]
    largest = largest_slip(0.6, truth["cpa2"], truth["mu"], FZ.min())
    write("low_utilisation", rows("brush", "rig", largest))


if __name__ == "__main__":
    main()
