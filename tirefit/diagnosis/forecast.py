"""Cannot tell, and the next measurement: forecasts from the geometry of the data."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from tirefit.diagnosis.base import Base
from tirefit.diagnosis.basis import without
from tirefit.diagnosis.rows import Prepared

__all__ = [
    "Recognition",
    "confusion",
    "next_measurements",
    "recognition",
    "scores_of_nothing",
    "separability",
]


def separability(columns, a: int, b: int, size_a: float, size_b: float) -> float:
    """Forecast probability of telling effect a from b, by the larger |z|.

    Args:
        columns: (m, K) directions of the effects, base parameters taken out.
        size_a, size_b: amplitudes in units of the columns.
    """
    one, two = columns[:, a] * size_a, columns[:, b] * size_b
    energy = (one @ one, two @ two)
    if min(energy) < 1e-9:
        return 0.5
    correlation = one @ two / np.sqrt(energy[0] * energy[1])
    # Exact confusions have a correlation of 1, and a rounding beyond it.
    apart = max(1 - abs(correlation), 0.0)
    return float(ndtr(np.sqrt(min(energy) * apart / 2)))


class Recognition(NamedTuple):
    """Forecast probabilities that a gap would be ``seen`` at all, and that it would be
    seen and ``recognised``; ``taken_for`` is what it is taken for else, None if it
    hardly ever is."""

    seen: float
    recognised: float
    taken_for: str | None


def recognition(directions, names: Sequence[str], truth: int, size: float, sign, noise):
    """What an effect would be taken for, by the largest score: :class:`Recognition`.

    The scores of unit directions are z ~ N(size R[:, truth], R), R their correlation,
    whatever the forces turn out to be (diagnosis by matched filters).

    Args:
        directions: (m, K) of length one, base parameters taken out.
        names: what each of them stands for (K); variants share a name.
        truth: which of them is there.
        size: its amplitude in standard errors.
        sign: (K,) +1 or -1 where only that sign is possible, else 0.
        noise: (K, draws) scores of no gap, see :func:`scores_of_nothing`.
    """

    def ranked(z):
        return np.where(sign[:, None] != 0, z * sign[:, None], np.abs(z))

    # A gap is seen where nothing exceeds its score in 19 cases of 20.
    limit = np.quantile(ranked(noise).max(axis=0), 0.95)
    correlation = directions.T @ directions[:, truth]
    score = ranked(noise + size * correlation[:, None])
    seen = score.max(axis=0) > limit
    top = Counter(names[k] for k in score.argmax(axis=0)[seen])
    right = top.pop(names[truth], 0)
    (other, often), *_ = top.most_common(1) or [(None, 0)]
    count = noise.shape[1]
    return Recognition(
        float(seen.mean()), right / count, other if often > 0.05 * count else None
    )


def scores_of_nothing(directions, draws: int, generator) -> np.ndarray:
    """Scores of unit directions in white noise: (K, draws)."""
    values, vectors = np.linalg.eigh(directions.T @ directions)
    root = vectors * np.sqrt(np.maximum(values, 0))
    return root @ generator.standard_normal((directions.shape[1], draws))


def confusion(search, draws: int = 2000) -> list[dict]:
    """For every effect that can be tested, at its usual size: would these rows show it,
    and what would it be taken for? From the rows' conditions, not from their forces."""
    base, left = search.base, search.projected
    length = np.linalg.norm(left, axis=0)
    use = [k for k in search.testable if length[k] > 1e-6]
    if not use:
        return []
    directions = left[:, use] / length[use]
    effects = [base.atoms[k].effect for k in use]
    names = [effect.id for effect in effects]
    sign = np.array([effect.sign for effect in effects], float)
    noise = scores_of_nothing(directions, draws, np.random.default_rng(0))
    center, scale = base.design.prior_center, base.design.prior_scale
    found = []
    for name in dict.fromkeys(names):
        first = names.index(name)
        k, effect = use[first], effects[first]
        usual = float(center[k]) or float(effect.sign or 1)
        record = recognition(
            directions, names, first, usual * length[k], sign, noise
        )._asdict()
        amplitude = {"amplitude": usual * float(scale[k]), "unit": effect.unit}
        found.append({"effect": name} | amplitude | record)
    return found


def _changes(prepared: Prepared) -> dict[str, object]:
    """Further measurements: name -> the covariates and inputs that they change."""
    rows = prepared.covariates
    options = {"the same again": {}}
    if "signs" not in prepared.has:
        options["the opposite sign of slip"] = {"flip": True}
    spread = "other loads" if "loads" in prepared.has else "two more loads"
    options[f"{spread} (half and one and a half times)"] = {"fz": (0.5, 1.5)}
    if float(np.median(rows.v)) > 0.1:
        options["other speeds (half and twice)"] = {"v": (0.5, 2.0)}
    if "time" in prepared.has and not prepared.random_order:
        options["the same points in random order"] = {"shuffle": True}
    options["small slips (a tenth)"] = {"slip": 0.1}
    return options


