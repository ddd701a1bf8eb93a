"""A rig test from a script with a known truth: its commands and their times.

The script moves channels and holds them; every command is an :class:`Event` with its
rows. Then come the wander of the controllers, the load's answer to the slip, the tire's
temperature and the noise of the sensors. Nothing here is shared with the package.
"""

from typing import NamedTuple

import numpy as np

DEG = np.pi / 180


class Event(NamedTuple):
    """One command: rows ``begin`` to ``end``; ``kind`` is held, swept or moved."""

    kind: str
    begin: int
    end: int
    channel: str
    direction: int
    note: str
    settings: dict


class Script:
    """Set-points of a rig, command by command."""

    def __init__(self, rate, **start):
        self.rate, self.now = rate, dict(start)
        self.parts = {name: [] for name in start}
        self.events, self.rows = [], 0

    def _add(self, rows, kind, channel="", path=None, to=0.0, note=""):
        direction = int(np.sign(to - self.now[channel])) if kind == "swept" else 0
        for name, value in self.now.items():
            here = path if name == channel else np.full(rows, float(value))
            self.parts[name].append(here)
        if channel:
            self.now[channel] = to
        settings = dict(self.now)
        event = Event(kind, self.rows, self.rows + rows, channel, direction, note, settings)
        self.events.append(event)
        self.rows += rows

    def hold(self, seconds, note=""):
        self._add(round(seconds * self.rate), "held", note=note)

    def _path(self, channel, to, rows, shape):
        way = np.arange(1, rows + 1) / rows
        if shape == "sine":
            way = (1 - np.cos(np.pi * way)) / 2
        return self.now[channel] + (to - self.now[channel]) * way

    def move(self, channel, to, seconds, note=""):
        if to == self.now[channel]:
            return
        rows = max(round(seconds * self.rate), 2)
        path = self._path(channel, to, rows, "sine")
        self._add(rows, "moved", channel, path, to, note)

    def sweep(self, channel, to, seconds, note="", shape="line"):
        rows = round(seconds * self.rate)
        path = self._path(channel, to, rows, shape)
        self._add(rows, "swept", channel, path, to, note)

    def columns(self):
        return {name: np.concatenate(part) for name, part in self.parts.items()}


