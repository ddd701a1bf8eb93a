"""O Figures 3 to 6 on a simulated road of packed snow, and the asserted numbers.

``python -m fits.braking_stiffness.draw`` writes the figures to this folder and prints
the numbers. The stops are tirefit's simulation of one front wheel with the mass that it
carries, brake and sensors, under constant pressure: 150 stops each, with a different
road every time. The estimates use only the wheel speed.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.signal
from scipy.optimize import least_squares

from fits.braking_stiffness.reference import (
    FRICTION,
    FROM,
    INERTIA,
    PRESSURES,
    RADIUS,
    SPEED,
    STIFFNESS,
    UNTIL,
    stiffness,
)
from tirefit.models import MODELS
from tirefit.online.braking.controller import NoController
from tirefit.online.braking.xbs import Xbs
from tirefit.params import with_values
from tirefit.report.canvas import COLORS, DARK, GREY, Picture, tidy
from tirefit.sim.brake import Sensors, simulate_stop
from tirefit.sim.brake_request import Request, arrays, plant_of
from tirefit.sim.brake_vehicle import Hydraulics

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent
STOPS = 150
SENSORS = Sensors(road_std=0.015)
"""An even road: on a road of usual roughness 3 MPa lock the wheel within seconds."""
RATE = 200.0
SAMPLES = round(UNTIL * RATE) + 1
ICE = 0.2
MORE = {FRICTION: (0.5e6, 1e6, 2e6, 2.5e6, 3e6), ICE: (0.5e6, 1e6, 1.5e6)}
"""Pressures of O Figure 6 on snow and on ice."""


class Stops(NamedTuple):
    """All stops (stops, samples): speed of the car and of the wheel (as measured) [m/s],
    deceleration [m/s2], pressure [Pa], true k [N s/m]; the estimate of k, its std, and
    the estimate by the recursion as printed, [N s/m]."""

    v: np.ndarray
    wheel: np.ndarray
    deceleration: np.ndarray
    pressure: np.ndarray
    true: np.ndarray
    xbs: np.ndarray
    std: np.ndarray
    printed: np.ndarray


def estimator() -> Xbs:
    """Estimator with O's band; sensor noise and corner frequency of the road are given."""
    noise = np.hypot(SENSORS.speed_std, SENSORS.speed_step / np.sqrt(12))
    return Xbs(
        rate=RATE,
        radius=RADIUS,
        wheel_inertia=INERTIA,
        speed_noise=float(noise),
        road_corner=SENSORS.road_corner,
        stiffness=2 * STIFFNESS,
    )


@eqx.filter_jit
def _many(plant, sensors, keys):
    def one(key):
        speed = jnp.asarray(SPEED)
        return simulate_stop(plant, NoController(), sensors, speed, key, SAMPLES, 0)

    return jax.vmap(one)(keys)


@eqx.filter_jit
def _estimates(record: Xbs, wheels):
    def one(wheel):
        def step(state, speed):
            after, made = record.step(state, {"omega": speed / record.radius})
            return after, (made.value[0], made.std[0], record.pole(after)[2])

        return jax.lax.scan(step, record.init(), wheel)[1]

    return jax.vmap(one)(wheels)


@cache
def stops(pressure: float, friction: float = FRICTION) -> Stops:
    """All stops at one pressure."""
    tire = with_values(MODELS["brush"], {"cpa2": STIFFNESS})
    request = Request(
        tire,
        "brush",
        road=f"mu={friction}",
        speed=SPEED,
        vehicle="quarter",
        hydraulics=Hydraulics(demand=pressure, ramp=2e7),
        sensors=SENSORS,
    )
    keys = jax.vmap(jax.random.key)(jnp.arange(STOPS))
    log = _many(plant_of(request), arrays(request.sensors), keys)
    wheel = log.reading.wheel_speed[..., 0]
    xbs, std, printed = _estimates(estimator(), wheel)
    kept = (
        log.motion.v_x,
        wheel,
        log.reading.deceleration,
        log.motion.pressure[..., 0],
        log.xbs_true[..., 0],
        xbs,
        std,
        printed * INERTIA / RADIUS**2,
    )
    return Stops(*(np.asarray(part) for part in kept))


WINDOW = slice(round(FROM * RATE), round(UNTIL * RATE) + 1)


@cache
def spectrum(pressure: float):
    """(frequencies [Hz], power of wheel speed [m2/s2/Hz]) in the window, of all stops."""
    wheel = stops(pressure).wheel[:, WINDOW]
    frequency, power = scipy.signal.welch(wheel, RATE, nperseg=400, detrend="linear")
    return frequency, power.mean(0)


