r"""The fit problem, and its residuals whose sum of squares is -2 log likelihood.

A problem is one pytree, :class:`FitProblem`. Every function of a fit takes it and the
unconstrained parameters z (p,). Every solver, the profile and the
samplers use the one function :func:`root_deviance`. Without slip noise its entries are
the whitened residuals. With slip noise of standard deviation :math:`\tau` the true slip
of a row is latent, and its likelihood an integral over the true slip, see
:mod:`tirefit.fitting.problem.latent_slip`. The entry is then
:math:`\sqrt{2 (\log L_i^{max} - \log L_i)}`, which is the absolute whitened residual in
the limit of no slip noise, so Gauss-Newton steps carry over.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tirefit.arrays import Numbers
from tirefit.compiled import BRIEF
from tirefit.fitting.problem.latent_slip import SlipNodes, integrals, node_weights, unbent
from tirefit.fitting.problem.layout import Layout
from tirefit.fitting.problem.noise import HUBER
from tirefit.models import AbstractTire, TireInputs
from tirefit.params import Values, with_values

_BEYOND = 3.0
"""Force standard deviations above the peak from which a row misses the curve: one in 700 does
by its noise. With less, one-sided misses raise the friction of sliding rows."""

CHANNEL_SLIP = {"fx": "sigma_x", "fy": "alpha", "mz": "alpha"}
"""Force channel -> the slip that drives it in pure slip."""


class Channel(NamedTuple):
    """One fitted force: its name and whether its noise scale is estimated."""

    name: str
    noise_estimated: bool
    slip: str  # whose noise, if any, is integrated out


class Rows(NamedTuple):
    """The used rows of a data set, padded so that few shapes are compiled."""

    inputs: TireInputs
    run: Int[Array, " n"]
    weight: Float[Array, " n"]  # 0 for padding
    observed: dict[str, Float[Array, " n"]]  # by channel
    scale: dict[str, Float[Array, " n"]]  # by channel
    slip_std: dict[str, Float[Array, " n"]]  # noise of each slip that has one
    nodes: dict[str, SlipNodes]  # its true values, once they are laid out


class Rule(NamedTuple):
    """How one block of residuals enters the deviance; by default as a sum of squares."""

    inflation: Float[Array, ""] | float = 1.0  # rows per independent row (x chi2/dof)
    effective: Float[Array, ""] | float = 1.0  # number of independent rows
    smallest: Float[Array, ""] | float = 0.0  # sum of squares at best; 0: noise given


class Widened(NamedTuple):
    """A map of z by which the deviance of rows with noisy slips has the curvature of the
    profile over the density of the slips, although it is computed with a fixed density.

    The rows are compared with the model at centre + matrix (z - centre) (Chandler and Bate,
    Biometrika 94, 2007).
    """

    centre: Float[Array, " p"]
    matrix: Float[Array, "p p"]


class FitProblem(eqx.Module):
    """A fit ready to solve, as one pytree; its rows are on the device.

    Static fields identify a compiled program, so they hold nothing specific to a file,
    such as the names of its runs or its number of rows.
    """

    model: AbstractTire
    rows: Rows
    rules: dict[str, Rule]
    """By block of residuals, see :meth:`block_of`; units until they are judged."""
    layout: Layout = eqx.field(static=True)
    channels: tuple[Channel, ...] = eqx.field(static=True)
    widened: Widened | None = None
    is_huber: bool = eqx.field(static=True, default=False)
    """Whether the deviance of a row is Huber's loss of its whitened residual."""

    @property
    def n(self) -> int:
        """Number of used rows, padding not counted."""
        return int(np.count_nonzero(np.asarray(self.rows.weight)))

    @property
    def slip_name(self) -> str:
        """The slip that drives the first fitted force."""
        return CHANNEL_SLIP[self.channels[0].name]

    @property
    def slip_noise(self) -> dict[str, np.ndarray]:
        """Standard deviation (n,) of each noisy slip, without padding."""
        return {slip: self.used(std) for slip, std in self.rows.slip_std.items()}

    @property
    def noise_estimated(self) -> bool:
        """Whether the noise scale of any channel is estimated."""
        return any(channel.noise_estimated for channel in self.channels)

    @property
    def unknowns(self) -> int:
        """Number of free parameters and of noise levels that are estimated."""
        return self.layout.size + sum(channel.noise_estimated for channel in self.channels)

    def block_of(self, channel: Channel) -> str:
        """The block of residuals that a channel is in: its own, or that of its slip if
        the slip has latent values."""
        return channel.slip if channel.slip in self.rows.nodes else channel.name

    def block_channels(self, block: str) -> tuple[Channel, ...]:
        """The channels in one block."""
        return tuple(c for c in self.channels if self.block_of(c) == block)

    def compared_at(self, z: Float[Values, " p"]) -> Float[Values, " p"]:
        """The z at which the model is compared with the rows."""
        if self.widened is None:
            return z
        return self.widened.centre + self.widened.matrix @ (z - self.widened.centre)

    def used(self, array: Numbers) -> np.ndarray:
        """An array over padded rows without its padding, shape (n,)."""
        return np.asarray(array)[: self.n]

    def with_rules(self, rules: Mapping[str, Rule]) -> "FitProblem":
        """The problem with other rules for its residuals."""
        return replace(self, rules=dict(rules))

    def with_rows(self, **changes: Any) -> "FitProblem":
        """The problem with other rows."""
        changed = replace(self, rows=jax.device_put(self.rows._replace(**changes)))
        blocks = dict.fromkeys(changed.block_of(channel) for channel in self.channels)
        return changed.with_rules({block: Rule() for block in blocks})


