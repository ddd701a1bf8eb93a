"""The figure and the asserted numbers of the diagnoses.

``python -m fits.diagnosis_measured.draw`` writes ``held_out.png`` to this folder.
"""

import tomllib
from pathlib import Path

import jax
import numpy as np

import tirefit
from fits.diagnosis_measured.reference import fitted, force, logs_of, rmse
from tirefit.report.canvas import BLUE, DARK, GREY, Picture, tidy

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent
WHEELS = HERE.parent / "cmu_wheel"


def axle(name: str):
    return tirefit.read(HERE / f"{name}.csv", convention="braking")


def wheel(name: str):
    """The rover wheel, read with the settings of ``cmu_wheel``."""
    declared = tomllib.loads((WHEELS / "fit.toml").read_text())["data"]
    return tirefit.read(WHEELS / f"{name}.csv", **declared)


def _confident_name(verdict) -> float:
    """Probability of the named effects, 0 without any."""
    return 0.0 if verdict.status == "unknown" else verdict.probability


def properties() -> dict:
    found = tirefit.diagnose(axle("diagnosed"), holdout=[axle("held_out")])
    gap, best = found.gap, found.candidates[0]
    held = gap.holdout
    values = {
        "axle: status": found.verdict.status,
        "axle: effects": list(found.effects),
        "axle: probability": found.verdict.probability,
        "axle: shift": best.parameters["slip_offset: amplitude"].value,
        "axle: noise": found.noise.forces["fy"],
        "axle: gap": gap.rms,
        "axle: gap left": gap.remaining_rms,
        "axle: held-out gap": held.rms,
        "axle: held-out gap left": held.remaining_rms,
        "axle: held-out closed": held.closed,
        "axle: held-out closed, interval": list(held.closed_ci),
    }
    for name in ("smooth_wheel", "grouser_wheel"):
        verdict = tirefit.diagnose(wheel(name)).verdict
        values[f"{name}: status"] = verdict.status
        values[f"{name}: probability of what is named"] = _confident_name(verdict)
    return values


def main() -> None:
    seen, held = logs_of("diagnosed"), logs_of("held_out")
    rows, others = (np.hstack(list(logs.values())) for logs in (seen, held))
    plain, shifted = fitted(rows, False), fitted(rows, True)
    picture = Picture(figsize=(7.0, 3.2), layout="constrained")
    left, right = picture.subplots(1, 2)
    angle = np.linspace(others[0].min(), others[0].max(), 300)
    curve = np.stack([angle, angle, np.full(300, others[2].mean())])
    left.plot(np.degrees(others[0]), others[1], ".", ms=1.5, color=GREY)
    left.plot(np.degrees(angle), force(curve, *plain), "--", color=DARK, label="brush")
    left.plot(np.degrees(angle), force(curve, *shifted), color=BLUE, label="brush at α - 8.8 mrad")
    left.set_title("held-out logs, nothing fitted to them", fontsize=9)
    tidy(left, "slip angle α [°]", "side force $F_y$ [N]")
    logs = [*seen.values(), *held.values()]
    place = np.arange(len(logs))
    for step, parameters, color in ((-0.2, plain, DARK), (0.2, shifted, BLUE)):
        right.bar(place + step, [rmse(log, *parameters) for log in logs], 0.38, color=color)
    right.axvline(2.5, color=GREY, lw=0.8, ls=":")
    right.set_xticks(place, [str(k + 1) for k in place])
    right.set_title("left of the line: diagnosed; right: held out", fontsize=9)
    tidy(right, "log, in the order of recording", "RMSE [N]")
    left.legend(fontsize=7, frameon=False, loc="upper left")
    picture.savefig(HERE / "held_out.png")


if __name__ == "__main__":
    main()
    for name, value in properties().items():
        print(f"{name:50s} {value}")
