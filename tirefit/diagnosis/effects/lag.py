"""Effects of the past: a channel that comes late, a force that needs a way to build."""

import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects.free_forms import SHIFT_BY_DELAY, SHIFT_BY_LAG
from tirefit.diagnosis.effects.known import of_a_known_clock
from tirefit.diagnosis.effects.record import Effect, scaled
from tirefit.diagnosis.rows.rates import AGES, AHEAD, STEPS

_NO_LENGTH = 1e-12
"""Share of a step that counts as no length: the slope there is one-sided, not zero."""

_RELAXED, _FILTERED = 2.0, 0.1
"""Longest relaxation of a tire, in radii of its wheel, and delay of a filter [s]."""

_LATE = "so look for another cause: steering or a sensor that comes late"

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


def _steer(state, change, rows):
    """The road wheels steer by a change (n,) [rad] more than was logged, and a force
    that was derived across them turns with them."""
    slip = rows.past[:, AHEAD]
    return state._replace(
        shift=state.shift + jnp.tan(jnp.arctan(slip) - change) - slip,
        force=state.force + rows.pivot * change,
    )


def _too_long(length: float, prepared) -> str:
    """Doubt of a relaxation length; empty where it is one of a tire."""
    wheel = prepared.sizes.wheel
    if not wheel or length <= _RELAXED * wheel:
        return ""
    return f"doubtful: {length / wheel:.2g} wheel radii, {_LATE}"


def _too_late(delay: float, prepared) -> str:
    if abs(delay) <= _FILTERED:
        return ""
    return f"doubtful: more than the {_FILTERED:g} s of a filter, {_LATE}"


def _within_the_past(prior, prepared, rig):
    """No row knows more of its past, or of what comes, than was taken along."""
    first, last = AGES[[0, -1]] * float(prepared.covariates.interval[0])
    return prior._replace(low=max(prior.low, first), high=min(prior.high, last))


DELAY = Effect(
    id="channel_delay", family="measurement", change=_delay, scale=0.15,
    per=("period",), unit="s", formula="force(t) belongs to slip(t - amplitude)",
    means="force and slip are shifted in time",
    remedy="measure the delay (clock in vehicle.toml), and shift the force back by it",
    parameter="delay", bounds=((-3.0, 3.0), (-3.0, 3.0), (0.0, 3.0)),
    prior=lambda *given: _within_the_past(of_a_known_clock(*given), *given[1:]),
    doubts=_too_late, needs=("sweeps",),
    variants=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), forms=SHIFT_BY_DELAY,
    looks_like=("relaxation_length", "friction_hysteresis"), told_apart_by="speeds",
)  # fmt: skip
RELAXATION = Effect(
    id="relaxation_length", family="transient", change=_relax, scale=0.15, per=("way",),
    unit="m", formula="d slip'/dt = v / amplitude (slip - slip')",
    means="the force lags the slip over a rolling distance",
    remedy="fit brush-relaxation", parameter="length", bounds=((0.0, 3.0),),
    doubts=_too_long, needs=("sweeps", "v"), variants=((1.0, 0.0), (0.0, 1.0)),
    forms=SHIFT_BY_LAG, looks_like=("channel_delay", "friction_hysteresis"),
    told_apart_by="speeds",
)  # fmt: skip

STEERING_DELAY = Effect(
    id="steering_delay", family="slip x steering",
    change=lambda state, a, _, rows: _steer(state, _late(rows.steered, a, rows), rows),
    scale=0.08, unit="s", formula="road wheel angle(t) = steering(t - amplitude)",
    means="the road wheels steer later than was logged: the servo, or its clock",
    remedy="measure the road wheel angle itself, or shift the steering by the delay",
    parameter="delay", bounds=((-0.15, 0.5),), prior=_within_the_past,
    needs=("steering", "sweeps"), channels=("fy", "mz"),
    looks_like=("relaxation_length", "channel_delay", "steering_lag"),
    told_apart_by="speeds",
)  # fmt: skip
STEERING_LAG = Effect(
    id="steering_lag", family="slip x steering",
    change=lambda state, a, _, rows: _steer(
        state, lagged(rows.steered, a, rows.interval), rows
    ),
    scale=0.08, unit="s",
    formula="amplitude d(angle)/dt = steering - angle, of the road wheels",
    means="the road wheels follow the steering slowly: a servo, soft linkage",
    remedy="measure the road wheel angle itself, or lag the steering by the constant",
    parameter="time constant", bounds=((0.0, 0.5),), needs=("steering", "sweeps"),
    channels=("fy", "mz"),
    looks_like=("steering_delay", "relaxation_length", "channel_delay"),
    told_apart_by="speeds",
)  # fmt: skip

EFFECTS = (DELAY, RELAXATION, STEERING_DELAY, STEERING_LAG)
