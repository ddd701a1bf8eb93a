"""Write the simulated rig test: ``python -m fits.rig_test.generate --out DIR``.

The recordings have the layout of the FSAE Tire Test Consortium: ``cornering.dat`` (slip
angle swept, wheel rolling freely) and ``drive_brake.dat`` (slip ratio swept at three
slip angles), each of a new tire, at 100 Hz. ``true_tire.tir`` is the true tire.
``--small`` writes means of ten rows.
"""

import argparse
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from scipy.signal import lfilter

from fits.rig_test.tire import NOMINAL, RACING, RigTire, true_forces, write_true_tire
from tirefit.models import TireInputs

__all__ = ["LOADS", "SMALL", "Recording", "recordings", "write"]

DEG = np.pi / 180
STEP = 0.01
"""Time between rows [s]."""
SMALL = 10
"""Rows of the full test per row of the small test."""
LOADS = (889.6, 667.2, 222.4, 1112.1, 444.8)
"""Wheel loads [N] in the order of the test: 50 to 250 lbf."""
CAMBERS = (0.0, 2 * DEG, 4 * DEG)
PRESSURES = (82.7e3, 96.5e3)
"""Inflation pressures [Pa]: 12 and 14 psi."""
States = tuple[Sequence[float], Sequence[float]]
"""Pressures [Pa] and cambers [rad] of a test."""
SPEED = 11.18
"""Speed of the belt [m/s]: 25 mph."""
ANGLE, ANGLE_RATE = 12 * DEG, 4 * DEG
"""Largest slip angle [rad] of a sweep and its rate [rad/s]."""
SLIP, SLIP_RATE = 0.2, 0.1
"""Largest kappa of a sweep and its rate [1/s]."""
HELD_ANGLES = (0.0, 3 * DEG, 6 * DEG)
"""Slip angles of the brake and drive sweeps [rad], canonical: SA = 0, -3, -6 deg."""
MOVES = {"fz": 0.5, "alpha": 0.5, "gamma": 1.5, "pressure": 4.0}
"""Time [s] in which a channel moves to its next setting."""
WARM_UP = 8
"""Number of sweeps before the first setting."""
RELAXATION = {"alpha": 0.35, "kappa": 0.12}
"""Distance [m] by which the force lags the slip."""
REFERENCE_TEMPERATURE = 62.0
"""Surface temperature [degC] at which the tire is that of ``tire.TRUE``."""
FRICTION_PER_KELVIN, STIFFNESS_PER_KELVIN = -0.006, -0.003
"""Relative change of friction and slip stiffness with the surface temperature."""
FRICTION_NEW, STIFFNESS_NEW = -0.05, 0.08
"""Relative change of friction and slip stiffness of a new tire, before it wears in."""
RUN_IN = 60e3
"""Sliding work [J] by which a new tire wears in to 1/e: some six sweeps."""
AMBIENT = 24.0
"""Temperature [degC] of the air, and of a new tire."""


class Recording(NamedTuple):
    """One recording in canonical SI units and signs; arrays (n,).

    ``measured`` holds the channels with their errors, ``inputs`` the true inputs of the
    tire. ``friction`` and ``stiffness`` are the factors of :func:`true_forces` for the
    state of the tire (temperature, run-in). ``warm`` marks rows after the warm-up.
    """

    name: str
    measured: dict[str, np.ndarray]
    inputs: TireInputs
    friction: np.ndarray
    stiffness: np.ndarray
    warm: np.ndarray


# --- commands to the rig ----------------------------------------------------------


class _Script:
    """Commands row by row: settings that move, and sweeps of one slip."""

    def __init__(self, **settings: float):
        self.now = {"alpha": 0.0, "kappa": 0.0} | settings
        self.parts: dict[str, list[np.ndarray]] = {name: [] for name in self.now}
        self.rows = 0

    def _append(self, n: int, **paths: np.ndarray) -> None:
        for name, parts in self.parts.items():
            parts.append(paths.get(name, np.full(n, self.now[name])))
            self.now[name] = float(parts[-1][-1])
        self.rows += n

    def move(self, **settings: float) -> None:
        """Move all settings that differ together, then wait for half a second."""
        new = {k: v for k, v in settings.items() if v != self.now[k]}
        if new:
            n = round(max(MOVES[name] for name in new) / STEP)
            way = (1 - np.cos(np.pi * np.arange(1, n + 1) / n)) / 2
            self._append(n, **{k: self.now[k] + way * (v - self.now[k]) for k, v in new.items()})
        self._append(round(0.5 / STEP))

    def sweep(self, name: str, most: float, rate: float) -> None:
        """Sweep from zero to ``most``, to -``most``, and back to zero."""
        n = round(4 * most / rate / STEP)
        quarter = np.arange(1, n + 1) / n * 4
        path = most * np.interp(quarter, [0, 1, 3, 4], [0, 1, -1, 0])
        self._append(n, **{name: path})

    def commands(self) -> dict[str, np.ndarray]:
        return {name: np.concatenate(parts) for name, parts in self.parts.items()}


