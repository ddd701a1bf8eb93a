r"""Run an estimator over a whole log by one scan, or sample by sample.

For all methods, a guard checks each sample first. For samples that are missing, out of
order, without load, of a locked wheel or at standstill, the method holds its state, whose
covariance grows with time, and the row is flagged. Usable samples are averaged in small
groups before the method steps, because slip noise biases a curve: with single samples,
mu would be a fifth too low in S section 5.1.

The reported variance of mu is :math:`s^2 = s_{own}^2 + s_{20}^2 + (0.05 \mu)^2`, with
:math:`s_{own}` by the method, which follows from the noise that it assumes, and :math:`s_{20}` the
scatter of the estimates of the last 20 s about their mean, which shows what its model misses; each
has the weight :math:`1/(1 + (s_{own} / 0.15 \mu)^2)`, and a detected change starts a new mean.
Alarms, detection of changes and flags use :math:`s_{own}`. The form and the 20 s were chosen on the
measured logs of `fits/friction_benchmark`; 10 or 40 s serve the f1tenth logs as well.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tirefit.arrays import Number, Tree
from tirefit.online.base import RESOLVED, AbstractEstimator, Estimate, Flag, Sample, code, flag_of
from tirefit.padding import padded_size

GUARDED = ("time", "run", "v", "omega")
"""Columns that the guard checks if a log has them, in addition to those of the method."""
_CHUNK = 16
"""Samples of an inner scan. XLA runs the kernels of a loop in sequence only if all its
arrays are smaller than about 512 bytes (measured: two columns of 32 rows are fast, of 64
are not); otherwise it schedules each kernel, with half the samples per second."""
STANDSTILL = 0.5
"""Speed [m/s] below which wheel speeds give no slip: 1 % of slip is 5 mm/s."""
LOCKED_SLIP = 5.0
"""Physical slip above which a wheel counts as locked: a sixth of its free speed."""
_GAP = 3.0  # usual intervals after which samples count as missing
_JUMP = 0.02
"""Slips that differ by more are not averaged: the mean of their forces differs from the
curve by F'' 0.02^2 / 8, 1 % of the load for the tire of S section 5."""
CUSUM_DRIFT, CUSUM_ALARM = 0.5, 12.0
"""Threshold of Page's test: it detects a shift of one standard deviation in 24 steps, and
has one false alarm in 5e5 steps of Gaussian noise (Siegmund's approximation)."""
_MOST_SURPRISING = 4.0  # limit of a single sample in the test, so that one outlier is not a change

MODEL = 0.05
"""Error of a tire model in mu that no log shows by itself, relative: batch fits of one run each
differ by 3 to 6 % on the f1tenth and DART cars."""


class Scatter(NamedTuple):
    """Recent estimates of mu, weighted by time, age and their own standard deviation."""

    mean: Number | float = 0.0  # [-] since the last detected change
    square: Number | float = 0.0  # sum of squared deviations from the mean of their time
    weight: Number | float = 0.0  # sum of the weights of all
    level: Number | float = 0.0  # sum of the weights since the last change

    @property
    def variance(self) -> Number:
        """Weighted mean square deviation [-] of the recent estimates; 0 before the first."""
        return self.square / jnp.where(self.weight > 0, self.weight, 1.0)

    def after(self, mu: Array, std: Array, dt: Array) -> "Scatter":
        """The scatter with an estimate that holds for ``dt`` [s], and its own std."""
        new = dt / (1 + (std / (RESOLVED * mu)) ** 2)
        new = jnp.where(jnp.isfinite(new) & jnp.isfinite(mu), new, 0.0)
        keep = jnp.exp(-dt / 20.0)  # memory of the scatter [s]
        weight, level = keep * self.weight + new, keep * self.level + new
        off = jnp.where(new > 0, mu - self.mean, 0.0)
        step = new / jnp.where(level > 0, level, 1.0) * off
        square = keep * self.square + new * off * (off - step)
        return Scatter(self.mean + step, square, weight, level)


def reported(
    estimator: AbstractEstimator,
    scatter: Scatter,
    estimate: Estimate,
    dt: Number,
    changed: Bool[Array, ""],
) -> tuple[Scatter, Estimate]:
    """The scatter after a row, and the estimate with the reported standard deviation of mu.

    ``own_std`` keeps the standard deviations of the method, by which a row is flagged if mu is not
    resolved.
    The estimate holds for ``dt`` [s], 0 if the sample cannot be used; where ``changed``, a new
    mean starts.
    """
    names, method_std = estimator.method.parameters, jnp.asarray(estimate.std)
    if "mu" not in names:
        return scatter, estimate._replace(own_std=method_std)
    k = names.index("mu")
    mu, flag = estimate.value[k], estimate.flag
    level = jnp.where(changed, 0.0, scatter.level)
    scatter = scatter._replace(level=level).after(mu, method_std[k], dt)
    wide = jnp.sqrt(method_std[k] ** 2 + scatter.variance + (MODEL * mu) ** 2)
    if estimator.judged:
        flag = jnp.where(method_std[k] < RESOLVED * mu, flag, jnp.maximum(flag, code(Flag.LOW_USE)))
    return scatter, estimate._replace(std=method_std.at[k].set(wide), own_std=method_std, flag=flag)


class Guarded(NamedTuple):
    """State of a run: that of the method, and that of the guard."""

    inner: Any
    time: Number  # [s] of the last sample that had one
    interval: Number  # [s] mean interval between samples
    waited: Number  # [s] since the last step
    sums: dict[str, Number]  # of the inputs since the last step
    gathered: Number  # number of samples in them
    flag: Int[Array, ""]  # of the last step
    scatter: Scatter  # of the recent estimates of mu
    rise: Number  # cumulative sum for a rise
    fall: Number  # cumulative sum for a fall
    run: Number  # code of the run


def start(estimator: AbstractEstimator) -> Guarded:
    """The state before the first sample."""
    none, zero = jnp.full((), jnp.nan), jnp.zeros(())
    sums = dict.fromkeys(estimator.method.inputs, zero)
    flag = jnp.asarray(code(Flag.LITTLE_EXCITATION))
    began = (none, none, jnp.full((), jnp.inf), sums, zero, flag, Scatter(), zero, zero, none)
    return _strong(Guarded(estimator.init(), *began))


def _strong(tree: Tree) -> Tree:
    """The same arrays with strong types, as weak types would be compiled again."""
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(x)), tree)


