"""Forecast, from the conditions of the rows and not from their forces, which further
measurement would distinguish two effects, or a cause from a stand-in."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from scipy.special import logit, ndtr

from tirefit.diagnosis.engine import FLAT, UNSEEN
from tirefit.diagnosis.engine.decide import UNKNOWN, Verdict
from tirefit.diagnosis.engine.fit import Fit, without
from tirefit.diagnosis.engine.search import Search, Weighed
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.subject import Base
from tirefit.diagnosis.summary.result import NextMeasurement
from tirefit.models import modelled

_FACTORS, _SMALL = (0.5, 2.0), 0.1
"""Loads, speeds and slips of further measurements over those of the file."""
_FEW = 3  # largest numbers of compared pairs of effects and of listed additions
_WORTHWHILE = 0.02
"""Smallest rise of the probability to distinguish two effects that is worth measuring."""
_SAME_AGAIN, _MOMENT = "the same again", "the aligning moment M_z on lateral runs"
_SHUFFLED = "the same points in random order"


def separability(first: np.ndarray, second: np.ndarray) -> float:
    """Forecast probability of distinguishing two effects by the larger abs(z).

    Args:
        first, second: (m,) whitened changes by each, orthogonal to the base parameters.
    """
    energy = float(first @ first), float(second @ second)
    if min(energy) < FLAT:
        return 0.5
    correlation = first @ second / np.sqrt(energy[0] * energy[1])
    # Equal effects have a correlation of 1, which rounding may exceed.
    apart = max(1 - abs(correlation), 0.0)
    return float(ndtr(np.sqrt(min(energy) * apart / 2)))


def _changes(prepared: Prepared) -> dict[str, dict[str, Any]]:
    """Further measurements: name -> the changed conditions."""
    options: dict[str, dict[str, Any]] = {_SAME_AGAIN: {}}
    if "signs" not in prepared.has:
        options["the opposite sign of slip"] = {"slip": -1.0}
    spread = "other loads" if "loads" in prepared.has else "two more loads"
    options[f"{spread} (half and twice)"] = {"fz": _FACTORS}
    if float(np.median(prepared.covariates.v)) > 0:
        options["other speeds (half and twice)"] = {"v": _FACTORS}
    if "time" in prepared.has and not prepared.random_order:
        options[_SHUFFLED] = {"shuffle": True}
    options["small slips (a tenth)"] = {"slip": _SMALL}
    return options


def _changed(base: Base, change: dict[str, Any]) -> Base:
    """The design under other conditions; of two conditions, in turn from row to row."""
    design, n, size = base.design, base.rows.n, len(base.design.keep)
    inputs, rows, slip = design.inputs, design.rows, change.get("slip", 1.0)
    scaled: dict[str, Any] = {k: np.resize(change[k], size) for k in ("fz", "v") if k in change}
    inputs = inputs._replace(**{k: getattr(inputs, k) * f for k, f in scaled.items()})
    if "v" in scaled:
        scaled |= dict.fromkeys(("pace", "sliding", "step"), scaled["v"])
    if "slip" in change:
        scaled = dict.fromkeys(("rate", "past", "pull", "twist"), slip)
        scaled["sliding"] = abs(slip)
    if slip < 0:
        scaled |= dict.fromkeys(("side", "other", "force", "traction"), slip)
    rows = rows._replace(**{k: getattr(rows, k) * f for k, f in scaled.items()})
    if change.get("shuffle"):
        order = np.arange(size)
        order[:n] = np.random.default_rng(0).permutation(n)
        rows = rows._replace(time=rows.time[order], temperature=rows.temperature[order])
    return base.on(design._replace(inputs=inputs, rows=rows, slip=design.slip * slip))


_Block = tuple[np.ndarray, np.ndarray]
"""Whitened slopes of one measurement by base parameters (m, p) and amplitudes (m, K)."""


def _block(base: Base, z: np.ndarray) -> _Block:
    _, jacobian, columns, _ = base.linearised(z, base.amplitudes())
    return np.asarray(jacobian), np.asarray(columns)


def _with_moment(base: Base, z: np.ndarray) -> _Block:
    """Lateral runs at the slips and loads of these rows, with F_y and M_z measured. F_y has
    the noise of the present force, M_z the same share of its peak. The contact length, a
    factor on M_z, is unknown: it is the last column of the parameters."""
    n, channels = base.rows.n, ("fy", "mz")
    scale = np.asarray(base.design.scale[base.rows.channels[0]])
    none = dict.fromkeys(channels, np.zeros_like(scale))
    design = base.design._replace(observed=none, offset=none, scale=dict.fromkeys(channels, scale))
    rows, tire = replace(base.rows, mode="y", channels=channels), replace(base.tire, mode="y")
    lateral = replace(base, rows=rows, tire=tire, design=design)
    force = lateral.forces(z, base.amplitudes())
    peaks = {c: max(float(np.max(np.abs(f))), FLAT) for c, f in force.items()}
    scales = {"fy": scale, "mz": scale * peaks["mz"] / peaks["fy"]}
    jacobian, columns = _block(lateral.on(design._replace(scale=scales)), z)
    length = np.append(np.zeros(n), force["mz"] / scales["mz"][:n])
    return np.column_stack([jacobian, length]), columns


def _told_apart(blocks: Sequence[_Block], *effects: tuple[int, float]) -> float:
    """Forecast probability of distinguishing two effects by all these measurements.

    Args:
        effects: (atom, amplitude in prior scales) of each.
    """
    width = max(jacobian.shape[1] for jacobian, _ in blocks)
    known = [np.pad(x, ((0, 0), (0, width - x.shape[1]))) for x, _ in blocks]
    atoms, sizes = zip(*effects, strict=True)
    columns = np.concatenate([columns[:, atoms] for _, columns in blocks]) * sizes
    return separability(*without(columns, np.concatenate(known)).T)


def decided(chance: float, distance: float) -> float:
    """Forecast probability of a right decision between a cause and a stand-in.

    Args:
        chance: probability of the cause now.
        distance: between the two expected results, in standard errors.
    """
    odds = logit(chance) / max(distance, FLAT)
    right = chance * ndtr(distance / 2 + odds), (1 - chance) * ndtr(distance / 2 - odds)
    return float(sum(right))


def size_apart(blocks: Sequence[_Block], fit: Fit, place: int) -> float:
    """Difference between the size of a stand-in here and that under other conditions, over the
    standard deviation of that of a cause; zero if the effect is not felt there.

    Args:
        blocks: slopes of the present rows and of those under other conditions.
        fit: the effects that help; ``place`` is that of the effect.
    """
    (jacobian, columns), (other, changed) = blocks
    atom, beside = fit.atoms[place], [k for k in fit.atoms if k != fit.atoms[place]]
    known = np.concatenate([jacobian, other]), np.concatenate([columns, changed])[:, beside]
    split = np.zeros((len(columns) + len(changed), 2))
    split[: len(columns), 0], split[len(columns) :, 1] = columns[:, atom], changed[:, atom]
    left = without(split, np.concatenate(known, axis=1))
    gram, rest = left.T @ left, fit.remainder()
    size = np.diag(gram)
    if min(size) < FLAT or np.linalg.det(gram) < UNSEEN * np.prod(size):
        return 0.0
    by_apart = np.array([1.0, -1.0])
    variance = by_apart @ np.linalg.solve(gram, by_apart) * max(float(np.mean(rest**2)), 1.0)
    relative = float(np.sqrt(variance)) / max(abs(float(fit.amplitude[place])), FLAT)
    # Under other conditions, on measured logs, the size of a stand-in changes by a quarter to once
    # itself, that of a cause by up to .3: half of either.
    return 0.5 / float(np.hypot(relative, 0.15))


def _sizes(search: Search, weighed: Weighed) -> dict[str, tuple[int, float]]:
    """Atom and amplitude in prior scales of each testable effect: the usual amplitude, or
    that of the single refit if it is larger (a refit near zero is not a limit)."""
    center = search.subject.priors.center
    sizes: dict[str, tuple[int, float]] = {}
    for k in search.subject.testable:
        name, usual = search.subject.atoms[k].effect.id, abs(float(center[k])) or 1.0
        alone = weighed.best_of.get((name,))
        if alone is not None and abs(alone.amplitude[0]) > usual:
            sizes[name] = alone.atoms[0], abs(float(alone.amplitude[0]))
        sizes.setdefault(name, (k, usual))
    return sizes


def _pairs(
    search: Search, weighed: Weighed, verdict: Verdict, known: Mapping[str, tuple[int, float]]
) -> list[tuple[str, str]]:
    """Pairs of known effects that the data may confuse: the named ones with other possible
    ones and with those they resemble, then the most probable single effects."""
    alike = {atom.effect.id: atom.effect.looks_like for atom in search.subject.atoms}
    pairs = [(e, other) for e in verdict.key for other in verdict.also_possible]
    pairs += [(e, other) for e in verdict.key for other in alike.get(e, ())]
    log = {key[0]: w for key, w in weighed.log_weight.items() if len(key) == 1}
    ranked = sorted(log, key=lambda effect: -log[effect])
    pairs += [(ranked[0], other) for other in ranked[1:_FEW]]
    distinct = (p for p in pairs if p[0] != p[1] and set(p) <= set(known))
    return list(dict.fromkeys(distinct))[:_FEW]


def manoeuvres(search: Search, weighed: Weighed, verdict: Verdict) -> tuple[NextMeasurement, ...]:
    """The measurement by which each pair of confused effects is told apart, as their records
    name it, and the probability of distinguishing them without it, the smallest first."""
    sizes, steps = _sizes(search, weighed), []
    for pair in _pairs(search, weighed, verdict, sizes):
        (first, size), (second, other) = (sizes[name] for name in pair)
        now = separability(search.projected[:, first] * size, search.projected[:, second] * other)
        add = search.subject.atoms[first].effect.told_apart_by
        if add and now <= 1 - _WORTHWHILE:
            steps.append(NextMeasurement(add, pair, now, np.nan))
    return tuple(sorted(steps, key=lambda step: step.p_now))


def next_measurements(
    base: Base, search: Search, weighed: Weighed, verdict: Verdict
) -> tuple[NextMeasurement, ...]:
    """At most three further measurements, of as many rows as the file has, that would distinguish
    confused effects, the largest gain first."""
    sizes, z = _sizes(search, weighed), weighed.best_of[()].z
    here, changes, considered = _block(base, base.z), _changes(base.rows), list[NextMeasurement]()

    @cache
    def added(name: str) -> _Block:
        if name == _MOMENT:
            return _with_moment(base, z)
        return _block(_changed(base, changes[name]), z)

    for pair in _pairs(search, weighed, verdict, sizes):
        first, second = (sizes[name] for name in pair)
        now, names = _told_apart([here], first, second), list(changes)
        by = {base.atoms[k].effect.told_apart_by for k, _ in (first, second)}
        if "mz" in by and "mz" not in base.rows.has and "mz" in modelled(base.tire.model):
            names.append(_MOMENT)
        for name in names:
            after = _told_apart([here, added(name)], first, second)
            considered.append(NextMeasurement(name, pair, now, after))
    for effect, claim in verdict.each.items():
        if effect in verdict.key and 0.2 <= claim.probability <= 0.8:
            fit, now = weighed.best_of[verdict.key], max(claim.probability, 1 - claim.probability)
            # Under the same conditions a stand-in has the same size.
            for name in (name for name in changes if name not in (_SAME_AGAIN, _SHUFFLED)):
                distance = size_apart([here, added(name)], fit, fit.effects.index(effect))
                after = decided(claim.probability, distance)
                considered.append(NextMeasurement(name, (effect, UNKNOWN), now, after))
    useful = [step for step in considered if step.p_after > step.p_now + _WORTHWHILE]
    ranked = sorted(useful, key=lambda step: step.p_now - step.p_after)
    # One of them decides whether an effect is the cause, if any can.
    deciding = [step for step in ranked if UNKNOWN in step.separates][:1]
    return tuple(dict.fromkeys([*deciding, *ranked]))[:_FEW]
