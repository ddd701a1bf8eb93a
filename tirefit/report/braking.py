"""Report of simulated stops: text, and figures of a stop, of a comparison of controllers,
and of the path of slip and friction on the curve of the tire."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.table import WHEELS
from tirefit.params import check_names
from tirefit.report.canvas import COLORS, DARK, GREY, Picture, panel_title, tidy
from tirefit.report.numbers import format_number, plain_text
from tirefit.report.page import table
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
_SLOWEST_SHOWN = 2.0
"""Speed [m/s] above which a path of slip is shown; below, controllers switch off."""
_PEAKS_SHOWN = 8.0  # largest slip shown, over that of the highest peak


def _cell(value: float, scale: float = 1.0) -> str:
    return "-" if not np.isfinite(value) else format_number(value * scale)


def _scaled(name: str) -> tuple[float, str]:
    unit = UNITS[name]
    return (1e-6, "MPa") if unit == "Pa" else (1.0, unit)


def _asked(result: Braking) -> dict[str, str]:
    """Number -> heading; without a recovery time if the road does not change."""
    jumps = road_of(result.request.road).jumps
    return {k: v for k, v in _SHORT.items() if jumps or k != "recovery_time"}


def _rows(result: Braking) -> list[list[str]]:
    """One row for each controller: its numbers, with intervals over many seeds."""
    head = ["controller"]
    for name, text in _asked(result).items():
        unit = _scaled(name)[1]
        head.append(text if unit == "-" else f"{text} [{unit}]")
    rows = [head]
    many = result.table()
    for name, stop in result.stops.items():
        row = [name]
        for key in _asked(result):
            scale, _ = _scaled(key)
            if not many:
                row.append(_cell(float(getattr(stop.summary, key)), scale))
                continue
            each = many[name][key]
            half = (each["high"] - each["mean"]) * scale
            mean = _cell(each["mean"], scale)
            row.append(mean if mean == "-" else f"{mean} ± {half:.2g}")
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
    notes = [f"  {note}" for note in _notes(result)]
    right = tuple(range(1, len(_asked(result)) + 1))
    return "\n".join([f"BRAKING {_head(result)}", *table(_rows(result), right), *notes])


def plot_braking(result: Braking, what: str = "stop") -> Picture:
    """The ``stop`` over time, ``compare`` of the controllers, or the ``slip`` paths.

    Raises:
        UsageError: no such figure.
    """
    figures = {"stop": stop_figure, "compare": compare_figure, "slip": paths_figure}
    check_names("figure", [what], figures)
    return figures[what](result)


def _foot(result: Braking) -> str:
    return f"tirefit {result.version} · braking positive, SI · seed {result.seed} · {_head(result)}"


_PANELS = (
    "speed [m/s]",
    "pressure [MPa]",
    "valve",
    "deceleration\n[m/s²]",
    "$F_x/F_z$ [–]",
    "slip $\\kappa$ [–]",
    "stiffness $k$\n[kN s/m]",
)
"""Panels of a stop; the last one only if a controller estimates it."""


def _draw_stop(all_axes, stop: Stop) -> None:
    """One controller's stop down a column of axes, as O Figures 8-9 and 12-13."""
    log, time = stop.log, stop.log.reading.time
    colors = dict(zip(range(4), COLORS, strict=False))
    names = list(WHEELS.values()) if len(stop.wheels) == 4 else ["wheel"]
    lines = {"linewidth": 0.8}
    for k in range(len(names)):
        style = lines | {"color": colors[k], "label": names[k]}
        all_axes[0].plot(time, log.reading.wheel_speed[:, k], **style)
        all_axes[1].plot(time, log.motion.pressure[:, k] / 1e6, **style)
        # One line per wheel, because the wheels would hide each other.
        lane = 0.4 * np.clip(log.valve[:, k], -1, 1) - k
        all_axes[2].plot(time, lane, **style)
        force = log.contacts.fx[:, k] / log.contacts.fz[:, k]
        all_axes[4].plot(time, force, **style)
        all_axes[5].plot(time, log.contacts.slips.kappa[:, k], **style)
    all_axes[0].plot(time, log.motion.v_x, color=DARK, linewidth=1.1, label="body")
    if "reference_speed" in log.info:
        style = {"color": DARK, "linewidth": 0.7, "linestyle": ":", "label": "reference"}
        all_axes[0].plot(time, log.info["reference_speed"][:, 0], **style)
    all_axes[3].plot(time, log.reading.deceleration, color=DARK, **lines)
    peak = {"color": GREY, "linewidth": 0.9, "linestyle": "--"}
    truth, of = log.reading.truth, f" ({names[0]})" if len(names) > 1 else ""
    all_axes[4].plot(time, truth.mu[:, 0], label=f"available $\\mu${of}", **peak)
    all_axes[5].plot(time, truth.peak[:, 0], label=f"of the peak{of}", **peak)
    all_axes[2].set_yticks([-k for k in range(len(names))], names)