def shape(frequency, power, break_frequency):
    """Power of a first-order wheel on a road that is white above its corner, with sensor
    noise; the simulated road is linear between samples, which lowers its high
    frequencies."""
    corner = SENSORS.road_corner
    wheel = (frequency**2 + break_frequency**2) * (frequency**2 + corner**2)
    noise = 2 * float(estimator().speed_noise) ** 2 / RATE
    return power * np.sinc(frequency / RATE) ** 2 / wheel + noise


def break_frequency(pressure: float) -> np.ndarray:
    """(power, break frequency [Hz]) fitted to the spectrum from 3 to 40 Hz."""
    frequency, power = (part[6:81] for part in spectrum(pressure))

    def gap(x):
        return np.log(shape(frequency, *np.exp(x))) - np.log(power)

    return np.exp(least_squares(gap, np.log([power[0] * 1e3, 15.0])).x)


def properties() -> dict[str, float]:
    """Numbers of the stops by name, as explained in expected.toml."""
    numbers: dict[str, float] = {}
    for pressure in PRESSURES:
        name, made = f"{pressure / 1e6:.0f} MPa", stops(pressure)
        true = made.true[:, WINDOW].mean()
        middle = np.median(made.xbs[:, WINDOW], axis=0)
        last = made.xbs[:, -1]
        spread = np.diff(np.quantile(last, [0.159, 0.841]))[0] / 2
        frequency, power = spectrum(pressure)
        fitted = break_frequency(pressure)[1]
        numbers |= {
            f"{name}: k": true,
            f"{name}: break frequency": fitted,
            f"{name}: estimate over truth": np.mean(middle) / true,
            f"{name}: estimate over spectrum": np.mean(middle)
            / (2 * np.pi * fitted * INERTIA / RADIUS**2),
            f"{name}: spread over truth": spread / made.true[:, -1].mean(),
            f"{name}: std said over spread": np.median(made.std[:, -1]) / spread,
            f"{name}: as printed over truth": made.printed[:, WINDOW].mean() / true,
            f"{name}: power at 2 Hz": power[frequency == 2][0],
            f"{name}: power at 40 Hz": power[frequency == 40][0],
        }
    soft, hard = ("1 MPa", "3 MPa")
    for at in ("2 Hz", "40 Hz"):
        key = f"power at {at}"
        numbers[f"{key}, 3 over 1 MPa"] = numbers[f"{hard}: {key}"] / numbers[f"{soft}: {key}"]
    for friction, name in ((FRICTION, "snow"), (ICE, "ice")):
        means = [mean_of(p, friction)[0] for p in MORE[friction]]
        numbers[f"{name}: largest rise of k with pressure"] = np.max(np.diff(means))
    return {key: float(value) for key, value in numbers.items()}


def mean_of(pressure: float, friction: float) -> tuple[float, float, float, float]:
    """Mean of k over the window and the stops, the 16 and 84 % quantiles over single
    stops, and the true mean."""
    made = stops(pressure, friction)
    means = np.nanmean(made.xbs[:, WINDOW], axis=1)
    low, high = np.nanquantile(means, [0.159, 0.841])
    return float(np.nanmedian(means)), low, high, made.true[:, WINDOW].mean()


TIME = np.arange(SAMPLES) / RATE


def draw_stops() -> None:
    """O Figure 3: soft and hard braking."""
    picture = Picture(figsize=(8.2, 4.2), layout="constrained")
    axes = picture.subplots(3, 2, sharex=True, sharey="row", height_ratios=[2, 1, 1])
    for column, pressure in zip(axes.T, (PRESSURES[0], PRESSURES[-1]), strict=True):
        made, first = stops(pressure), column[0] is axes[0, 0]
        column[0].plot(TIME, made.v[0], color=DARK, linewidth=1, label="car")
        column[0].plot(TIME, made.wheel[0], color=COLORS[0], linewidth=0.8, label="wheel")
        column[0].set_title(f"{pressure / 1e6:.0f} MPa", fontsize=9)
        column[1].plot(TIME, made.deceleration[0], color=COLORS[0], linewidth=0.5)
        column[2].plot(TIME, made.pressure[0] / 1e6, color=COLORS[0])
        labels = ("speed [m/s]", "decel. [m/s²]", "pressure [MPa]")
        for each, text in zip(column, labels, strict=True):
            tidy(each, "", text if first else "")
        tidy(column[2], "time [s]", labels[2] if first else "")
    axes[0, 0].legend(fontsize=8, frameon=False)
    picture.savefig(HERE / "figure_3.png", dpi=90)


