"""Report of simulated stops: text, and figures of the stops over time and of the path of slip
and friction on the curve of the tire."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from tirefit.params import check_names
from tirefit.report import canvas
from tirefit.report.numbers import bracketed, format_number
from tirefit.report.page import Rows, Section, report_text
from tirefit.sim.brake import Log
from tirefit.sim.brake_request import tire_curve
from tirefit.sim.brake_result import LOCKED_SLIP, UNITS, Braking, Stop

_SHORT = {
    "stopping_distance": "distance",
    "mean_friction_used": "friction used",
    "locked_time": "locked",
    "pressure_rms_fluctuation": "p rms",
    "recovery_time": "recovery",
}
"""Numbers shown in the terminal."""


def _rows(result: Braking) -> Rows:
    """One row for each controller: its numbers, with intervals over many seeds."""
    many = result.table()
    scales = {key: 1e-6 if UNITS[key] == "Pa" else 1.0 for key in _SHORT}
    units = {key: "MPa" if UNITS[key] == "Pa" else UNITS[key] for key in _SHORT}
    heads = (text + bracketed(units[key]) for key, text in _SHORT.items())
    rows = [["controller", *heads]]
    for name, stop in result.stops.items():
        cells = []
        for key, scale in scales.items():
            value = float(many[name][key]["mean"] if many else getattr(stop.summary, key))
            text = format_number(value * scale)
            if many and text != "-":
                text += f" ± {(many[name][key]['high'] - value) * scale:.2g}"
            cells.append(text)
        rows.append([name, *cells])
    return rows


def _notes(result: Braking) -> list[str]:
    notes = [f"{name}: {stop.summary.reason}" for name, stop in result.stops.items()]
    notes.append(f"locked: time with a wheel at kappa >= {LOCKED_SLIP:g}, above 2 m/s")
    for name, each in result.table().items():
        if each["stopped"] < each["stops"]:
            notes.append(f"{name}: {each['stopped']} of {each['stops']} stops ended")
    if result.many:
        stops = len(next(iter(result.many.values())).stopped)
        notes.append(
            f"means of {stops} seeds from {result.seed} on ± half a 95 % confidence interval"
        )
    return notes


def _head(result: Braking) -> str:
    r = result.request
    steer = f", steered {r.steer:g} rad" if r.steer else ""
    return f"{r.tire_name} from {r.speed:g} m/s on {r.road}{steer}, {r.vehicle}"


def braking_text(result: Braking) -> str:
    """The report for the terminal: numbers by controller, and why each stop ended."""
    section = Section("", _notes(result), _rows(result), right=range(1, len(_SHORT) + 1))
    return f"BRAKING {_head(result)}\n{report_text([section])}"


def plot_braking(result: Braking, what: str = "stop") -> canvas.Picture:
    """The ``stop`` of every controller over time, or their paths of ``slip``.

    Raises:
        UsageError: no such figure.
    """
    figures = {"stop": stop_figure, "slip": paths_figure}
    check_names("figure", [what], figures)
    return figures[what](result)


def _together(panels: Sequence[canvas.Panel], result: Braking) -> canvas.Picture:
    ends = []
    for name, stop in result.stops.items():
        distance, used = stop.summary.stopping_distance, stop.summary.mean_friction_used
        end = f"{distance:.1f} m" if np.isfinite(distance) else "no stop"
        ends.append(f"{name}: {end}, {100 * float(used):.0f} % of the friction")
    foot = f"tirefit {result.version} · braking positive, SI · seed {result.seed}"
    return canvas.together(panels, f"Braking: {_head(result)}", "; ".join(ends), foot)


Series = Callable[[Log], Any]
"""Values of a log: (n, w) of the wheels, or (n,)."""

_SERIES: dict[str, tuple[str, Series, Series | None]] = {
    "Speed of the wheels; dashed: of the car": (
        "m/s", lambda log: log.reading.wheel_speed, lambda log: log.motion.v_x,
    ),
    "Pressure of the wheels": ("MPa", lambda log: log.motion.pressure / 1e6, None),
    "Friction in use; dashed: available": (
        "–", lambda log: log.contacts.fx / log.contacts.fz, lambda log: log.reading.truth.mu[:, 0],
    ),
    "Slip κ; dashed: of the peak": (
        "–", lambda log: log.contacts.slips.kappa, lambda log: log.reading.truth.peak[:, 0],
    ),
    "Stiffness estimated of the first wheel; dashed: true": (
        "kN s/m", lambda log: log.info["xbs"][:, :1] / 1e3, lambda log: log.xbs_true[:, 0] / 1e3,
    ),
}  # fmt: skip
"""Title of a panel -> unit, a line for each wheel, and one of the first wheel or of the car."""


def draw_series(axes: Any, result: Braking, title: str) -> None:
    """One quantity of every controller over time, a colour for each.

    At the end of a stop slip and stiffness are without bound: the axis ends at the values while
    the car is faster than a third of its initial speed.
    """
    _, wheels, beside = _SERIES[title]
    highest = []
    for color, (name, stop) in zip(canvas.COLORS, result.stops.items(), strict=False):
        log = stop.log
        if "xbs" not in log.info and title.startswith("Stiffness"):
            continue
        values = [np.asarray(of(log)) for of in (wheels, beside) if of is not None]
        for shown, style in zip(values, ("-", "--"), strict=False):
            lines = axes.plot(log.reading.time, shown, style, color=color, lw=0.9, alpha=0.8)
            lines[0].set_label(name if style == "-" and title.startswith("Speed") else "")
        fast = np.asarray(log.motion.v_x > 0.3 * log.motion.v_x[0])
        highest += [np.nanpercentile(shown[fast], 97) for shown in values]
    top = 1.2 * float(np.max(highest)) or 1.0
    # The slope of the force is negative beyond its peak.
    axes.set_ylim((-0.4 if title.startswith("Stiffness") else -0.1) * top, top)


def stop_figure(result: Braking) -> canvas.Picture:
    """Speed, pressure, friction in use and slip over time, and the extended braking stiffness if
    a controller estimates it, as O Figures 8-9 and 12-13."""
    estimates = any("xbs" in stop.log.info for stop in result.stops.values())
    panels = [
        canvas.axes_panel(
            partial(draw_series, result=result, title=title), title, "time [s]", f"[{unit}]"
        )._replace(size=(canvas.WIDE, 2.1))
        for title, (unit, *_) in _SERIES.items()
        if estimates or not title.startswith("Stiffness")
    ]
    return _together(panels, result)


def _slowest_shown(stop: Stop) -> float:
    """Speed [m/s] below which the slip is not shown: there controllers switch off."""
    return min(2.0, 0.5 * float(stop.log.motion.v_x[0]))


class Path(NamedTuple):
    """Slip and use of one wheel's stop."""

    kappa: np.ndarray
    force: np.ndarray  # (n,) over the load
    mean: tuple[float, float]  # mean of both, the operating point of O Figure 10


