"""Simulated drives of cars with one withheld effect, in plain NumPy: independent of
tirefit, with other forms of the effects.

Every trial is a car, a drive, sensors and one withheld effect (listed, unlisted or
none), drawn from its number.
"""

# ruff: noqa: B023  # ``slope`` is called in its own turn of the loop only

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fits.formulas import brush

G = 9.81
STEP = 0.002  # s, of the simulation
LISTED = (
    "steering_ratio", "steering_offset", "steering_delay", "steering_lag",
    "steering_play",
    "compliance_steer", "yaw_inertia", "centre_of_gravity", "lateral_load_transfer",
    "longitudinal_load_transfer", "aerodynamic_load", "friction_speed",
    "sliding_friction", "friction_drift", "relaxation_length", "drive_force",
    "yaw_resistance", "bank", "sideslip_zero", "yaw_rate_zero", "tracked_point",
)  # fmt: skip
UNLISTED = ("gusts", "friction_patches", "sway")


@dataclass
class Trial:
    """One simulated drive; ``size``: amplitude of the effect in its own unit; ``also``: further
    effects with their amplitudes."""

    number: int
    effect: str = ""
    size: float = 0.0
    car: dict = field(default_factory=dict)
    seconds: float = 40.0
    rate: float = 50.0
    also: dict = field(default_factory=dict)


def trial(number: int, kind: str) -> Trial:
    """The trial of a number; ``kind`` is listed, unlisted or none."""
    rng = np.random.default_rng([number, 4343])
    small = rng.random() < 0.4
    if small:
        mass = rng.uniform(2.5, 6.0)
        wheelbase = rng.uniform(0.25, 0.36)
        speed = rng.uniform(2.0, 3.5)
    else:
        mass = rng.uniform(900, 2100)
        wheelbase = rng.uniform(2.3, 3.0)
        speed = rng.uniform(12.0, 25.0)
    share = rng.uniform(0.42, 0.58)
    l_f = share * wheelbase
    l_r = wheelbase - l_f
    mu = rng.uniform(0.6, 1.0)
    inertia = mass * l_f * l_r * rng.uniform(0.8, 1.2)
    loads = mass * G * l_r / wheelbase, mass * G * l_f / wheelbase
    # Slip at which the axles slide; the rear axle is stiffer.
    slides = rng.uniform(0.15, 0.3), rng.uniform(0.1, 0.16)
    tires = [(1.5 * mu * f / s, mu) for f, s in zip(loads, slides, strict=True)]
    effect, size = "", 0.0
    if kind == "listed":
        effect = LISTED[int(rng.integers(len(LISTED)))]
        size = _size(effect, rng)
    elif kind == "unlisted":
        effect = UNLISTED[int(rng.integers(len(UNLISTED)))]
    car = dict(
        mass=mass, l_f=l_f, l_r=l_r, inertia=inertia, loads=loads, tires=tires, mu=mu,
        speed=speed, small=small, grip=rng.uniform(0.75, 0.95),
        pace=rng.uniform(0.6, 1.4), seed=int(rng.integers(1 << 31)),
    )  # fmt: skip
    return Trial(number, effect, size, car, seconds=float(rng.uniform(30, 50)))


def _size(effect: str, rng) -> float:
    low, high = {
        "steering_ratio": (0.08, 0.25), "steering_offset": (0.01, 0.03),
        "steering_delay": (0.04, 0.12), "steering_lag": (0.05, 0.15),
        "compliance_steer": (0.01, 0.03), "yaw_inertia": (0.25, 0.6),
        "centre_of_gravity": (0.04, 0.1), "lateral_load_transfer": (0.3, 0.6),
        "longitudinal_load_transfer": (0.15, 0.4), "aerodynamic_load": (0.1, 0.3),
        "friction_speed": (0.2, 0.5), "sliding_friction": (0.2, 0.5),
        "friction_drift": (0.15, 0.4), "relaxation_length": (0.15, 0.4),
        "drive_force": (1.0, 2.5), "yaw_resistance": (0.1, 0.3), "bank": (0.02, 0.06),
        "sideslip_zero": (0.01, 0.04), "yaw_rate_zero": (0.01, 0.05),
        "tracked_point": (0.1, 0.4), "steering_play": (0.1, 0.3),
    }[effect]  # fmt: skip
    sign = 1.0
    if effect in (
        "steering_ratio",
        "steering_offset",
        "yaw_inertia",
        "centre_of_gravity",
        "bank",
        "sideslip_zero",
        "yaw_rate_zero",
        "tracked_point",
        "friction_drift",
    ):
        sign = rng.choice([-1.0, 1.0])
    return float(sign * rng.uniform(low, high))


