"""Report of simulated stops: text, and figures of the stops over time and of the path of slip
and friction on the curve of the tire."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.table import WHEELS
from tirefit.params import check_names
from tirefit.report.canvas import COLORS, DARK, GREY, WIDE, Picture, boxed, dots, panel_title, tidy
from tirefit.report.numbers import format_number, plain_text
from tirefit.report.page import Rows, Section, report_text
from tirefit.sim.brake_request import tire_curve
from tirefit.sim.brake_result import MEANINGS, UNITS, Braking, Stop
from tirefit.sim.brake_vehicle import road_of

_SHORT = {
    "stopping_distance": "distance",
    "mean_friction_used": "friction used",
    "locked_time": "locked",
    "pressure_rms_fluctuation": "p rms",
    "recovery_time": "recovery",
}
"""Numbers shown in the terminal."""
_LEGEND: dict[str, Any] = {"facecolor": "white", "edgecolor": "none"}
_LIMITED = ("pressure", "slip", "stiffness")
"""Panels of a stop whose axis ends at the values while the car is fast."""
_SLOWEST_SHOWN = 2.0
"""Speed [m/s] above which a path of slip is shown; below, controllers switch off."""
_PEAKS_SHOWN = 8.0  # largest slip shown, over that of the highest peak


def _scaled(name: str) -> tuple[float, str]:
    unit = UNITS[name]
    return (1e-6, "MPa") if unit == "Pa" else (1.0, unit)


def _asked(result: Braking) -> dict[str, str]:
    """Number -> heading; without a recovery time if the road does not change."""
    jumps = road_of(result.request.road).jumps
    return {k: v for k, v in _SHORT.items() if jumps or k != "recovery_time"}


def _rows(result: Braking) -> Rows:
    """One row for each controller: its numbers, with intervals over many seeds."""
    asked, many = _asked(result), result.table()
    heads = ((text, _scaled(name)[1]) for name, text in asked.items())
    rows = [["controller", *(t if unit == "-" else f"{t} [{unit}]" for t, unit in heads)]]
    for name, stop in result.stops.items():
        row = [name]
        for key in asked:
            scale, half = _scaled(key)[0], None
            value = float(getattr(stop.summary, key))
            if many:
                value = many[name][key]["mean"]
                half = (many[name][key]["high"] - value) * scale
            text = format_number(value * scale)
            row.append(text if half is None or text == "-" else f"{text} ± {half:.2g}")
        rows.append(row)
    return rows


def _notes(result: Braking) -> list[str]:
    notes = [f"{name}: {stop.reason}" for name, stop in result.stops.items()]
    notes.append(f"locked: {MEANINGS['locked_time']}")
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
    right = range(1, len(_asked(result)) + 1)
    section = Section("", _notes(result), _rows(result), right=right)
    return f"BRAKING {_head(result)}\n{report_text([section])}"


def plot_braking(result: Braking, what: str = "stop") -> Picture:
    """The ``stop`` of every controller over time, or their paths of ``slip``.

    Raises:
        UsageError: no such figure.
    """
    figures = {"stop": stop_figure, "slip": paths_figure}
    check_names("figure", [what], figures)
    return figures[what](result)


def _foot(picture: Picture, result: Braking) -> None:
    foot = f"tirefit {result.version} · braking positive, SI · seed {result.seed} · {_head(result)}"
    picture.supxlabel(plain_text(foot), fontsize=6.5, color=GREY)


class Line(NamedTuple):
    """One line over time: values (n,), label, colour and style."""

    values: Any  # array of NumPy or JAX
    label: str
    color: str = DARK
    style: str = "-"


def lines_of(stop: Stop) -> dict[str, list[Line]]:
    """Label of a panel -> its lines, as O Figures 8-9 and 12-13, with slip and friction below;
    and the extended braking stiffness of the first wheel if a controller estimates it."""
    log, info = stop.log, stop.log.info
    names = list(WHEELS.values()) if len(stop.wheels) == 4 else ["wheel"]

    def wheels(values: Any) -> list[Line]:
        return [Line(values[:, k], name, COLORS[k]) for k, name in enumerate(names)]

    # One lane per wheel, because the valves would hide each other.
    lanes = 0.4 * np.clip(log.valve, -1, 1) - np.arange(log.valve.shape[1])
    truth, of = log.reading.truth, f" ({names[0]})" if len(names) > 1 else ""
    speeds = [*wheels(log.reading.wheel_speed), Line(log.motion.v_x, "body")]
    if "reference_speed" in info:
        speeds.append(Line(info["reference_speed"][:, 0], "reference", DARK, ":"))
    used = Line(truth.mu[:, 0], f"available $\\mu${of}", GREY, "--")
    peak = Line(truth.peak[:, 0], f"of the peak{of}", GREY, "--")
    panels = {
        "speed [m/s]": speeds,
        "pressure [MPa]": wheels(log.motion.pressure / 1e6),
        "valve": wheels(lanes),
        "deceleration\n[m/s²]": [Line(log.reading.deceleration, "")],
        "$F_x/F_z$ [–]": [*wheels(log.contacts.fx / log.contacts.fz), used],
        "slip $\\kappa$ [–]": [*wheels(log.contacts.slips.kappa), peak],
    }
    if "xbs" in info:
        stiffness = [Line(log.xbs_true[:, 0] / 1e3, "true", GREY)]
        stiffness.append(Line(info["xbs"][:, 0] / 1e3, "estimated", COLORS[0]))
        if "xbs_wanted" in info:
            stiffness.append(Line(info["xbs_wanted"][:, 0] / 1e3, "wanted, O(22)", DARK, ":"))
        panels["stiffness $k$\n[kN s/m]"] = stiffness
    return panels


def _reach(stop: Stop, lines: Sequence[Line]) -> float:
    """Upper axis limit of lines by the time in which the car is fast; at the end of a stop
    slip and stiffness are without bound."""
    fast = np.asarray(stop.log.motion.v_x > 0.3 * stop.log.motion.v_x[0])
    highest = [np.nanpercentile(line.values[fast], 97) for line in lines]
    return 1.2 * float(np.max(highest)) or 1.0


def stop_figure(result: Braking) -> Picture:
    """Every controller in a column: speeds, pressure, valves, deceleration, use, slip."""
    columns = {name: lines_of(stop) for name, stop in result.stops.items()}
    labels = max(columns.values(), key=len)
    picture = Picture(
        figsize=(max(WIDE, 3.6 * len(columns)), 1.6 * len(labels)), layout="constrained"
    )
    shape = len(labels), len(columns)
    grid = picture.subplots(*shape, sharex=True, sharey="row", squeeze=False)
    reach: dict[str, list[float]] = {}
    for number, (name, panels) in enumerate(columns.items()):
        stop, column = result.stops[name], grid[:, number]
        for axes, label in zip(column, labels, strict=True):
            for line in panels.get(label, ()):
                style = {"color": line.color, "linestyle": line.style, "linewidth": 0.8}
                axes.plot(stop.log.reading.time, line.values, label=line.label, **style)
            tidy(axes, "", label if number == 0 else "")
            if label in panels and label.startswith(_LIMITED):
                reach.setdefault(label, []).append(_reach(stop, panels[label]))
        distance, used = stop.summary.stopping_distance, stop.summary.mean_friction_used
        end = f"{distance:.1f} m, " if np.isfinite(distance) else "no stop, "
        panel_title(column[0], name, f"{end}{100 * float(used):.0f} % of the friction")
        column[-1].set_xlabel("time [s]", fontsize=8.5, color=DARK)
    for (label, lines), row in zip(labels.items(), grid, strict=True):
        if label in reach:
            row[0].set_ylim(max(min(row[0].get_ylim()[0], 0.0), -1.0), max(reach[label]))
        if label == "valve":
            row[0].set_yticks(-np.arange(len(lines)), [line.label for line in lines])
        elif label.startswith(("speed", "stiffness")):
            last = [axes for axes in row if axes.lines][-1]
            last.legend(fontsize=7, **_LEGEND, loc="upper right", ncols=2)
    _foot(picture, result)
    return picture


def _slowest_shown(stop: Stop) -> float:
    """Speed [m/s] below which the slip of a wheel is not shown."""
    return min(_SLOWEST_SHOWN, 0.5 * float(stop.log.motion.v_x[0]))


class Path(NamedTuple):
    """Slip and use of one wheel's stop."""

    kappa: np.ndarray
    force: np.ndarray  # (n,) over the load
    mean: tuple[float, float]  # mean of both, the operating point of O Figure 10


