"""Cannot tell, and the next measurement: forecasts from the geometry of the data."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
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
"""Draws of noise: a chance of 5 % is known to half a percent."""

_FALSE, _HARDLY_EVER = 0.05, 0.05
"""Share of files without a gap whose largest score passes for one; share of files in
which an effect is taken for another one that is not worth saying."""

_LOADS, _SPEEDS, _SMALL = (0.5, 1.5), (0.5, 2.0), 0.1
"""Conditions of further measurements, over those of the file."""

_MOVES = 0.1
"""Usual speed [m/s] from which other speeds can be asked for."""

_RANKED, _PAIRS, _ADDITIONS = 3, 4, 3
"""Single effects that are compared beside those named, pairs that additions are judged
by, and additions that are named, at most: what a page holds."""

_LEAST_SIZE = 0.3
"""Amplitude in prior scales that two effects are told apart at, at least: a refit that
ended near zero says nothing of how large the effect may be."""


def separability(columns, a: int, b: int, size_a: float, size_b: float) -> float:
    """Forecast probability of telling effect a from b, by the larger |z|.

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


class Recognition(NamedTuple):
    """Forecast probabilities that a gap would be ``seen`` at all, and that it would be
    seen and ``recognised``; ``taken_for`` is what it is taken for else, None if it
    hardly ever is."""

    seen: float
    recognised: float
    taken_for: str | None


class Nothing(NamedTuple):
    """What scores do without a gap.

    ``scores`` (K, draws) are turned to the one sign that is possible; ``mirror`` (K, 1)
    is -1 where either is, else 1; ``turn`` (K,) is what turned them; ``limit`` is what
    the largest exceeds in :data:`_FALSE` of the draws.
    """

    scores: np.ndarray
    mirror: np.ndarray
    turn: np.ndarray
    limit: float

    @classmethod
    def of(cls, noise, sign) -> "Nothing":
        """From scores (K, draws), see :func:`scores_of_nothing`, and ``sign`` (K,): +1
        or -1 where only that one is possible, else 0."""
        turn = np.where(sign != 0, sign, 1.0)
        mirror = np.where(sign != 0, 1.0, -1.0)[:, None]
        drawn = cls(noise * turn[:, None], mirror, turn, np.nan)
        largest = drawn.ranked(np.zeros(len(turn))).max(axis=0)
        return drawn._replace(limit=float(np.quantile(largest, 1 - _FALSE)))

    def ranked(self, shift) -> np.ndarray:
        """Scores (K, draws) as they are ranked, all moved by ``shift`` (K,)."""
        moved = self.scores + (self.turn * shift)[:, None]
        return np.maximum(moved, moved * self.mirror, out=moved)


def recognition(
    directions, names: Sequence[str], truth: int, size: float, nothing: Nothing
):
    """What an effect would be taken for, by the largest score: :class:`Recognition`.

    The scores of unit directions are z ~ N(size R[:, truth], R), R their correlation,
    whatever the forces turn out to be (diagnosis by matched filters).

    Args:
        directions: (m, K) of length one, base parameters taken out.
        names: what each of them stands for (K); variants share a name.
        truth: which of them is there.
        size: its amplitude in standard errors.
    """
    score = nothing.ranked(size * (directions.T @ directions[:, truth]))
    highest = score.argmax(axis=0)
    count = len(highest)
    seen = score[highest, np.arange(count)] > nothing.limit
    codes = {name: code for code, name in enumerate(dict.fromkeys(names))}
    largest = np.array([codes[name] for name in names])[highest[seen]]
    often, own = np.bincount(largest, minlength=len(codes)), codes[names[truth]]
    right, often[own] = int(often[own]), 0
    other = int(np.argmax(often))
    return Recognition(
        float(seen.mean()), right / count,
        tuple(codes)[other] if often[other] > _HARDLY_EVER * count else None,
    )  # fmt: skip


def scores_of_nothing(directions, draws: int, generator) -> np.ndarray:
    """Scores of unit directions in white noise: (K, draws)."""
    values, vectors = np.linalg.eigh(directions.T @ directions)
    root = vectors * np.sqrt(np.maximum(values, 0))
    return root @ generator.standard_normal((directions.shape[1], draws))


