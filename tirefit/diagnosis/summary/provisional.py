"""Provisional: verdict and ladder of schema 3 from what schema 2 knows."""

import numpy as np

from tirefit.diagnosis.decide.case import Case
from tirefit.diagnosis.decide.chances import chance_of_unlisted
from tirefit.diagnosis.negligible import ROUNDING
from tirefit.diagnosis.summary.budget import parameter_changes
from tirefit.diagnosis.summary.look_curve import LookCurve
from tirefit.diagnosis.summary.records import (
    NOISE,
    SMOOTH,
    Each,
    Gap,
    Ladder,
    Left,
    Status,
    Step,
    VerdictSummary,
)


def verdict_of(
    case: Case, curves: tuple[LookCurve, ...], gap: Gap, widening: float
) -> VerdictSummary:
    """Schema 3 filled from what schema 2 knows."""
    verdict, weighed, held = case.verdict, case.weighed, gap.holdout
    noise, named = case.on_the_noise, verdict.status not in ("none", "unknown")
    unlisted = chance_of_unlisted(verdict, weighed)
    own = {e: weighed.holding((e,)) for e in (*verdict.effects, *verdict.also_possible)}
    shares = gap.shares or {e: 1.0 for e in verdict.effects}
    whole = held.closed if held is not None and named else None
    twins = verdict.also_possible if verdict.status == "cannot_tell" else ()
    each = {
        e: Each(
            p, None if whole is None else whole * shares.get(e, 0.0),
            None if whole is None else 0.1, twins if e in verdict.effects else (),
        )
        for e, p in own.items() if e != "unknown"
    }  # fmt: skip
    tests = verdict.adequacy._asdict()
    return VerdictSummary(
        status=Status("named" if noise else verdict.status),
        effects=noise or (() if verdict.status == "unknown" else verdict.effects),
        probability=verdict.probability,
        each=each,
        also_possible=verdict.also_possible,
        left=Left(
            rms=gap.remaining_rms,
            share=(gap.remaining_rms / max(gap.rms, ROUNDING)) ** 2,
            unlisted=unlisted,
            tests={k: tests[k] for k in ("time", "slip_order", "line", "pure_error",
                                         "local")},
            looks_like=tuple(curve.look for curve in curves),
        ),
        parameters=parameter_changes(case, widening),
    )  # fmt: skip


def ladder_of(case: Case, gap: Gap, rows) -> Ladder:
    """One step for all effects, from the closure on data left out; the
    step of anything smooth is of the rows fitted."""
    held, main = gap.holdout, case.base.prepared.channels[0]
    if held is None:
        return Ladder()
    floor = float(np.sqrt(np.mean(case.base.noise[main].std ** 2)))
    parts, observed = rows[main], case.base.prepared.observed[main]
    missed = observed - parts["base"] - parts["gap"]
    smooth = max(float(np.sqrt(np.mean(missed**2))), floor)
    found = [(SMOOTH, smooth), (NOISE, floor)]
    if case.verdict.status not in ("none", "unknown"):
        after = float(np.hypot(held.remaining_rms, floor))
        found.insert(0, (case.verdict.effects, after))
    before, beyond = float(np.hypot(held.rms, floor)), max(held.rms**2, ROUNDING)
    steps = [Step((), before)]
    for effects, rms in found:
        closed, gain = (
            (before**2 - rms**2) / beyond,
            steps[-1].rms_left_out ** 2 - rms**2,
        )
        steps.append(Step(effects, rms, closed, 0.1, gain, 0.1 * beyond))
    return Ladder(held.on, tuple(steps))