def path_of(stop: Stop, wheel: int = 0) -> Path:
    """The path of a wheel while the car was faster than 2 m/s, or than half its initial
    speed if that was below 4 m/s."""
    log = stop.log
    fast = log.motion.v_x > _slowest_shown(stop)
    kappa = np.asarray(log.contacts.slips.kappa)[fast, wheel]
    force = np.asarray(log.contacts.fx / log.contacts.fz)[fast, wheel]
    return Path(kappa, force, (float(kappa.mean()), float(force.mean())))


def paths_figure(result: Braking) -> Picture:
    """Slip and friction of each controller on the curve of the tire, and their mean, O Figure 10.

    Below: the share of time that it spent at each slip, locked wheels at the right end.
    """
    picture = Picture(figsize=(WIDE, 4.8), layout="constrained")
    axes, below = picture.subplots(2, 1, sharex=True, height_ratios=(3, 1.3))
    peak = max(float(np.max(s.log.reading.truth.peak)) for s in result.stops.values())
    limit = min(_PEAKS_SHOWN * peak, 1.0)
    for mu, (kappa, force) in tire_curve(result.request, limit).items():
        axes.plot(kappa, force, color=DARK, linewidth=1.1, zorder=3)
        boxed(
            axes, kappa[-1], force[-1] + 0.02, f"tire at mu = {mu:g}", 7.5, ha="right", va="bottom"
        )
    edges = np.linspace(0.0, limit, 41)
    for color, (name, stop) in zip(COLORS, result.stops.items(), strict=False):
        path = path_of(stop)
        dots(axes, path.kappa, path.force, 2, color, 0.35)
        beyond = path.mean[0] > limit
        label = f"{name}: mean" + f", at $\\kappa$ = {path.mean[0]:.2f}" * beyond
        marker = {"markersize": 8, "markeredgecolor": "white", "clip_on": False, "zorder": 4}
        place = min(path.mean[0], limit), path.mean[1]
        axes.plot(*place, ">" if beyond else "o", color=color, label=label, **marker)
        counts, _ = np.histogram(np.clip(path.kappa, 0.0, limit), edges)
        share = 100 * counts / max(len(path.kappa), 1)
        below.stairs(share, edges, color=color, linewidth=1.1)
    axes.set_xlim(-0.02 * limit, limit)
    axes.set_ylim(bottom=0.0)
    tidy(axes, "", "$F_x/F_z$ [–]")
    tidy(below, "slip $\\kappa$ [–]; larger slips are in the last bar", "time [%]")
    axes.legend(fontsize=8, **_LEGEND, loc="lower right")
    slowest = min(map(_slowest_shown, result.stops.values()))
    note = f"line: the tire at its static load; dots: every sample above {slowest:.2g} m/s"
    panel_title(axes, "Slip and friction of the first wheel", note)
    _foot(picture, result)
    return picture