def confusion(search, draws: int = DRAWS) -> list[Forecast]:
    """For every effect that can be tested, at its usual size: would these rows show it,
    and what would it be taken for? From the rows' conditions, not from their forces."""
    base, left = search.base, search.projected
    length = np.linalg.norm(left, axis=0)
    use = [k for k in search.testable if length[k] > UNSEEN]
    if not use:
        return []
    directions = left[:, use] / length[use]
    effects = [base.atoms[k].effect for k in use]
    names = [effect.id for effect in effects]
    sign = np.array([effect.sign for effect in effects], float)
    noise = scores_of_nothing(directions, draws, np.random.default_rng(0))
    nothing = Nothing.of(noise, sign)
    center, scale = base.design.prior_center, base.design.prior_scale
    forecasts = []
    for name in dict.fromkeys(names):
        first = names.index(name)
        k, effect = use[first], effects[first]
        usual = float(center[k]) or float(effect.sign or 1)
        chances = recognition(directions, names, first, usual * length[k], nothing)
        amplitude = usual * float(scale[k])
        forecasts.append(Forecast(name, amplitude, effect.unit, *chances))
    return forecasts


def _changes(prepared: Prepared) -> dict[str, dict]:
    """Further measurements: name -> the covariates and inputs that they change."""
    rows = prepared.covariates
    options: dict[str, dict] = {"the same again": {}}
    if "signs" not in prepared.has:
        options["the opposite sign of slip"] = {"flip": True}
    spread = "other loads" if "loads" in prepared.has else "two more loads"
    options[f"{spread} (half and one and a half times)"] = {"fz": _LOADS}
    if float(np.median(rows.v)) > _MOVES:
        options["other speeds (half and twice)"] = {"v": _SPEEDS}
    if "time" in prepared.has and not prepared.random_order:
        options["the same points in random order"] = {"shuffle": True}
    options["small slips (a tenth)"] = {"slip": _SMALL}
    return options


def _changed(base: Base, change: dict, generator):
    """The design with one block measured under other conditions."""
    design, n = base.design, base.prepared.n
    rows, inputs, slip = design.rows, design.inputs, design.slip
    size = len(design.keep)
    half = generator.random(size) < 0.5
    if change.get("flip"):
        turned = (
            "side", "rate", "lag", "other", "past", "pull", "twist", "force",
            "traction",
        )  # fmt: skip
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
        less = ("rate", "lag", "past", "pull", "twist", "sliding")
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
    pairs = [(e, other) for e in named for other in verdict.also_possible]
    for effect in named:
        pairs += [(effect, o) for o in ids[effect].looks_like if o in testable]
    ranked = sorted(
        (k for k in weighed.sets if len(k) == 1), key=weighed.log_weight.get,
        reverse=True,
    )  # fmt: skip
    pairs += [(ranked[0][0], k[0]) for k in ranked[1:_RANKED]]
    unique = dict.fromkeys(pair for pair in pairs if pair[0] != pair[1])
    return list(unique)[:_PAIRS]


def _singles(search, weighed) -> dict[str, tuple[int, float]]:
    """The atom that stands for each testable effect, and its amplitude in prior scales:
    that of the refit where the effect was refitted alone, else the usual one."""
    center = np.asarray(search.base.design.prior_center)
    singles: dict[str, tuple[int, float]] = {}
    for k in search.testable:
        usual = abs(float(center[k])) or 1.0
        singles.setdefault(search.base.atoms[k].effect.id, (k, usual))
    for hypothesis in weighed.best_of.values():
        if len(hypothesis.atoms) == 1:
            (k,), (amplitude,) = hypothesis.atoms, hypothesis.amplitude
            singles[search.base.atoms[k].effect.id] = k, abs(float(amplitude))
    return singles


def next_measurements(
    base: Base, search, weighed, verdict, most: int = _ADDITIONS
) -> tuple[tuple[NextMeasurement, ...], str | None]:
    """Ranked additions that would separate what the data leave confused.

    Returns:
        (additions, reason): the largest gain first; where there are none, the reason,
        else None.
    """
    singles = _singles(search, weighed)
    pairs = [
        pair
        for pair in _pairs(search, weighed, verdict)
        if pair[0] in singles and pair[1] in singles
    ]
    options = _Options(base, weighed.best_of[()].z)
    considered = []
    for a, b in pairs:
        now = options.told_apart(singles[a], singles[b])
        effects = [base.atoms[singles[name][0]].effect for name in (a, b)]
        with_moment = "mz" not in base.prepared.has and "mz" in {
            effect.told_apart_by for effect in effects
        }
        names = [] if now > _APART else options.names(with_moment)
        considered += [
            NextMeasurement(
                name, (a, b), now, options.told_apart(singles[a], singles[b], name)
            )
            for name in names or [_AS_IT_IS]
        ]
    useful = [step for step in considered if step.p_after > step.p_now + _WORTHWHILE]
    if useful:
        return tuple(sorted(useful, key=lambda s: s.p_now - s.p_after)[:most]), None
    return (), _reason(considered, verdict.status)