def _commands(
    swept: str, angles: Sequence[float], loads: Sequence[float], states: States
) -> tuple[dict[str, np.ndarray], int]:
    """Commands of a test that sweeps one slip, and the number of its warm-up rows.

    Args:
        swept: ``alpha`` or ``kappa``.
        angles: slip angles [rad] that are held; of the cornering test, zero.
        loads: wheel loads [N].
        states: pressures and cambers.
    """
    sweep = (swept, ANGLE, ANGLE_RATE) if swept == "alpha" else (swept, SLIP, SLIP_RATE)
    script = _Script(fz=LOADS[0], gamma=0.0, pressure=states[0][0])
    script.move()
    for _ in range(WARM_UP):
        script.sweep(*sweep)
    warm_up = script.rows
    for pressure, gamma, alpha, fz in product(*states, angles, loads):
        script.move(fz=fz, gamma=gamma, pressure=pressure, alpha=alpha)
        script.sweep(*sweep)
    return script.commands(), warm_up


# --- physics of rig and tire ------------------------------------------------------


def _lagged(values: np.ndarray, time: float) -> np.ndarray:
    """First-order lag of a time constant [s]."""
    share = 1 - np.exp(-STEP / time)
    start = [(1 - share) * values[0]]
    return lfilter([share], [1, share - 1], values, zi=start)[0]


def _wander(rng, n: int, std: float, time: float) -> np.ndarray:
    """Noise (n,) of a standard deviation and a correlation time [s]."""
    kept = np.exp(-STEP / time)
    white = rng.standard_normal(n)
    white[1:] *= np.sqrt(1 - kept**2)
    return std * lfilter([1], [1, -kept], white)


def _exposed(command: dict[str, np.ndarray], rng) -> dict[str, np.ndarray]:
    """True channels: the commands with the errors of their controllers.

    The load controller lags, and the slip forces disturb it: the load is up to about
    8 % off, as a function of the swept slip.
    """
    n = len(command["fz"])
    angle, slip = command["alpha"] / ANGLE, command["kappa"] / SLIP
    pushed = 0.035 * angle + 0.04 * np.abs(angle) - 0.05 * np.abs(slip) - 0.02 * slip
    fz = _lagged(command["fz"], 0.08) * (1 + _lagged(pushed, 0.3) + _wander(rng, n, 0.01, 0.8))
    return {
        "alpha": command["alpha"] + _wander(rng, n, 0.01 * DEG, 0.2),
        "kappa": command["kappa"] + _wander(rng, n, 4e-4, 0.2),
        "fz": fz,
        "gamma": command["gamma"] + 0.04 * DEG * angle,
        "pressure": command["pressure"] + _wander(rng, n, 250.0, 5.0),
        "v": SPEED + _wander(rng, n, 0.015, 1.0),
    }


def _inputs(exposed: dict[str, np.ndarray]) -> TireInputs:
    """Canonical inputs; the slips are delayed by their relaxation lengths."""
    alpha, kappa = (_lagged(exposed[name], RELAXATION[name] / SPEED) for name in ("alpha", "kappa"))
    rest = {name: exposed[name] for name in ("fz", "v", "gamma", "pressure")}
    return TireInputs(kappa / (1 - kappa), alpha, **rest, time=np.zeros(len(alpha)))


_HEATING, _SURFACE, _BULK = 0.5, 150.0, 2500.0
"""Share of the sliding power that heats the tire; heat capacities of surface and bulk
[J/K]."""
_INWARDS, _AWAY = 32.0, 26.0
"""Thermal conductance from surface to bulk, and from bulk to air [W/K]."""


