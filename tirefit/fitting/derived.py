"""Quantities that follow from the parameters, with their uncertainty.

Without a posterior the interval of a quantity is that of its profile likelihood: the
range of its values over all parameters whose deviance stays below the 95 % level. Of
one parameter alone it is that parameter's own interval, mapped.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import expit, logit

from tirefit.compiled import compiled
from tirefit.fitting.inference import deviance_at, inflation, linearise
from tirefit.fitting.layout import Layout
from tirefit.fitting.likelihood import CHANNEL_SLIP, FitProblem
from tirefit.fitting.profile import Profile
from tirefit.fitting.result import Estimate
from tirefit.fitting.solve import Solved
from tirefit.models import TireInputs
from tirefit.params import with_values

__all__ = [
    "derived_channel",
    "derived_from_draws",
    "derived_from_profile",
    "derived_values",
    "quantities",
    "reference_point",
]

_LARGEST_SLIP = 3.0
_AT_ONCE = 8
_GRID = np.append(0.0, np.geomspace(1e-5, _LARGEST_SLIP, 199))
"""Slips among which the peak is looked for, a whole number of times so many at once."""

_NARROWED = 16
"""Rounds that narrow it to 1e-15 of the distance of two of them."""


def derived_channel(forces: Sequence[str]) -> str | None:
    """The fitted force that the derived quantities are of; None for a moment alone."""
    return next((name for name in ("fx", "fy") if name in forces), None)


def quantities(channel: str) -> dict[str, tuple[str, str]]:
    """Derived quantity of fx or fy -> (unit, meaning), in the order of the report."""
    slope, unit, slip = {
        "fx": ("C_x", "N", "sigma_x"),
        "fy": ("C_alpha", "N/rad", "tan(alpha)"),
    }[channel]
    return {
        slope: (unit, "slope at zero slip"),
        "F_max": ("N", "peak force"),
        "F_max_over_fz": ("-", "peak force / load"),
        "mu_fz": ("N", "static mu x load"),
        "slip_at_peak": ("-", f"{slip} at peak"),
    }


def reference_point(problem: FitProblem) -> dict[str, float]:
    """Median load [N] and speed [m/s] of the fitted rows."""
    fz = problem.used(problem.rows.inputs.fz)
    v = problem.used(problem.rows.inputs.v)
    return {"fz": float(np.median(fz)), "v": float(np.median(v))}


def _curve(model, values, channel: str, fz, v):
    tire, slip_name = with_values(model, values), CHANNEL_SLIP[channel]

    def force(slip):
        if slip_name == "alpha":
            slip = jnp.arctan(slip)
        inputs = TireInputs(fz=fz, v=v)._replace(**{slip_name: slip})
        return getattr(tire(inputs), channel)

    return force


def _start_and_peak(force):
    """Slope at zero slip, and (slip, force) of the first largest force: a grid, then
    where the slope ends.

    A plateau is flat to the third order where it begins, so values alone would give
    its slip to 1e-4; the sign of the slope gives it to rounding. One loop serves both,
    a few slips at a time: the force is what takes time to compile, and stands in the
    program once.
    """

    def with_slope(slip):
        return jax.jvp(force, (slip,), (jnp.ones_like(slip),))

    grid, last = jnp.asarray(_GRID), len(_GRID) - 1
    rounds = len(_GRID) // _AT_ONCE
    parts = jnp.arange(1, _AT_ONCE + 1) / (_AT_ONCE + 1)

    def look(k, state):
        values, start, (low, high, value) = state
        tabled = jax.lax.dynamic_slice(grid, (k * _AT_ONCE,), (_AT_ONCE,))
        slips = jnp.where(k < rounds, tabled, low + parts * (high - low))
        there, slopes = jax.vmap(with_slope)(slips)
        start = jnp.where(k == 0, slopes[0], start)
        values = jnp.where(
            k < rounds,
            jax.lax.dynamic_update_slice(values, there, (k * _AT_ONCE,)),
            values,
        )
        first = jnp.argmax(values >= values.max() * (1 - 1e-12))
        end = jnp.minimum(first + 1, last)
        around = grid[jnp.maximum(first - 1, 0)], grid[end], values[end]
        # Thrice the rounding of a slope of zero: 7e-8 of the slip of full sliding.
        falls = jnp.append(slopes <= 5e-16 * start, True)
        ends = jnp.argmax(falls)
        lows, highs = jnp.append(low, slips), jnp.append(slips, high)
        narrowed = lows[ends], highs[ends], jnp.append(there, value)[ends]
        bracket = jax.tree.map(
            lambda a, b: jnp.where(k < rounds, a, b), around, narrowed
        )
        return values, start, bracket

    nothing = jnp.zeros(())
    _, start, (_, slip, peak) = jax.lax.fori_loop(
        0, rounds + _NARROWED, look,
        (jnp.full(len(_GRID), -jnp.inf), nothing, (nothing, nothing, nothing)),
    )  # fmt: skip
    # A force that still rises at the largest slip has no peak.
    return start, jnp.where(slip < 0.999 * _LARGEST_SLIP, slip, jnp.nan), peak


@compiled(static=("layout", "channel", "run"), brief=True)
def derived_values(model, layout: Layout, z, channel, fz, v, run: int = 0):
    """Derived quantities of a batch of parameter vectors.

    Args:
        z: unconstrained parameters, shape (m, p).
        channel: fx or fy.
        fz, v: reference load [N] and speed [m/s].
        run: the run whose parameters count where they are per run.

    Returns:
        dict of arrays (m,) by name of :func:`quantities`. ``slip_at_peak`` is sigma for
        the longitudinal, tan(alpha) for the lateral force; NaN where there is no peak.
        ``mu_fz`` is missing where the model has no static friction.
    """

    def one(z):
        values = {
            name: value[run] if jnp.ndim(value) else value
            for name, value in layout.natural(z).items()
        }
        force = _curve(model, values, channel, fz, v)
        slope, slip, peak = _start_and_peak(force)
        derived = {
            next(iter(quantities(channel))): slope,
            "F_max": peak,
            "F_max_over_fz": peak / fz,
            "slip_at_peak": slip,
        }
        mu = with_values(model, values).static_friction(fz)
        if mu is not None:
            derived["mu_fz"] = mu * fz
        return derived

    return jax.lax.map(one, z, batch_size=64)


def _evaluator(problem: FitProblem, channel: str) -> Callable:
    """z (m, p) -> quantity -> values (m,), at the reference point, in order."""
    at = reference_point(problem)

    def evaluate(z):
        derived = derived_values(
            problem.model, problem.layout, z, channel, at["fz"], at["v"]
        )
        return {k: np.asarray(derived[k]) for k in quantities(channel) if k in derived}

    return evaluate


def _bowl(solved: Solved, z):
    """Deviance at z, half its slope (p,), and half its curvature (p, p)."""
    problem = solved.problem
    at = linearise(problem, z)
    slope, curvature = np.zeros(len(z)), np.zeros((len(z), len(z)))
    for name, slopes in at.slopes.items():
        values, slopes = np.asarray(at.values[name]), np.asarray(slopes)
        weight = 1 / inflation(problem, name)
        if name in problem.rules and problem.rules[name].smallest > 0:
            weight = problem.rules[name].effective / (values @ values)
        slope += weight * (values @ slopes)
        curvature += weight * (slopes.T @ slopes)
    return deviance_at(problem, at), slope, curvature


def _slope_of(evaluate: Callable, name: str, z, std):
    """A quantity at z and its slope (p,), by central differences."""
    steps = np.diag(np.clip(1e-2 * std, 1e-4, 1e-2))
    values = evaluate(np.concatenate([z[None], z + steps, z - steps]))[name]
    up, down = np.split(values[1:], 2)
    return values[0], (up - down) / (2 * np.diag(steps))


_NEXT_TO_BOUND = 1e-9

_LONGEST_SHARE = 0.3
"""Share of an element's range that one step may cross."""


