"""The script an engineer writes instead: SciPy curve_fit of one CSV, same figures.

python scipy_peer.py data.csv directory
"""

import csv
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import curve_fit

FZ = 4000.0


def brush(slip, cpa2, mu):
    rho = np.minimum(cpa2 * slip / (mu * FZ), 1.5)
    u = 4 / 3 * rho
    return mu * FZ * u**2 * (3 - u) / 4 + cpa2 * slip * (2 - u) ** 2 / 2


def main(file, directory):
    with open(file, newline="") as text:
        rows = list(csv.DictReader(text))
    slip = np.array([float(row["sigma_x"]) for row in rows])
    force = np.array([float(row["fx"]) for row in rows])
    (cpa2, mu), cov = curve_fit(brush, slip, force, p0=[4e4, 0.9])
    std = np.sqrt(np.diag(cov))
    residual = force - brush(slip, cpa2, mu)
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    grid = np.linspace(0, slip.max(), 300)
    figure = Figure(figsize=(7, 4.5), dpi=130)
    axes = figure.subplots()
    axes.plot(slip, force, ".", ms=2)
    axes.plot(grid, brush(grid, cpa2, mu), "k")
    jacobian = np.array(
        [
            (brush(grid, cpa2 + std[0], mu) - brush(grid, cpa2, mu)) / std[0],
            (brush(grid, cpa2, mu + std[1]) - brush(grid, cpa2, mu)) / std[1],
        ]
    )
    band = 1.96 * np.sqrt(np.einsum("in,ij,jn->n", jacobian, cov, jacobian))
    curve = brush(grid, cpa2, mu)
    axes.fill_between(grid, curve - band, curve + band, alpha=0.4)
    axes.set_xlabel(r"slip $\sigma_x$ [-]")
    axes.set_ylabel(r"force $F_x$ [N]")
    figure.savefig(directory / "fit.png")
    figure = Figure(figsize=(7, 9), dpi=130)
    panels = figure.subplots(2, 2)
    panels[0, 0].plot(slip, residual, ".", ms=2)
    panels[0, 1].hist(residual, 40)
    ordered = np.sort(residual)
    quantiles = np.random.default_rng(0).standard_normal((200, len(ordered)))
    panels[1, 0].plot(np.sort(quantiles, axis=1).mean(0), ordered, ".", ms=2)
    lags = [residual[k:] @ residual[: len(residual) - k] for k in range(40)]
    panels[1, 1].bar(range(40), np.array(lags) / lags[0])
    figure.savefig(directory / "residuals.png")
    # The profile likelihood of both parameters, which tirefit draws as well.
    figure = Figure(figsize=(7, 3.5), dpi=130)
    panels = figure.subplots(1, 2)
    scale = residual @ residual / (len(slip) - 2)
    for i, panel in enumerate(panels):
        offsets = np.linspace(-3, 3, 13) * std[i]
        deviance = []
        for offset in offsets:
            fixed = (cpa2, mu)[i] + offset

            def held(slip, other, fixed=fixed, i=i):
                return brush(slip, fixed, other) if i == 0 else brush(slip, other, fixed)

            best, _ = curve_fit(held, slip, force, p0=[(cpa2, mu)[1 - i]])
            rest = force - held(slip, *best)
            deviance.append((rest @ rest - residual @ residual) / scale)
        panel.plot((cpa2, mu)[i] + offsets, deviance)
    figure.savefig(directory / "profile.png")
    print(f"cpa2 {cpa2:.1f} +- {std[0]:.1f}, mu {mu:.5f} +- {std[1]:.5f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
