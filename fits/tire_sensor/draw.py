"""The Gough plot S Figure 12 and the error of ``tire-sensor`` over it.

``python -m fits.tire_sensor.draw`` writes the figure to this folder.
"""

from pathlib import Path

import jax
import numpy as np

from fits.tire_sensor.reference import force_and_moment
from tirefit.online.tire_sensor import gough, network, seen, trained
from tirefit.report.canvas import DARK, GREY, Picture, tidy

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent
POINTS = {"A": (0.1, 0.5), "B": (0.3, 0.5), "C": (0.5, 1.0)}
FRICTIONS = (0.2, 0.4, 0.6, 0.8, 1.0, 1.2)


def outputs(y, m):
    """theta and used friction by the network of the package."""
    weights = trained()
    theta, used = jax.vmap(lambda a, b: network(weights, a, b))(y, m)
    return np.asarray(theta), np.asarray(used)


def error_map(n: int = 120):
    """sliding, mu (n^2,) off the training grid, and the network's two errors."""
    random = np.random.default_rng(7)
    sliding, mu = random.uniform(0.05, 0.999, n * n), random.uniform(0.1, 1.2, n * n)
    y, m = (np.asarray(part) for part in gough(sliding, mu))
    kept = y >= 0.03
    sliding, mu, y, m = sliding[kept], mu[kept], y[kept], m[kept]
    theta, used = outputs(y, m)
    truth = 1 - (1 - sliding) ** 3
    return y, m, truth, used - truth, (theta - mu * sliding) / y


def properties() -> dict[str, float]:
    y, m, truth, error, theta_error = error_map()
    numbers = {
        "rms error of used friction": np.sqrt(np.mean(error**2)),
        "rms error of theta over force": np.sqrt(np.mean(theta_error**2)),
        "largest error of used friction above 0.5": abs(error[truth > 0.5]).max(),
        "share of the region that is seen": np.mean(
            jax.vmap(lambda a, b: seen(a, b, 1e-9, 1e-9))(y, m)
        ),
        "rms relative error of mu, used 0.1 to 0.3": _relative(truth, error, 0.1, 0.3),
        "rms relative error of mu, used 0.7 to 1": _relative(truth, error, 0.7, 1.0),
    }
    for name, (theta, mu) in POINTS.items():
        one, two = force_and_moment(theta, mu)
        numbers[f"used at {name}"] = outputs(np.array([one]), np.array([two]))[1][0]
    return {key: float(value) for key, value in numbers.items()}


def _relative(truth, error, low, high) -> float:
    inside = (truth > low) & (truth < high)
    return np.sqrt(np.mean((error[inside] / truth[inside]) ** 2))


def main() -> None:
    y, m, _, error, theta_error = error_map(60)
    picture = Picture(figsize=(8.2, 3.3), layout="constrained")
    panels = picture.subplots(1, 2, sharey=True)
    names = ("used friction $\\mu_u$", "$\\theta / (F_y / F_z)$")
    for axes, values, name in zip(panels, (error, theta_error), names, strict=True):
        dots = axes.scatter(m, y, c=values, s=5, cmap="RdBu", vmin=-0.03, vmax=0.03, linewidths=0)
        for mu in FRICTIONS:
            curve = gough(np.linspace(0, 1, 100), mu)
            axes.plot(curve[1], curve[0], color=DARK, linewidth=0.6)
        for theta in (0.05, 0.1, 0.2, 0.3):
            mus = np.linspace(max(theta, 0.1), 1.2, 100)
            line = gough(theta / mus, mus)
            axes.plot(line[1], line[0], color=GREY, linewidth=0.6, linestyle=":")
        axes.set_title(f"error of {name}", fontsize=9)
        tidy(axes, "$-M_z / (a F_z)$ [–]", "$F_y / F_z$ [–]" if axes is panels[0] else "")
    picture.colorbar(dots, ax=panels, shrink=0.9)
    picture.savefig(HERE / "gough.png", dpi=70)


if __name__ == "__main__":
    main()
    for name, value in properties().items():
        print(f"{name:45s} {value:.5g}")