def row_forces(
    model: AbstractTire,
    layout: Layout,
    z: Float[Values, " p"],
    inputs: TireInputs,
    run: Int[Values, " n"],
) -> dict[str, Float[Array, " n"] | None]:
    """Forces of every row, by channel, each of shape (n,).

    Args:
        model: template that holds the fixed parameters.
        layout: meaning of z.
        z: unconstrained free parameters, shape (size,).
        inputs: arrays of shape (n,).
        run: run of each row, shape (n,).
    """
    values = layout.natural(z)
    rows = {k: jnp.asarray(v)[run] if jnp.ndim(v) else v for k, v in values.items()}
    axes = {name: 0 if jnp.ndim(value) else None for name, value in rows.items()}
    felt = with_values(model, rows).felt(inputs, run)

    def at_row(values: dict[str, Numbers], sample: TireInputs) -> dict[str, Array | None]:
        return with_values(model, values)(sample)._asdict()

    return jax.vmap(at_row, in_axes=(axes, 0))(rows, felt)


def _forces_at(
    problem: FitProblem, z: Float[Values, " p"], slip: str, slips: Float[Array, "n q"]
) -> dict[str, Float[Array, "n q"]]:
    """Forces at true slips (n, q), of the channels whose slip it is."""
    rows = problem.rows
    names = [c.name for c in problem.channels if c.slip == slip]

    def at(slips: Float[Array, " n"]) -> dict[str, Array]:
        inputs = rows.inputs._replace(**{slip: slips})
        forces = row_forces(problem.model, problem.layout, z, inputs, rows.run)
        return {name: jnp.asarray(forces[name]) for name in names}

    return jax.vmap(at, in_axes=1, out_axes=1)(slips)


def _channel_forces(problem: FitProblem, z: Float[Values, " p"]) -> dict[str, Array]:
    """Forces by channel: (n,), or (n, q) at the latent slips where there are some."""
    rows, nodes, forces = problem.rows, problem.rows.nodes, {}
    if plain := [c.name for c in problem.channels if c.slip not in nodes]:
        predicted = row_forces(problem.model, problem.layout, z, rows.inputs, rows.run)
        # Channels are always forces that the model computes.
        forces = {k: v for k, v in predicted.items() if k in plain and v is not None}
    for slip in nodes:
        forces |= _forces_at(problem, z, slip, nodes[slip].slip)
    return forces


