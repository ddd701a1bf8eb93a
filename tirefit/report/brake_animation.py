"""Animation of a stop: the car from above, its wheels, and their slip."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.patches import Polygon

from tirefit.data.table import WHEELS
from tirefit.files import replacing
from tirefit.report.canvas import COLORS, DARK, GREY, RED, Picture, tidy
from tirefit.report.numbers import plain_text
from tirefit.sim.brake_request import VEHICLES
from tirefit.sim.brake_result import Braking, Stop
from tirefit.sim.brake_vehicle import road_of

_RATE = 20  # pictures per second of simulated time, shown in real time
_WHEEL = (0.6, 0.22)
_BODY = (4.2, 1.7)


def outline(x: float, y: float, heading: float, size: tuple[float, float]) -> np.ndarray:
    """Corners (4, 2) [m] of a rectangle ``size`` (length, width) about (x, y)."""
    length, width = size
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) / 2 * [length, width]
    cos, sin = np.cos(heading), np.sin(heading)
    return corners @ np.array([[cos, sin], [-sin, cos]]) + [x, y]


def _wheels(stop: Stop, vehicle, steer: float, k: int) -> list[np.ndarray]:
    """Outlines of the wheels at sample k."""
    s = stop.log.motion
    heading = float(s.heading[k])
    cos, sin = np.cos(heading), np.sin(heading)
    made = []
    for x, y, steered in zip(vehicle.x, vehicle.y, vehicle.steered, strict=True):
        at = float(s.x[k]) + x * cos - y * sin, float(s.y[k]) + x * sin + y * cos
        made.append(outline(*at, heading + steered * steer, _WHEEL))
    return made


def save_animation(result: Braking, path: Path) -> Path:
    """Write the stops as a GIF, one controller above the other, completely or not at all."""
    stops = result.stops
    picture = Picture(figsize=(7.5, 0.6 + 1.9 * len(stops)), dpi=80)
    all_axes = picture.subplots(
        len(stops),
        2,
        width_ratios=(3, 1),
        squeeze=False,
        gridspec_kw={"hspace": 0.55, "left": 0.08, "right": 0.97, "bottom": 0.2},
    )
    vehicle = VEHICLES[result.request.vehicle]()
    longest = max(len(stop.log.moving) for stop in stops.values())
    period = float(np.diff(next(iter(stops.values())).log.reading.time[:2])[0])
    draws = [
        _scene(axes, stop, vehicle, result, period)
        for axes, stop in zip(all_axes, stops.values(), strict=True)
    ]
    every = max(round(1 / (_RATE * period)), 1)
    picture.text(
        0.02,
        0.01,
        plain_text(f"tirefit {result.version} · seed {result.seed}"),
        fontsize=6.5,
        color=GREY,
    )

    def frame(k: int):
        for draw in draws:
            draw(k)
        return []

    frames = [*range(0, longest, every), *[longest - 1] * _RATE]
    moving = FuncAnimation(picture, frame, frames=frames)
    with TemporaryDirectory() as folder, replacing(path) as temporary:
        made = Path(folder) / "stop.gif"  # the writer needs this ending
        moving.save(made, writer=PillowWriter(fps=_RATE))
        temporary.write_bytes(made.read_bytes())
    return path


def _scene(axes, stop: Stop, vehicle, result: Braking, period: float):
    """Draw the fixed parts of one controller; return the function that draws sample k."""
    road, bars = axes
    s = stop.log.motion
    reach = max(float(np.ptp(s.x)), 5.0)
    middle = (float(s.y.min()) + float(s.y.max())) / 2
    road.plot(s.x, s.y, color=GREY, linewidth=0.6, linestyle=":")
    road.set_xlim(float(s.x.min()) - 4, float(s.x.min()) + 1.05 * reach + 4)
    half = max(2.5, 0.6 * float(np.ptp(s.y)))
    road.set_ylim(middle - half, middle + half)
    road.set_aspect("equal" if half > 8 else "auto")
    jump = road_of(result.request.road).jump
    if np.isfinite(jump):
        road.axvline(float(jump), color=GREY, linewidth=0.8, linestyle="--")
    tidy(road, "x [m]", "y [m]", 7.5)
    body = Polygon(np.zeros((4, 2)), facecolor="#dde6ee", edgecolor=DARK)
    road.add_patch(body)
    names = list(WHEELS) if len(stop.wheels) == 4 else [""]
    wheels = [road.add_patch(Polygon(np.zeros((4, 2)))) for _ in names]
    shown = bars.bar(range(len(names)), np.zeros(len(names)), color=COLORS[0])
    bars.set_xticks(range(len(names)), names)
    bars.set_ylim(0, 1.05)
    tidy(bars, "", "slip", 7.5)
    steer = result.request.steer

    def draw(k: int) -> None:
        k = min(k, len(s.x) - 1)
        heading = float(s.heading[k])
        body.set_xy(outline(float(s.x[k]), float(s.y[k]), heading, _BODY))
        slips = stop.log.contacts.slips.kappa[k]
        for patch, bar, at, slip in zip(
            wheels, shown, _wheels(stop, vehicle, steer, k), slips, strict=True
        ):
            patch.set_xy(at)
            color = RED if slip > 0.9 else DARK
            patch.set_color(color)
            bar.set_height(max(float(slip), 0.0))
            bar.set_color(color if slip > 0.9 else COLORS[0])
        title = f"{stop.name}: {k * period:.2f} s, {float(s.v_x[k]):.1f} m/s"
        road.set_title(title, fontsize=9, loc="left", color=DARK)

    return draw
