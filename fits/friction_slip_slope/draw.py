"""Estimates the slope of the slip curve of a gently braked wheel, S section 3.1.

``python -m fits.friction_slip_slope.draw`` writes the figure to this folder and
prints the numbers. The logs are tirefit's simulation of S section 5.1.
"""

from functools import cache
from pathlib import Path

import jax
import numpy as np

from fits.friction_slip_slope.reference import USE, reference
from tirefit.online.methods import estimator_of
from tirefit.online.run import run
from tirefit.online.slip_slope import ROADS
from tirefit.report.canvas import COLORS, DARK, Picture, tidy
from tirefit.sim.braking import LOAD, Braking, simulate_braking

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent
SEEDS = range(5)
TEETH = 30
METHODS = ("slip-slope", "slip-slope-braking")


@cache
def estimates(method: str, seed: int):
    """Time [s] and estimates along a log."""
    log = simulate_braking(Braking(USE, TEETH, seed=seed)).columns
    return log["time"], run(estimator_of(method, LOAD), log)[1]


def properties() -> dict[str, float]:
    numbers, line = {}, reference()
    for method in METHODS:
        ends = [estimates(method, seed)[1] for seed in SEEDS]
        slopes = np.array([end.value[-1, 0] for end in ends])
        stds = np.array([end.std[-1, 0] for end in ends])
        numbers[f"{method}: slope"] = slopes.mean()
        numbers[f"{method}: offset"] = np.mean([end.value[-1, 1] for end in ends])
        pulls = (slopes - line["slope"]) / stds
        numbers[f"{method}: rms pull"] = np.sqrt(np.mean(pulls**2))
        roads = {ROADS[int(end.value[-1, 3]) - 1] for end in ends}
        numbers[f"{method}: logs called asphalt"] = float(roads == {"asphalt"})
    return {key: float(value) for key, value in numbers.items()}


def main() -> None:
    picture = Picture(figsize=(8.2, 2.8), layout="constrained")
    panels = picture.subplots(1, 2, sharey=True)
    line = reference()
    for axes, method in zip(panels, METHODS, strict=True):
        time, seen = estimates(method, 0)
        value, std = seen.value[:, 0], seen.std[:, 0]
        low, high = value - 1.96 * std, value + 1.96 * std
        axes.fill_between(time, low, high, color=COLORS[0], alpha=0.2, linewidth=0)
        axes.plot(time, value, color=COLORS[0], label="estimate, 95 %")
        axes.axhline(line["slope"], color=DARK, ls="--", label="closest line")
        axes.axhline(line["slope at rest"], color=DARK, ls=":", label="at rest")
        axes.set_title(method, fontsize=9)
        axes.set_ylim(10, 30)
        tidy(axes, "time [s]", "slope k" if method == METHODS[0] else "")
    panels[1].legend(fontsize=7, frameon=False)
    picture.savefig(HERE / "slope.png", dpi=85)
    for key, number in properties().items():
        print(f"{key:40s} {number:.6g}")


if __name__ == "__main__":
    main()
