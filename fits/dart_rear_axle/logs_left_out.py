"""Effects of the axle named on five logs, and the gap that they close on the sixth.

``python -m fits.dart_rear_axle.logs_left_out``: README.md states the split, which was
fixed before any diagnosis. The second part gives limits of the remainder: the noise of
the tracker after the filter, and the scatter of repeated states.
"""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from scipy.special import stdtrit

import tirefit
from tirefit.data.vehicle.derive import derive
from tirefit.data.vehicle.motion import read_motion
from tirefit.data.vehicle.vehicle import load_vehicle

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent
LOGS = HERE.parent / "dart_jetracer"
AT_REST = 0.02  # m/s
ALIKE = {"alpha": 1e-3, "v": 0.03, "alpha_rate": 0.02}
"""Largest differences of two rows with the same tire state: rad, m/s, rad/s."""
TURNING = ALIKE | {"yaw_rate": 0.05}
"""The same with the yaw rate [rad/s], on which a tire does not depend."""
APART = 5.0  # s, least time between two measurements of a state


def split(data, out: int):
    """(the other logs, the log left out) as separate data."""
    codes = [k for k in range(len(data.runs)) if k != out]
    return data.where(data.run != out), data.where(data.run == out), codes


def left_out(data) -> list[dict]:
    """One line per log: the effects named on the others, and their closure on it."""
    lines = []
    for out, name in enumerate(data.runs):
        rest, held, _ = split(data, out)
        held = replace(held, name=name)
        found = tirefit.diagnose(rest, holdout=[held])
        gap = found.gap.holdout
        lines.append(
            {
                "log": name,
                "status": found.verdict.status,
                "effects": found.effects,
                "probability": found.verdict.probability,
                "here": found.gap.closed,
                "gap": gap and gap.rms,
                "left": gap and gap.remaining_rms,
                "closed": gap and gap.closed,
                "parameters": found.candidates[0].parameters,
                "runs": found.runs,
            }
        )
        print(lines[-1], flush=True)
    return lines


def tracker_noise() -> dict[str, float]:
    """Noise of alpha [rad] and fy [N] at 2 m/s: differences of neighbouring poses of the
    car at rest, after the filter and the differentiation."""
    vehicle = load_vehicle(LOGS / "vehicle.toml")
    position, heading = [], []
    for path in sorted(LOGS.glob("*/*.csv.gz")):
        track, motion, _ = read_motion(path, vehicle)
        speed = np.hypot(motion.v_x, motion.v_y)
        still = np.interp(track.time, motion.time, np.nan_to_num(speed, nan=9.0))
        rest = np.flatnonzero(still < AT_REST)
        pairs = rest[:-1][np.diff(rest) == 1]
        steps = track.signals[pairs + 1] - track.signals[pairs]
        position.append(steps[:, :2].ravel())
        heading.append(steps[:, 2])
    xy, yaw = (
        1.4826 * np.median(np.abs(np.concatenate(x))) / np.sqrt(2) for x in (position, heading)
    )
    rate, cutoff = vehicle.filter.sample_rate, vehicle.filter.cutoff
    frequency = np.linspace(0, rate / 2, 20001)
    passed = 1 / (1 + (frequency / cutoff) ** (2 * vehicle.filter.order))
    difference = np.sin(2 * np.pi * frequency / rate) * rate
    gain = [np.sqrt(np.mean((passed * difference**k) ** 2)) for k in range(3)]
    wheelbase = vehicle.l_f + vehicle.l_r
    arm = vehicle.tracked_point[0]
    sideways = np.hypot(xy, arm * yaw) * gain[1] / 2.0
    mass = vehicle.mass * vehicle.l_f / wheelbase
    return {
        "position": xy,
        "heading": yaw,
        "alpha": float(np.hypot(sideways, yaw * gain[0])),
        "fy": float(np.hypot(mass * xy, vehicle.yaw_inertia / wheelbase * yaw) * gain[2]),
    }


def repeats(alike=ALIKE, every: int = 10) -> dict[str, float]:
    """Scatter of fy [N] between two measurements of one state, within a log and between
    logs, with equal weight of all pairs. The linear dependence of fy on the remaining
    difference of state is removed."""
    vehicle = load_vehicle(LOGS / "vehicle.toml")
    logs = [derive(path, vehicle) for path in sorted(LOGS.glob("*/*.csv.gz"))]
    names = (*alike, "time", "fy")
    table = [np.stack([log.columns[n][::every] for n in names]) for log in logs]
    run = np.repeat(np.arange(len(logs)), [part.shape[1] for part in table])
    *state, time, force = np.concatenate(table, axis=1)
    state = np.stack([x / size for x, size in zip(state, alike.values(), strict=True)])
    off = {"one log": [], "two logs": []}
    for k in range(len(time)):
        step = state[:, k + 1 :] - state[:, [k]]
        rows = k + 1 + np.flatnonzero(np.all(np.abs(step) < 1, axis=0))
        same = run[rows] == run[k]
        later = same & (np.abs(time[rows] - time[k]) > APART)
        for name, some in (("one log", rows[later]), ("two logs", rows[~same])):
            moved = state[:, some] - state[:, [k]]
            off[name].append(np.vstack([moved, force[some] - force[k]]))
    scatter = {}
    for name, parts in off.items():
        *moved, differs = np.concatenate(parts, axis=1)
        slope = np.linalg.lstsq(np.stack(moved, axis=1), differs)[0]
        rest = differs - np.stack(moved, axis=1) @ slope
        scatter[name] = float(np.sqrt(np.mean(rest**2) / 2))
        scatter[f"pairs of {name}"] = len(differs)
    return scatter


def main() -> None:
    data = tirefit.read(HERE / "six_logs.csv", convention="braking")
    print(tracker_noise())
    print(repeats())
    print(repeats(TURNING))
    closed = np.array([line["closed"] or 0.0 for line in left_out(data)])
    reach = stdtrit(len(closed) - 1, 0.95) * closed.std(ddof=1) / len(closed) ** 0.5
    print(f"closed: {closed.mean():.3f} +- {reach:.3f} (90 %, t of {len(closed)} logs)")


if __name__ == "__main__":
    main()
