"""S Figures 21-24 and 26, and the asserted numbers.

``python -m fits.friction_while_braking.draw`` writes the figures to this folder and
prints the numbers; ``... .draw spread`` prints the standard errors from which the
tolerances of expected.toml follow. The logs are tirefit's simulation of S section 5.1, the
estimates ``tirefit.estimate``.
"""

import sys
from functools import cache
from pathlib import Path

import jax
import numpy as np
from PIL import Image

import tirefit
from fits.friction_while_braking.reference import AMPLITUDES, ASYMMETRIES, LESS, reference
from tirefit.data.read import read_frame
from tirefit.online.base import Flag, code
from tirefit.online.result import changes
from tirefit.report.canvas import COLORS, DARK, GREY, WIDE, Picture, legend_below, panel_title, tidy
from tirefit.sim.braking import Braking, simulate_braking

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent
SEEDS = range(5)
TEETH = 10
SOURCE = {
    "rls.average": 1,
    "rls.least_use": 0,
    "rls.cpa2": 2.5e5,
    # P0 = diag(2, 10) 1e-10 F_z^2 = prior^2 / noise^2.
    "rls.prior0": 0.0171,
    "rls.prior1": 0.0382,
}
"""S section 5.3: all samples, also near zero force, with its P0, lambda, theta_0."""
TOOTH = 2.0
PEAK = 0.98


@cache
def second_tire(amplitude: float, seed: int = 0):
    """RLS on the tire with less friction, braked with the same torque."""
    share = amplitude * PEAK / LESS
    how = Braking(amplitude=share, teeth=TEETH, friction=LESS, seed=seed)
    data = read_frame(simulate_braking(how).columns, "braking", mask_bad_rows=True)
    return tirefit.estimate(data, "rls")


@cache
def two_terms(d: float, seed: int = 0):
    """RLS with two terms and an asymmetry, at 60 % of the peak (S Figure 26)."""
    how = Braking(amplitude=0.6, teeth=TEETH, seed=seed)
    data = read_frame(simulate_braking(how).columns, "braking", mask_bad_rows=True)
    return tirefit.estimate(data, "rls", {"third": 0.0, "d": d})


@cache
def estimates(amplitude: float, seed: int = 0, drop: float | None = None):
    """(log, estimates with default settings, estimates with the settings of S)."""
    change = None if drop is None else (TEETH + 0.0, drop)
    how = Braking(amplitude=amplitude, teeth=TEETH, seed=seed, drop=change)
    log = simulate_braking(how)
    data = read_frame(log.columns, "braking", mask_bad_rows=True)
    ours = tirefit.estimate(data, ["rls", "mit", "ekf"])
    return log, ours, tirefit.estimate(data, "rls", SOURCE)


def finals(seeds=SEEDS) -> dict[str, list[float]]:
    """Last estimates by name, one per seed."""
    ends: dict[str, list[float]] = {}

    def put(key, value):
        ends.setdefault(key, []).append(float(value))

    for seed in seeds:
        for amplitude in AMPLITUDES:
            name = f"{100 * amplitude:.0f} %"
            _, ours, source = estimates(amplitude, seed)
            for method in ("rls", "ekf"):
                for parameter in ("mu", "cpa2"):
                    value = ours[method][parameter][-1]
                    put(f"{name}: {method} {parameter}", value)
                    target = reference_of(f"{name}: {parameter}")
                    std = own_std(ours[method], parameter)[-1]
                    put(f"{name}: {method} {parameter}, pull", (value - target) / std)
            put(f"{name}: rls mu, settings of S", source["rls"]["mu"][-1])
            other = second_tire(amplitude, seed)["rls"]["mu"][-1]
            put(f"{name}: rls mu, second tire", other)
        for d in ASYMMETRIES:
            put(f"60 %: rls mu, two terms, d = {d:g}", two_terms(d, seed)["rls"]["mu"][-1])
    return ends


def own_std(method, parameter: str) -> np.ndarray:
    """Standard deviations (n,) by the method alone, without the scatter of its estimates."""
    return method.own_std[:, method.parameters.index(parameter)]


@cache
def reference_of(name: str) -> float:
    return reference()[name]


def properties() -> dict[str, float]:
    """Numbers of the estimates by name, as explained in expected.toml."""
    numbers = {}
    for key, ends in finals().items():
        if key.endswith(", pull"):
            numbers[f"{key[:-6]}, rms pull"] = np.sqrt(np.mean(np.square(ends)))
        else:
            numbers[key] = np.mean(ends)
    for amplitude in AMPLITUDES:
        name = f"{100 * amplitude:.0f} %"
        numbers[f"{name}: largest sigma"] = estimates(amplitude)[0].truth["sigma_x"].max()
    pulls = [value for key, value in numbers.items() if key.endswith("rms pull")]
    numbers["largest rms pull"] = max(pulls)
    return {key: float(value) for key, value in (numbers | start() | drops()).items()}