def _wander(rng, n, rate, seconds):
    """Slow noise of one standard deviation, correlated over this many seconds."""
    steps = max(int(seconds * rate / 4), 1)
    knots = rng.normal(size=n // steps + 4)
    at = np.arange(n) / steps
    smooth = np.convolve(knots, [0.25, 0.5, 0.25], mode="same") / 0.61
    return np.interp(at, np.arange(len(knots)), smooth)


def measured(script, rng, *, noise=1.0, wander=1.0, mu=1.5, stiffness=20.0, tau=40.0):
    """Canonical columns (n,) as measured, and the noise-free truth."""
    truth = script.columns()
    n, rate = script.rows, script.rate
    time = np.arange(n) / rate
    alpha, kappa = (truth.get(name, np.zeros(n)) for name in ("alpha", "kappa"))
    cold = 40 * np.exp(-np.cumsum(truth["v"] > 1) / rate / tau)
    temperature = 60 - cold
    fz = truth["fz"] * (1 + wander * (0.008 * _wander(rng, n, rate, 5) + 0.01 * np.sin(20 * alpha)))
    grip = mu * (1 - 0.003 * cold) * (1 - 0.1 * fz / np.max(fz))
    slide = np.hypot(np.tan(alpha), kappa) + 1e-12
    force = grip * fz * np.tanh(stiffness / mu * slide) / slide
    gamma = truth["gamma"]
    pressure = truth["pressure"] * (1 + 0.004 * wander * _wander(rng, n, rate, 30))
    clean = {
        "time": time,
        "v": truth["v"],
        "alpha": alpha,
        "gamma": gamma,
        "pressure": pressure,
        "fz": fz,
        "fy": force * np.tan(alpha) + 0.5 * gamma * fz,
        "temperature": temperature,
    }
    if "kappa" in truth:
        clean |= {"kappa": kappa, "fx": force * kappa}
    size = {
        "v": 0.03,
        "alpha": 0.02 * DEG,
        "gamma": 0.01 * DEG,
        "pressure": 200.0,
        "fz": 0.01 * truth["fz"].max(),
        "fy": 0.01 * truth["fz"].max(),
        "fx": 0.01 * truth["fz"].max(),
        "kappa": 0.001,
        "temperature": 0.3,
    }
    seen = {
        name: values + noise * size[name] * rng.normal(size=n) if name in size else values
        for name, values in clean.items()
    }
    return seen, clean


def cornering(seed=0, *, rate=100, loads=5, cambers=3, pressures=2, shape="line"):
    """A cornering test: spring rate, cold sweeps, warm-up, then every bin in turn."""
    rng = np.random.default_rng(seed)
    most = rng.uniform(800, 6000)
    loads = most * np.linspace(0.2, 1, loads)
    first = loads[len(loads) // 2]
    cambers = 2.0 * DEG * np.arange(cambers)
    pressures = 1e3 * (rng.uniform(55, 180) + 14 * np.arange(pressures))
    angle = rng.uniform(6, 13) * DEG
    leg = rng.uniform(2.0, 4.0)
    script = Script(rate, alpha=0.0, fz=loads[0], gamma=0.0, pressure=pressures[0], v=0.0)
    script.hold(2)
    script.move("v", 11.0, 3)
    script.hold(2)
    script.move("fz", first, 1)
    script.hold(1)
    for _ in range(3):
        _both_ways(script, angle, leg, "cold", shape)
    script.hold(rng.uniform(60, 90), "warm-up")
    script.move("fz", loads[0], 1)
    script.hold(2)
    script.sweep("fz", loads[-1], 8, "spring-rate")
    script.sweep("fz", loads[0], 8, "spring-rate")
    script.hold(2)
    for pressure in pressures:
        script.move("pressure", pressure, 5)
        script.hold(1.5)
        for gamma in cambers:
            script.move("gamma", gamma, 1.5)
            script.hold(1.5)
            for load in rng.permutation(loads):
                script.move("fz", load, rng.uniform(0.3, 0.8))
                script.hold(rng.uniform(1.2, 2))
                _both_ways(script, angle, leg, "", shape)
    return script, rng


def _both_ways(script, angle, leg, note, shape):
    script.sweep("alpha", -angle, leg, note, shape)
    script.sweep("alpha", angle, 2 * leg, note, shape)
    script.sweep("alpha", 0.0, leg, note, shape)
    script.hold(0.8, note)


def drum(seed=0, *, rate=200, loads=3, speeds=2):
    """A longitudinal test: braking sweeps by ramps, with a release after each."""
    rng = np.random.default_rng(seed)
    loads = rng.uniform(2000, 3000) * np.arange(1, loads + 1)
    speeds = 15.0 + 12.0 * np.arange(speeds)
    peak, leg = rng.uniform(0.3, 0.6), rng.uniform(0.8, 2.0)
    script = Script(rate, kappa=0.0, alpha=0.0, fz=loads[0], gamma=0.0, pressure=2.2e5, v=speeds[0])
    script.hold(2)
    for speed in speeds:
        script.move("v", speed, 4)
        script.hold(2)
        for load in loads:
            script.move("fz", load, 0.8)
            script.hold(1.5)
            for _ in range(3):
                script.sweep("kappa", peak, leg)
                script.move("kappa", 0.0, 0.15)
                script.hold(1.0)
    return script, rng


def combined(seed=0, *, rate=100):
    """Slip angles held in turn while the slip is swept both ways."""
    rng = np.random.default_rng(seed)
    script = Script(rate, kappa=0.0, alpha=0.0, fz=2000.0, gamma=0.0, pressure=2e5, v=20.0)
    script.hold(2)
    for load in (2000.0, 4000.0):
        script.move("fz", load, 0.6)
        for alpha in np.array([0.0, -3.0, -6.0]) * DEG:
            script.move("alpha", alpha, 0.8)
            script.hold(1.5)
            script.sweep("kappa", 0.15, 1.5)
            script.sweep("kappa", -0.15, 3.0)
            script.sweep("kappa", 0.0, 1.5)
            script.hold(1.0)
    return script, rng


def flat(seed=0):
    """Rows without time: sweeps one after the other, alternately up and down."""
    rng = np.random.default_rng(seed)
    loads = rng.uniform(1000, 2000) * np.arange(1, 5)
    angle, count = rng.uniform(5, 12) * DEG, int(rng.integers(15, 41))
    rows = []
    for load in loads:
        for gamma in (0.0, 3 * DEG):
            for direction in (1, -1):
                sweep = direction * np.linspace(-angle, angle, count)
                rows += [(a, gamma, load, direction) for a in sweep]
    alpha, gamma, load, direction = np.array(rows).T
    n = len(rows)
    fz = load * (1 + 0.01 * rng.normal(size=n))
    fy = 1.2 * fz * np.tanh(12 * alpha) + 0.01 * load * rng.normal(size=n)
    noisy = alpha + 0.01 * DEG * rng.normal(size=n)
    columns = {"alpha": noisy, "gamma": gamma, "fz": fz, "fy": fy}
    return columns, {"fz": load, "gamma": gamma, "direction": direction}
