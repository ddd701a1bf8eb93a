"""Whatever the file: no warning, and no number that nobody can mean.

Files of a small generator of its own, over designs, sizes, gaps, noise and what is
stated of it. A handful runs with the suite, two hundred with ``-m statistics``: all of
the handful have a little noise of the slip, known or found, so that two programs that
other tests compile as well, of F_x and of F_y, serve them all.
"""

import json
import math

import numpy as np
import pytest
from conftest_diagnosis import brush

from tirefit.data.read import read_frame
from tirefit.diagnosis.effects import EFFECTS, effects_by_id
from tirefit.diagnosis.engine import diagnose
from tirefit.diagnosis.rig import Rig

GAPS = ("none", "shift", "ripple", "late", "step", "kappa", "load", "half", "noise")
OFTEN_NONE = {
    "closed", "closed_ci", "z", "z_given_rivals", "holdout", "taken_for", "settings",
    "path", "sha256", "given", "slip_check", "next_measurement_reason",
    "simulator", "adequacy",
}  # fmt: skip
"""Keys that may have no value: too small a gap to say, nothing that it is taken for."""


def _slips(draw, n, order):
    """A slip and the time of each row: sweeps, random points or sorted blocks."""
    size = np.exp(draw.uniform(np.log(0.02), np.log(0.7)))
    low = draw.choice([0.0, -size])
    time = np.arange(n) * draw.choice([0.01, 0.05])
    if order == "sweeps":
        turns = draw.uniform(1.0, 4.0)
        return low + (size - low) * (0.5 - 0.5 * np.cos(
            2 * np.pi * turns * np.arange(n) / n)), time  # fmt: skip
    slip = np.linspace(low, size, n)
    return (draw.permutation(slip) if order == "random" else slip), time


def _force(gap, slip, time, fz, v, cpa2, mu):
    half = time > np.median(time)
    if gap == "late":
        return brush(np.interp(time - 0.03, time, slip), cpa2, mu, fz)
    if gap == "load":
        return brush(slip, cpa2, mu * (fz / 4e3) ** -0.3, fz)
    if gap == "step":
        return brush(slip, cpa2, mu * np.where(half, 0.7, 1.0), fz)
    if gap == "half":
        return brush(slip, cpa2, mu * np.where(slip > 0, 0.8, 1.0), fz)
    if gap == "noise":
        return 0.0 * slip
    force = brush(slip + 0.01 * (gap == "shift"), cpa2, mu, fz)
    return force + (0.08 * fz * np.sin(80 * slip) if gap == "ripple" else 0.0)