def draw_spectrum() -> None:
    """O Figure 4: the break frequency falls with the pressure."""
    picture = Picture(figsize=(5.4, 3.6), layout="constrained")
    axes = picture.subplots()
    for color, pressure in zip(COLORS, PRESSURES, strict=False):
        frequency, power = spectrum(pressure)
        fitted = break_frequency(pressure)
        axes.loglog(
            frequency[1:],
            power[1:],
            color=color,
            label=f"{pressure / 1e6:.0f} MPa: break at {fitted[1]:.1f} Hz,"
            f" true {_true_break(pressure):.1f} Hz",
        )
        axes.loglog(frequency[1:], shape(frequency[1:], *fitted), color=color, linestyle=":")
        axes.axvline(fitted[1], color=color, linewidth=0.6)
    axes.axvspan(2, 20, color=GREY, alpha=0.12, linewidth=0)
    axes.text(2.1, axes.get_ylim()[0] * 1.5, "2–20 Hz", fontsize=7.5, color=GREY)
    axes.legend(fontsize=7.5, frameon=False, loc="upper right")
    tidy(axes, "frequency [Hz]", "power of wheel speed [(m/s)²/Hz]")
    picture.savefig(HERE / "figure_4.png", dpi=90)


def _true_break(pressure: float) -> float:
    k = np.mean(stiffness(pressure, np.linspace(FROM, UNTIL, 401))[0])
    return float(k * RADIUS**2 / (2 * np.pi * INERTIA))


def draw_estimate() -> None:
    """O Figure 5: the estimate in one hard stop, and in all stops."""
    picture = Picture(figsize=(8.2, 3.2), layout="constrained")
    left, right = picture.subplots(1, 2, sharey=True)
    made = stops(PRESSURES[-1])
    one, std = made.xbs[0], made.std[0]
    left.fill_between(TIME, one - std, one + std, color=COLORS[0], alpha=0.2, linewidth=0)
    left.plot(TIME, one, color=COLORS[0], label="estimate of one stop, ± std")
    left.plot(TIME, made.printed[0], color=COLORS[1], label="O(3)–(7) as printed")
    left.plot(TIME, made.true[0], color=DARK, linewidth=0.5, label="true")
    there = np.isfinite(made.xbs).all(0)
    low, middle, high = np.quantile(made.xbs[:, there], [0.159, 0.5, 0.841], axis=0)
    right.fill_between(TIME[there], low, high, color=COLORS[0], alpha=0.2, linewidth=0)
    right.plot(TIME[there], middle, color=COLORS[0], label="median of 150 stops, 68 %")
    right.plot(TIME, made.true.mean(0), color=DARK, linewidth=1, label="true, mean")
    left.set_ylim(0, 2500)
    for axes in (left, right):
        axes.legend(fontsize=7.5, frameon=False, loc="upper right")
        tidy(axes, "time [s]", "k at 3 MPa [N s/m]" if axes is left else "")
    picture.savefig(HERE / "figure_5.png", dpi=90)


def draw_means() -> None:
    """O Figure 6: mean estimate over pressure on two roads."""
    picture = Picture(figsize=(5.4, 3.4), layout="constrained")
    axes = picture.subplots()
    for color, friction in zip(COLORS, MORE, strict=False):
        pressures = np.array(MORE[friction])
        middle, low, high, true = np.array([mean_of(p, friction) for p in pressures]).T
        # Shifted sideways, so that the bars do not overlap.
        beside = pressures / 1e6 + 0.03 * (friction == ICE)
        axes.errorbar(
            beside,
            middle,
            (middle - low, high - middle),
            color=color,
            fmt="o",
            markersize=4,
            linewidth=1,
            label=f"estimate (line: true), µ = {friction:g}",
        )
        axes.plot(pressures / 1e6, true, color=color, linewidth=1)
    axes.set_ylim(0, 3000)
    axes.legend(fontsize=7.5, frameon=False)
    tidy(axes, "pressure [MPa]", "k, mean of 1–3 s [N s/m]")
    picture.savefig(HERE / "figure_6.png", dpi=90)


if __name__ == "__main__":
    draw_stops()
    draw_spectrum()
    draw_estimate()
    draw_means()
    for name, value in properties().items():
        print(f"{name:35s} {value:.5g}")