def _draw_stiffness(axes, stop: Stop) -> None:
    """Extended braking stiffness of the first wheel: true, estimated and target."""
    time, info = stop.log.reading.time, stop.log.info
    axes.plot(time, stop.log.xbs_true[:, 0] / 1e3, color=GREY, label="true", linewidth=0.9)
    for name, label, color, line in (
        ("xbs", "estimated", COLORS[0], "-"),
        ("xbs_wanted", "wanted, O(22)", DARK, ":"),
    ):
        if name in info:
            values = info[name][:, 0] / 1e3
            axes.plot(time, values, line, color=color, label=label, linewidth=0.9)


def _fast(stop: Stop) -> np.ndarray:
    """The samples (n,) bool at which the car is faster than 0.3 of its initial speed."""
    return np.asarray(stop.log.motion.v_x > 0.3 * stop.log.motion.v_x[0])


def _stiffness_limit(stop: Stop) -> float:
    """Upper axis limit [kN s/m] of estimate and truth while the car is fast."""
    fast = _fast(stop)
    known = [np.asarray(stop.log.xbs_true)[fast, 0]]
    known += [np.asarray(stop.log.info["xbs"])[fast, 0]] if "xbs" in stop.log.info else []
    return 1.1 * float(np.nanpercentile(np.concatenate(known), 95)) / 1e3


def _slip_limit(stop: Stop) -> float:
    """Upper axis limit of the slips while the car is fast, at least three times the peak."""
    kappa = stop.log.contacts.slips.kappa[_fast(stop)]
    least = 3 * float(np.max(stop.log.reading.truth.peak))
    return float(np.clip(1.1 * np.percentile(kappa, 99.5), min(least, 1.05), 1.05))


def _slowest_shown(stop: Stop) -> float:
    """Speed [m/s] below which the slip of a wheel is not shown."""
    return min(_SLOWEST_SHOWN, 0.5 * float(stop.log.motion.v_x[0]))


def _pressure_limit(stop: Stop) -> float:
    """Largest pressure [MPa] while the car is controlled; later it is the driver's."""
    fast = stop.log.motion.v_x > _slowest_shown(stop)
    return 1.1 * float(np.max(stop.log.motion.pressure[fast])) / 1e6


def stop_figure(result: Braking) -> Picture:
    """Every controller in a column: speeds, pressure, valves, deceleration, use, slip.

    The panels are those of O Figures 8, 9, 12 and 13, with slip and friction below.
    """
    columns = len(result.stops)
    width = max(7.0, 4.6 * columns)
    stops = result.stops.values()
    estimated = any("xbs" in stop.log.info for stop in stops)
    panels = _PANELS if estimated else _PANELS[:-1]
    picture = Picture(figsize=(width, 1.6 * len(panels)), layout="constrained")
    grid = picture.subplots(len(panels), columns, sharex=True, sharey="row", squeeze=False)
    for number, (name, stop) in enumerate(result.stops.items()):
        column = grid[:, number]
        _draw_stop(column, stop)
        if estimated:
            _draw_stiffness(column[6], stop)
        used = float(stop.summary.mean_friction_used)
        distance = float(stop.summary.stopping_distance)
        end = f"{distance:.1f} m, " if np.isfinite(distance) else "no stop, "
        panel_title(column[0], f"{name}: {end}{100 * used:.0f} % of the friction")
        for axes, label in zip(column, panels, strict=True):
            tidy(axes, "", label if number == 0 else "")
        column[-1].set_xlabel("time [s]", fontsize=8.5, color=DARK)
    grid[1, 0].set_ylim(0.0, max(map(_pressure_limit, stops)))
    grid[5, 0].set_ylim(-0.02, max(map(_slip_limit, stops)))
    grid[4, 0].set_ylim(top=1.2 * grid[4, 0].get_ylim()[1])
    if estimated:
        grid[6, 0].set_ylim(-1.0, max(map(_stiffness_limit, stops)))
        _legend(grid[6], ncols=3)
    _legend(grid[0], ncols=2)
    for row in (4, 5):
        _legend(grid[row], shown=1)
    picture.supxlabel(plain_text(_foot(result)), fontsize=6.5, color=GREY)
    return picture