def generated(seed):
    """(columns, rig) of one file."""
    draw = np.random.default_rng([2026, seed])
    n = int(np.exp(draw.uniform(np.log(30), np.log(250))))
    order = draw.choice(["sweeps", "random", "sorted"])
    lateral = draw.random() < 0.25
    slip, time = _slips(draw, n, order)
    fz = draw.choice([2e3, 4e3, 6e3], n) if draw.random() < 0.6 else np.full(n, 4e3)
    v = draw.choice([5.0, 20.0], n) if draw.random() < 0.4 else np.full(n, 15.0)
    cpa2, mu = 4e4 * draw.uniform(0.5, 2.5), draw.uniform(0.2, 1.3)
    gap = draw.choice(GAPS)
    # Without any force and any noise there is nothing to read.
    share = draw.choice([0.0, 1e-3, 1e-2, 0.1]) if gap != "noise" else 0.01
    force = _force(gap, slip, time, fz, v, cpa2, mu)
    force = force + share * fz * draw.standard_normal(n)
    if draw.random() < 0.15:
        force[draw.integers(0, n, max(n // 15, 1))] += 0.4 * 4e3
    measured = slip + draw.choice([0.0, 1e-3]) * draw.standard_normal(n)
    if lateral:
        columns = {"alpha": np.arctan(measured), "fy": force}
    else:
        # A kappa below -1 is no sigma_x that a reader would take.
        other = gap == "kappa" and measured.min() > -0.45
        logged = measured / (1 + measured) if other else measured
        columns = {"sigma_x": logged, "fx": force}
    columns |= {"fz": fz}
    if draw.random() < 0.7:
        columns |= {"time": time}
    if draw.random() < 0.7:
        columns |= {"v": v, "omega": v / (0.3 * (1 + (0 if lateral else slip)))}
    stated = {"force_relative": share * draw.choice([0.2, 1.0, 5.0])} if share else {}
    noise = stated if draw.random() < 0.6 else {}
    noise |= {"slip": 1e-3} if draw.random() < 0.3 else {}
    radius = draw.choice([None, 0.3, 0.305])
    return columns, Rig(noise=noise, rolling_radius=radius)


def _walk(value, path=()):
    """(path, leaf) of every leaf of a document."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _walk(inner, (*path, key))
    elif isinstance(value, list):
        for inner in value:
            yield from _walk(inner, path)
    else:
        yield path, value


def faults(document):
    """What nobody can mean in a document: sentences."""
    said = []
    for path, value in _walk(document):
        where = ".".join(path)
        if value is None and not OFTEN_NONE & set(path):
            said.append(f"{where} has no value")
        if isinstance(value, float) and not abs(value) < 1e12:
            said.append(f"{where} = {value}")
        if path[-1] in ("probability", "share", "p_value", "p_now", "p_after"):
            if not -1e-9 <= value <= 1 + 1e-9:
                said.append(f"{where} = {value}")
        if path[-1] in ("closed", "closed_ci") and value is not None:
            if not -1 <= value <= 1:
                said.append(f"{where} = {value}")
    known = effects_by_id(EFFECTS)
    for candidate in document["candidates"]:
        for name, figure in candidate["parameters"].items():
            effect = known[name.split(":")[0]]
            low = min(pair[0] for pair in effect.bounds) - 0.2
            high = max(pair[1] for pair in effect.bounds) + 0.2
            if not low <= figure["value"] <= high or not figure["std"] < 1e3:
                said.append(f"{name} = {figure}")
            if not figure["std"] < 100 * effect.scale:
                said.append(f"{name}: std {figure['std']}")
    return said


def _check(seed):
    columns, rig = generated(seed)
    found = diagnose(read_frame(columns, f"file {seed}"), rig=rig, seed=seed)
    said = faults(json.loads(found.to_json()))
    assert not said, f"seed {seed}: {said}"
    for channel, parts in found.rows.items():
        for name, values in parts.items():
            assert np.all(np.isfinite(values)), (seed, channel, name)
            limit = 20 * np.max(np.abs(columns[channel])) + 1e4
            assert np.max(np.abs(values)) < limit, (seed, channel, name)


A_HANDFUL = {4: "noise", 33: "kappa", 47: "order", 55: "late", 74: "step", 81: "half"}
"""What each has beside others; 47, 55 and 74 are lateral, 47 has no time."""


@pytest.mark.parametrize("seed", A_HANDFUL, ids=A_HANDFUL.get)
def test_a_document_means_something(seed):
    _check(seed)


@pytest.mark.statistics
@pytest.mark.parametrize("seed", sorted(set(range(206)) - set(A_HANDFUL)))
def test_every_document_means_something(seed):
    _check(seed)


def test_the_check_sees_what_nobody_can_mean():
    good = {"candidates": [], "gap": {"closed": 0.5}, "verdict": {"probability": 0.5}}
    assert faults(good) == []
    assert faults(good | {"gap": {"closed": -1.4e147}})
    assert faults(good | {"n_effective": None})
    assert faults(good | {"noise": {"fx": math.inf}})
    assert faults(good | {"verdict": {"probability": 1.5}})
    number = {"value": -0.4, "std": 1.8e146, "unit": "s"}
    wild = {"parameters": {"channel_delay: delay": number}}
    assert faults(good | {"candidates": [wild]})
