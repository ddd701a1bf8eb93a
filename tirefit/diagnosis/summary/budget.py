"""Divide the distance from a base to the measurement into parts: parameters of a
simulator, effects, an unexplained part, and noise. The squares of the parts add up."""

from collections.abc import Callable, Mapping
from itertools import combinations
from math import comb

import numpy as np

from tirefit.diagnosis.engine.fit import Fit
from tirefit.diagnosis.engine.left_out import jackknife_error
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.fits import missed_share
from tirefit.diagnosis.rows.subject import Base
from tirefit.diagnosis.summary.case import Case
from tirefit.diagnosis.summary.closure import INTERVAL, block_means, of_so_few_runs, without_each
from tirefit.diagnosis.summary.records import Change, Part, SimulatorSummary, Surrogate

PARAMETERS = "parameters"

_DIFFERS = 2.0
"""Standard errors from which a parameter of a simulator counts as different."""

_HELD = 1e4
"""Stiffness that holds parameters z: they move by 1e-8 of the gradient."""


def subsets(players: tuple) -> list[tuple]:
    """All subsets of the players, the empty one first, each in the order of players."""
    sizes = range(len(players) + 1)
    return [chosen for size in sizes for chosen in combinations(players, size)]


def shapley(players: tuple, worth: Callable[[tuple], float]) -> dict:
    """Shapley value of every player: its mean gain over all orders. ``worth`` takes
    each of the :func:`subsets`."""
    count, known = len(players), {chosen: worth(chosen) for chosen in subsets(players)}
    values = dict.fromkeys(players, 0.0)
    for player in players:
        for without in (chosen for chosen in known if player not in chosen):
            joined = tuple(p for p in players if p in (*without, player))
            # Share of the orders in which exactly this subset precedes the player.
            share = 1 / (count * comb(count - 1, len(without)))
            values[player] += share * (known[joined] - known[without])
    return values


def budgets_of(case, rows, generator) -> dict[str, tuple[Part, ...]]:
    """Parts of the energy of every channel: parameters (of a simulator), each named
    effect, unexplained, noise; their shares add to one. ``rows`` holds by channel
    ``extended`` (n,), the force of the verdict of a ``Case``."""
    missed = _missed(case.base, case.chosen)
    return {
        channel: _budget(case, channel, missed[channel], parts["extended"], generator)
        for channel, parts in rows.items()
    }


def _budget(case, channel: str, missed, extended, generator) -> tuple[Part, ...]:
    base, chosen = case.base, case.chosen
    noise = base.noise[channel]
    players = ((PARAMETERS,) if base.simulator else ()) + chosen.atoms
    whole = missed[()] ** 2
    parts = shapley(players, lambda subset: whole - missed[subset] ** 2)
    rest = (base.rows.observed[channel] - extended) ** 2
    for atom in chosen.atoms:
        # Rounding of a refit is attributed to the effects.
        parts[atom] = parts[atom] + (missed[players] ** 2 - rest) / len(chosen.atoms)
    fitted = (len(chosen.z) + len(chosen.atoms)) * noise.inflation / base.rows.n
    rows = [*parts.values(), rest, max(1 - fitted, 0.0) * noise.std**2, whole]
    terms = np.stack(rows, axis=1)[~noise.outlier]
    run = base.rows.run[~noise.outlier]

    def shares(means):
        energies = _energies(means)
        return energies[..., :-1] / energies[..., -1:]

    means = terms.mean(axis=0)
    drawn = shares(block_means(terms, run, noise.inflation, generator))
    low, high = np.quantile(drawn, INTERVAL, axis=0)
    if len(fewer := without_each(terms, run)):
        low, high = of_so_few_runs(shares(means), low, high, shares(fewer))
    names = [p if p == PARAMETERS else base.atoms[p].effect.id for p in parts]
    ends = np.clip([low, high], 0.0, 1.0).T.tolist()
    rms = np.sqrt(_energies(means)[:-1]).tolist()
    columns = [*names, "unexplained", "noise"], rms, shares(means).tolist()
    return tuple(map(Part, *columns, map(tuple, ends)))


