"""S Figures 21-23, and what is asserted of them.

``python -m fits.friction_while_braking.draw`` writes the figure beside this file. The
logs are tirefit's simulation of S section 5.1, the estimates ``tirefit.estimate``.
"""

from functools import cache
from pathlib import Path

import jax
import numpy as np

import tirefit
from fits.friction_while_braking.reference import AMPLITUDES, reference
from tirefit.data.read import read_frame
from tirefit.report.canvas import COLORS, DARK, GREY, Picture, tidy
from tirefit.sim.braking import Braking, simulate_braking

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent
SEEDS = range(5)
TEETH = 10
SOURCE = {
    "rls.average": 1, "rls.least_use": 0, "rls.cpa2": 2.5e5,
    # P0 = diag(2, 10) 1e-10 F_z^2 = prior^2 / noise^2.
    "rls.prior0": 0.0171, "rls.prior1": 0.0382,
}  # fmt: skip
"""S section 5.3 as it is: every sample, the near-zero force too, and its P0."""


@cache
def estimates(amplitude: float, seed: int = 0, drop: float | None = None):
    """(log, estimates as they are by default, those with the settings of S)."""
    change = None if drop is None else (TEETH + 0.0, drop)
    how = Braking(amplitude=amplitude, teeth=TEETH, seed=seed, drop=change)
    log = simulate_braking(how)
    data = read_frame(log.columns, "braking", mask_bad_rows=True)
    ours = tirefit.estimate(data, ["rls", "mit", "ekf"])
    return log, ours, tirefit.estimate(data, "rls", SOURCE)


def properties() -> dict[str, float]:
    """Numbers read off the estimates, by name; expected.toml says what they are."""
    numbers = {}
    for amplitude in AMPLITUDES:
        name = f"{100 * amplitude:.0f} %"
        runs = [estimates(amplitude, seed) for seed in SEEDS]
        numbers[f"{name}: largest sigma"] = runs[0][0].truth["sigma_x"].max()
        best = reference()
        for method in ("rls", "ekf"):
            for parameter in ("mu", "cpa2"):
                ends = [
                    (ours[method][parameter][-1], ours[method].std_of(parameter)[-1])
                    for _, ours, _ in runs
                ]
                target = best[f"{name}: {parameter}"]
                pulls = [(value - target) / std for value, std in ends]
                key = f"{name}: {method} {parameter}"
                numbers[key] = np.mean([value for value, _ in ends])
                numbers[f"{key}, rms pull"] = np.sqrt(np.mean(np.square(pulls)))
        printed = [source["rls"]["mu"][-1] for _, _, source in runs]
        numbers[f"{name}: rls mu, settings of S"] = np.mean(printed)
    alarms = [
        change.time
        for seed in SEEDS
        for change in _changes(estimates(0.6, seed, 0.6)[1])
    ]
    numbers["drop: changes of mu found"] = len(alarms)
    numbers["drop: mean delay"] = np.mean(alarms) - TEETH
    return {key: float(value) for key, value in numbers.items()}


def _changes(ours):
    from tirefit.online.result import changes

    return [c for c in changes(ours.time, ours["ekf"]) if c.parameter == "mu"]


def main() -> None:
    picture = Picture(figsize=(8.2, 4.6), layout="constrained")
    axes = picture.subplots(2, 3, sharex=True, sharey="row", height_ratios=[1, 2])
    for (above, below), amplitude in zip(axes.T, AMPLITUDES, strict=True):
        log, ours, source = estimates(amplitude)
        time = ours.time
        above.plot(time, log.columns["fx"] / 27e3, color=GREY, linewidth=0.3)
        above.plot(time, log.truth["fx"] / 27e3, color=DARK, linewidth=0.8)
        above.set_title(f"{100 * amplitude:.0f} % of the peak", fontsize=9)
        tidy(above, "", "$F_x / F_z$ [–]" if amplitude == AMPLITUDES[0] else "")
        target = reference()[f"{100 * amplitude:.0f} %: mu"]
        below.axhline(0.98, color=DARK, linewidth=0.8, linestyle="--", label="peak")
        below.axhline(target, color=DARK, linewidth=0.8, linestyle=":", label="brush")
        for color, name in zip(COLORS, ours.methods, strict=False):
            mu, std = ours[name]["mu"], ours[name].std_of("mu")
            below.plot(time, mu, color=color, linewidth=1, label=name)
            below.fill_between(
                time, mu - std, mu + std, color=color, alpha=0.15, linewidth=0
            )
        below.plot(
            time, source["rls"]["mu"], color=COLORS[3], linewidth=0.8,
            label="rls, settings of S",
        )  # fmt: skip
        below.set_ylim(0.2, 1.8)
        tidy(below, "time [s]", "$\\mu$ [–]" if amplitude == AMPLITUDES[0] else "")
    axes[1, 2].legend(fontsize=7, frameon=False, ncols=2)
    picture.savefig(HERE / "friction.png", dpi=85)


if __name__ == "__main__":
    main()
    for name, value in properties().items():
        print(f"{name:35s} {value:.5g}")