def _places(rows: Rows, slip: str) -> Float[Array, "n q"]:
    """Nodes from the measured slip, in its standard deviations."""
    measured = getattr(rows.inputs, slip)[:, None]
    return (rows.nodes[slip].slip - measured) / rows.slip_std[slip][:, None]


def _slip_likelihoods(
    problem: FitProblem, forces: Mapping[str, Float[Array, "n q"]], slip: str
) -> tuple[Array, Array | None, Array]:
    """Logs (n,) of the likelihood of the forces and the measured slip, and of the forces
    alone (None where that is not needed); the weights of the nodes in the first."""
    rows, nodes = problem.rows, problem.rows.nodes[slip]
    place = _places(rows, slip)
    steep = nodes.of_force is not None
    chords = {
        c.name: unbent(forces[c.name], place, steep) for c in problem.channels if c.slip == slip
    }
    residuals = [
        (rows.observed[name][:, None] - force) / rows.scale[name][:, None]
        for name, force in chords.items()
    ]

    log, weight = integrals(place, residuals, nodes.density)
    of_force = None
    if steep:
        of_force, _ = integrals(place, residuals, nodes.density, measured=False)
        # No slip belongs to a force far above the peak.
        for residual in residuals:
            off = jnp.maximum(_least(residual), _least(-residual))
            of_force += jnp.maximum(off - _BEYOND, 0.0) ** 2 / 2
    return log, of_force, weight


def _least(values: Float[Array, "n q"]) -> Float[Array, " n"]:
    """Smallest value of each row. Slopes of jnp.min would be 0/0 where a program computes the
    values twice, and jnp.argmin takes as long as an integral."""
    least = jax.lax.stop_gradient(jnp.min(values, axis=1, keepdims=True))
    mask = values <= least + 1e-9
    return jnp.sum(jnp.where(mask, values, 0.0), axis=1) / jnp.sum(mask, axis=1)


def _log_of_slip(rows: Rows, slip: str) -> Float[Array, " n"]:
    """Log of the density (n,) of the measured slips."""
    return jnp.log(jnp.sum(node_weights(_places(rows, slip)) * rows.nodes[slip].density, axis=1))


@partial(jax.jit, compiler_options=BRIEF)
def slip_weights(problem: FitProblem, z: Float[Values, " p"]) -> dict[str, Float[Array, "n q"]]:
    """Likelihood of each row for a true slip at each node, times the width of the node and
    up to a factor of the row, by noisy slip."""
    forces = _channel_forces(problem, z)
    return {slip: _slip_likelihoods(problem, forces, slip)[2] for slip in problem.rows.nodes}


@partial(jax.jit, compiler_options=BRIEF)
def steepness(problem: FitProblem, z: Float[Values, " p"]) -> Float[Array, ""]:
    """Largest change of a force for one standard deviation of its slip, in standard
    deviations of the force."""
    rows, most = problem.rows, jnp.zeros(())
    for slip, std in rows.slip_std.items():
        here = getattr(rows.inputs, slip)[:, None]
        along = partial(_forces_at, problem, z, slip)
        _, slopes = jax.jvp(along, (here,), (std[:, None],))
        for name, slope in slopes.items():
            most = jnp.maximum(most, jnp.max(jnp.abs(slope[:, 0]) / rows.scale[name]))
    return most


def _blocks(problem: FitProblem, forces: Mapping[str, Array]) -> dict[str, Float[Array, " n"]]:
    """:func:`root_deviance` of known forces."""
    rows, blocks = problem.rows, {}
    for channel in problem.channels:
        name = channel.name
        if problem.block_of(channel) == name:
            blocks[name] = rows.weight * (rows.observed[name] - forces[name]) / rows.scale[name]
    for slip in rows.nodes:
        log_row, log_force, _ = _slip_likelihoods(problem, forces, slip)
        # The largest value of the likelihood, so that no deviance is negative.
        log_most = _log_of_slip(rows, slip) if log_force is None else log_force
        # The floor keeps the slope of the root finite for a perfect row.
        row_deviance = jnp.maximum(2 * (log_most - log_row), 1e-12)
        blocks[slip] = rows.weight * jnp.sqrt(row_deviance)
    return {k: _huber(v) for k, v in blocks.items()} if problem.is_huber else blocks