def guarded_step(
    estimator: AbstractEstimator, state: Guarded, sample: Mapping[str, Any]
) -> tuple[Guarded, Estimate]:
    """Process one sample, in the scan and in the stream.

    Args:
        estimator: any of :data:`tirefit.online.methods.METHODS`.
        state: from :func:`start` or the previous sample.
        sample: canonical column -> value: the inputs of the method, ``time``, and those
            of :data:`GUARDED` that are known; NaN if missing.
    """
    began = start(estimator)
    if "run" in sample:
        state = _either(sample["run"] != state.run, began, state)
    now = jnp.asarray(sample["time"], float)
    passed = jnp.where(jnp.isnan(state.time) | jnp.isnan(now), 0.0, now - state.time)
    back = (passed <= 0) & ~jnp.isnan(state.time) & ~jnp.isnan(now)
    dt = jnp.maximum(passed, 0.0)
    known = ~jnp.isnan(state.interval)
    steps = jnp.where(known, dt / jnp.where(known, state.interval, 1.0), 1.0)
    unusable = _unusable(estimator, sample, back)
    usable, gap = unusable == 0, steps > _GAP

    lost = jnp.where(usable, jnp.where(gap, steps - 1, 0.0), steps)
    waited = estimator.wait(state.inner, dt, lost)
    waiting = estimator.estimate(waited)
    sums, count = _gathered(state, sample, usable, gap)
    due = usable & (count >= estimator.average)
    broken = ~_all_finite(waited, began.inner)
    kept = state._replace(inner=waited, waited=state.waited + dt, sums=sums, gathered=count)
    # The last flag is kept until the next step, unless time has made it worse.
    latest = jnp.where(usable, jnp.maximum(state.flag, waiting.flag), unusable)
    waiting = waiting._replace(flag=latest)
    # A branch instead of a selection, as nine of ten samples only add to a mean and XLA
    # would repeat shared computations for each of several selections.
    kept, estimate, alarm, broken = jax.lax.cond(
        due | broken,
        lambda: _stepped(estimator, kept, began),
        lambda: _strong((kept, waiting, *jnp.zeros(2, bool))),
    )
    events = flag_of((usable & gap, Flag.GAP), (alarm, Flag.CHANGED), (broken, Flag.RESET))
    counted = jnp.where(usable, dt, 0.0)
    scatter, estimate = reported(estimator, state.scatter, estimate, counted, alarm | broken)
    # The mean interval between samples, without lost samples; a new one has a weight of 0.1.
    learned = jnp.where(known, state.interval + 0.1 * (dt - state.interval), dt)
    after = kept._replace(
        scatter=scatter,
        time=jnp.where(jnp.isnan(now), state.time, now),
        interval=jnp.where((dt > 0) & (steps <= _GAP), learned, state.interval),
        run=jnp.asarray(sample.get("run", state.run), float),
    )
    flag = jnp.maximum(estimate.flag, events)
    return _strong(after), estimate._replace(flag=flag)


