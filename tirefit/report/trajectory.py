"""A fit by trajectory as text and as a picture."""

import numpy as np

from tirefit.diagnosis.summary.result import UNITS
from tirefit.models import TireInputs, forces
from tirefit.report.canvas import BLUE, GREY, Picture, dots, panel_title, tidy
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.page import indented, table
from tirefit.vehicle.trajectory import UNKNOWNS, TrajectoryFit

_DRAWN, _POINTS, _REACH = 60, 1500, 99.5
"""Number of draws of a band, of derived points, and percentile of |slip angle| drawn."""


def trajectory_text(fit: TrajectoryFit) -> str:
    """The report: tires and unknowns of the car, noise, assumptions."""
    models = ", ".join(f"{axle} {tire.name}" for axle, tire in fit.axles.items())
    head = f"FIT BY TRAJECTORY: {models}; {fit.windows} windows of {', '.join(fit.logs)}"
    noise = (f"{name} {format_number(std, 2)} {UNITS[name]}" for name, std in fit.noise.items())
    answer = f"rms error of the car within a window, on these tires: {', '.join(noise)}"
    rows = [["parameter", "value ± std", "95 % interval", "unit", ""]]
    for name, one in fit.parameters.items():
        interval = " to ".join(format_number(end, 3) for end in one.ci95)
        note = UNKNOWNS[name].meaning if name in UNKNOWNS else ""
        note = note if one.identified else "NOT IDENTIFIED"
        rows.append([name, format_estimate(one.value, one.std), interval, one.unit, note])
    notes = [
        f"95 % by covariance; {fit.blocks} blocks of windows count as independent",
        "speed and steering are those of the log; axle loads are static; no drive force",
    ]
    first, last = ([x for y in z for x in indented(y)] for z in ((*fit.warnings, answer), notes))
    return "\n".join([head, "ANSWER", *first, "FOUND", *table(rows), "NOTES", *last])


def trajectory_figure(fit: TrajectoryFit) -> Picture:
    """Lateral force of both axles with its 95 % band, over the points that ``derive``
    gives, with the steering as it was logged."""
    picture = Picture(figsize=(9.0, 3.8), layout="constrained")
    generator = np.random.default_rng(0)
    for ax, (axle, tire) in zip(picture.subplots(1, 2), fit.axles.items(), strict=True):
        rows = fit.rows[axle]
        some = generator.permutation(len(rows))[:_POINTS]
        alpha, force = rows["alpha"][some], rows["fy"][some]
        dots(ax, alpha, force, 1.4, GREY, label="derived from the log")
        reach = np.percentile(np.abs(rows["alpha"]), _REACH)
        alpha, fz, v = np.linspace(-reach, reach, 121), rows["fz"][0], rows["v"].mean()

        at = TireInputs(alpha=alpha, fz=fz, v=v)
        drawn = [np.asarray(forces(one, at).fy) for one in tire.drawn(generator, _DRAWN)]
        low, high = np.percentile(drawn, (2.5, 97.5), axis=0)
        ax.fill_between(alpha, low, high, color=BLUE, alpha=0.3, lw=0, label="95 %")
        ax.plot(alpha, forces(tire.tire, at).fy, color=BLUE, lw=1.4, label=tire.name)
        tidy(ax, "slip angle [rad]", "lateral force of the axle [N]")
        panel_title(ax, f"{axle.capitalize()} axle, by trajectory")
        ax.legend(frameon=False, fontsize=7.5)
    return picture
