"""The closure on data that the search did not use."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tirefit.diagnosis.decide.conclusion import WORSE
from tirefit.diagnosis.evidence.base import Base, on_rows
from tirefit.diagnosis.evidence.linear_fit import linear_at
from tirefit.diagnosis.evidence.runs import KINDS
from tirefit.diagnosis.evidence.search import amplitudes_of
from tirefit.diagnosis.negligible import ROUNDING
from tirefit.diagnosis.rows.prepared import Prepared, prepare
from tirefit.diagnosis.rows.rates import shown_runs
from tirefit.diagnosis.summary.closure import Closure, closure_elsewhere
from tirefit.diagnosis.summary.records import HeldOut

_TOP = 0.05
"""Share of the range of loads or speeds that counts as its highest setting."""

_LEAST, _MOST = 0.05, 0.6
"""Share of the rows that a regime to be left out may hold."""

_FEWEST = 4
"""Runs from which they are left out in turn."""

_LARGEST = 0.7
"""Quantile of the slip beyond which it is the regime, where no setting is."""

_LIMIT = "largest slip"
"""The regime of the largest slips."""

_FAILS = "the largest slips, left out, are predicted no better than without it"
"""What is said of the limit where it is no test."""

_UNKNOWN = "fits without the largest slips know too little to tell there"

_QUARTERS = 4
"""Stretches of time into which a record of a moving tire is cut."""


def held_out(case, holdout: Sequence, rig, generator) -> HeldOut | None:
    """Closure on other files, or on a regime of this one: the figures of ``gap``.

    Without other files each run is left out in turn, where there are four or more and
    the verdict holds for all of them. Else the regime farthest out (highest load, else
    highest speed, else largest slip) is left out, both fits are repeated without it,
    and judged on it; a simulator stays as it was given. What a tire does at its limit
    is no test of effects that are named beside something unlisted: where these fail
    there, and the rows are a record in time, each quarter of it is left out in turn,
    and both is said. So it is where the fits without the largest slips do not know
    their parameters. None, but for other files, where the verdict names nothing, unless
    a simulator's parameters may close a part, and where no part of the rows can be
    predicted from the others.
    """
    status = case.verdict.status
    if holdout:
        return _on_files(case, holdout, rig, generator)
    if status in ("none", "unknown") and not case.base.simulator:
        return None
    prepared = case.base.prepared
    codes = shown_runs(prepared.run, prepared.data.runs)
    own = {f"{kind}_run" for kind in KINDS} & set(case.verdict.effects)
    if len(codes) >= _FEWEST and not own:
        return _in_turn(case, prepared.run, codes, f"{len(codes)} runs", generator)
    out, what = _regime(case.base)
    at_limit, timed = what == _LIMIT, "sweeps" in prepared.has
    if at_limit and not _known_without(case, out):
        return _told(_in_quarters(case, _UNKNOWN, generator)) if timed else None
    before, after = _both_without(case, out)
    on, run = f"{what}, left out of both fits", prepared.run[out]
    held = _judged(case, before, after, out, run, on, generator)
    fails = held.closed is not None and held.closed <= WORSE
    if fails and at_limit and timed and status == "incomplete":
        return _in_quarters(case, _FAILS, generator)
    return held


def _told(held: HeldOut) -> HeldOut:
    """The figures, without a closure where that may be of either sign: they do not
    tell."""
    low, high = held.closed_ci
    if low is None or high is None or not low < WORSE < high:
        return held
    return replace(held, resolvable=False, closed=None, closed_ci=(None, None))


def _known_without(case, out) -> bool:
    """Whether fits without the rows ``out`` (n,) bool know their parameters well enough
    to say there what the verdict changes: a friction that only the largest slips show
    is off by more without them. To first order."""
    base, chosen, n = case.base, case.verdict.chosen, case.base.prepared.n
    main = base.prepared.channels[0]
    used_up = linear_at(base, chosen).used_up
    inside = used_up[np.tile(~out, len(base.prepared.channels))]
    prior = np.full(used_up.shape[1], ROUNDING)
    prior[len(chosen.z) :] = 1.0
    inside = np.concatenate([inside, np.diag(np.sqrt(prior))])
    _, root = np.linalg.qr(inside)
    error = np.linalg.solve(root.T, used_up[:n][out].T)
    changed = base.forces(chosen.z, amplitudes_of(base, chosen))[main]
    changed = (changed - base.forces(base.as_given, base.amplitudes())[main])[out]
    scale = base.design.scale[main][:n][out]
    return bool(np.sum(error**2) < np.sum((changed / scale) ** 2))


def _record(closure: Closure, what: str) -> HeldOut:
    return HeldOut(
        rms=closure.rms, resolvable=closure.resolvable, closed=closure.closed,
        closed_ci=(closure.low, closure.high), remaining_rms=closure.remaining, on=what,
    )  # fmt: skip


def _on_files(case, holdout, rig, generator) -> HeldOut:
    base, chosen = case.base, case.verdict.chosen
    before, after, variance, run = [], [], [], []
    rows, runs = base.prepared, 0
    main = rows.channels[0]
    for data in holdout:
        there = prepare(data, rig, rows.channels, rows.slip_scatter)
        other = on_rows(base, there, rig)
        observed = other.prepared.observed[main]
        forces = other.forces(base.as_given, base.amplitudes())
        before.append(observed - forces[main])
        amplitudes = amplitudes_of(base, chosen)
        after.append(observed - other.forces(chosen.z, amplitudes)[main])
        scale = np.median(base.noise[main].std / base.prepared.inputs.fz)
        variance.append((scale * other.prepared.inputs.fz) ** 2)
        run.append(other.prepared.run + runs)
        runs += len(data.runs)
    closure = closure_elsewhere(
        np.concatenate(before), np.concatenate(after), np.concatenate(variance),
        np.concatenate(run), base.noise[main].inflation, generator,
    )  # fmt: skip
    return _record(closure, ", ".join(data.name for data in holdout))


def _regime(base: Base) -> tuple[np.ndarray, str]:
    """Rows to leave out, and what they are."""
    prepared = base.prepared
    for name, values in (("fz", prepared.inputs.fz), ("v", prepared.inputs.v)):
        need = {"fz": "loads", "v": "speeds"}[name]
        if need in prepared.has:
            values = np.asarray(values)
            top = values >= values.max() - _TOP * np.ptp(values)
            if _LEAST < top.mean() < _MOST:
                return top, f"highest {name}"
    size = np.abs(prepared.slip)
    return size > np.quantile(size, _LARGEST), _LIMIT


def _quarters(prepared: Prepared) -> np.ndarray:
    """Which quarter of the record each row is in, in the order of time: (n,)."""
    quarter = np.empty(prepared.n, int)
    order = np.lexsort((prepared.covariates.time, prepared.run))
    quarter[order] = np.arange(prepared.n) * _QUARTERS // prepared.n
    return quarter


def _in_turn(case, part, codes, what: str, generator) -> HeldOut:
    """Each ``part`` (n,) of the rows in turn, predicted by fits to the others."""
    before, after = np.full((2, case.base.prepared.n), np.nan)
    for code in codes:
        out = part == code
        before[out], after[out] = _both_without(case, out)
    every = np.isin(part, list(codes))
    what = f"each of {what}, left out of both fits in turn"
    return _judged(
        case, before[every], after[every], every, part[every], what, generator
    )


def _in_quarters(case, why: str, generator) -> HeldOut:
    rows, quarters = case.base.prepared, range(_QUARTERS)
    what = f"{_QUARTERS} stretches of the record"
    held = _in_turn(case, _quarters(rows), quarters, what, generator)
    return replace(held, on=f"{held.on} ({why})")


def _both_without(case, out) -> tuple[np.ndarray, np.ndarray]:
    """What the base and the verdict miss of the rows ``out`` (n,) bool, both refitted
    without them; a simulator stays as it was given."""
    base, chosen = case.base, case.verdict.chosen
    keep = np.array(base.design.keep)
    keep[: base.prepared.n] *= ~out
    design = base.design._replace(keep=keep)
    main = base.prepared.channels[0]

    def refitted(z, amplitude, atoms):
        again = base.refit([(z, amplitude)], [atoms], design)
        amplitudes = base.amplitudes(atoms, again.amplitude[0])
        return base.forces(again.z[0], amplitudes)[main][out]

    null = case.weighed.best_of[()]
    observed = base.prepared.observed[main][out]
    before = observed - refitted(null.z, np.zeros(0), ())
    if base.simulator:
        before = observed - base.forces(base.as_given, base.amplitudes())[main][out]
    return before, observed - refitted(chosen.z, chosen.amplitude, chosen.atoms)


def _judged(case, before, after, out, run, what: str, generator) -> HeldOut:
    base = case.base
    noise = base.noise[base.prepared.channels[0]]
    good = ~noise.outlier[out]
    if not good.any():  # all of them are something else than the noise
        good[:] = True
    closure = closure_elsewhere(
        before[good], after[good], (noise.std[out] ** 2)[good],
        run[good], noise.inflation, generator,
    )  # fmt: skip
    return _record(closure, what)
