"""Quantities that follow from the parameters, with their uncertainty.

Without a posterior the interval of a quantity is that of its profile likelihood: the
range of its values over all parameters whose deviance is below the 95 % level. For a
function of one parameter it is the interval of that parameter, transformed.

A quantity of per-run parameters has one value per run, ``F_max[run]``. If the runs were
held at different loads or speeds, like bins of a rig, it is evaluated at those of its
run; otherwise at those of the file, so that runs can be compared.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial

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
_GRID = np.append(0.0, np.geomspace(1e-5, LARGEST_SLIP, 63))
"""Slips between which the peak is searched first."""
_NARROWED = 9  # rounds of refinement, each by the number of slips: to rounding


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
    """Slope at zero slip; (slip, force) of the first maximum, where the slope ends.

    The beginning of a plateau is flat to the third order, so values would give its slip only to
    1e-4; the sign of the slope gives it to rounding. One loop does all, so that the force is
    compiled only once.
    """
    grid, parts = jnp.asarray(_GRID), jnp.arange(1, len(_GRID) + 1) / (len(_GRID) + 1)

    def narrowed(k: Array, state: tuple[Array, ...]) -> tuple[Array, ...]:
        low, high, start, peak = state
        slips = jnp.where(k == 0, grid, low + parts * (high - low))
        values, slopes = jax.vmap(lambda slip: jax.jvp(force, (slip,), (jnp.ones(()),)))(slips)
        start = jnp.where(k == 0, slopes[0], start)
        # Three times the rounding of a zero slope: 7e-8 of the slip of full sliding.
        end = jnp.argmax(jnp.append(slopes <= 5e-16 * start, True))
        values = jnp.append(values, jnp.where(k == 0, values[-1], peak))
        return jnp.append(low, slips)[end], jnp.append(slips, high)[end], start, values[end]

    nothing = jnp.zeros(())
    first = nothing, jnp.full((), LARGEST_SLIP), nothing, nothing
    _, slip, start, peak = jax.lax.fori_loop(0, 1 + _NARROWED, narrowed, first)
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


def _involved(
    evaluate: Evaluator, z: np.ndarray, low: np.ndarray, high: np.ndarray
) -> dict[str, tuple[float, np.ndarray]]:
    """Quantity -> (value at z, indices of the elements that change it)."""
    # Intervals at rounding level would hide the elements that a quantity depends on.
    ends = np.minimum(low, z - 0.01), np.maximum(high, z + 0.01)
    moved = [np.where(np.eye(len(z), dtype=bool), end, z) for end in ends]
    values = evaluate(np.concatenate([z[None], *moved]))
    changes = {k: np.abs(v[1:] - v[0]).reshape(2, -1) for k, v in values.items()}
    return {
        k: (float(v[0]), np.flatnonzero(~np.all(changes[k] <= 1e-7 * abs(v[0]), axis=0)))
        for k, v in values.items()
    }


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
    problem, z = solved.problem, solved.z
    channel = derived_channel([c.name for c in problem.channels])
    if channel is None:
        return {}
    low = np.array([-np.inf if p.open_low else p.low for p in profiles]) if profiles else z
    high = np.array([np.inf if p.open_high else p.high for p in profiles]) if profiles else z
    per_run = np.array([p.per_run for _, p in problem.layout.elements])
    derived: dict[str, Estimate] = {}
    for code, run in [(None, ""), *enumerate(problem.layout.runs if per_run.any() else ())]:
        evaluate, ending = _evaluator(problem, channel, code), "" if code is None else f"[{run}]"
        for name, (value, involved) in _involved(evaluate, z, low, high).items():
            # The quantities of a per-run element are those of its runs, the others those of all.
            if name == "F_max_over_fz" or per_run[involved].any() == (code is None):
                continue
            if only and name not in only:
                continue
            unit, known = quantities(channel)[name][0], [estimates[i] for i in involved if profiles]
            if not np.isfinite(value):
                estimate = Estimate(value, None, unit, (None, None), identified=False)
            elif len(involved) == 0:
                estimate = Estimate(value, None, unit, (None, None), fixed=True)
            else:
                ends = None
                if profiles and len(involved) == 1:
                    both = np.tile(z, (2, 1))
                    both[:, involved[0]] = low[involved[0]], high[involved[0]]
                    ends = evaluate(both)[name]
                estimate = _estimate(solved, evaluate, name, unit, known, ends)
            derived[name + ending] = estimate
            if name == "F_max":
                share = 1 / reference_point(problem, code)["fz"]
                derived["F_max_over_fz" + ending] = estimate.times(share, "-")
    order = list(quantities(channel))
    by_quantity = sorted(derived, key=lambda label: order.index(quantity_of(label)))
    return {label: derived[label] for label in by_quantity}


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
        ci95, identified = _ends(*ends), known[0].identified
    elif std < 1e-6 * abs(value):
        half = np.sqrt(solved.level) * std
        ci95, identified = _ends(value - half, value + half), True
    else:
        low, high = ci95 = _ends(*(extreme(solved, quantity, sign) for sign in (-1, 1)))
        # Closed, and less than a factor of three wide.
        identified = low is not None and high is not None and 0 < low and high <= 3 * low
    low, high = ci95
    if low is not None and high is not None and any(estimate.std is None for estimate in known):
        # The covariance does not determine it: use the width of the profile.
        std = (high - low) / (2 * float(np.sqrt(solved.level)))
    return Estimate(float(value), std if identified else None, unit, ci95, identified)


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
    derived: dict[str, Estimate] = {}
    for code, run in [(None, ""), *enumerate(problem.layout.runs)]:
        ending = "" if code is None else f"[{run}]"
        asked = {
            name: f"{name}{ending}"
            for name in map(quantity_of, least_squares)
            if f"{name}{ending}" in least_squares
        }
        if asked:
            values = _evaluator(problem, channel, code)(z_draws)
        for name, label in asked.items():
            known = derived[label] = least_squares[label]
            if known.fixed:
                continue
            defined = values[name][np.isfinite(values[name])]
            if len(defined) > 0.975 * len(z_draws):
                derived[label] = Estimate.of_draws(defined, known.unit, known.identified)
            else:
                derived[label] = Estimate(np.nan, None, known.unit, (None, None), identified=False)
    return {label: derived[label] for label in least_squares}