def _step(slope, pull, curvature, room: float, share):
    """The step (p,) of :func:`_extreme` from shares at (p,).

    An element at its bound that would go on is held there.
    """
    free, step = np.ones(len(share), bool), np.zeros(len(share))
    for _ in range(2):
        inverse = np.linalg.pinv(curvature[np.ix_(free, free)], hermitian=True)
        left = room + slope[free] @ inverse @ slope[free]
        reach = pull[free] @ inverse @ pull[free]
        size = np.sqrt(max(left, 0.0) / max(reach, 1e-300))
        step[free] = inverse @ (size * pull - slope)[free]
        free = _inside(share + step) != share
        step[~free] = 0.0
    return step


def _inside(share):
    return np.clip(share, _NEXT_TO_BOUND, 1 - _NEXT_TO_BOUND)


def _extreme(solved: Solved, quantity: Callable, sign: int) -> float:
    """Largest (sign 1) or smallest (-1) value of a quantity within the 95 % region.

    Venzon and Moolgavkar's iteration (Applied Statistics 37, 1988) for a function of
    the parameters: where the deviance is a parabola and the quantity straight, one
    step is exact. Taken in shares of each element's range, where a bound is a place
    and not infinity. NaN where it does not settle.
    """
    level, fixed = solved.level, np.linalg.inv(solved.covariance)
    share = _inside(expit(solved.z))
    here = _bowl(solved, logit(share))
    base, before, damping = here[0], np.inf, 1.0
    for _ in range(60):
        total, slope, curvature = here
        scale = share * (1 - share)
        value, pull = quantity(logit(share))
        # Rows with slip noise are no squares: their curvature is the estimate's.
        curvature = fixed if solved.problem.rows.nodes else curvature
        step = _step(
            slope / scale, sign * pull / scale, curvature / np.outer(scale, scale),
            level - total + base, share,
        )  # fmt: skip
        length = float((step / scale) @ curvature @ (step / scale))
        if not np.isfinite(length):
            break
        if length < 1e-6 * level and abs(total - base - level) < 1e-2 * level:
            return float(value)
        # Next to a bound the deviance may have no curvature to hold a step back.
        step *= min(1.0, _LONGEST_SHARE / max(np.max(np.abs(step)), 1e-300))
        damping = damping / 2 if length > before else min(1.0, 1.5 * damping)
        before, start = length, share
        # Never far outside the region: beyond it lie other valleys.
        while damping > 1e-4:
            share = _inside(start + damping * step)
            here = _bowl(solved, logit(share))
            if here[0] - base < 2 * level:
                break
            damping /= 2
        else:
            break
    return float("nan")


