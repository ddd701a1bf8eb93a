"""Effects of the past: a channel that comes late, a force that needs a way to build."""

import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects.free_forms import SHIFT_BY_DELAY, SHIFT_BY_LAG
from tirefit.diagnosis.effects.known import of_a_known_clock
from tirefit.diagnosis.effects.record import Effect, scaled
from tirefit.diagnosis.rows.rates import AGES, AHEAD, STEPS

_NO_LENGTH = 1e-12
"""Share of a step that counts as no length: the slope there is one-sided, not zero."""

_FEW_WAYS = 1e-4
"""Steps over the length below which the response is the first term of its series: its
second is a third of this times it, and the closed form loses digits."""


def _late(past, delay, rows):
    """Values of a delay [s] ago, less the values: (n,) of (n, k).

    Exact for values that move in straight lines from column to column.
    """
    age, ages = jnp.clip(delay / rows.interval, AGES[0], AGES[-1]), jnp.asarray(AGES)
    passed = jnp.sum(age[:, None] >= ages[None, :], axis=1)
    low = jnp.clip(passed - 1, 0, ages.size - 2)
    share = (age - ages[low]) / (ages[low + 1] - ages[low])
    before = jnp.take_along_axis(past, low[:, None], axis=1)[:, 0]
    after = jnp.take_along_axis(past, low[:, None] + 1, axis=1)[:, 0]
    return before + share * (after - before) - past[:, AHEAD]


def lagged(past, length, step):
    """Values that follow over a length, less the values: (n,) of (n, k).

    Exact for values that rest before their past and then move in straight lines from
    column to column. A length below zero would foresee, and counts as none.

    Args:
        length: of the response, in the unit of ``step``.
        step: (n,) of one of :data:`AGES`.
    """
    # At a length of zero itself the slope is that of lengths above.
    length = jnp.where(length < 0, 0.0, length) + _NO_LENGTH * step
    one = (step / length)[:, None]
    ways, gone = (one * np.array([of], float) for of in (STEPS, AGES[AHEAD:]))
    # Response to values that rise over the way, and what is left of it by now.
    decay, since = jnp.exp(-ways), jnp.exp(-gone)
    share = jnp.where(ways < _FEW_WAYS, ways / 2, 1 - (1 - decay) / ways)
    after, before = past[:, AHEAD:-1], past[:, AHEAD + 1 :]
    risen = share * after + (1 - share - decay) * before
    behind = jnp.sum(since[:, :-1] * risen, axis=1) + since[:, -1] * past[:, -1]
    return behind - past[:, AHEAD]


def _delay(state, delay, constants, rows):
    """Of the slip; of the forces, which belong to slip and load of then; or of the
    forces through a filter of first order, whose delay is its time constant [s]."""
    slip, force, filtered = constants
    # A brush under another load is one of another friction, see S(12).
    load = 1 + _late(rows.burden, force * delay, rows)
    moved = scaled(state, "friction", load)
    constant = filtered * delay
    return moved._replace(
        shift=state.shift + _late(rows.past, (slip + force) * delay, rows),
        force=state.force + filtered * lagged(rows.pull, constant, rows.interval),
        moment=state.moment + filtered * lagged(rows.twist, constant, rows.interval),
    )


def _relax(state, length, constants, rows):
    slip, force = constants
    return state._replace(
        shift=state.shift + slip * lagged(rows.past, length, rows.step),
        force=state.force + force * lagged(rows.pull, length, rows.step),
        moment=state.moment + force * lagged(rows.twist, length, rows.step),
    )


def _within_the_past(prior, prepared, rig):
    """No row knows more of its past, or of what comes, than was taken along."""
    prior = of_a_known_clock(prior, prepared, rig)
    first, last = AGES[[0, -1]] * float(prepared.covariates.interval[0])
    return prior._replace(low=max(prior.low, first), high=min(prior.high, last))


DELAY = Effect(
    id="channel_delay",
    family="measurement",
    change=_delay,
    scale=0.15,
    per=("period",),
    unit="s",
    formula="force(t) belongs to slip(t - amplitude)",
    means="force and slip are shifted in time",
    remedy="shift the force back by the delay",
    parameter="delay",
    bounds=((-3.0, 3.0), (-3.0, 3.0), (0.0, 3.0)),
    prior=_within_the_past,
    needs=("sweeps",),
    variants=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    forms=SHIFT_BY_DELAY,
    looks_like=("relaxation_length", "friction_hysteresis"),
    told_apart_by="speeds",
)
RELAXATION = Effect(
    id="relaxation_length",
    family="transient",
    change=_relax,
    scale=0.15,
    per=("way",),
    unit="m",
    formula="d slip'/dt = v / amplitude (slip - slip')",
    means="the force lags the slip over a rolling distance",
    remedy="fit brush-relaxation",
    parameter="length",
    bounds=((0.0, 3.0),),
    needs=("sweeps", "v"),
    variants=((1.0, 0.0), (0.0, 1.0)),
    forms=SHIFT_BY_LAG,
    looks_like=("channel_delay", "friction_hysteresis"),
    told_apart_by="speeds",
)

EFFECTS = (DELAY, RELAXATION)