def drive(one: Trial):
    """Time, and the logged v_x, v_y, yaw rate, a_y and steering of a trial."""
    car, sizes = one.car, {one.effect: one.size} | one.also
    is_ = sizes.__contains__
    rng = np.random.default_rng(car["seed"])
    count = int(one.seconds / STEP)
    time = STEP * np.arange(count)
    wheelbase = car["l_f"] + car["l_r"]
    scale = 1.0 if car["small"] else 0.6  # factor of the driver's frequencies
    slow = sum(
        a * np.sin(2 * np.pi * f * time + p)
        for a, f, p in zip((1, 0.7), (0.05, 0.11), rng.uniform(0, 6.3, 2), strict=True)
    )
    v_x = car["speed"] * (1 + 0.18 * slow / 1.7)
    a_x = np.gradient(v_x, STEP)
    a_x = a_x + 0.3 * car["mu"] * G * np.sin(2 * np.pi * 0.23 * scale * time)
    v_x = v_x[0] + np.cumsum(a_x) * STEP
    waves = (1, 0.6, 0.35), (0.13, 0.41, 1.1), rng.uniform(0, 6.3, 3)
    wish = sum(
        a * np.sin(2 * np.pi * f * car["pace"] * scale * time + p)
        for a, f, p in zip(*waves, strict=True)
    )
    wish *= car["grip"] * car["mu"] * G / 1.6
    # Steering of a driver who roughly knows the car without the effect.
    curvature = wish / v_x**2
    angle = np.arctan(car.get("known_wheelbase", wheelbase) * curvature) + 0.02 * wish / G
    logged = angle.copy()
    if is_("steering_delay"):
        angle = np.interp(time - sizes["steering_delay"], time, angle)
    if is_("steering_lag"):
        angle = _lag(angle, sizes["steering_lag"])
    if is_("steering_ratio"):
        angle = angle * (1 + sizes["steering_ratio"])
    if is_("steering_offset"):
        angle = angle + sizes["steering_offset"]
    if is_("steering_play"):
        angle = _play(angle, sizes["steering_play"] * np.std(angle))
    gust = np.zeros(count)
    if is_("gusts"):
        noise = _lag(rng.standard_normal(count) / np.sqrt(STEP), 0.5)
        gust = 0.12 * car["mu"] * G * noise / np.std(noise)
    patch = np.ones(count)
    if is_("friction_patches"):
        distance = np.cumsum(v_x) * STEP / wheelbase
        patch = 1 - 0.35 * (np.sin(2 * np.pi * distance / 25 + 1) > 0.3)
    states = np.zeros((count, 2))
    lateral = np.zeros(count)
    late = np.zeros(2)
    before = np.zeros(2)
    l_f, l_r = car["l_f"], car["l_r"]
    if is_("centre_of_gravity"):
        moved = sizes["centre_of_gravity"] * wheelbase
        l_f, l_r = l_f - moved, l_r + moved
    inertia = car["inertia"] * np.exp(sizes.get("yaw_inertia", 0.0))
    mass = car["mass"]
    a_y = 0.0
    for k in range(count - 1):
        v, yields = v_x[k], 0.0
        if is_("compliance_steer"):
            yields = -sizes["compliance_steer"] * a_y / G
        loads = np.array([l_r, l_f]) * mass * G / wheelbase
        if is_("longitudinal_load_transfer"):
            loads = loads + np.array([-1, 1]) * sizes["longitudinal_load_transfer"] * mass * a_x[k]
        if is_("aerodynamic_load"):
            loads = loads * (1 + sizes["aerodynamic_load"] * ((v / car["speed"]) ** 2 - 1))
        friction = np.array([t[1] for t in car["tires"]]) * patch[k]
        stiffness = np.array([t[0] for t in car["tires"]])
        if is_("lateral_load_transfer"):
            friction = friction * (1 - sizes["lateral_load_transfer"] * (a_y / G) ** 2)
        if is_("friction_speed"):
            friction = friction * (1 - sizes["friction_speed"] * (v / car["speed"] - 1))
        if is_("friction_drift"):
            friction = friction * (1 + sizes["friction_drift"] * (time[k] / one.seconds - 0.5))
        if is_("drive_force"):
            friction = friction * np.sqrt(1 - min(sizes["drive_force"] * (a_x[k] / G) ** 2, 0.8))

        def slope(part, state):
            v_y, r = state
            v = v_x[k] + part * (v_x[k + 1] - v_x[k])
            delta = angle[k] + part * (angle[k + 1] - angle[k]) + yields
            slip = np.array([np.arctan2(v_y + l_f * r, v) - delta, np.arctan2(v_y - l_r * r, v)])
            used = slip + late
            forces = np.empty(2)
            for j in (0, 1):
                s = abs(np.tan(used[j]))
                mu = friction[j]
                if is_("sliding_friction"):
                    wide = 1.5 * mu * loads[j] / stiffness[j]
                    mu = mu * (1 - sizes["sliding_friction"] * (1 - np.exp(-((s / wide) ** 2))))
                force = float(brush(s, loads[j], v, stiffness[j], mu))
                if car.get("linear"):
                    force = 2 * stiffness[j] * s
                forces[j] = -np.sign(used[j]) * force
            front = forces[0] * np.cos(delta)
            moment = l_f * front - l_r * forces[1]
            if is_("yaw_resistance"):
                moment = moment - sizes["yaw_resistance"] * mass * G * wheelbase**2 * r / v
            across = (front + forces[1]) / mass + gust[k]
            if is_("bank"):
                across = across + sizes["bank"] * G
            return np.array([across - v * r, moment / inertia]), across, slip

        state = states[k]
        k1, a_y, slip = slope(0.0, state)
        if is_("relaxation_length"):
            if k:
                rate = (slip - before) / STEP
                time_constant = sizes["relaxation_length"] * wheelbase / v
                kept = np.exp(-STEP / time_constant)
                late = late * kept - time_constant * rate * (1 - kept)
            before = slip
        k2, *_ = slope(0.5, state + 0.5 * STEP * k1)
        k3, *_ = slope(0.5, state + 0.5 * STEP * k2)
        k4, *_ = slope(1.0, state + STEP * k3)
        states[k + 1] = state + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        lateral[k] = a_y
    lateral[-1] = lateral[-2]
    v_y, r = states.T
    if is_("sway"):
        # The sensor is mounted on the rolling body.
        sway = np.gradient(_lag(lateral, 0.1), STEP)
        v_y = v_y + 0.3 * np.std(v_y) * sway / np.std(sway)
    if is_("sideslip_zero"):
        v_y = v_y + sizes["sideslip_zero"] * v_x
    if is_("tracked_point"):
        v_y = v_y + sizes["tracked_point"] * wheelbase * r
    if is_("yaw_rate_zero"):
        r = r + sizes["yaw_rate_zero"]
    return time, v_x, v_y, r, lateral, logged


