"""The closure on data that the search did not use."""

from collections.abc import Sequence

import numpy as np

from tirefit.diagnosis.evidence.base import on_rows
from tirefit.diagnosis.evidence.search import amplitudes_of
from tirefit.diagnosis.left_out import Ladder
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.summary.case import Case
from tirefit.diagnosis.summary.closure import closure_elsewhere
from tirefit.diagnosis.summary.records import HeldOut

_NINETY = 1.645
"""Standard errors on both sides of a 90 % interval."""


def held_out(case: Case, holdout: Sequence, rig, ladder: Ladder, generator):
    """Closure on other files where there are some, else that of the ladder's last set
    of effects; None where no effect is named and no file is given."""
    if holdout:
        return _on_files(case, holdout, rig, generator)
    if not case.verdict.status.names or len(ladder.steps) < 4:
        return None
    base, step, floor = ladder.steps[0], ladder.steps[-3], ladder.steps[-1]
    rms = np.sqrt(max(base.rms_left_out**2 - floor.rms_left_out**2, 0.0))
    reach = _NINETY * step.closed_std
    return HeldOut(
        rms=float(rms), resolvable=True, closed=step.closed,
        closed_ci=(max(step.closed - reach, -1.0), min(step.closed + reach, 1.0)),
        remaining_rms=float((1 - step.closed) * rms), on=ladder.on,
    )  # fmt: skip


def _on_files(case: Case, holdout: Sequence, rig, generator) -> HeldOut:
    base, chosen = case.base, case.chosen
    before, after, variance, run = [], [], [], []
    rows, runs = base.rows, 0
    main = rows.channels[0]
    for data in holdout:
        other = on_rows(base, prepare(data, rig, rows.channels, rows.slip_scatter), rig)
        observed = other.rows.observed[main]
        forces = other.forces(base.as_given, base.amplitudes())
        before.append(observed - forces[main])
        amplitudes = amplitudes_of(base, chosen)
        after.append(observed - other.forces(chosen.z, amplitudes)[main])
        scale = np.median(base.noise[main].std / base.rows.inputs.fz)
        variance.append((scale * other.rows.inputs.fz) ** 2)
        run.append(other.rows.run + runs)
        runs += len(data.runs)
    closure = closure_elsewhere(
        np.concatenate(before), np.concatenate(after), np.concatenate(variance),
        np.concatenate(run), base.noise[main].inflation, generator,
    )  # fmt: skip
    return HeldOut(
        rms=closure.rms, resolvable=closure.resolvable, closed=closure.closed,
        closed_ci=(closure.low, closure.high), remaining_rms=closure.remaining,
        on=", ".join(data.name for data in holdout),
    )  # fmt: skip