def start() -> dict[str, float]:
    """Irregularities at the start, at 75 % of the peak."""
    _, ours, source = estimates(0.75)
    early = ours.time < 2 * TOOTH
    target = reference_of("75 %: mu")
    supported = ours["rls"].flag == 0
    pulls = [abs(run["rls"]["mu"] - target) / own_std(run["rls"], "mu") for run in (ours, source)]
    return {
        "75 %: share of the first second that is flagged": np.mean(
            ours["rls"].flag[ours.time < 1] > 0
        ),
        "75 %: largest pull of rls mu where not flagged": pulls[0][supported].max(),
        "75 %: largest pull in two teeth, settings of S": np.nanmax(pulls[1][early]),
    }


def drops() -> dict[str, float]:
    """Detections by ekf of a drop to 0.6 in the middle of five logs."""
    found, alarms = [], 0
    for seed in SEEDS:
        ours = estimates(0.6, seed, 0.6)[1]
        found += [c for c in changes(ours.time, ours["ekf"]) if c.parameter == "mu"]
        early = ours.time < TEETH
        alarms += np.count_nonzero(ours["ekf"].flag[early] == code(Flag.CHANGED))
    return {
        "drop: changes of mu found": len(found),
        "drop: mean delay": np.mean([c.time for c in found]) - TEETH,
        "drop: largest delay": np.max([c.time for c in found]) - TEETH,
        "drop: alarms before it": alarms,
    }


def spread() -> None:
    """Means over 20 other seeds, and the standard error of the mean of five."""
    for key, ends in finals(range(100, 120)).items():
        error = np.std(ends, ddof=1) / np.sqrt(len(SEEDS))
        print(f"{key:40s} {np.mean(ends):.5g} {error:.2g} {error / np.mean(ends):.2%}")


def main() -> None:
    picture = Picture(figsize=(WIDE, 9.0), layout="constrained")
    axes = picture.subplots(6, 1, sharex=True, height_ratios=[1, 2] * 3)
    for above, below, amplitude in zip(axes[::2], axes[1::2], AMPLITUDES, strict=True):
        log, ours, source = estimates(amplitude)
        time = ours.time
        above.plot(time, log.columns["fx"] / 27e3, color=GREY, linewidth=0.3)
        above.plot(time, log.truth["fx"] / 27e3, color=DARK, linewidth=0.8)
        above.set_ylim(-0.05, 0.95)
        panel_title(above, f"{100 * amplitude:.0f} % of the peak")
        tidy(above, "", "$F_x / F_z$ [–]")
        target = reference()[f"{100 * amplitude:.0f} %: mu"]
        below.axhline(PEAK, color=DARK, linewidth=0.8, linestyle="--", label="peak")
        below.axhline(target, color=DARK, linewidth=0.8, linestyle=":", label="brush")
        for color, name in zip(COLORS, ours.methods, strict=False):
            mu, std = ours[name]["mu"], own_std(ours[name], "mu")
            below.plot(time, mu, color=color, linewidth=1, label=name)
            below.fill_between(time, mu - std, mu + std, color=color, alpha=0.15, linewidth=0)
        below.plot(
            time, source["rls"]["mu"], color=COLORS[3], linewidth=0.8, label="rls, settings of S"
        )
        below.set_ylim(0.2, 1.8)
        tidy(below, "time [s]" if below is axes[-1] else "", "$\\mu$ [–]")
    legend_below(picture, axes[-1].get_legend_handles_labels()[0], columns=3)
    picture.savefig(HERE / "friction.png", dpi=90)
    # 96 colours: bands that overlap have thousands.
    Image.open(HERE / "friction.png").quantize(96).save(HERE / "friction.png", optimize=True)


def draw_tires() -> None:
    """S Figure 24, two tires, and 26, two terms with three asymmetries."""
    picture = Picture(figsize=(WIDE, 6.2), layout="constrained")
    upper, middle, lower = panels = picture.subplots(3, 1, sharex=True, sharey=True)
    for axes, amplitude in ((upper, 0.5), (middle, 0.75)):
        _, ours, _ = estimates(amplitude)
        other = second_tire(amplitude)
        for color, run, name in ((COLORS[0], ours, "0.98"), (COLORS[1], other, "0.875")):
            axes.plot(run.time, run["rls"]["mu"], color=color, label=f"peak {name}")
        panel_title(axes, f"rls, {100 * amplitude:.0f} % of the first peak")
    for color, d in zip(COLORS, ASYMMETRIES, strict=False):
        ours = two_terms(d)
        lower.plot(ours.time, ours["rls"]["mu"], color=color, label=f"d = {d:g}")
    lower.axhline(PEAK, color=DARK, linewidth=0.8, linestyle="--")
    panel_title(lower, "rls, two terms, 60 %")
    lower.set_ylim(0.4, 1.6)
    for axes in panels:
        tidy(axes, "time [s]" if axes is lower else "", "$\\mu$ [–]")
        axes.legend(fontsize=8, frameon=False, loc="lower right", ncols=3)
    picture.savefig(HERE / "tires_and_asymmetry.png")


if __name__ == "__main__" and "spread" in sys.argv:
    spread()
elif __name__ == "__main__":
    main()
    draw_tires()
    for name, value in properties().items():
        print(f"{name:35s} {value:.5g}")