def _reason(considered: Sequence[NextMeasurement], status: str) -> str:
    """Why no addition is worth while."""
    if not considered:
        return "there is only one effect that these rows can be tested for"
    a, b = considered[0].separates
    own = [step for step in considered if step.separates == (a, b)]
    best, now = max(step.p_after for step in own), own[0].p_now
    if now > _APART:
        apart = f"rows like these tell {a} from {b} with probability {now:.2f}"
        if status == "cannot_tell":
            return f"{apart}: this time their noise does not, so repeat them"
        return apart
    return (
        f"no addition that is known here would tell {a} from {b}: at best with"
        f" probability {best:.2f} (now {now:.2f})"
    )


_APART = 0.98
"""Forecast probability from which two effects are told apart."""
_WORTHWHILE = 0.02
"""Rise of that probability from which an addition is worth its work."""
_AS_IT_IS = "nothing"
_MOMENT = "the aligning moment M_z on lateral runs"
_PART = 1 / 3
"""Rows of an addition, as a share of those that are there."""


class _Block(NamedTuple):
    """Whitened rows of one measurement: by the base parameters (m, p) and by the
    amplitudes of the effects (m, K)."""

    jacobian: np.ndarray
    columns: np.ndarray


class _Options:
    """Further measurements, each simulated once and only if it is asked for."""

    def __init__(self, base: Base, z):
        self.base, self.z = base, z
        _, jacobian, columns, _ = base.at_null
        self.here = _Block(np.asarray(jacobian), np.asarray(columns))
        self.changes = _changes(base.prepared)
        self.known: dict[str, _Block] = {}
        self.generator = np.random.default_rng(0)

    @cached_property
    def gives_moment(self) -> bool:
        """Whether the base model has an aligning moment."""
        return "mz" in modelled(self.base.fit.tire.model)

    def names(self, with_moment: bool) -> list[str]:
        moment = [_MOMENT] if with_moment and self.gives_moment else []
        return [*self.changes, *moment]

    def _block(self, name: str) -> _Block:
        if not self.known:
            # All at once: each draws from the same generator.
            for option, change in self.changes.items():
                other = _changed(self.base, change, self.generator)
                self.known[option] = _part_of(other, self.z)
        if name == _MOMENT and name not in self.known:
            self.known[name] = _with_moment(self.base, self.z)
        return self.known[name]

    def told_apart(self, one, two, name: str = _AS_IT_IS) -> float:
        """Forecast probability of telling two effects apart, with an addition.

        Args:
            one, two: (atom, amplitude in prior scales) of the effects.
        """
        blocks = [self.here] + ([] if name == _AS_IT_IS else [self._block(name)])
        # What an addition has of parameters of its own is unknown in it alone.
        width = max(block.jacobian.shape[1] for block in blocks)
        jacobian = np.concatenate(
            [
                np.pad(b.jacobian, ((0, 0), (0, width - b.jacobian.shape[1])))
                for b in blocks
            ]
        )
        (i, size), (j, other) = one, two
        columns = np.concatenate([block.columns[:, [i, j]] for block in blocks])
        left = without(columns, jacobian)
        return separability(left, 0, 1, max(size, _LEAST_SIZE), max(other, _LEAST_SIZE))


def _part_of(base: Base, z) -> _Block:
    """A measurement under the conditions of ``base``, of a third as many rows."""
    _, jacobian, columns, _ = base.linearised(z, base.amplitudes())
    return _Block(jacobian * np.sqrt(_PART), columns * np.sqrt(_PART))


def _with_moment(base: Base, z) -> _Block:
    """Lateral runs at the slips and loads of these rows, with F_y and M_z measured.

    Noise of F_y as that of the force here; M_z is as noisy beside its own peak as F_y
    is beside its. The contact length, by which all of M_z is multiplied, is unknown.
    """
    main, n = base.prepared.channels[0], base.prepared.n
    channels = ("fy", "mz")
    scale = np.asarray(base.design.scale[main])
    rows = replace(base.rows, mode="y", channels=channels)
    tire = replace(base.fit.tire, mode="y")
    design = base.design._replace(
        observed=dict.fromkeys(channels, np.zeros_like(scale)),
        offset=dict.fromkeys(channels, np.zeros_like(scale)),
        scale={"fy": scale, "mz": scale},
    )
    lateral = replace(base, rows=rows, fit=replace(base.fit, tire=tire, design=design))
    force = lateral.forces(z, base.amplitudes())
    peaks = {c: max(float(np.max(np.abs(f))), FLAT) for c, f in force.items()}
    scales = {"fy": scale, "mz": scale * peaks["mz"] / peaks["fy"]}
    block = _part_of(lateral.on(design._replace(scale=scales)), z)
    moment = np.zeros((2 * n, 1))
    moment[n:, 0] = np.sqrt(_PART) * force["mz"] / scales["mz"][:n]
    return block._replace(jacobian=np.concatenate([block.jacobian, moment], axis=1))