def path_of(stop: Stop) -> Path:
    """The path of the first wheel while the car was faster than 2 m/s, or than half its initial
    speed if that was below 4 m/s."""
    log = stop.log
    fast = log.motion.v_x > _slowest_shown(stop)
    kappa = np.asarray(log.contacts.slips.kappa)[fast, 0]
    force = np.asarray(log.contacts.fx / log.contacts.fz)[fast, 0]
    return Path(kappa, force, (float(kappa.mean()), float(force.mean())))


def paths_figure(result: Braking) -> canvas.Picture:
    """Slip and friction of each controller on the tire's curve, and their mean, O Figure 10."""
    peak = max(float(np.max(s.log.reading.truth.peak)) for s in result.stops.values())
    limit = min(8.0 * peak, 1.0)  # largest slip shown, over that of the highest peak
    paths = {name: path_of(stop) for name, stop in result.stops.items()}

    def on_curve(axes: Any) -> None:
        for mu, (kappa, force) in tire_curve(result.request, limit).items():
            axes.plot(kappa, force, color=canvas.DARK, linewidth=1.1, zorder=1.5)
            place = kappa[len(kappa) // 2], force[len(kappa) // 2] - 0.02  # below the line
            canvas.boxed(axes, *place, f"tire at mu = {mu:g}", 7.5, ha="center", va="top")
        colored = [*zip(canvas.COLORS, paths.items(), strict=False)]
        # All lie on the same curve: the smaller dots are over the larger ones, those of a narrow
        # range of slip over those of a wide one.
        wide = sorted(colored, key=lambda item: -np.ptp(item[1][1].kappa))
        for smaller, (color, (_, path)) in enumerate(wide):
            size = 2.5 + 4.0 * (len(wide) - 1 - smaller)
            canvas.dots(axes, path.kappa, path.force, size, color, 0.6)
        for color, (name, path) in colored:
            marker = {"markersize": 8, "markeredgecolor": "white", "clip_on": False, "zorder": 4}
            label = f"{name}: mean κ {path.mean[0]:.2g}"
            axes.plot(
                min(path.mean[0], limit), path.mean[1], "o", color=color, label=label, **marker
            )
        axes.set_xlim(-0.02 * limit, limit)
        axes.set_ylim(bottom=0.0)

    slowest = min(map(_slowest_shown, result.stops.values()))
    note = f"line: the tire at its static load; dots: every sample above {slowest:.2g} m/s"
    title = "Slip and friction of the first wheel"
    return _together(
        [canvas.axes_panel(on_curve, title, "slip κ [–]", "$F_x/F_z$ [–]", note)], result
    )