def _ends(*values: float) -> tuple[float | None, float | None]:
    """The smallest and the largest; None where an end is not known."""
    low, high = sorted(values) if np.all(np.isfinite(values)) else values
    return _known(low), _known(high)


def _known(end: float) -> float | None:
    return float(end) if np.isfinite(end) else None


def _says_something(ci95) -> bool:
    """Whether an interval is closed, and less than a factor of three wide."""
    low, high = ci95
    return low is not None and high is not None and 0 < low and high <= 3 * low


def _with_ratio(derived: dict[str, Estimate], names, fz: float) -> dict[str, Estimate]:
    """The estimates in order, with that of the peak over the load."""
    peak = derived["F_max"]
    low, high = peak.ci95
    derived["F_max_over_fz"] = replace(
        peak, value=peak.value / fz, std=None if peak.std is None else peak.std / fz,
        unit="-",
        ci95=(None if low is None else low / fz, None if high is None else high / fz),
    )  # fmt: skip
    return {name: derived[name] for name in names if name in derived}


def _moved(evaluate: Callable, z, low, high):
    """Quantity -> (value at z, values (2, p) with one element moved to either end)."""
    size = len(z)
    batch = np.tile(z, (2 * size + 1, 1))
    batch[np.arange(1, size + 1), np.arange(size)] = low
    batch[np.arange(size + 1, 2 * size + 1), np.arange(size)] = high
    return {k: (v[0], v[1:].reshape(2, size)) for k, v in evaluate(batch).items()}


