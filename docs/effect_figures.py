"""A figure for each effect of an axle's forces: without it, with it, and the difference.

The forces are those of the diagnosis itself, on two simulated records: sweeps of a
rig at three loads and two speeds, and a drive of a car.
"""

import io

import jax
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from fits.withheld.car import Car, drive
from tirefit.data.read import read_frame
from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.subject import fit_base
from tirefit.models import MODELS, TireInputs, forces
from tirefit.report.canvas import BLUE, GREEN, GREY, PURPLE, RED
from tirefit.report.diagnosis.words import name_of

RIG = Rig(
    noise={"fx_relative": 0.005, "fy_relative": 0.005, "sigma_x": 1e-4, "alpha": 1e-4},
    rolling_radius=0.3,
)
SWEEPS = [(fz, v) for v in (10.0, 20.0) for fz in (2000.0, 4000.0, 6000.0)]
"""Load [N] and speed [m/s] of each sweep of the rig."""
ROWS, STEP, PERIOD = 160, 0.0125, 2.0
"""Rows of a sweep; time between two rows [s]; length of a sweep, and of the pause
after it [s]."""
STRETCH = 12.0
"""Time [s] of the drive that a figure shows."""
MOST_SETTINGS = 3
"""Number of values of a quantity up to which each has a curve over the slip."""
SHOWN, LARGEST = 0.12, 3.0
"""Change of the force (rms, over that of the force) that a figure aims at, and its
largest amplitude in standard deviations of the prior."""
OVER = {
    "load": ("fz", "load [N]"),
    "speed": ("v", "speed [m/s]"),
    "temperature": ("temperature", "temperature [°C]"),
    "time": ("time", "time [s]"),
    "inflation": ("pressure", "pressure [Pa]"),
    "work": ("time", "time [s]"),
    "run": ("run", "run"),
    "yaw": ("yaw_rate", "yaw rate [rad/s]"),
    "yaw acceleration": ("yaw_acceleration", "yaw acceleration [rad/s²]"),
    "heading": ("heading", "heading [rad]"),
    "steering": ("steering", "road wheel angle [rad]"),
    "lateral acceleration": ("a_y", "lateral acceleration [m/s²]"),
    "acceleration": ("a_x", "longitudinal acceleration [m/s²]"),
}
"""Quantity of a family -> column and label that its change is drawn over; else slip."""


