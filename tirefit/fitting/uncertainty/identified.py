"""Estimates of the parameters of a solved problem, and what the data identify of them."""

import numpy as np

from tirefit.fitting.result import Estimate
from tirefit.fitting.solve.inference import half_width_95
from tirefit.fitting.solve.multistart import Solved
from tirefit.fitting.uncertainty.profile import Profile
from tirefit.params import Spec, constrain, log_jacobian


def limited(spec: Spec, low: float, high: float) -> bool:
    """Whether an interval, which ends at a bound where it is open, limits the parameter.

    It does not if it is open on both sides; or open on one side and wider than half
    of the allowed range; or wider than 0.8 of the range; or, for a positive quantity, if
    its ends differ by a factor of ten (three for a friction coefficient).
    """
    open_ends = int(low <= spec.lower) + int(high >= spec.upper)
    if spec.scale == "log":
        return open_ends == 0 and high / low <= 10
    if spec.lower > 0 and high / low > 3:
        return False
    return open_ends < 2 and (high - low) / (spec.upper - spec.lower) <= (0.8, 0.5)[open_ends]


def profile_estimates(
    solved: Solved, profiles: list[Profile]
) -> tuple[dict[str, Estimate], dict[str, tuple[float | None, float | None]]]:
    """Least-squares estimates with profile intervals, and covariance intervals.

    A parameter is identified if its profile interval is limited.
    """
    estimates = {}
    by_covariance: dict[str, tuple[float | None, float | None]] = {}
    dof = max(solved.n_effective - solved.problem.layout.size, 1.0)
    quantile = half_width_95(solved.problem.noise_estimated, dof)
    for i, (label, parameter) in enumerate(solved.problem.layout.elements):
        spec, z = parameter.spec, solved.z[i]
        value, slope = float(constrain(z, spec)), float(np.exp(log_jacobian(z, spec)))
        std = slope * float(np.sqrt(solved.covariance[i, i]))
        profile = profiles[i]
        low = spec.lower if profile.open_low else float(constrain(profile.low, spec))
        high = spec.upper if profile.open_high else float(constrain(profile.high, spec))
        is_limited = limited(spec, low, high)
        known = is_limited and not at_bound(spec, value)
        ends = low, high
        estimates[label] = Estimate(value, std if known else None, spec.unit, ends, is_limited)
        by_covariance[label] = (value - quantile * std, value + quantile * std)
    return estimates, by_covariance


def at_bound(spec: Spec, value: float) -> bool:
    """Whether a fitted value lies at a bound of its parameter."""
    if spec.scale == "log":
        return not spec.lower * 1.01 < value < spec.upper / 1.01
    margin = 1e-3 * (spec.upper - spec.lower)
    return not spec.lower + margin < value < spec.upper - margin


def labels_at_bound(solved: Solved) -> tuple[str, ...]:
    """Labels of the elements of z whose estimates lie at a bound."""
    elements = enumerate(solved.problem.layout.elements)
    return tuple(
        k for i, (k, p) in elements if at_bound(p.spec, float(constrain(solved.z[i], p.spec)))
    )


def minus_two_log_likelihood(solved: Solved) -> float:
    """-2 log likelihood of all rows as if independent, at the noise scales in use."""
    problem, total = solved.problem, 0.0
    for name in problem.rules:
        block = solved.at.values[name]
        for channel in problem.block_channels(name):
            scale = problem.used(problem.rows.scale[channel.name])
            total += float(np.sum(np.log(2 * np.pi * scale**2)))
        total += float(np.sum(solved.at.unlikely[name] if name in solved.at.unlikely else block**2))
    return total