def _lag(values, time_constant: float):
    kept = np.exp(-STEP / time_constant)
    found, now = np.empty_like(values), values[0]
    for k, value in enumerate(values):
        now = now * kept + value * (1 - kept)
        found[k] = now
    return found


def _play(values, width: float):
    found, now = np.empty_like(values), 0.0
    for k, value in enumerate(values):
        now = min(max(now, value - width), value + width)
        found[k] = now
    return found


def written(one: Trial, folder: Path) -> tuple[Path, Path]:
    """The log and the vehicle file of a trial."""
    time, v_x, v_y, r, a_y, steer = drive(one)
    car, rng = one.car, np.random.default_rng(car_seed(one))
    every = round(1 / one.rate / STEP)
    scale = 0.3 if car["small"] else 1.0
    columns = [time[::every]]
    for values, std in (
        (v_x, 0.02 * scale),
        (v_y, 0.02 * scale),
        (r, 0.004 / scale),
        (a_y, 0.05),
        (steer, 0.0),
    ):
        values = values[::every]
        columns.append(values + std * rng.standard_normal(len(values)))
    folder.mkdir(parents=True, exist_ok=True)
    log, vehicle = folder / f"drive_{one.number}.csv", folder / "vehicle.toml"
    head = "t,v_x,v_y,yaw_rate,a_y,steer"
    np.savetxt(log, np.stack(columns, axis=1), "%.7g", ",", header=head, comments="")
    vehicle.write_text(
        f"mass = {car['mass']}\nl_f = {car['l_f']}\nl_r = {car['l_r']}\n"
        f"yaw_inertia = {car['inertia']}\ngravity = {G}\n"
        '[columns]\ntime = "t"\nv_x = "v_x"\nv_y = "v_y"\nyaw_rate = "yaw_rate"\n'
        'a_y = "a_y"\nsteering = "steer"\n'
        "[steering]\ncommand = [-1.0, 1.0]\nangle = [-1.0, 1.0]\n"
        f"[filter]\ncutoff = 8.0\nsample_rate = {one.rate:g}\n"
    )
    return log, vehicle


def car_seed(one: Trial) -> int:
    return one.car["seed"] + 1


KINDS = ("listed", "none", "unlisted")


def kind_of(number: int) -> str:
    """Of four trials, two have a listed effect, one has none, one an unlisted effect."""
    return ("listed", "listed", "none", "unlisted")[(number // 16 + number) % 4]


def judged(number: int, folder: Path) -> dict:
    """The trial and the result of its diagnosis."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import tirefit
    from tirefit.models import Brush

    kind = kind_of(number)
    one = trial(number, kind)
    log, vehicle = written(one, folder / f"{number}")
    rng = np.random.default_rng(number)
    tires = [
        Brush(cpa2=c * np.exp(rng.normal(0, 0.15)), mu=m * np.exp(rng.normal(0, 0.1)))
        for c, m in one.car["tires"]
    ]
    about = {"number": number, "kind": kind, "effect": one.effect, "size": one.size}
    try:
        found = tirefit.diagnose_vehicle([log], vehicle, *tires)
    except tirefit.DataError as error:
        return about | {"outcome": "refused", "reason": str(error)}
    verdict = found.verdict
    outcome = verdict.status.value
    if one.effect in verdict.effects:
        outcome = "right"
    elif one.effect in verdict.also_possible:
        outcome = "twin"
    return about | {
        "outcome": outcome,
        "status": verdict.status.value,
        "effects": verdict.effects,
        "also_possible": verdict.also_possible,
        "unlisted": verdict.left.unlisted,
        "amplitudes": {k.partition(": ")[0]: list(v[:3]) for k, v in found.amplitudes.items()},
    }
