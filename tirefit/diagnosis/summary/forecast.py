"""Forecasts from the conditions of the rows, not from their forces: which effects the
rows would show, and which further measurement would separate two effects."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.negligible import FLAT, UNSEEN
from tirefit.diagnosis.rows.basis import without
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.summary.records import Forecast, NextMeasurement
from tirefit.models import modelled

DRAWS = 2000
"""Draws of noise: a probability of 5 % is known to half a percent."""

_RARE = 0.05
"""False alarm rate of the largest score; share of files below which a confusion is not
reported."""

_FACTORS, _SMALL = (0.5, 2.0), 0.1
"""Loads, speeds and slips of further measurements over those of the file."""

_FEW = 3
"""Pairs of effects that additions are judged by, and additions listed, at most."""

_LEAST_SIZE = 0.3
"""Least amplitude, in prior scales, at which two effects are compared: a refit near
zero does not bound the effect."""

_APART, _WORTHWHILE = 0.98, 0.02
"""Probability from which two effects count as told apart, and the least rise of it that
is worth a measurement."""

_SAME_AGAIN = "the same again"
_MOMENT = "the aligning moment M_z on lateral runs"


def separability(columns, a: int, b: int, size_a: float, size_b: float) -> float:
    """Forecast probability of telling effect a from b, by the larger abs(z).

    Args:
        columns: (m, K) directions of the effects, base parameters taken out.
        size_a, size_b: amplitudes in units of the columns.
    """
    one, two = columns[:, a] * size_a, columns[:, b] * size_b
    energy = (one @ one, two @ two)
    if min(energy) < FLAT:
        return 0.5
    correlation = one @ two / np.sqrt(energy[0] * energy[1])
    # Exact confusions have a correlation of 1, and a rounding beyond it.
    apart = max(1 - abs(correlation), 0.0)
    return float(ndtr(np.sqrt(min(energy) * apart / 2)))


def scores_of_nothing(directions, draws: int, generator) -> np.ndarray:
    """Scores of unit directions in white noise: (K, draws)."""
    values, vectors = np.linalg.eigh(directions.T @ directions)
    root = vectors * np.sqrt(np.maximum(values, 0))
    return root @ generator.standard_normal((directions.shape[1], draws))


def recognition(directions, names: Sequence[str], truth: int, size: float, noise):
    """Probabilities that the largest score exceeds that of noise, and that it is also
    the right one; the effect that is taken for it instead, None if hardly ever any.

    The scores of unit directions are z ~ N(size R[:, truth], R), R their correlation.

    Args:
        directions: (m, K) of length one, base parameters taken out.
        names: the effect of each (K,); variants share a name.
        truth: index of the direction that is there.
        size: its amplitude in standard errors.
        noise: (K, draws) of :func:`scores_of_nothing`.
    """
    limit = np.quantile(np.abs(noise).max(axis=0), 1 - _RARE)
    score = np.abs(noise + size * (directions.T @ directions[:, [truth]]))
    found = score.argmax(axis=0)[score.max(axis=0) > limit]
    count, draws = Counter(names[k] for k in found), noise.shape[1]
    right = count.pop(names[truth], 0)
    other, often = max(count.items(), key=lambda one: one[1], default=(None, 0))
    return len(found) / draws, right / draws, other if often > _RARE * draws else None


def confusion(search, draws: int = DRAWS) -> list[Forecast]:
    """For each testable effect at its usual size: would these rows show it, and what
    would it be taken for?"""
    base, left = search.base, search.projected
    length = np.linalg.norm(left, axis=0)
    use = [k for k in search.testable if length[k] > UNSEEN]
    if not use:
        return []
    directions = left[:, use] / length[use]
    noise = scores_of_nothing(directions, draws, np.random.default_rng(0))
    names, forecasts = [base.atoms[k].effect.id for k in use], []
    for name in dict.fromkeys(names):
        first = names.index(name)
        k, effect = use[first], base.atoms[use[first]].effect
        usual = float(base.design.prior_center[k]) or float(effect.sign or 1)
        chances = recognition(directions, names, first, usual * length[k], noise)
        amplitude = usual * float(base.design.prior_scale[k])
        forecasts.append(Forecast(name, amplitude, effect.unit, *chances))
    return forecasts


def _changes(prepared: Prepared) -> dict[str, dict]:
    """Further measurements: name -> the conditions that they change."""
    options: dict[str, dict] = {_SAME_AGAIN: {}}
    if "signs" not in prepared.has:
        options["the opposite sign of slip"] = {"slip": -1.0}
    spread = "other loads" if "loads" in prepared.has else "two more loads"
    options[f"{spread} (half and twice)"] = {"fz": _FACTORS}
    if float(np.median(prepared.covariates.v)) > 0:
        options["other speeds (half and twice)"] = {"v": _FACTORS}
    if "time" in prepared.has and not prepared.random_order:
        options["the same points in random order"] = {"shuffle": True}
    options["small slips (a tenth)"] = {"slip": _SMALL}
    return options


def _changed(base: Base, change: dict) -> Base:
    """The design measured under other conditions; of two, in turn from row to row."""
    design, n, size = base.design, base.prepared.n, len(base.design.keep)
    rows, inputs, slip = design.rows, design.inputs, design.slip
    if "fz" in change:
        factor = np.resize(change["fz"], size)
        inputs = inputs._replace(fz=inputs.fz * factor)
        rows = rows._replace(fz=rows.fz * factor)
    if "v" in change:
        factor = np.resize(change["v"], size)
        inputs = inputs._replace(v=inputs.v * factor)
        rows = rows._replace(
            v=rows.v * factor, lag=rows.lag / factor, sliding=rows.sliding * factor,
            step=rows.step * factor,
        )  # fmt: skip
    if factor := change.get("slip"):
        slip = slip * factor
        scaled = dict.fromkeys(("rate", "lag", "past", "pull", "twist"), factor)
        scaled["sliding"] = abs(factor)
        if factor < 0:
            scaled |= dict.fromkeys(("side", "other", "force", "traction"), factor)
        rows = rows._replace(**{k: getattr(rows, k) * f for k, f in scaled.items()})
    if change.get("shuffle"):
        order = np.arange(size)
        order[:n] = np.random.default_rng(0).permutation(n)
        rows = rows._replace(time=rows.time[order], temperature=rows.temperature[order])
    return base.on(design._replace(inputs=inputs, rows=rows, slip=slip))


class _Block(NamedTuple):
    """Whitened rows of one measurement: by the base parameters (m, p) and by the
    amplitudes of the effects (m, K)."""

    jacobian: np.ndarray
    columns: np.ndarray

    @classmethod
    def of(cls, base: Base, z) -> "_Block":
        return cls(*base.linearised(z, base.amplitudes())[1:3])


def _with_moment(base: Base, z) -> _Block:
    """Lateral runs at the slips and loads of these rows, with F_y and M_z measured.

    F_y has the noise of the force here; the noise of M_z over its peak is that of F_y
    over its own. The contact length, a factor on all of M_z, is unknown: its column
    is the last of the jacobian.
    """
    n, channels = base.prepared.n, ("fy", "mz")
    scale = np.asarray(base.design.scale[base.prepared.channels[0]])
    none = dict.fromkeys(channels, np.zeros_like(scale))
    rows = replace(base.rows, mode="y", channels=channels)
    design = base.design._replace(
        observed=none, offset=none, scale=dict.fromkeys(channels, scale)
    )
    tire = replace(base.fit.tire, mode="y")
    lateral = replace(base, rows=rows, fit=replace(base.fit, tire=tire, design=design))
    force = lateral.forces(z, base.amplitudes())
    peaks = {c: max(float(np.max(np.abs(f))), FLAT) for c, f in force.items()}
    scales = {"fy": scale, "mz": scale * peaks["mz"] / peaks["fy"]}
    block = _Block.of(lateral.on(design._replace(scale=scales)), z)
    length = np.append(np.zeros(n), force["mz"] / scales["mz"][:n])
    return block._replace(jacobian=np.column_stack([block.jacobian, length]))


def _told_apart(blocks: Sequence[_Block], one, two) -> float:
    """Forecast probability of telling two effects apart by all of these measurements.

    Args:
        one, two: (atom, amplitude in prior scales) of the effects.
    """
    width = max(block.jacobian.shape[1] for block in blocks)
    jacobian = np.concatenate(
        [np.pad(b[0], ((0, 0), (0, width - b[0].shape[1]))) for b in blocks]
    )
    (i, size), (j, other) = one, two
    left = without(np.concatenate([b.columns[:, [i, j]] for b in blocks]), jacobian)
    return separability(left, 0, 1, max(size, _LEAST_SIZE), max(other, _LEAST_SIZE))


def _sizes(search, weighed) -> dict[str, tuple[int, float]]:
    """Atom and amplitude in prior scales of each testable effect: as refitted where the
    effect was refitted alone, else the usual one."""
    center = np.asarray(search.base.design.prior_center)
    sizes: dict[str, tuple[int, float]] = {}
    for k in search.testable:
        usual = abs(float(center[k])) or 1.0
        sizes.setdefault(search.base.atoms[k].effect.id, (k, usual))
    for hypothesis in weighed.best_of.values():
        if len(hypothesis.atoms) == 1:
            (k,), (amplitude,) = hypothesis.atoms, hypothesis.amplitude
            sizes[search.base.atoms[k].effect.id] = k, abs(float(amplitude))
    return sizes


def _pairs(search, weighed, verdict, known) -> list[tuple[str, str]]:
    """Pairs of known effects that the data may confuse: those named with what else is
    possible and with what they resemble, then the most probable single effects."""
    resembles = {a.effect.id: a.effect.looks_like for a in search.base.atoms}
    pairs = [(e, other) for e in verdict.effects for other in verdict.also_possible]
    pairs += [(e, other) for e in verdict.effects for other in resembles.get(e, ())]
    log = {key[0]: w for key, w in weighed.log_weight.items() if len(key) == 1}
    ranked = sorted(log, key=lambda effect: -log[effect])
    pairs += [(ranked[0], other) for other in ranked[1:_FEW]]
    distinct = (p for p in pairs if p[0] != p[1] and set(p) <= set(known))
    return list(dict.fromkeys(distinct))[:_FEW]


def next_measurements(
    base: Base, search, weighed, verdict, most: int = _FEW
) -> tuple[tuple[NextMeasurement, ...], str | None]:
    """Additions, of as many rows as there are, that would separate what the data leave
    confused.

    Returns:
        (additions, reason): the largest gain first; where there are none, the reason,
        else None.
    """
    sizes, z = _sizes(search, weighed), weighed.best_of[()].z
    here, changes = _Block(*base.at_null[1:3]), _changes(base.prepared)

    @cache
    def added(name: str) -> _Block:
        if name == _MOMENT:
            return _with_moment(base, z)
        return _Block.of(_changed(base, changes[name]), z)

    considered = []
    for pair in _pairs(search, weighed, verdict, sizes):
        one, two = (sizes[name] for name in pair)
        now, names = _told_apart([here], one, two), list(changes)
        by = {base.atoms[k].effect.told_apart_by for k, _ in (one, two)}
        has_moment = "mz" in modelled(base.fit.tire.model)
        if "mz" in by and "mz" not in base.prepared.has and has_moment:
            names.append(_MOMENT)
        for name in names if now <= _APART else [_SAME_AGAIN]:
            after = _told_apart([here, added(name)], one, two)
            considered.append(NextMeasurement(name, pair, now, after))
    useful = [step for step in considered if step.p_after > step.p_now + _WORTHWHILE]
    if useful:
        return tuple(sorted(useful, key=lambda s: s.p_now - s.p_after)[:most]), None
    return (), _reason(considered, verdict.status)


def _reason(considered: Sequence[NextMeasurement], status: str) -> str:
    """Why no addition is worth a measurement."""
    if not considered:
        return "there is only one effect that these rows can be tested for"
    _, (a, b), now, _ = considered[0]
    if now > _APART:
        apart = f"rows like these tell {a} from {b} with probability {now:.2f}"
        if status == "cannot_tell":
            return f"{apart}: this time their noise does not, so repeat them"
        return apart
    best = max(step.p_after for step in considered if step.separates == (a, b))
    return (
        f"no addition that is known here would tell {a} from {b}: at best with"
        f" probability {best:.2f} (now {now:.2f})"
    )
