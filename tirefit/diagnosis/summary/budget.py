"""What the distance from a base to the measurement is made of: a simulator's own
parameters, effects, what nobody names, and the noise. The parts add in squares."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from scipy.special import ndtr, ndtri

from tirefit.diagnosis.decide.case import Case
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.search import Hypothesis, amplitudes_of
from tirefit.diagnosis.evidence.simulator import missed_share
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.summary.closure import (
    INTERVAL,
    block_means,
    of_so_few_runs,
    without_each,
)
from tirefit.diagnosis.summary.records import Change, Part, SimulatorSummary, Surrogate
from tirefit.diagnosis.summary.shares import shapley

PARAMETERS = "parameters"

_HELD = 1e4
"""Stiffness that holds parameters z: they would move by 1e-8 of the force that pulls at
them, in standard deviations of the noise."""

_DIFFERS = 2.0
"""Standard errors from which a parameter of the simulator is said to be wrong."""

_BESIDE = 3
"""Terms beside the parts: what is left, the noise and the whole."""

_STEP = 1e-5
"""Step of z of a central difference: its error is 1e-10, and rounding adds 1e-11."""

_MOST_LOST = 0.5
"""Share of the noise's energy that the fitted parameters take up, at most."""


def budgets_of(case: Case, rows, generator) -> dict[str, tuple[Part, ...]]:
    """Parts of the energy of every channel: parameters (of a simulator), each named
    effect, unexplained, noise; their shares add to one.

    Args:
        rows: by channel ``extended`` (n,), the force of the verdict, in whatever form
            of its effects.
    """
    missed = _missed(case.base, case.verdict.chosen)
    return {
        channel: _budget(case, channel, missed[channel], parts["extended"], generator)
        for channel, parts in rows.items()
    }


def _budget(case: Case, channel: str, missed, extended, generator) -> tuple[Part, ...]:
    base, chosen = case.base, case.verdict.chosen
    noise, keep = base.noise[channel], ~base.noise[channel].outlier
    observed = base.rows.observed[channel]
    players = ((PARAMETERS,) if base.simulator else ()) + chosen.atoms
    whole = missed[()] ** 2
    parts = shapley(players, lambda subset: whole - missed[subset] ** 2)
    rest = (observed - extended) ** 2
    if chosen.atoms:
        # Another form than the formulas' belongs to the effects that have it.
        form = (missed[players] ** 2 - rest) / len(chosen.atoms)
        for atom in chosen.atoms:
            parts[atom] = parts[atom] + form
    used_up = len(chosen.z) + len(chosen.atoms)
    lost = min(used_up * noise.inflation / base.rows.n, _MOST_LOST)
    rows = [*parts.values(), rest, (1 - lost) * noise.std**2, whole]
    terms = np.stack(rows, axis=1)[keep]
    run = base.rows.run[keep]
    drawn = _energies(block_means(terms, run, noise.inflation, generator))
    energy = _energies(terms.mean(axis=0))
    low, high = np.quantile(drawn[..., :-1] / drawn[..., -1:], INTERVAL, axis=0)
    one_less = _energies(without_each(terms, run))
    if len(one_less):
        shares = one_less[..., :-1] / one_less[..., -1:]
        low, high = of_so_few_runs(energy[:-1] / energy[-1], low, high, shares)
        low = np.maximum(low, 0.0)
    low, high = np.minimum((low, high), 1.0)  # by rounding
    names = [p if p == PARAMETERS else base.atoms[p].effect.id for p in parts]
    return tuple(
        Part(
            part=name,
            rms=float(np.sqrt(value)),
            share=float(value / energy[-1]),
            closed_ci=(float(ends[0]), float(ends[1])),
        )
        for name, value, ends in zip(
            [*names, "unexplained", "noise"], energy[:-1],
            zip(low, high, strict=True), strict=True,
        )
    )  # fmt: skip


def _energies(means):
    """Means (..., parts + 3) of the parts, of what is left, of the noise and of the
    whole -> the same, none below zero, with what is left beyond the noise and the noise
    that is left: all but the last add to the last.

    A part that makes matters worse, as where it serves another channel, counts nothing;
    the others share what was closed.
    """
    parts = np.maximum(means[..., :-_BESIDE], 0.0)
    left, noise, whole = np.moveaxis(means[..., -_BESIDE:], -1, 0)
    whole = np.maximum(whole, NONZERO)
    total = np.sum(parts, axis=-1)
    left = np.where(total > 0, np.minimum(left, whole), whole)
    parts = parts * ((whole - left) / np.where(total > 0, total, 1.0))[..., None]
    noise = np.minimum(left, noise)
    rest = np.stack([left - noise, noise, whole], axis=-1)
    return np.concatenate([parts, rest], axis=-1)


