"""The fitted curve at any inputs, with 95 % bands of the curve and of a measurement."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.fitting.problem.likelihood import FitProblem, moments
from tirefit.fitting.result import FitResult
from tirefit.fitting.solve.inference import half_width_95
from tirefit.models import TireInputs
from tirefit.padding import pad_rows, padded_size
from tirefit.params import Values

_DRAWS = 400
_ROOM = 8192  # rows for which 400 evaluations take as long as compiling a program


class Band(NamedTuple):
    """A fitted force (m,), ends of its 95 % band and of that of measurements (m,)."""

    force: np.ndarray
    low: np.ndarray
    high: np.ndarray
    noise_low: np.ndarray
    noise_high: np.ndarray


def _force_at(
    problem: FitProblem, channel: str, inputs: TireInputs, run: Values
) -> Callable[[np.ndarray], np.ndarray]:
    """z (p,) -> one force at other inputs (m,), with exact slip.

    It is evaluated in blocks of as many rows as the problem has, so that a figure uses the programs
    that the fit has compiled, unless many rows would take longer than compiling. For a transient
    tire they are one series.
    """
    room, count = len(problem.rows.weight), len(run)
    room = min(room, padded_size(count, _ROOM))
    if problem.model.transient:
        room = max(room, padded_size(count))
    rows = jax.tree.map(lambda a: pad_rows(a[:room], room), problem.rows._replace(nodes={}))

    def block(first: int) -> FitProblem:
        there, of_run = jax.tree.map(
            lambda a: pad_rows(a[first : first + room], room), (inputs, run)
        )
        return problem.with_rows(**rows._replace(inputs=there, run=of_run)._asdict())

    blocks = [block(first) for first in range(0, count, room)]
    return lambda z: np.concatenate([moments(each, z)[0][channel] for each in blocks])[:count]


def fitted_force(result: FitResult, channel: str, inputs: TireInputs, run: Values) -> np.ndarray:
    """One force (m,) of a fit at other inputs.

    Args:
        channel: a fitted force.
        inputs: (m,) each; ``run`` (m,): the run of each.
    """
    return _force_at(result.problem, channel, inputs, run)(result.z)


def force_band(
    result: FitResult, channel: str, inputs: TireInputs, run: Values, noise: np.ndarray
) -> Band:
    """The fitted curve at other inputs, with its bands.

    The band of the curve is that of the posterior draws if there are any, else it is
    linearised in z around the estimate, with slopes by central differences.

    Args:
        inputs: (m,) each; ``run`` (m,): the run of each.
        noise: (m,) standard deviation of a measured force, without slip noise.
    """
    problem, std, layout = result.problem, noise, result.problem.layout
    at = _force_at(problem, channel, inputs, run)
    quantile = half_width_95(problem.noise_estimated, result.statistics.dof)
    force = at(result.z)
    if result.chains is not None:
        flat = np.asarray(result.chains).reshape(-1, layout.size)
        flat = flat[np.linspace(0, len(flat) - 1, min(_DRAWS, len(flat))).astype(int)]
        z = layout.unconstrained(dict(zip(layout.labels, flat.T, strict=True)))
        low, high = np.quantile([at(draw) for draw in np.asarray(z).T], [0.025, 0.975], axis=0)
    else:
        steps = np.diag(1e-4 * np.minimum(np.sqrt(np.diag(result.covariance)), 1.0))
        slope = np.array([at(result.z + step) - at(result.z - step) for step in steps])
        slope /= 2 * np.diag(steps)[:, None]
        variance = np.einsum("in,ij,jn->n", slope, result.covariance, slope)
        half = quantile * np.sqrt(np.maximum(variance, 0))
        low, high = force - half, force + half
    name = next(c.slip for c in problem.channels if c.name == channel)
    if name in problem.slip_noise:
        slip = getattr(inputs, name)
        step = 1e-6 * (1 + jnp.abs(slip))
        moved = inputs._replace(**{name: slip + step})
        slope = (fitted_force(result, channel, moved, run) - force) / np.asarray(step)
        std = np.hypot(noise, slope * float(np.median(problem.slip_noise[name])))
    half = quantile * std
    # Noise and parameter uncertainty are independent: half-widths add in quadrature.
    below, above = np.hypot(force - low, half), np.hypot(high - force, half)
    return Band(force, low, high, force - below, force + above)