def _energies(means):
    """Convert means (..., parts + 3) of the parts, the remainder, the noise and the whole
    to non-negative ones that add up to the whole, with the remainder beyond the noise and
    the remaining noise. A part that increases the error counts zero; the others share the
    energy that was closed."""
    parts = np.maximum(means[..., :-3], 0.0)
    left, noise, whole = np.moveaxis(means[..., -3:], -1, 0)
    whole = np.maximum(whole, NONZERO)
    total = np.sum(parts, axis=-1)
    left = np.where(total > 0, np.minimum(left, whole), whole)
    parts = parts * ((whole - left) / np.where(total > 0, total, 1.0))[..., None]
    noise = np.minimum(left, noise)
    rest = np.stack([left - noise, noise, whole], axis=-1)
    return np.concatenate([parts, rest], axis=-1)


def _missed(base: Base, chosen: Fit) -> dict[str, dict[tuple, np.ndarray]]:
    """Residual (n,) of every channel for each subset of the players. All subsets are
    refitted; the parameters of the simulator are held unless they are in the subset."""
    atoms, sets = chosen.atoms, subsets(chosen.atoms)
    guess = [chosen.amplitude[[atoms.index(k) for k in s]] for s in sets]
    refit = base.refitted([(chosen.z, a) for a in guess], sets, base.design)
    free = dict(zip(sets, zip(refit.z, refit.amplitude, strict=True), strict=True))
    free[atoms] = chosen.z, chosen.amplitude
    fits: dict[tuple, tuple] = {**free}
    if base.simulator is not None:
        start, held = base.simulator.z, base.design._replace(hold=np.array(_HELD))
        stuck = base.refitted([(start, a) for a in guess], sets, held)
        fits = {(PARAMETERS, *s): fit for s, fit in free.items()}
        fits |= {s: (start, a) for s, a in zip(sets, stuck.amplitude, strict=True)}
    missed: dict[str, dict] = {channel: {} for channel in base.rows.channels}
    for subset, (z, amplitude) in fits.items():
        index = [k for k in subset if not isinstance(k, str)]
        forces = base.forces(z, base.amplitudes(index, amplitude))
        for channel, force in forces.items():
            missed[channel][subset] = base.rows.observed[channel] - force
    return missed


def _spread(case: Case) -> np.ndarray:
    """Standard errors (p,) of the parameters z fitted with the effects that help: those of
    the mixture of the parts of their set, and at least those of the jackknife over the parts
    of the data that are left out."""
    chosen, out, p = case.chosen, case.predicted, len(case.chosen.z)
    each = [case.weighed.best_of[key] for key in case.parts]
    variance = np.array([np.diag(fit.covariance)[:p] for fit in [chosen, *each]])
    variance = np.maximum(variance, 0.0) * case.widening
    off = np.array([fit.z for fit in each]) - chosen.z
    mixed = np.array([*case.parts.values()]) @ (variance[1:] + off**2)
    by_parts = jackknife_error(out.parameters[out.effects.index(chosen.key)])
    return np.sqrt(np.maximum.reduce([variance[0], mixed, by_parts**2]))


def parameter_changes(case: Case) -> Mapping[str, Change]:
    """The parameters of the simulator as given, and as fitted with the effects of the verdict;
    empty if a form was fitted."""
    base, z, changes = case.base, np.asarray(case.chosen.z), {}
    if base.simulator is None:
        return {}
    values, spread = base.layout.vector, _spread(case)
    std = np.abs(values(z + spread) - values(z - spread)) / 2
    ends = values(base.simulator.z), values(z), std
    for name, given, measured, error in zip(base.layout.labels, *ends, strict=True):
        differs = bool(abs(measured - given) > _DIFFERS * error)
        changes[name] = Change(float(given), float(measured), float(error), differs)
    return changes


def simulator_summary(base: Base, model: str, gap: float) -> SimulatorSummary | None:
    """The record of the given simulator, with the error of its stand-in ``model``, also
    over the whole gap [N]."""
    if base.simulator is None:
        return None
    given, main, n = base.simulator.given, base.rows.channels[0], base.rows.n
    missed = base.design.offset[main][:n]
    off = float(np.sqrt(np.mean(missed**2)))
    share = missed_share(base.rows, main, missed)
    followed = Surrogate(model, off, share, off / max(gap, NONZERO))
    return SimulatorSummary(given.kind, given.source, given.sha256, followed)