def _changed(base: Base, change: dict, generator):
    """The design with one block measured under other conditions."""
    design, n = base.design, base.prepared.n
    rows, inputs, slip = design.rows, design.inputs, design.slip
    size = len(design.keep)
    half = generator.random(size) < 0.5
    if change.get("flip"):
        turned = ("side", "rate", "lag", "other", "past", "pull", "force", "traction")
        slip = -slip
        rows = rows._replace(**{name: -getattr(rows, name) for name in turned})
    if "fz" in change:
        factor = np.where(half, *change["fz"])
        inputs = inputs._replace(fz=inputs.fz * factor)
        rows = rows._replace(fz=rows.fz * factor)
    if "v" in change:
        factor = np.where(half, *change["v"])
        inputs = inputs._replace(v=inputs.v * factor)
        rows = rows._replace(
            v=rows.v * factor, lag=rows.lag / factor, sliding=rows.sliding * factor,
            step=rows.step * factor,
        )  # fmt: skip
    if "slip" in change:
        slip = slip * change["slip"]
        less = ("rate", "lag", "past", "pull", "sliding")
        rows = rows._replace(**{k: change["slip"] * getattr(rows, k) for k in less})
    if change.get("shuffle"):
        order = np.arange(size)
        order[:n] = generator.permutation(n)
        rows = rows._replace(time=rows.time[order], temperature=rows.temperature[order])
    return base.on(design._replace(inputs=inputs, rows=rows, slip=slip))


def _pairs(search, weighed, verdict) -> list[tuple[str, str]]:
    """Effects that the verdict cannot or can hardly tell apart, most wanted first."""
    ids = {atom.effect.id: atom.effect for atom in search.base.atoms}
    testable = {search.base.atoms[k].effect.id for k in search.testable}
    named = [e for e in verdict.effects if e in ids]
    found = [(e, other) for e in named for other in verdict.also_possible]
    for effect in named:
        found += [(effect, o) for o in ids[effect].looks_like if o in testable]
    ranked = sorted(
        (k for k in weighed.sets if len(k) == 1), key=weighed.sets.get, reverse=True
    )
    found += [(ranked[0][0], k[0]) for k in ranked[1:3]]
    unique = dict.fromkeys(pair for pair in found if pair[0] != pair[1])
    return list(unique)[:4]


def next_measurements(base: Base, search, weighed, verdict, most: int = 3):
    """Ranked additions that would separate what the data leave confused.

    Returns:
        records {add, separates, p_now, p_after}, the largest gain first; empty where
        every pair is told apart already (forecast 0.98 or more).
    """
    null = weighed.best_of[()]
    silent, generator = np.zeros(len(base.atoms)), np.random.default_rng(0)
    index, sizes = {}, {}
    for hypothesis in weighed.best_of.values():
        for k, a in zip(hypothesis.atoms, hypothesis.amplitude, strict=True):
            if len(hypothesis.atoms) == 1:
                index[search.base.atoms[k].effect.id] = k
                sizes[k] = abs(a)
    pairs = [
        (a, b) for a, b in _pairs(search, weighed, verdict) if a in index and b in index
    ]
    if not pairs:
        return []
    _, jacobian, now, _ = base.at_null
    records = []
    blocks = {}
    for a, b in pairs:
        i, j = index[a], index[b]
        before = _told_apart([(jacobian, now)], i, j, sizes)
        if before > 0.98:
            continue
        if not blocks:
            blocks = _blocks(base, null.z, silent, generator)
        for name, block in blocks.items():
            after = _told_apart([(jacobian, now), block], i, j, sizes)
            records.append(
                {"add": name, "separates": [a, b], "p_now": before, "p_after": after}
            )
        effect = search.base.atoms[i].effect
        if effect.told_apart_by == "mz" and "mz" not in base.prepared.has:
            records.append(
                {"add": "the aligning moment M_z on lateral runs",
                 "separates": [a, b], "p_now": before, "p_after": 0.99}
            )  # fmt: skip
    useful = [r for r in records if r["p_after"] > r["p_now"] + 0.02]
    return sorted(useful, key=lambda r: r["p_now"] - r["p_after"])[:most]


def _blocks(base: Base, z, silent, generator) -> dict:
    found = {}
    for name, change in _changes(base.prepared).items():
        other = _changed(base, change, generator)
        _, jacobian, use, _ = other.linearised(z, silent)
        third = 1 / np.sqrt(3)  # a third as many rows again
        found[name] = (jacobian * third, use * third)
    return found


def _told_apart(blocks, i: int, j: int, sizes) -> float:
    jacobian = np.concatenate([block[0] for block in blocks])
    columns = np.concatenate([block[1][:, [i, j]] for block in blocks])
    columns = without(columns, jacobian)
    return separability(columns, 0, 1, max(sizes[i], 0.3), max(sizes[j], 0.3))
