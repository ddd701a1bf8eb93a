"""Quantities that follow from the parameters, with their uncertainty.

Without a posterior the interval of a quantity is that of its profile likelihood: the
range of its values over all parameters whose deviance is below the 95 % level. For a
function of one parameter it is the interval of that parameter, transformed.

A quantity of per-run parameters has one value per run, ``F_max[run]``. If the runs were
held at different loads or speeds, like bins of a rig, it is evaluated at those of its
run; otherwise at those of the file, so that runs can be compared.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tirefit.arrays import Numbers, Scalar
from tirefit.compiled import BRIEF
from tirefit.fitting.problem.layout import Layout
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP, FitProblem
from tirefit.fitting.result import Estimate
from tirefit.fitting.solve.multistart import Solved
from tirefit.fitting.uncertainty.extremes import extreme
from tirefit.fitting.uncertainty.profile import Profile
from tirefit.models import TireInputs
from tirefit.models.base import AbstractTire
from tirefit.padding import pad_rows, padded_size
from tirefit.params import Values, with_values

Evaluator = Callable[[np.ndarray], dict[str, np.ndarray]]
"""z (m, p) -> quantity -> values (m,)."""

LARGEST_SLIP = 3.0
_AT_ONCE = 8
_GRID = np.append(0.0, np.geomspace(1e-5, LARGEST_SLIP, 199))
"""Number of slips at which the peak is searched, and how many are evaluated together."""

_NARROWED = 16  # rounds of refinement, to 1e-15 of the distance of two of them


def quantity_of(label: str) -> str:
    """The derived quantity of a label: ``F_max`` for ``F_max[run]``."""
    return label.partition("[")[0]


def derived_channel(forces: Sequence[str]) -> str | None:
    """The fitted force of the derived quantities; None if only a moment is fitted."""
    return next((name for name in ("fx", "fy") if name in forces), None)


def quantities(channel: str, has_peak: bool = True) -> dict[str, tuple[str, str]]:
    """Derived quantity of fx or fy -> (unit, meaning), in the order of the report."""
    slope, unit, slip = {"fx": ("C_x", "N", "sigma_x"), "fy": ("C_alpha", "N/rad", "tan(alpha)")}[
        channel
    ]
    largest = "peak force" if has_peak else f"no peak: force at slip {LARGEST_SLIP:g}"
    return {
        slope: (unit, "slope at zero slip"),
        "F_max": ("N", largest),
        "F_max_over_fz": ("-", f"{largest} / load"),
        "mu_fz": ("N", "static mu x load"),
        "slip_at_peak": ("-", f"{slip} at peak"),
    }


def reference_point(problem: FitProblem, run: int | None = None) -> dict[str, float]:
    """Median load [N] and speed [m/s] of the fitted rows.

    Args:
        run: code of a run. The median of its rows is used if 90 % of them are closer to
            it than it is to the median of all rows.
    """
    point, here = {}, problem.used(problem.rows.run) == run
    for name in ("fz", "v"):
        values = problem.used(getattr(problem.rows.inputs, name))
        point[name] = float(np.median(values))
        if here.any():
            of_run = float(np.median(values[here]))
            stray = np.quantile(np.abs(values[here] - of_run), 0.9)
            point[name] = of_run if stray < abs(of_run - point[name]) else point[name]
    return point


def reference_points(problem: FitProblem) -> dict[str, float]:
    """Load and speed of the derived quantities; ``fz[run]`` and ``v[run]`` for runs with
    per-run parameters that were held at other values."""
    shared = reference_point(problem)
    is_per_run = problem.layout.is_sparse
    return shared | {
        f"{name}[{run}]": value
        for code, run in enumerate(problem.layout.runs if is_per_run else ())
        for name, value in reference_point(problem, code).items()
        if value != shared[name]
    }


def _curve(
    model: AbstractTire, values: Mapping[str, Numbers], channel: str, fz: Scalar, v: Scalar
) -> Callable[[Array], Array]:
    tire, slip_name = with_values(model, values), CHANNEL_SLIP[channel]

    def force(slip: Array) -> Array:
        if slip_name == "alpha":
            slip = jnp.arctan(slip)
        inputs = TireInputs(fz=fz, v=v)._replace(**{slip_name: slip})
        return getattr(tire(inputs), channel)

    return force


def _start_and_peak(force: Callable[[Array], Array]) -> tuple[Array, Array, Array]:
    """Slope at zero slip; (slip, force) of the first maximum, by a grid, then slope.

    The beginning of a plateau is flat to the third order, so values would give its slip
    only to 1e-4; the sign of the slope gives it to rounding. One loop does both, with a
    few slips at a time, so that the force is compiled only once.
    """

    def with_slope(slip: Array) -> tuple[Array, Array]:
        return jax.jvp(force, (slip,), (jnp.ones_like(slip),))

    grid, last = jnp.asarray(_GRID), len(_GRID) - 1
    rounds = len(_GRID) // _AT_ONCE
    parts = jnp.arange(1, _AT_ONCE + 1) / (_AT_ONCE + 1)

    def tabled(k: Array, state: Any, there: Array, slopes: Array, slips: Array) -> Any:
        values, start, bracket = state
        values = jax.lax.dynamic_update_slice(values, there, (k * _AT_ONCE,))
        return values, jnp.where(k == 0, slopes[0], start), bracket

    def narrowed(k: Array, state: Any, there: Array, slopes: Array, slips: Array) -> Any:
        values, start, (low, high, value) = state
        # Three times the rounding of a zero slope: 7e-8 of the slip of full sliding.
        falls = jnp.append(slopes <= 5e-16 * start, True)
        ends = jnp.argmax(falls)
        lows, highs = jnp.append(low, slips), jnp.append(slips, high)
        return values, start, (lows[ends], highs[ends], jnp.append(there, value)[ends])

    def around(values: Array) -> tuple[Array, Array, Array]:
        first = jnp.argmax(values >= values.max() * (1 - 1e-12))
        end = jnp.minimum(first + 1, last)
        return grid[jnp.maximum(first - 1, 0)], grid[end], values[end]

    def look(k: Array, state: Any) -> Any:
        # Only one branch runs, as k is the same for all parameter vectors.
        values, start, bracket = state
        low, high, value = bracket = jax.lax.cond(
            k == rounds, lambda: around(values), lambda: bracket
        )
        slips = jax.lax.cond(
            k < rounds,
            lambda: jax.lax.dynamic_slice(grid, (k * _AT_ONCE,), (_AT_ONCE,)),
            lambda: low + parts * (high - low),
        )
        there, slopes = jax.vmap(with_slope)(slips)
        state = values, start, bracket
        return jax.lax.cond(k < rounds, tabled, narrowed, k, state, there, slopes, slips)

    nothing = jnp.zeros(())
    _, start, (_, slip, peak) = jax.lax.fori_loop(
        0,
        rounds + _NARROWED,
        look,
        (jnp.full(len(_GRID), -jnp.inf), nothing, (nothing, nothing, nothing)),
    )
    # A force that still rises at the largest slip has no peak.
    return start, jnp.where(slip < 0.999 * LARGEST_SLIP, slip, jnp.nan), peak


@partial(jax.jit, static_argnames=("layout", "channel"), compiler_options=BRIEF)
def derived_values(
    model: AbstractTire,
    layout: Layout,
    z: Float[Values, "n p"],
    channel: str,
    fz: Scalar,
    v: Scalar,
    run: Int[Values, ""] | int = 0,
) -> dict[str, Float[Array, " n"]]:
    """Derived quantities of a batch of parameter vectors.

    Args:
        z: unconstrained parameters, shape (m, p).
        channel: fx or fy.
        fz, v: reference load [N] and speed [m/s].
        run: code of the run whose parameters are used if they are per run.

    Returns:
        dict of arrays (m,) by name of :func:`quantities`. ``slip_at_peak`` is sigma for
        the longitudinal, tan(alpha) for the lateral force; NaN without a peak. ``mu_fz``
        is missing if the model has no static friction.
    """

    def derive_one(z: Array) -> dict[str, Scalar]:
        values = {
            name: jnp.asarray(value)[jnp.asarray(run)] if jnp.ndim(value) else value
            for name, value in layout.natural(z).items()
        }
        force = _curve(model, values, channel, fz, v)
        slope, slip, peak = _start_and_peak(force)
        derived: dict[str, Scalar] = {
            next(iter(quantities(channel))): slope,
            "F_max": peak,
            "F_max_over_fz": peak / fz,
            "slip_at_peak": slip,
        }
        mu = with_values(model, values).static_friction(fz)
        if mu is not None:
            derived["mu_fz"] = mu * fz
        return derived

    return jax.lax.map(derive_one, z, batch_size=1024)  # 64: 2.5 times as long


def _evaluator(problem: FitProblem, channel: str, run: int | None) -> Evaluator:
    """z (m, p) -> quantity -> values (m,) of a run at its reference point, in order.

    Vectors that differ only in elements of other runs are evaluated once.
    """
    at = reference_point(problem, run)
    elements = problem.layout.elements_of(np.array([run or 0]))[0]

    def evaluate(z: np.ndarray) -> dict[str, np.ndarray]:
        _, first, code = np.unique(z[:, elements], axis=0, return_index=True, return_inverse=True)
        derived = derived_values(
            problem.model,
            problem.layout,
            pad_rows(z[first], padded_size(len(first))),
            channel,
            at["fz"],
            at["v"],
            run or 0,
        )
        names = [name for name in quantities(channel) if name in derived]
        return {name: np.asarray(derived[name])[code.ravel()] for name in names}

    return evaluate


def _slope_of(
    evaluate: Evaluator, name: str, z: np.ndarray, std: np.ndarray
) -> tuple[float, np.ndarray]:
    """A quantity at z and its slope (p,), by central differences."""
    steps = np.diag(np.clip(1e-2 * std, 1e-4, 1e-2))
    values = evaluate(np.concatenate([z[None], z + steps, z - steps]))[name]
    up, down = np.split(values[1:], 2)
    return values[0], (up - down) / (2 * np.diag(steps))


def _ends(*values: float) -> tuple[float | None, float | None]:
    """The smallest and the largest value; None if an end is unknown."""
    if np.all(np.isfinite(values)):
        values = tuple(sorted(values))
    low, high = (float(end) if np.isfinite(end) else None for end in values)
    return low, high


def _says_something(ci95: tuple[float | None, float | None]) -> bool:
    """Whether an interval is closed, and less than a factor of three wide."""
    low, high = ci95
    return low is not None and high is not None and 0 < low and high <= 3 * low


def _moved(
    evaluate: Evaluator, z: np.ndarray, low: np.ndarray, high: np.ndarray
) -> dict[str, tuple[float, np.ndarray]]:
    """Quantity -> (value at z, values (2, p) with one element moved to either end)."""
    size = len(z)
    batch = np.tile(z, (2 * size + 1, 1))
    batch[np.arange(1, size + 1), np.arange(size)] = low
    batch[np.arange(size + 1, 2 * size + 1), np.arange(size)] = high
    return {k: (v[0], v[1:].reshape(2, size)) for k, v in evaluate(batch).items()}


def derived_from_profile(
    solved: Solved,
    profiles: Sequence[Profile] = (),
    estimates: Sequence[Estimate] = (),
    only: Collection[str] = (),
) -> dict[str, Estimate]:
    """Derived quantities at the least-squares estimate, with profile intervals.

    Args:
        profiles, estimates: of every element of z, in order; without them, the interval of a
            quantity of one element is searched like the others.
        only: quantities to compute; all if empty.

    Returns:
        By name, or by ``name[run]`` if runs differ; in the order of the report, with the
        runs of a quantity together.
    """
    problem = solved.problem
    channel = derived_channel([c.name for c in problem.channels])
    if channel is None:
        return {}
    ends = None
    if profiles:
        low = [-np.inf if p.open_low else p.low for p in profiles]
        high = [np.inf if p.open_high else p.high for p in profiles]
        ends = np.array(low), np.array(high)
    per_run = np.array([p.per_run for _, p in problem.layout.elements])
    derived: dict[str, Estimate] = {}
    for code, run in [(None, ""), *enumerate(problem.layout.runs if per_run.any() else ())]:
        part = _of_run(solved, channel, code, ends, estimates, per_run, only)
        for name, estimate in part:
            derived[name if code is None else f"{name}[{run}]"] = estimate
    order = list(quantities(channel))
    by_quantity = sorted(derived, key=lambda label: order.index(quantity_of(label)))
    return {label: derived[label] for label in by_quantity}


def _of_run(
    solved: Solved,
    channel: str,
    run: int | None,
    ends: tuple[np.ndarray, np.ndarray] | None,
    estimates: Sequence[Estimate],
    per_run: np.ndarray,
    only: Collection[str] | None,
) -> Iterator[tuple[str, Estimate]]:
    """(quantity, estimate) of the quantities that depend on a per-run element (``per_run``
    (p,)), or of the other quantities if ``run`` is None; ``ends`` (low, high) are those
    of every element (p,), None if not known."""
    z, (low, high) = solved.z, ends or (solved.z, solved.z)
    evaluate = _evaluator(solved.problem, channel, run)
    mapped = _moved(evaluate, z, low, high)
    # Intervals at rounding level would hide the elements that a quantity depends on.
    apart = _moved(evaluate, z, np.minimum(low, z - 0.01), np.maximum(high, z + 0.01))
    for name, (value, moved) in apart.items():
        value, unit = float(value), quantities(channel)[name][0]
        same = np.abs(moved - value) <= 1e-7 * abs(value)
        involved = np.flatnonzero(~same.all(axis=0))
        if name == "F_max_over_fz" or per_run[involved].any() == (run is None):
            continue
        if only and name not in only:
            continue
        if not np.isfinite(value):
            estimate = Estimate(value, None, unit, (None, None), identified=False)
        elif len(involved) == 0:
            estimate = Estimate(value, None, unit, (None, None), fixed=True)
        else:
            of_one = mapped[name][1][:, involved[0]] if ends and len(involved) == 1 else None
            parts = [estimates[int(i)] for i in involved] if ends else []
            estimate = _estimate(solved, evaluate, name, unit, parts, of_one)
        yield name, estimate
        if name == "F_max":
            fz = reference_point(solved.problem, run)["fz"]
            ends_std = (*estimate.ci95, estimate.std)
            least, most, std = (None if number is None else number / fz for number in ends_std)
            share = replace(estimate, value=value / fz, std=std, unit="-", ci95=(least, most))
            yield "F_max_over_fz", share


def _estimate(
    solved: Solved,
    evaluate: Evaluator,
    name: str,
    unit: str,
    known: Sequence[Estimate],
    ends: np.ndarray | None,
) -> Estimate:
    """One quantity of the elements ``known``; ``ends`` if it depends on only one."""
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
        ci95 = _ends(*(extreme(solved, quantity, sign) for sign in (-1, 1)))
        identified = _says_something(ci95)
        noise = solved.of_noise
        if not identified and noise is not None:  # misfit may widen the interval
            half = np.sqrt(solved.level * (slope @ noise @ slope))
            identified = _says_something((value - half, value + half))
    low, high = ci95
    if low is not None and high is not None and any(estimate.std is None for estimate in known):
        # The covariance does not determine it: use the width of the profile.
        std = (high - low) / (2 * float(np.sqrt(solved.level)))
    return Estimate(float(value), std if identified else None, unit, ci95, identified)


_BLOCK = 4096


def derived_from_draws(
    problem: FitProblem, z_draws: np.ndarray, least_squares: dict[str, Estimate]
) -> dict[str, Estimate]:
    """Derived quantities of posterior draws: median, spread and central 95 %.

    Args:
        z_draws: draws of the unconstrained parameters, shape (m, p).
        least_squares: estimates by least squares, which show what the data identify.
    """
    channel = derived_channel([c.name for c in problem.channels])
    if channel is None or not least_squares:
        return {}
    # Blocks of the same size need one program for any number of draws.
    count, blocks = len(z_draws), -(-len(z_draws) // _BLOCK)
    padded = np.resize(z_draws, (blocks * _BLOCK, z_draws.shape[1]))
    derived: dict[str, Estimate] = {}
    for code, run in [(None, ""), *enumerate(problem.layout.runs)]:
        ending = "" if code is None else f"[{run}]"
        asked = {
            name: f"{name}{ending}"
            for name in map(quantity_of, least_squares)
            if f"{name}{ending}" in least_squares
        }
        if asked:
            evaluate = _evaluator(problem, channel, code)
            parts = [evaluate(block) for block in np.split(padded, blocks)]
        for name, label in asked.items():
            known = derived[label] = least_squares[label]
            if known.fixed:
                continue
            draws = np.concatenate([part[name] for part in parts])[:count]
            defined = draws[np.isfinite(draws)]
            if len(defined) > 0.975 * count:
                derived[label] = Estimate.of_draws(defined, known.unit, known.identified)
            else:
                derived[label] = Estimate(np.nan, None, known.unit, (None, None), identified=False)
    return {label: derived[label] for label in least_squares}
