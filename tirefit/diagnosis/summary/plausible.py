"""What the force may truly be, given the data: draws from everything that is believed.

A gap that is left hides below the noise: its energy is the difference of two that are
nearly alike. Drawn are instead the fits that the data leave possible, each with the
error of its parameters and with what stands beside it: a remainder of a kind that the
search knows, or an effect in another form than its formula's.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from tirefit.diagnosis.decide.case import Case
from tirefit.diagnosis.decide.one_place import set_aside_together
from tirefit.diagnosis.decide.verdict import Verdict, Weighed
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.linear_fit import LinearFit, linear_at
from tirefit.diagnosis.evidence.search import Hypothesis, amplitudes_of
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.basis import (
    PRIORS,
    SCALES,
    Generic,
    gain,
    orthogonal,
    without,
    worth_of_waves,
)
from tirefit.diagnosis.rows.patterns import USUAL_SIZES, Patterns, weights_of_sizes

DRAWS = 300
"""Draws: fifteen beyond either end of a 90 % interval."""

_SETS, _LEAST = 3, 0.03
"""Sets of effects that are drawn from, at most, and the share of the probability from
which one is: of less, one draw in thirty at most is."""

_OTHERWISE = 0.1
"""What another form changes of an effect's part of the force, typically: half of the
development trials' effects have a form of their own, which is .02 to .2 of theirs."""

_SHARES = np.geomspace(0.005, 1.0, 14)
"""Shares of the effect's part that another form of it may have; their prior is normal
in the logarithm about :data:`_OTHERWISE`, with a standard deviation of one."""

_OF_FAMILY = 0.5
"""Probability that another form is one of its family, not any smooth function."""

_UNDRAWN, _UNDRAWN_OF_REST = 0.03, 0.4
"""What no basis draws, as a share of the effect's part and of the remainder, typically:
development trials leave .01 to .1 and .2 to .6 of theirs."""

_WIDER = 1.2
"""Factor on the errors of parameters: those of a fit whose form is not quite right."""

_EVEN = 0.5
"""Probability of something unlisted where a verdict says that it is there, at least."""


class _Belief(NamedTuple):
    """A set of effects: refitted, around that fit, whether its effects are in a form of
    their own, the log evidence of each kind of remainder, and the probabilities of it
    without and with one."""

    hypothesis: Hypothesis
    linear: LinearFit
    in_other_form: bool
    kinds: Mapping[str, float]
    alone: float
    beside: float


def plausible_forces(case: Case, generator) -> dict[str, np.ndarray]:
    """Draws of the true force of every used row at its measured slip: (n, draws) by
    channel."""
    base = case.base
    beliefs, at = _beliefs(case), base.measured
    chances = np.ravel(_chances(beliefs, case.verdict))
    counts = generator.multinomial(DRAWS, chances)
    drawn: dict[str, list] = {channel: [] for channel in base.rows.channels}
    for belief, (alone, beside) in zip(beliefs, counts.reshape(-1, 2), strict=True):
        amplitudes = amplitudes_of(base, belief.hypothesis)
        force = at.forces(belief.hypothesis.z, amplitudes)
        for count, has_rest in ((alone, False), (beside, True)):
            if not count:
                continue
            rest = _rest if has_rest else _other_form
            off = _of_parameters(base, belief, count, generator)
            off = off + rest(base, belief, count, generator)
            whole = _by_channel(base, force, off)
            whole = _set_aside(base, belief.hypothesis, force, whole)
            for channel, values in whole.items():
                drawn[channel].append(values)
    return {channel: np.concatenate(parts, 1) for channel, parts in drawn.items()}


def _beliefs(case: Case) -> list[_Belief]:
    """The most probable sets, whatever the verdict makes of them."""
    weighed: Weighed = case.weighed
    beside = weighed.unknown_beside | {(): weighed.unknown_alone}
    total = {key: alone + beside.get(key, 0.0) for key, alone in weighed.sets.items()}
    ranked = sorted(total, key=lambda key: total[key], reverse=True)[:_SETS]
    least = _LEAST * sum(total.values())
    return [
        _Belief(
            weighed.best_of[key],
            linear_at(case.base, weighed.best_of[key]),
            key in weighed.other_form,
            weighed.gains.get(key, {}),
            weighed.sets[key],
            beside.get(key, 0.0),
        )
        for key in ranked
        if total[key] >= least or key == ranked[0]
    ]