def _stepped(
    estimator: AbstractEstimator, state: Guarded, began: Guarded
) -> tuple[Guarded, Estimate, Bool[Array, ""], Bool[Array, ""]]:
    """The state and the estimate after a step on the mean of the gathered samples,
    whether a change was detected, and whether the state was initialised again."""
    count = jnp.maximum(state.gathered, 1.0)
    mean = {name: total / count for name, total in state.sums.items()}
    sample = {**mean, "count": count, "dt": state.waited}
    moved, estimate = estimator.step(state.inner, sample)
    # Page's two-sided test on the surprises; both sums are reset at an alarm.
    surprise = jnp.asarray(estimate.surprise)
    there = jnp.isfinite(surprise)
    z = jnp.clip(jnp.where(there, surprise, 0.0), -_MOST_SURPRISING, _MOST_SURPRISING)
    drift = jnp.where(there, CUSUM_DRIFT, 0.0)
    rise = jnp.maximum(state.rise + z - drift, 0.0)
    fall = jnp.maximum(state.fall - z - drift, 0.0)
    alarm = jnp.maximum(rise, fall) > CUSUM_ALARM
    moved = _either(alarm, estimator.open(moved), moved)
    finite = _all_finite(moved, began.inner)
    after = state._replace(
        inner=_either(finite, moved, began.inner),
        waited=jnp.where(finite, 0.0, jnp.inf),
        sums=began.sums,
        gathered=began.gathered,
        flag=jnp.asarray(estimate.flag),
        rise=jnp.where(alarm, 0.0, rise),
        fall=jnp.where(alarm, 0.0, fall),
    )
    return _strong((after, estimate, alarm, ~finite))


def _either(condition: Bool[Array, ""], yes: Tree, no: Tree) -> Tree:
    """``choose`` by a branch, so that only one alternative is computed."""
    return jax.lax.cond(condition, lambda: _strong(yes), lambda: _strong(no))


def _gathered(
    state: Guarded, sample: Sample, usable: Bool[Array, ""], gap: Bool[Array, ""]
) -> tuple[dict[str, Number], Number]:
    """Sums and count with this sample; after a gap or a jump, of this sample only."""
    jump = gap
    if "sigma_x" in state.sums:
        mean = state.sums["sigma_x"] / jnp.maximum(state.gathered, 1.0)
        jump |= (state.gathered > 0) & (jnp.abs(sample["sigma_x"] - mean) > _JUMP)
    kept = jnp.where(usable & jump, 0.0, 1.0)
    sums = {
        name: kept * total + jnp.where(usable, sample[name], 0.0)
        for name, total in state.sums.items()
    }
    return sums, kept * state.gathered + jnp.where(usable, 1.0, 0.0)