def _temperatures(power: np.ndarray) -> np.ndarray:
    """Surface temperature [degC] for a sliding power [W], (n,)."""
    surface = bulk = AMBIENT
    out = np.empty(len(power))
    for row, heat in enumerate((_HEATING * power).tolist()):
        inwards = _INWARDS * (surface - bulk)
        surface += STEP * (heat - inwards) / _SURFACE
        bulk += STEP * (inwards - _AWAY * (bulk - AMBIENT)) / _BULK
        out[row] = surface
    return out


def _state(inputs: TireInputs, tire: RigTire) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Temperature, and the factors of friction and stiffness, of each row.

    The sliding power depends on the force, and so on the temperature: three rounds.
    """
    friction = stiffness = np.full(len(inputs.fz), 1.0)
    for _ in range(3):
        given = true_forces(inputs, friction, stiffness, tire)
        kappa = inputs.sigma_x / (1 + inputs.sigma_x)
        sliding = given["fx"] * kappa + given["fy"] * np.tan(inputs.alpha)
        power = np.abs(sliding) * inputs.v
        temperature = _temperatures(power)
        new = np.exp(-np.cumsum(power) * STEP / RUN_IN)
        warmer = temperature - REFERENCE_TEMPERATURE
        friction = (1 + FRICTION_PER_KELVIN * warmer) * (1 + FRICTION_NEW * new)
        stiffness = (1 + STIFFNESS_PER_KELVIN * warmer) * (1 + STIFFNESS_NEW * new)
    return temperature, friction, stiffness


# --- measurement ------------------------------------------------------------------

_WHITE, _SLOW, _RIPPLE = 0, 1, 2
_NOISE = {
    "fx": (4.0, 5.0, 0.008),
    "fy": (4.0, 5.0, 0.008),
    "fz": (2.5, 2.0, 0.012),
    "mz": (0.15, 0.25, 0.0012),
    "mx": (0.6, 0.8, 0.0008),
}
"""Standard deviations of white and of correlated noise [N, N m], and the amplitude of
the once-per-revolution ripple relative to the load [-, m]."""
_VERTICAL_STIFFNESS = 95e3
"""Vertical stiffness of the tire [N/m]."""


def _measured(exposed, inputs: TireInputs, temperature, given, rng) -> dict:
    """Channels with measurement errors, in canonical signs."""
    n = len(temperature)
    fz, v = exposed["fz"], exposed["v"]
    loaded = NOMINAL["UNLOADED_RADIUS"] - fz / _VERTICAL_STIFFNESS
    effective = NOMINAL["UNLOADED_RADIUS"] - fz / _VERTICAL_STIFFNESS / 3
    slip = exposed["kappa"] + 2e-4 * rng.standard_normal(n)
    omega = v * np.cos(exposed["alpha"]) * (1 - slip) / effective
    turned = np.cumsum(omega) * STEP
    clean = given | {"fz": fz}
    out = {}
    for number, (name, noise) in enumerate(_NOISE.items()):
        ripple = noise[_RIPPLE] * fz * np.cos(turned + 1.3 * number)
        ripple += 0.3 * noise[_RIPPLE] * fz * np.cos(2 * turned + 0.7 * number)
        out[name] = clean[name] + ripple + noise[_WHITE] * rng.standard_normal(n)
        out[name] += _wander(rng, n, noise[_SLOW], 0.15)
    side = 120 * exposed["gamma"]
    return out | {
        "time": STEP * np.arange(n),
        "v": v + 0.005 * rng.standard_normal(n),
        "omega": omega,
        "alpha": exposed["alpha"] + 0.004 * DEG * rng.standard_normal(n),
        "kappa": slip,
        "gamma": exposed["gamma"] + 0.004 * DEG * rng.standard_normal(n),
        "pressure": exposed["pressure"] + 60 * rng.standard_normal(n),
        "loaded_radius": loaded + 5e-5 * rng.standard_normal(n),
        "effective_radius": effective,
        "inner": temperature + side + 0.3 * rng.standard_normal(n),
        "centre": temperature + 0.3 * rng.standard_normal(n),
        "outer": temperature - side + 0.3 * rng.standard_normal(n),
        "ambient": AMBIENT + _wander(rng, n, 0.3, 200.0),
        "belt": AMBIENT + 2 + 0.1 * (_lagged(temperature, 60.0) - AMBIENT),
    }


def _thinned(values: np.ndarray, thin: int) -> np.ndarray:
    """Means of ``thin`` successive rows."""
    rows = len(values) // thin * thin
    return values[:rows].reshape(-1, thin).mean(axis=1)


def recordings(
    seed: int,
    thin: int = 1,
    loads: Sequence[float] = LOADS,
    tire: RigTire = RACING,
    states: States = (PRESSURES, CAMBERS),
) -> tuple[Recording, Recording]:
    """The cornering test, and the brake and drive test.

    Args:
        seed: seed of the noise and of the errors of the controllers.
        thin: number of 100 Hz rows that are averaged into one.
        loads: wheel loads [N] of the sweeps after the warm-up.
        tire: the true tire.
        states: pressures and cambers.
    """
    made = []
    tests = {"cornering": ("alpha", (0.0,)), "drive_brake": ("kappa", HELD_ANGLES)}
    for number, (name, (swept, angles)) in enumerate(tests.items()):
        rng = np.random.default_rng([seed, number])
        command, warm_up = _commands(swept, angles, loads, states)
        exposed = _exposed(command, rng)
        felt = _inputs(exposed)
        temperature, friction, stiffness = _state(felt, tire)
        given = true_forces(felt, friction, stiffness, tire)
        measured = _measured(exposed, felt, temperature, given, rng)
        warm = np.arange(len(friction)) >= warm_up
        made.append(
            Recording(
                name,
                {k: _thinned(v, thin) for k, v in measured.items()},
                TireInputs(*(_thinned(np.asarray(v), thin) for v in felt)),
                _thinned(friction, thin),
                _thinned(stiffness, thin),
                _thinned(warm.astype(float), thin) == 1,
            )
        )
    return made[0], made[1]


# --- files ------------------------------------------------------------------------

_COLUMNS = {
    "ET": ("time", 1.0, "sec"),
    "V": ("v", 3.6, "kph"),
    "N": ("omega", 30 / np.pi, "rpm"),
    "SA": ("alpha", -1 / DEG, "deg"),
    "IA": ("gamma", 1 / DEG, "deg"),
    "RL": ("loaded_radius", 100.0, "cm"),
    "RE": ("effective_radius", 100.0, "cm"),
    "P": ("pressure", 1e-3, "kPa"),
    "FX": ("fx", -1.0, "N"),
    "FY": ("fy", 1.0, "N"),
    "FZ": ("fz", -1.0, "N"),
    "MX": ("mx", 1.0, "N-m"),
    "MZ": ("mz", 1.0, "N-m"),
    "NFX": ("nfx", -1.0, "none"),
    "NFY": ("nfy", -1.0, "none"),
    "RST": ("belt", 1.0, "deg C"),
    "TSTI": ("inner", 1.0, "deg C"),
    "TSTC": ("centre", 1.0, "deg C"),
    "TSTO": ("outer", 1.0, "deg C"),
    "AMBTMP": ("ambient", 1.0, "deg C"),
    "SR": ("slip_of_loaded_radius", 1.0, "none"),
    "SL": ("kappa", -1.0, "none"),
}
"""Header -> channel, factor to the unit and sign (SAE) of the file, unit."""


def table_of(recording: Recording) -> tuple[dict[str, np.ndarray], list[str]]:
    """Header -> values (n,) in the units and signs of the file, and the units."""
    seen = dict(recording.measured)
    seen |= {"nfx": seen["fx"] / seen["fz"], "nfy": -seen["fy"] / seen["fz"]}
    rolling = seen["omega"] * seen["loaded_radius"]
    seen["slip_of_loaded_radius"] = rolling / (seen["v"] * np.cos(seen["alpha"])) - 1
    table = {header: f * seen[name] for header, (name, f, _) in _COLUMNS.items()}
    return table, [unit for _, _, unit in _COLUMNS.values()]


def write(directory: Path, seed: int, thin: int = 1, loads: Sequence[float] = LOADS) -> list[Path]:
    """Write both recordings and the true tire; returns the paths."""
    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    for recording in recordings(seed, thin, loads):
        table, units = table_of(recording)
        path = directory / f"{recording.name}.dat"
        title = f"Title:Simulated rig test: {recording.name}, seed {seed}"
        head = "\n".join([title, "\t".join(table), "\t".join(units)])
        rows = np.column_stack(list(table.values()))
        np.savetxt(path, rows, "%.7g", "\t", header=head, comments="")
        paths.append(path)
    write_true_tire(directory / "true_tire.tir")
    return [*paths, directory / "true_tire.tir"]


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--small", action="store_true", help=f"means of {SMALL} rows")
    given = parser.parse_args()
    for path in write(given.out, given.seed, SMALL if given.small else 1):
        print(path)


if __name__ == "__main__":
    main()