def derived_from_profile(
    solved: Solved, profiles: Sequence[Profile], estimates: Sequence[Estimate]
) -> dict[str, Estimate]:
    """Derived quantities at the least-squares estimate, with profile intervals.

    Args:
        profiles, estimates: of every element of z, in order.
    """
    problem, z = solved.problem, solved.z
    channel = derived_channel([c.name for c in problem.channels])
    if channel is None:
        return {}
    evaluate, units = _evaluator(problem, channel), quantities(channel)
    low = np.array([-np.inf if p.open_low else p.low for p in profiles])
    high = np.array([np.inf if p.open_high else p.high for p in profiles])
    mapped = _moved(evaluate, z, low, high)
    # Ends at rounding level would hide which elements a quantity depends on.
    apart = _moved(evaluate, z, np.minimum(low, z - 0.01), np.maximum(high, z + 0.01))
    derived = {}
    for name, (value, moved) in apart.items():
        if name == "F_max_over_fz":
            continue
        value, unit = float(value), units[name][0]
        same = np.abs(moved - value) <= 1e-7 * abs(value)
        involved = np.flatnonzero(~same.all(axis=0))
        if not np.isfinite(value):
            derived[name] = Estimate(value, None, unit, (None, None), identified=False)
        elif len(involved) == 0:
            derived[name] = Estimate(value, None, unit, (None, None), fixed=True)
        else:
            ends = mapped[name][1][:, involved[0]] if len(involved) == 1 else None
            known = [estimates[int(i)] for i in involved]
            derived[name] = _estimate(solved, evaluate, name, unit, known, ends)
    return _with_ratio(derived, units, reference_point(problem)["fz"])


def _estimate(solved: Solved, evaluate, name: str, unit: str, known, ends) -> Estimate:
    """One quantity of the elements ``known``; ``ends`` where it is of one alone."""
    spread = np.sqrt(np.diag(solved.covariance))
    quantity = partial(_slope_of, evaluate, name, std=spread)
    value, slope = quantity(solved.z)
    std = float(np.sqrt(slope @ solved.covariance @ slope))
    if ends is not None:
        ci95 = _ends(*ends)
        identified = known[0].identified
    elif std < 1e-6 * abs(value):
        half = np.sqrt(solved.level) * std
        ci95, identified = _ends(value - half, value + half), True
    else:
        ci95 = _ends(*(_extreme(solved, quantity, sign) for sign in (-1, 1)))
        identified = _says_something(ci95)
    sure = identified and all(one.std is not None for one in known)
    return Estimate(float(value), std if sure else None, unit, ci95, identified)


_BLOCK = 4096


def derived_from_draws(
    problem: FitProblem, z_draws, least_squares: dict[str, Estimate]
) -> dict[str, Estimate]:
    """Derived quantities of posterior draws: median, spread and central 95 %.

    Args:
        z_draws: draws of the unconstrained parameters, shape (m, p).
        least_squares: the same at the least-squares estimate, which says what the data
            identify.
    """
    channel = derived_channel([c.name for c in problem.channels])
    if channel is None or not least_squares:
        return {}
    evaluate = _evaluator(problem, channel)
    # Blocks of one size: one program, however many draws there are.
    count, blocks = len(z_draws), -(-len(z_draws) // _BLOCK)
    padded = np.resize(z_draws, (blocks * _BLOCK, z_draws.shape[1]))
    parts = [evaluate(block) for block in np.split(padded, blocks)]
    return {
        name: _of_draws(np.concatenate([part[name] for part in parts])[:count], before)
        for name, before in least_squares.items()
    }


def _of_draws(draws: np.ndarray, least_squares: Estimate) -> Estimate:
    if least_squares.fixed:
        return least_squares
    unit, defined = least_squares.unit, np.isfinite(draws)
    if np.mean(defined) <= 0.975:
        return Estimate(float("nan"), None, unit, (None, None), identified=False)
    return Estimate.of_draws(draws[defined], unit, least_squares.identified)