def _huber(residual: Float[Array, " n"]) -> Float[Array, " n"]:
    """Signed root of Huber's loss."""
    beyond = jnp.sqrt(2 * HUBER * jnp.maximum(jnp.abs(residual), HUBER) - HUBER**2)
    return jnp.where(jnp.abs(residual) <= HUBER, residual, jnp.sign(residual) * beyond)


def _moments(
    problem: FitProblem, forces: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """:func:`moments` of known forces."""
    rows, mean, variance = problem.rows, {}, {}
    for channel in problem.channels:
        name, force = channel.name, forces[channel.name]
        mean[name], variance[name] = force, rows.scale[name] ** 2
        if channel.slip in rows.nodes:
            weight = rows.nodes[channel.slip].density * node_weights(_places(rows, channel.slip))
            weight = weight / jnp.sum(weight, axis=1, keepdims=True)
            mean[name] = jnp.sum(weight * force, axis=1)
            spread = jnp.sum(weight * (force - mean[name][:, None]) ** 2, axis=1)
            variance[name] = variance[name] + spread
    return mean, variance


@jax.jit
def root_deviance(problem: FitProblem, z: Float[Values, " p"]) -> dict[str, Float[Array, " n"]]:
    """Residuals whose squares sum to -2 log likelihood, by block.

    Returns:
        dict of arrays (n,): one per channel, or one per slip name where that slip has
        noise (its channels share the latent slip). Padding rows are zero.
    """
    there = problem.compared_at(z)
    return _blocks(problem, _channel_forces(problem, there))


@partial(jax.jit, compiler_options=BRIEF)
def moments(
    problem: FitProblem, z: Float[Values, " p"]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Mean and variance of each fitted force given the measured slip, by channel (n,).

    Where the slip has noise, both are over the true slips of the row, whatever its force.
    """
    return _moments(problem, _channel_forces(problem, z))


def blocks_and_moments(
    problem: FitProblem, z: Float[Values, " p"]
) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array], dict[str, Array]]:
    """:func:`root_deviance`, :func:`moments`, and -2 log likelihood of the forces given each
    measured slip, over its smallest value, from one evaluation."""
    forces = _channel_forces(problem, problem.compared_at(z))
    unlikely = {
        slip: 2 * (_log_of_slip(problem.rows, slip) - _slip_likelihoods(problem, forces, slip)[0])
        for slip in problem.rows.nodes
    }
    return _blocks(problem, forces), *_moments(problem, forces), unlikely


@partial(jax.jit, compiler_options=BRIEF)
def noise_factor(problem: FitProblem, z: Float[Values, " p"]) -> Float[Array, ""]:
    """Factor on all force scales that maximises the likelihood of rows with noisy slip.

    With slip noise, the rms of the residuals does not give the force noise, because the
    contribution of the slip differs by row. Newton's method on the logarithm of the
    factor.
    """
    rows = problem.rows

    def objective(log_factor: Array) -> Array:
        scale = {k: v * jnp.exp(log_factor) for k, v in rows.scale.items()}
        # The likelihood of the slips for the forces says little of the noise of the forces.
        nodes = {k: v._replace(of_force=None) for k, v in rows.nodes.items()}
        there = replace(problem, rows=rows._replace(scale=scale, nodes=nodes))
        squares = sum(jnp.sum(block**2) for block in root_deviance(there, z).values())
        return squares / 2 + jnp.sum(rows.weight) * len(problem.channels) * log_factor

    def step(_: Array, log_factor: Array) -> Array:
        slope = jax.grad(objective)(log_factor)
        curvature = jnp.maximum(jax.hessian(objective)(log_factor), jnp.sum(rows.weight))
        return log_factor - jnp.clip(slope / curvature, -0.7, 0.7)

    return jnp.exp(jax.lax.fori_loop(0, 6, step, 0.0))