def _unusable(
    estimator: AbstractEstimator, sample: Sample, back: Bool[Array, ""]
) -> Int[Array, ""]:
    """Code of the reason why a sample does not reach the method; 0 if it does."""
    inputs = [sample[name] for name in estimator.method.inputs]
    missing = ~jnp.isfinite(sum(inputs)) | jnp.isnan(sample["time"])
    reasons = [(missing, Flag.MISSING), (back, Flag.TIME_BACK)]
    if "fz" in sample:
        reasons.append((sample["fz"] <= 0, Flag.NO_LOAD))
        for force in sorted({"fx", "fy"} & set(estimator.method.inputs)):
            # Force over load above which there is a wrong unit or a spike.
            beyond = jnp.abs(sample[force]) > 5.0 * sample["fz"]
            reasons.append((beyond & (sample["fz"] > 0), Flag.IMPLAUSIBLE))
    standing = jnp.abs(sample["v"]) < STANDSTILL if "v" in sample else False
    locked = sample["sigma_x"] > LOCKED_SLIP if "sigma_x" in sample else False
    if "omega" in sample:
        locked |= sample["omega"] <= 0
    reason = flag_of(*reasons)
    # Missing values do not matter for a locked wheel, whose force does not depend on the
    # slip. At standstill no slip is missing and no wheel counts as locked.
    reason = jnp.where(locked & ~back, flag_of((locked, Flag.LOCKED)), reason)
    return jnp.where(standing & ~back, flag_of((standing, Flag.STANDSTILL)), reason)


def _all_finite(inner: Any, began: Any) -> Bool[Array, ""]:
    """Whether a state is finite, except where its initial state is not."""
    leaves = zip(jax.tree.leaves(inner), jax.tree.leaves(began), strict=True)
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(a) | jnp.isnan(b)) for a, b in leaves]))


@jax.jit
def _scan(
    estimator: AbstractEstimator, state: Guarded, log: Mapping[str, Array]
) -> tuple[list[Array], list[Array]]:
    """Scan columns (m, _CHUNK); returns leaves of the state and arrays (m _CHUNK, ...).

    A scan over chunks, each of which is a scan, with the same steps as a single scan.
    """

    def step(state: Guarded, sample: Sample) -> tuple[Guarded, Estimate]:
        return guarded_step(estimator, state, sample)

    state, estimates = jax.lax.scan(
        lambda state, chunk: jax.lax.scan(step, state, chunk), state, log
    )
    flat = [part.reshape(-1, *part.shape[2:]) for part in jax.tree.leaves(estimates)]
    return jax.tree.leaves(state), flat


def run(
    estimator: AbstractEstimator,
    log: Mapping[str, Float[Array | np.ndarray, " n"]],
    state: Guarded | None = None,
) -> tuple[Guarded, Estimate]:
    """An estimator over a whole log.

    Args:
        estimator: any of :data:`tirefit.online.methods.METHODS`.
        log: canonical columns (n,), as for :func:`guarded_step`; others are ignored.
        state: the state from which to continue; that of :func:`start` if None.

    Returns:
        The state after the last row, and the estimates of all rows (n, ...), NumPy.
    """
    names = dict.fromkeys((*GUARDED, *estimator.method.inputs))
    columns = {name: np.asarray(log[name], float) for name in names if name in log}
    n = len(columns["time"])
    if state is None:
        state = start(estimator)
        if "run" in columns and n and np.all(columns["run"] == columns["run"][0]):
            # A single run from the start; checking for further ones costs a third more.
            state = state._replace(run=jnp.asarray(columns.pop("run")[0]))
    size = padded_size(n, 1024)
    # Rows without time and in the same run have no effect in any method.
    last = {"run": columns["run"][-1]} if "run" in columns and n else {}
    padded = {
        name: np.append(column, np.full(size - n, last.get(name, np.nan)))
        for name, column in columns.items()
    }
    chunks = {name: column.reshape(-1, _CHUNK) for name, column in padded.items()}
    leaves, parts = _scan(estimator, state, chunks)
    after = jax.tree.unflatten(jax.tree.structure(state), leaves)
    return after, Estimate(*(np.asarray(part)[:n] for part in parts))


_step = eqx.filter_jit(guarded_step)


class Stream:
    """An estimator that takes samples as they come; compiled once.

    stream = Stream(estimator_of("rls", 27e3))
    estimate = stream.push({"time": 0.0, "sigma_x": 0.01, "fx": 4e3, "fz": 27e3})
    """

    def __init__(self, estimator: AbstractEstimator):
        self.estimator = estimator
        self.state = start(estimator)

    def push(self, sample: Mapping[str, float]) -> Estimate:
        """The estimate after the next sample, which must have the same columns."""
        names = dict.fromkeys((*GUARDED, *self.estimator.method.inputs))
        row = {k: np.asarray(sample[k], float) for k in names if k in sample}
        self.state, estimate = _step(self.estimator, self.state, row)
        return estimate
