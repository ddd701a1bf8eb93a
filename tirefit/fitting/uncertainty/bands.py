"""The fitted curve at any inputs, with 95 % bands of the curve and of a measurement."""

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


def _elsewhere(problem: FitProblem, inputs: TireInputs, run: Values) -> list[FitProblem]:
    """The problem at other inputs (m,), with exact slip, in blocks of as many rows as it
    has, so that a figure uses the programs that the fit has compiled, unless many rows
    would take longer than compiling.

    For a transient tire they are one series.
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

    return [block(first) for first in range(0, count, room)]


def _force_at(blocks: list[FitProblem], channel: str, z: np.ndarray) -> np.ndarray:
    return np.concatenate([moments(block, z)[0][channel] for block in blocks])


def fitted_force(result: FitResult, channel: str, inputs: TireInputs, run: Values) -> np.ndarray:
    """One force (m,) of a fit at other inputs.

    Args:
        channel: a fitted force.
        inputs: (m,) each; ``run`` (m,): the run of each.
    """
    blocks = _elsewhere(result.problem, inputs, run)
    return _force_at(blocks, channel, result.z)[: len(run)]


def _curve_band(
    result: FitResult, channel: str, inputs: TireInputs, run: Values
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(force, low, high) of the fitted curve, each (m,).

    The band is that of the posterior draws if there are any, else it is linearised in z
    around the estimate, with slopes by central differences.
    """

    layout, blocks = result.problem.layout, _elsewhere(result.problem, inputs, run)

    def at(z: np.ndarray) -> np.ndarray:
        return _force_at(blocks, channel, z)[: len(run)]

    force = at(result.z)
    if result.chains is not None:
        flat = np.asarray(result.chains).reshape(-1, layout.size)
        flat = flat[np.linspace(0, len(flat) - 1, min(_DRAWS, len(flat))).astype(int)]
        z = layout.unconstrained(dict(zip(layout.labels, flat.T, strict=True)))
        draws = np.array([at(one) for one in np.asarray(z).T])
        return force, *np.quantile(draws, [0.025, 0.975], axis=0)
    steps = np.diag(1e-4 * np.minimum(np.sqrt(np.diag(result.covariance)), 1.0))
    slope = np.array([at(result.z + step) - at(result.z - step) for step in steps])
    slope /= 2 * np.diag(steps)[:, None]
    variance = np.einsum("in,ij,jn->n", slope, result.covariance, slope)
    half = half_width_95(result.problem.noise_estimated, result.statistics.dof)
    half = half * np.sqrt(np.maximum(variance, 0))
    return force, force - half, force + half


def force_band(
    result: FitResult, channel: str, inputs: TireInputs, run: Values, noise: np.ndarray
) -> Band:
    """The fitted curve at other inputs, with its bands.

    Args:
        inputs: (m,) each; ``run`` (m,): the run of each.
        noise: (m,) standard deviation of a measured force, without slip noise.
    """
    force, low, high = _curve_band(result, channel, inputs, run)
    problem, std = result.problem, noise
    name = next(c.slip for c in problem.channels if c.name == channel)
    if name in problem.slip_noise:
        slip = getattr(inputs, name)
        step = 1e-6 * (1 + jnp.abs(slip))
        moved = inputs._replace(**{name: slip + step})
        slope = (fitted_force(result, channel, moved, run) - force) / np.asarray(step)
        std = np.hypot(noise, slope * float(np.median(problem.slip_noise[name])))
    half = half_width_95(problem.noise_estimated, result.statistics.dof) * std
    # Noise and parameter uncertainty are independent: half-widths add in quadrature.
    below, above = np.hypot(force - low, half), np.hypot(high - force, half)
    return Band(force, low, high, force - below, force + above)
