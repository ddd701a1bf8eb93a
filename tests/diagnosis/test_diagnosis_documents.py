"""No file gives a warning or an implausible number.

Files of a small generator of its own, over designs, sizes, gaps, noise and what is
stated of it. A handful runs with the suite, two hundred with ``-m statistics``: all of
the handful have a little noise of the slip, known or found, so that two programs that
other tests compile as well, of F_x and of F_y, serve them all.
"""

import json
import math
from collections import defaultdict

import numpy as np
import pytest
from conftest_diagnosis import brush

from tirefit.data.read import read_frame
from tirefit.diagnosis.diagnose import diagnose
from tirefit.diagnosis.effects import EFFECTS, NOISE_EFFECTS, effects_by_id
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig

SLACK = 0.1
"""Of an amplitude's usual size: its bounds are those of a search, not to the digit."""

GAPS = ("none", "shift", "ripple", "late", "step", "kappa", "load", "half", "noise")
OFTEN_NONE = {
    "closed", "closed_ci", "holdout", "settings",
    "path", "sha256", "given", "slip_check",
    "simulator", "tests", "closed_left_out", "closed_left_out_std", "ladder",
}  # fmt: skip
"""Keys that may have no value: too small a gap to say."""


def _slips(draw, n, order):
    """A slip and the time of each row: sweeps, random points or sorted blocks."""
    size = np.exp(draw.uniform(np.log(0.02), np.log(0.7)))
    low = draw.choice([0.0, -size])
    time = np.arange(n) * draw.choice([0.01, 0.05])
    if order == "sweeps":
        turns = draw.uniform(1.0, 4.0)
        return low + (size - low) * (0.5 - 0.5 * np.cos(2 * np.pi * turns * np.arange(n) / n)), time
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
        # A reader refuses the sigma_x of a kappa below -1.
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


OF_NOISE = {effect.id for effect in NOISE_EFFECTS}
PROBABILITIES = ("probability", "unlisted", "share", "p_value", "p_now", "p_after")


def _together(document):
    """Probability of all that excludes one another: something unlisted, or one of the
    sets of listed effects alone. Where nothing is named, sets are ranked only."""
    verdict = document["verdict"]
    if verdict["status"] == "none" or set(verdict["effects"]) <= OF_NOISE:
        return 0.0
    beside = verdict["effects"] if verdict["status"] == "incomplete" else None
    alone = (
        one["probability"]
        for one in document["candidates"]
        if one["effects"] not in (["unknown"], beside)
    )
    return verdict["left"]["unlisted"] + sum(alone)


RADIUS = 0.3  # m, of every wheel here


def sizes_of_file(columns, data, rig):
    """The scales of a file; that of the inertia is computed independently."""
    channel = "fy" if "fy" in columns else "fx"
    carried = np.mean(columns["fz"]) / 9.81
    return prepare(data, rig, (channel,)).sizes | {"inertia": carried * RADIUS**2}


def _allowed(effect, sizes):
    """Lowest and highest amplitude of an effect and the largest standard error, on the
    scale of the file: each variant has bounds in shares of its own size or of one."""
    size = np.array([sizes[per] for per in effect.per])
    low, high = (np.array(effect.bounds) * size[:, None]).T
    return low.min(), high.max(), effect.scale * size.max()


def faults(document, sizes):
    """Sentences on implausible content of a document.

    Args:
        sizes: of its file, in shares of which amplitudes are bounded.
    """
    said = []
    for path, value in _walk(document):
        where = ".".join(path)
        if value is None and not OFTEN_NONE & set(path):
            said.append(f"{where} has no value")
        if isinstance(value, float) and not abs(value) < 1e12:
            said.append(f"{where} = {value}")
        if path[-1] in PROBABILITIES:
            if not -1e-9 <= value <= 1 + 1e-9:
                said.append(f"{where} = {value}")
        if path[-1] in ("closed", "closed_ci") and value is not None:
            if not -1 <= value <= 1:
                said.append(f"{where} = {value}")
    if _together(document) > 1 + 1e-9:
        said.append(f"probabilities add to {_together(document)}")
    known = effects_by_id(EFFECTS)
    for candidate in document["candidates"]:
        for name, figure in candidate["parameters"].items():
            effect = known[name.split(":")[0]]
            low, high, scale = _allowed(effect, sizes)
            if effect.id == "slip_offset" and document.get("slip_check"):
                # Seen between two slips, it may be meant whatever its size.
                seen = abs(document["slip_check"]["offset"])
                scale = max(scale, seen)
                low, high = min(low, -2 * seen), max(high, 2 * seen)
            if not low - SLACK * scale <= figure["value"] <= high + SLACK * scale:
                said.append(f"{name} = {figure}")
            # However badly an effect fits, no less is known of it than beforehand.
            if not 0 <= figure["std"] <= (1 + SLACK) * scale:
                said.append(f"{name}: std {figure['std']}")
    return said