def _rig_record():
    generator, count = np.random.default_rng(0), len(SWEEPS)
    time = np.arange(ROWS * count) * STEP + np.repeat(np.arange(count), ROWS) * PERIOD
    fz, v = (np.repeat(x, ROWS) for x in zip(*SWEEPS, strict=True))
    slip = 0.2 * np.sin(2 * np.pi * time / PERIOD)
    force = forces(MODELS["brush"], TireInputs(sigma_x=slip, fz=fz)).fx
    sideways = np.sin(0.9 * time)
    return {
        "time": time,
        "sigma_x": slip,
        "fz": fz,
        "v": v,
        "fx": np.asarray(force) + 0.003 * fz * generator.standard_normal(len(time)),
        "omega": v / (1 + slip) / RIG.rolling_radius,
        # Less than a tenth of the slip: a disturbance, and not combined slip.
        "alpha": 0.018 * sideways,
        "fy": 0.25 * fz * sideways,
        "temperature": 40 + 10 * np.sin(0.4 * time),
        "pressure": np.repeat(np.resize([2.0e5, 2.4e5], count), ROWS),
        "run": np.repeat(np.arange(count) // 2, ROWS),
    }


def _car_record():
    frame = drive(Car(height=0.55), "front")
    return frame | {"gamma": 0.05 * np.sin(0.7 * frame["time"])}


def _bases():
    """(columns of the record, force, base fit) of each record."""
    for frame, channel in ((_rig_record(), "fx"), (_car_record(), "fy")):
        base = fit_base(prepare(read_frame(frame), RIG, (channel,)), "brush", EFFECTS, RIG)
        if "run" in frame:
            base = base.on(_with_unlike_runs(base.design, frame["run"]))
        yield frame, channel, base


def _with_unlike_runs(design, run):
    """The design with runs that differ, by one standard deviation."""
    of_row = np.zeros(len(design.keep))
    of_row[: len(run)] = np.array([-1.2, 0.0, 1.2])[run]
    names = ("run_slip", "run_force", "run_friction", "run_stiffness")
    rows = design.rows._replace(**dict.fromkeys(names, of_row))
    return design._replace(rows=rows)


def figures():
    """Effect id -> (PNG, amplitude that it shows), of every effect."""
    jax.config.update("jax_enable_x64", True)
    found = {}
    for frame, channel, base in _bases():
        for k, atom in enumerate(base.atoms):
            effect = atom.effect
            shows = channel in (effect.channels or (channel,))
            met = set(effect.needs) <= base.rows.has
            if effect.id not in found and shows and met:
                found[effect.id] = _figure(frame, channel, base, k)
    return found


def _figure(frame, channel, base, k):
    atom, rows = base.atoms[k], base.rows

    def force(size):
        return base.forces(base.z, base.amplitudes([k], [size]))[channel]

    plain, once = force(0.0), force(1.0)
    change = np.sqrt(np.mean((once - plain) ** 2) / np.mean(plain**2))
    scale = float(base.priors.scale[k])
    size = min(max(SHOWN / change, 1.0), LARGEST, atom.prior(rows, RIG).high / scale)
    changed, kept = force(size), rows.kept
    columns = {name: np.asarray(column)[kept] for name, column in frame.items()}
    return _draw(atom.effect, columns, rows.slip, plain, changed), size * scale


def _draw(effect, columns, slip, plain, changed):
    on_a_rig = "sigma_x" in columns
    side = "slip [-]" if on_a_rig else "tan(alpha) [-]"
    time, change = columns["time"], changed - plain
    pieces = (time // (PERIOD if on_a_rig else STRETCH)).astype(int)
    shown = pieces == max(set(pieces), key=lambda k: np.mean(change[pieces == k] ** 2))
    x, label = (slip, side) if on_a_rig else (time, "time [s]")
    column, quantity = OVER.get(effect.family.rpartition(" x ")[2], (None, side))
    over = slip if column is None else columns[column]
    lower = [(over, change, "")]
    if len(set(over)) <= MOST_SETTINGS:  # a curve over the slip for each setting
        quantity, unit = side, quantity.replace("]", "").rpartition(" [")
        settings = [(f"{unit[0]} {x:g} {unit[2]}" if unit[0] else f"run {x:g}", over == x)
                    for x in sorted(set(over))]  # fmt: skip
        lower = [(slip[at], change[at], label) for label, at in settings]
    return picture(
        name_of(effect.id),
        [(x[shown], force[shown] / columns["fz"][shown]) for force in (plain, changed)],
        (label, "force / load [-]"),
        lower,
        (quantity, "difference [N]"),
    )


def picture(name, upper, labels, lower, below, line="."):
    """PNG of a quantity without and with an effect, above the difference.

    Args:
        upper: (x, y) without and with the effect; ``labels``: of the axes.
        lower: (x, difference, name in a legend) of each setting; ``below``: labels of the axes.
        line: how the difference is drawn.
    """
    file = io.BytesIO()
    with rc_context({"font.size": 11}):
        figure = Figure(figsize=(4.6, 4.9), layout="constrained")
        above, beneath = figure.subplots(2, 1)
        above.plot(*upper[0], color=GREY, lw=3, label="without")
        above.plot(*upper[1], color=BLUE, lw=1.6, label=f"with {name}")
        figure.legend(loc="outside upper left", ncols=1 + (len(name) < 26), frameon=False)
        beneath.axhline(0, color=GREY, lw=1)
        for (x, y, label), color in zip(lower, (RED, GREEN, PURPLE), strict=False):
            beneath.plot(x, y, line, ms=3, lw=1.6, color=color, label=label)
        if len(lower) > 1:
            beneath.legend(
                loc="lower left", bbox_to_anchor=(0, 1), ncols=3, fontsize=9, frameon=False,
                markerscale=3, handletextpad=0, columnspacing=1, borderpad=0,
            )  # fmt: skip
        for axes, (under, left) in ((above, labels), (beneath, below)):
            axes.set(xlabel=under, ylabel=left)
            axes.margins(0.04, 0.08)
            axes.spines[["top", "right"]].set_visible(False)
            axes.locator_params("x", nbins=6)
        figure.align_ylabels()
        figure.savefig(file, dpi=130)
    return file.getvalue()