def _legend(row, shown: int | None = None, **how) -> None:
    """Draw the legend of a row in its last panel, with lines of all controllers; only of
    the last ``shown`` panels."""
    handle_of: dict[str, Any] = {}
    for axes in row:
        handles, labels = axes.get_legend_handles_labels()
        handle_of |= dict(zip(labels, handles, strict=True))
    labels = list(handle_of)[-shown if shown else 0 :]
    handles = [handle_of[label] for label in labels]
    row[-1].legend(handles, labels, fontsize=7, **_LEGEND, loc="upper right", **how)


def compare_figure(result: Braking) -> Picture:
    """Compare controllers: speeds and pressure of the first wheel, distance."""
    picture = Picture(figsize=(7.0, 7.2), layout="constrained")
    all_axes = picture.subplots(4, 1, sharex=True)
    for color, (name, stop) in zip(COLORS, result.stops.items(), strict=False):
        log, time = stop.log, stop.log.reading.time
        style = {"color": color, "linewidth": 0.9}
        all_axes[0].plot(time, log.motion.v_x, label=name, **style)
        turning = log.reading.wheel_speed[:, 0]
        all_axes[0].plot(time, turning, alpha=0.5, **(style | {"linewidth": 0.6}))
        all_axes[1].plot(time, log.motion.pressure[:, 0] / 1e6, **style)
        there = np.sum(log.reading.truth.mu * log.contacts.fz, axis=1)
        used = np.sum(log.contacts.fx, axis=1) / there
        all_axes[2].plot(time, used, **style)
        all_axes[3].plot(time, log.motion.distance, **style)
    labels = (
        "speed of body,\nfirst wheel [m/s]",
        "pressure, first\nwheel [MPa]",
        "friction used [–]",
        "distance [m]",
    )
    for axes, label in zip(all_axes, labels, strict=True):
        tidy(axes, "", label)
    all_axes[2].axhline(1.0, color=GREY, linewidth=0.8, linestyle="--")
    all_axes[2].set_ylim(0.0, 1.15)
    all_axes[-1].set_xlabel("time [s]", fontsize=8.5, color=DARK)
    all_axes[0].legend(fontsize=8, **_LEGEND, ncols=4, loc="upper right")
    picture.suptitle(plain_text(_head(result)), fontsize=10, color=DARK)
    picture.supxlabel(plain_text(_foot(result)), fontsize=6.5, color=GREY)
    return picture


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
    picture = Picture(figsize=(7.0, 5.6), layout="constrained")
    axes, below = picture.subplots(2, 1, sharex=True, height_ratios=(3, 1.3))
    paths: Mapping[str, Path] = {n: path_of(s) for n, s in result.stops.items()}
    peak = max(float(np.max(s.log.reading.truth.peak)) for s in result.stops.values())
    limit = min(_PEAKS_SHOWN * peak, 1.0)
    for mu, (kappa, force) in tire_curve(result.request, limit).items():
        axes.plot(kappa, force, color=DARK, linewidth=1.1, zorder=3)
        text = f"tire at $\\mu$ = {mu:g}"
        place = {"xytext": (0, 3), "textcoords": "offset points", "ha": "right", "va": "bottom"}
        axes.annotate(text, (kappa[-1], force[-1]), fontsize=7.5, color=DARK, **place)
    edges = np.linspace(0.0, limit, 41)
    for color, (name, path) in zip(COLORS, paths.items(), strict=False):
        axes.plot(path.kappa, path.force, ".", color=color, markersize=2, alpha=0.35)
        beyond = path.mean[0] > limit
        note = f", at $\\kappa$ = {path.mean[0]:.2f}" if beyond else ""
        style: dict[str, Any] = {
            "markersize": 8,
            "markeredgecolor": "white",
            "clip_on": False,
            "zorder": 4,
        }
        style |= {"color": color, "label": f"{name}: mean{note}"}
        axes.plot(min(path.mean[0], limit), path.mean[1], ">" if beyond else "o", **style)
        counts, _ = np.histogram(np.clip(path.kappa, 0.0, limit), edges)
        share = counts / max(len(path.kappa), 1)
        below.stairs(100 * share, edges, color=color, linewidth=1.1)
    axes.set_xlim(-0.02 * limit, limit)
    axes.set_ylim(bottom=0.0)
    tidy(axes, "", "$F_x/F_z$ [–]")
    tidy(below, "slip $\\kappa$ [–]; larger slips are in the last bar", "time [%]")
    axes.legend(fontsize=8, **_LEGEND, loc="lower right")
    slowest = min(map(_slowest_shown, result.stops.values()))
    note = f"line: the tire at its static load; dots: every sample above {slowest:.2g} m/s"
    panel_title(axes, "slip and friction of the first wheel", note)
    picture.supxlabel(plain_text(_foot(result)), fontsize=6.5, color=GREY)
    return picture
