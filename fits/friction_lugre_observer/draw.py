"""Runs the LuGre observer of S section 3.4 on a simulated wheel.

``python -m fits.friction_lugre_observer.draw`` writes the figure to this folder and
prints the numbers. The wheel has the bristles of the whole patch, the observer only
their mean.
"""

from functools import cache
from pathlib import Path

import jax
import numpy as np

from fits.friction_lugre_observer.reference import FRICTIONS
from tirefit.online.base import Flag, code
from tirefit.online.methods import estimator_of
from tirefit.online.run import run
from tirefit.report.canvas import COLORS, DARK, GREY, Picture, tidy
from tirefit.sim.braking import LOAD, Braking, simulate_braking

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent
SEEDS = range(5)
TEETH, TOOTH = 10, 2.0
AMPLITUDE = 0.7
DROP = (10.5, 0.6)


@cache
def observed(friction: float, seed: int = 0, drop=None):
    """A log and its estimates, which start at theta = 1."""
    how = Braking(AMPLITUDE, TEETH, TOOTH, friction=friction, seed=seed, drop=drop, tire="lugre")
    log = simulate_braking(how)
    return log, run(estimator_of("lugre-observer", LOAD), log.columns)[1]


def properties() -> dict[str, float]:
    numbers = {}
    pulls = []
    for mu in FRICTIONS:
        ends = [observed(mu, seed)[1] for seed in SEEDS]
        numbers[f"mu = {mu:g}: mu"] = np.mean([end.value[-1, 0] for end in ends])
        numbers[f"mu = {mu:g}: theta"] = np.mean([end.value[-1, 1] for end in ends])
        pulls += [(end.value[-1, 0] - mu) / end.own_std[-1, 0] for end in ends]
    numbers["rms pull"] = np.sqrt(np.mean(np.square(pulls)))
    waits, early = [], 0
    for seed in SEEDS:
        log, seen = observed(0.9, seed, DROP)
        alarms = log.columns["time"][seen.flag == code(Flag.CHANGED)]
        early += np.count_nonzero(alarms < DROP[0])
        near = np.abs(seen.value[:, 0] - DROP[1]) < 0.05
        waits.append(np.argmax(near & (log.columns["time"] >= DROP[0])) / 100 - DROP[0])
    numbers |= {
        "drop: longest until within 0.05": max(waits),
        "drop: alarms before it": early,
        "drop: mu at the end": np.mean(
            [observed(0.9, seed, DROP)[1].value[-1, 0] for seed in SEEDS]
        ),
    }
    return {key: float(value) for key, value in numbers.items()}


def _panel(axes, log, seen, title: str) -> None:
    time, mu, std = log.columns["time"], seen.value[:, 0], seen.own_std[:, 0]
    sure = seen.flag == 0
    axes.fill_between(
        time, mu - 1.96 * std, mu + 1.96 * std, color=COLORS[0], alpha=0.2, linewidth=0
    )
    axes.plot(time, mu, color=GREY, linewidth=0.8, label="flagged")
    axes.plot(
        time, np.where(sure, mu, np.nan), color=COLORS[0], linewidth=1.2, label="estimate, 95 %"
    )
    axes.plot(time, log.truth["mu"], color=DARK, linestyle="--", label="truth")
    alarms = seen.flag == code(Flag.CHANGED)
    axes.plot(time[alarms], mu[alarms], "v", color="red", markersize=5, label="alarm")
    axes.set_title(title, fontsize=9)
    axes.set_ylim(0.2, 1.4)
    tidy(axes, "time [s]", "")


def main() -> None:
    picture = Picture(figsize=(8.2, 3.0), layout="constrained")
    panels = picture.subplots(1, 3, sharey=True)
    _panel(panels[0], *observed(0.4), r"$\mu = 0.4$")
    _panel(panels[1], *observed(0.9), r"$\mu = 0.9$")
    _panel(panels[2], *observed(0.9, 0, DROP), f"a drop to {DROP[1]:g}")
    panels[0].set_ylabel(r"$\mu$")
    panels[2].legend(fontsize=7, frameon=False, loc="upper right")
    picture.savefig(HERE / "observer.png", dpi=85)
    for key, value in properties().items():
        print(f"{key:28s} {value:.6g}")


if __name__ == "__main__":
    main()