def _check(seed):
    columns, rig = generated(seed)
    data = read_frame(columns, f"file {seed}")
    found = diagnose(data, rig=rig, seed=seed)
    said = faults(json.loads(found.to_json()), sizes_of_file(columns, data, rig))
    assert not said, f"seed {seed}: {said}"
    used = found.table.used
    assert used.sum() > 0.9 * len(used)
    for channel, parts in found.rows.items():
        for name, values in parts.items():
            np.testing.assert_array_equal(np.isfinite(values), used, f"{seed} {name}")
            limit = 20 * np.max(np.abs(columns[channel])) + 1e4
            assert np.max(np.abs(values[used])) < limit, (seed, channel, name)


A_HANDFUL = {4: "noise", 33: "kappa", 47: "order", 55: "late", 74: "step", 81: "half"}
"""What each has beside others; 47, 55 and 74 are lateral, 47 has no time."""

_LATER = (4, 55, 74, 81)


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(k, marks=pytest.mark.long if k in _LATER else (), id=A_HANDFUL[k])
        for k in A_HANDFUL
    ],
)
def test_a_document_has_plausible_values(seed):
    _check(seed)


@pytest.mark.statistics
@pytest.mark.parametrize("seed", sorted(set(range(206)) - set(A_HANDFUL)))
def test_every_stored_document_has_plausible_values(seed):
    _check(seed)


QUIET = {"status": "none", "probability": 0.5}


def test_the_check_detects_implausible_values():
    good = {"candidates": [], "gap": {"closed": 0.5}, "verdict": QUIET}
    plain = defaultdict(lambda: 1.0)
    assert faults(good, plain) == []
    assert faults(good | {"gap": {"closed": -1.4e147}}, plain)
    assert faults(good | {"n_effective": None}, plain)
    assert faults(good | {"noise": {"fx": math.inf}}, plain)
    assert faults(good | {"verdict": QUIET | {"probability": 1.5}}, plain)
    verdict = {"status": "named", "effects": ["toe"], "left": {"unlisted": 0.4}}
    sure = {"candidates": [{"effects": ["toe"], "probability": 0.7, "parameters": {}}]}
    assert faults(good | sure | {"verdict": verdict}, plain)
    less = verdict | {"left": {"unlisted": 0.3}}
    assert faults(good | sure | {"verdict": less}, plain) == []
    wild = named("channel_delay: delay", -0.4, 1.8e146, "s")
    assert faults(good | wild, plain)


def named(name, value, std, unit):
    """Part of a document: one candidate of one effect."""
    figure = {"value": value, "std": std, "unit": unit}
    return {"candidates": [{"parameters": {name: figure}}]}


@pytest.mark.parametrize(
    ("share", "std", "is_meant"),
    [
        (0.03, 0.02, True),  # a car's wheel
        (0.25, 0.03, True),  # a geared motor
        (-0.03, 0.02, True),  # taken off twice
        (-0.09, 0.03, False),  # three wheels the wrong way
        (0.5, 0.03, False),
        (0.03, 0.3, False),
    ],
)
@pytest.mark.parametrize("mass", [1.8, 400.0, 4000.0])
def test_amplitudes_are_compared_with_the_scale_of_their_file(share, std, is_meant, mass):
    """A share of the carried mass at the radius of the wheel, for any load."""
    sizes = defaultdict(lambda: 1.0, inertia=mass * RADIUS**2)
    figures = (sizes["inertia"] * share, sizes["inertia"] * std, "kg m^2")
    found = {"verdict": QUIET}
    said = faults(found | named("wheel_inertia: inertia", *figures), sizes)
    assert (not said) == is_meant