def _chances(beliefs, verdict: Verdict) -> np.ndarray:
    """Probability of each belief without and with a remainder: (beliefs, 2). What the
    verdict says of something unlisted is calibrated on trials; the evidence is not."""
    chances = np.array([(belief.alone, belief.beside) for belief in beliefs])
    chances = chances / chances.sum()
    if verdict.status in ("unknown", "incomplete") and chances[:, 1].any():
        more = np.clip(verdict.unlisted, _EVEN, 1.0)
        each = chances / np.maximum(chances.sum(axis=0), NONZERO)
        chances = each * (1 - more, more)
    return chances / chances.sum()


def _by_channel(base: Base, force, off) -> dict[str, np.ndarray]:
    """Force (n,) by channel and whitened draws (m, count) beside it: (n, count)."""
    n = base.rows.n
    return {
        channel: force[channel][:, None]
        + np.asarray(base.design.scale[channel])[:n, None] * off[k * n : (k + 1) * n]
        for k, channel in enumerate(base.rows.channels)
    }


def _of_parameters(base: Base, belief: _Belief, count: int, generator) -> np.ndarray:
    """What the error of parameters and amplitudes changes, whitened: (m, count). The
    slips are as unsure as their density and their phase; see ``Base.doubt``."""
    values, vectors = np.linalg.eigh(belief.hypothesis.covariance)
    # Symmetric roots, here and below: the same numbers give the same draws whichever
    # way the vectors point.
    spread = _WIDER * (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    misled = np.linalg.lstsq(belief.linear.used_up, base.doubt, rcond=None)[0]
    spread = np.concatenate([spread, misled], axis=1)
    unit = generator.standard_normal((spread.shape[1], count))
    return belief.linear.used_up @ (spread @ unit)


def _part_of_effects(belief: _Belief) -> float:
    """Length of the effects' part that no parameter of the base imitates, whitened."""
    p, amplitude = len(belief.hypothesis.z), belief.hypothesis.amplitude
    if not len(amplitude):
        return 0.0
    own = belief.linear.used_up[:, p:] @ amplitude
    return float(np.linalg.norm(without(own, belief.linear.used_up[:, :p])))


def _undrawn(length, rows: int, generator) -> np.ndarray:
    """Differences of no shape, (rows, count), of these typical lengths (count,)."""
    size = length * np.exp(generator.standard_normal(len(length))) / np.sqrt(rows)
    return size * generator.standard_normal((rows, len(length)))


def _other_form(base: Base, belief: _Belief, count: int, generator) -> np.ndarray:
    """What other forms of the effects add where nothing else is there: (m, count)."""
    linear, part = belief.linear, _part_of_effects(belief)
    m = len(linear.residual)
    if part == 0:
        return np.zeros((m, count))
    bases = [(1.0, orthogonal(base.generic.smooth, linear.explained))]
    if linear.forms.shape[1]:
        kin = orthogonal(linear.forms, linear.used_up)
        bases = [(1 - _OF_FAMILY, bases[0][1]), (_OF_FAMILY, kin)]
    prior = softmax(-0.5 * np.log(_SHARES / _OTHERWISE) ** 2)
    scales, weights = [], []
    for chance, (left, size) in bases:
        # Coefficients of this spread have the wanted share of the effect's energy.
        scale = _SHARES * part / np.maximum(np.linalg.norm(size), NONZERO)
        gains = [gain(left.T @ linear.residual, s * size) for s in scale]
        scales.append(scale)
        weights.append(np.array(gains) + np.log(chance * prior))
    share = softmax([np.logaddexp.reduce(w) for w in weights])
    drawn = [
        drawn_functions(*basis, linear.residual, scale, weight, k, generator)
        for (_, basis), scale, weight, k in zip(
            bases, scales, weights, generator.multinomial(count, share), strict=True
        )
    ]
    hidden = np.full(count, _UNDRAWN * part)
    return np.concatenate(drawn, axis=1) + _undrawn(hidden, m, generator)


def _rest(base: Base, belief: _Belief, count: int, generator) -> np.ndarray:
    """What something unlisted adds beside the effects, whitened: (m, count)."""
    linear = belief.linear
    against = linear.in_other_form() if belief.in_other_form else linear
    kinds = list(PRIORS)
    log = np.array(
        [belief.kinds.get(kind, 0.0) + np.log(PRIORS[kind]) for kind in kinds]
    )
    counts = generator.multinomial(count, softmax(log))
    residual, explained = against.residual, against.explained
    drawn = [
        _of_kind(kind, base.generic, explained, residual, k, generator)
        for kind, k in zip(kinds, counts, strict=True)
        if k
    ]
    rest = np.concatenate(drawn, axis=1)
    if belief.in_other_form:
        kin = orthogonal(linear.forms, linear.used_up)
        rest = rest + drawn_functions(*kin, residual, [1.0], [0.0], count, generator)
    length = np.hypot(
        _UNDRAWN * _part_of_effects(belief),
        _UNDRAWN_OF_REST * np.linalg.norm(rest, axis=0),
    )
    return rest + _undrawn(length, len(residual), generator)


def _of_kind(kind, generic: Generic, against, residual, count, generator):
    """Draws of a remainder of one kind: (m, count)."""
    if kind == "waves":
        return drawn_wave(generic.waves, against, residual, count, generator)
    if kind == "patterns":
        return drawn_pattern(generic.patterns, against, residual, count, generator)
    basis = orthogonal(getattr(generic, kind), against)
    scales = np.array(SCALES)
    score = basis[0].T @ residual
    weights = np.array([gain(score, scale * basis[1]) for scale in scales])
    return drawn_functions(*basis, residual, scales, weights, count, generator)


def drawn_functions(left, size, residual, scales, log_weight, count, generator):
    """Draws (m, count) of many functions at once, given the residual.

    Args:
        left, size: of :func:`tirefit.diagnosis.rows.basis.orthogonal`.
        scales, log_weight: (S,) standard deviations of the coefficients, and how much
            speaks for each.
    """
    chosen = generator.choice(len(scales), count, p=softmax(log_weight))
    t = (np.asarray(scales)[chosen] * size[:, None]) ** 2
    shrink = t / (1 + t)
    unit = left.T @ generator.standard_normal((len(left), count))
    return left @ (shrink * (left.T @ residual)[:, None] + np.sqrt(shrink) * unit)


def drawn_wave(waves, against, residual, count, generator) -> np.ndarray:
    """Draws (m, count) of one wave each, given the residual.

    Args:
        waves: (m, 2 x waves), sine and cosine side by side.
        against: (m, p) columns that the fit has used up.
    """
    worth = worth_of_waves(waves, against, residual)
    chance = softmax(np.ravel(worth.gain))
    scale, wave = np.unravel_index(
        generator.choice(len(chance), count, p=chance), worth.gain.shape
    )
    spread = np.linalg.cholesky(worth.covariance[scale, wave])
    unit = generator.standard_normal((count, 2))
    own = worth.mean[scale, wave] + np.einsum("dab,db->da", spread, unit)
    coefficient = np.zeros((waves.shape[1], count))
    for k in range(2):
        coefficient[2 * wave + k, np.arange(count)] = own[:, k]
    return without(waves @ coefficient, against)


def drawn_pattern(among: Patterns, against, residual, count, generator) -> np.ndarray:
    """Draws (m, count) of one pattern each, given the residual.

    Args:
        against: (m, p) columns that the fit has used up.
    """
    length, score, log_weight = weights_of_sizes(among, against, residual)
    chance = softmax(np.ravel(log_weight))
    scale, which = np.unravel_index(
        generator.choice(len(chance), count, p=chance), log_weight.shape
    )
    variance = np.array(USUAL_SIZES)[scale] ** 2
    variance = variance / (1 + variance * length[which])
    unit = generator.standard_normal(count)
    coefficient = variance * score[which] + np.sqrt(variance) * unit
    return without(among.columns(which) * coefficient, against)


def _set_aside(base: Base, hypothesis: Hypothesis, force, drawn):
    """Draws on rows that were set aside as outliers too: what the rows beside one miss
    as well is a gap there, not an outlier.

    Args:
        force: (n,) by channel at the measured slips; ``drawn`` (n, count).
    """
    if not (np.asarray(base.design.keep)[: base.rows.n] == 0).any():
        return drawn
    shared, whole = set_aside_together(base, hypothesis), {}
    for channel, values in drawn.items():
        typical, shown = shared[channel]
        there = (force[channel] + typical)[:, None]
        whole[channel] = np.where(shown[:, None], there, values)
    return whole