def _missed(
    base: Base, chosen: Hypothesis
) -> dict[str, dict[tuple[int | str, ...], np.ndarray]]:
    """Residual (n,) of every channel where only a subset of the players is allowed;
    every subset is refitted, with the simulator's parameters held unless they are among
    it."""
    atoms, observed = chosen.atoms, base.rows.observed
    sets = [s for size in range(len(atoms) + 1) for s in combinations(atoms, size)]
    place = {atom: k for k, atom in enumerate(atoms)}
    guess = {s: chosen.amplitude[[place[atom] for atom in s]] for s in sets}
    free = base.refit([(chosen.z, guess[s]) for s in sets], sets)
    fits: dict[tuple[int | str, ...], tuple[np.ndarray, np.ndarray]] = {}
    fits |= zip(sets, zip(free.z, free.amplitude, strict=True), strict=True)
    fits[atoms] = chosen.z, chosen.amplitude
    if base.simulator is not None:
        held = base.design._replace(hold=np.array(_HELD))
        start = base.simulator.z
        stuck = base.refit([(start, guess[s]) for s in sets], sets, held)
        fits = {(PARAMETERS, *s): fit for s, fit in fits.items()}
        fits |= {s: (start, a) for s, a in zip(sets, stuck.amplitude, strict=True)}
    missed: dict[str, dict] = {channel: {} for channel in base.rows.channels}
    for subset, (z, amplitude) in fits.items():
        index = [k for k in subset if not isinstance(k, str)]
        forces = base.forces(z, base.amplitudes(index, amplitude))
        for channel, force in forces.items():
            missed[channel][subset] = observed[channel] - force
    return missed


_HELD_WITHIN = 0.9
"""Probability that an interval of a parameter holds."""

_FARTHEST = 8.0
"""Standard deviations within which a normal part lies."""

_HALVINGS = 40
"""Steps of bisection to its end: of any width, one in 1e12 is left."""


def _misled(base: Base, chosen: Hypothesis) -> np.ndarray:
    """Variance of the parameters (p,) as the true slips are not known."""
    linear = base.linearised(chosen.z, amplitudes_of(base, chosen))
    columns = [linear.jacobian, linear.columns[:, list(chosen.atoms)]]
    fitted = np.concatenate(columns, axis=1)
    moved = np.linalg.lstsq(fitted, base.doubt, rcond=None)[0]
    return np.sum(moved[: len(chosen.z)] ** 2, axis=1)


def _of_mixture(shares, off, std) -> np.ndarray:
    """Standard deviations (p,) of which 1.645 about zero hold nine tenths of a mixture.

    Args:
        shares: (s,) probabilities of its normal parts.
        off, std: (s, p) their means and standard deviations.
    """
    low, high = np.zeros(off.shape[1]), np.max(np.abs(off) + _FARTHEST * std, axis=0)
    for _ in range(_HALVINGS):
        reach = (low + high) / 2
        inside = ndtr((reach - off) / std) - ndtr((-reach - off) / std)
        enough = shares @ inside > _HELD_WITHIN
        low, high = np.where(enough, low, reach), np.where(enough, reach, high)
    return high / float(ndtri((1 + _HELD_WITHIN) / 2))


def _spread(case: Case, widening: float) -> np.ndarray:
    """Standard deviations (p,) of the parameters beside the verdict's effects, of which
    1.645 hold nine tenths: of the errors of the fits of all sets that these data leave
    possible, each by its probability. Where they leave the verdict alone, its own.
    The slips are as unsure as their density and their phase; see ``Base.doubt``.

    Args:
        widening: see :func:`parameter_changes`.
    """
    chosen, weighed = case.verdict.chosen, case.weighed
    z = np.asarray(chosen.z)
    listed = weighed.listed
    each, shares = [weighed.best_of[k] for k in listed], np.array([*listed.values()])
    off = np.array([h.z for h in each]) - z
    variance = np.array([np.diag(h.covariance)[: len(z)] for h in [chosen, *each]])
    variance = np.maximum(variance, NONZERO) * widening + _misled(case.base, chosen)
    own, std = np.sqrt(variance[0]), np.sqrt(variance[1:])
    return np.maximum(own, _of_mixture(shares, off, std))


def parameter_changes(case: Case, widening: float) -> Mapping[str, Change]:
    """The simulator's parameters as given, and as the data have them beside the effects
    of the verdict; empty where a form was fitted.

    Args:
        widening: factor on variances, as for amplitudes.
    """
    base, chosen = case.base, case.verdict.chosen
    if base.simulator is None:
        return {}
    layout, z = base.layout, np.asarray(chosen.z)
    step, changes = _STEP, {}
    spread = _spread(case, widening)
    slope = (layout.vector(z + step) - layout.vector(z - step)) / (2 * step)
    given, measured = layout.vector(base.simulator.z), layout.vector(z)
    for k, name in enumerate(layout.labels):
        std = float(abs(slope[k]) * spread[k])
        change = float(measured[k] - given[k])
        changes[name] = Change(
            float(given[k]), float(measured[k]), std, abs(change) > _DIFFERS * std
        )
    return changes


def simulator_summary(base: Base, model: str, gap: float) -> SimulatorSummary | None:
    """What was given, and how well its tire follows it.

    Args:
        model: name of what stands in for it.
        gap: the whole gap, rms [N].
    """
    if base.simulator is None:
        return None
    given, main, n = base.simulator.given, base.rows.channels[0], base.rows.n
    missed = base.design.offset[main][:n]
    off = float(np.sqrt(np.mean(missed**2)))
    followed = Surrogate(
        model=model, rms=off, of_force=missed_share(base.rows, main, missed),
        of_gap=off / max(gap, NONZERO),
    )  # fmt: skip
    return SimulatorSummary(given.kind, given.source, given.sha256, followed)
