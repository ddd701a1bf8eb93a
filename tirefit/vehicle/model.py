"""The car with effects over windows of its logs, and its derivatives.

Steering, effects and errors of the log act on the car through a :class:`Setting` of each sample,
which depends on a few coefficients: :class:`Model`. :func:`moved` predicts the windows from their
start states, and differentiates the prediction by coefficients, start states and forces of the
axles.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from tirefit.compiled import BRIEF
from tirefit.diagnosis.effects.record import Atom
from tirefit.params import Values
from tirefit.vehicle.car import Car, State, delayed, lagged, predicted, with_play
from tirefit.vehicle.effects import Reading, Samples, Setting, Steering, scaled_axles
from tirefit.vehicle.shooting import Data

PARAMETERS = ("front.stiffness", "front.friction", "rear.stiffness", "rear.friction")
"""Coefficients that are fitted with every set of effects: logarithms of factors on the
tires, each with a prior standard deviation of one."""

TIRES = len(PARAMETERS)


class Moved(NamedTuple):
    """The motion in windows (w, k), and its derivatives.

    Attributes:
        by: of ``missed`` by coefficients or forces (w, k, c, q).
        by_start: of ``missed`` by the start states (w, k, c, s).
        missed: predicted - logged (w, k, c).
        states: (w, k) each; angles: both slip angles (w, k, 2) [rad].
        lateral: acceleration to the left (w, k) [m/s2].
    """

    by: Any
    by_start: Any
    missed: Any
    states: State
    angles: Any
    lateral: Any


def steered(
    steering: Steering, command: jax.Array, across: jax.Array, step: float | jax.Array
) -> jax.Array:
    """Wheel angle (n,) behind a logged one (l + n,) that begins l samples before.

    Args:
        across: (n,) lateral acceleration over g.
        step: time between samples [s].
    """
    angle = lagged(delayed(command, steering.delay / step), steering.lag, step)
    angle = with_play(angle, steering.play)[-len(across) :]
    return angle * steering.ratio + steering.offset - steering.yields * across


class Model(NamedTuple):
    """The model of a car with all atoms. Its coefficients z are the logarithms of factors
    on the tires and the amplitudes of the atoms in prior scales.

    Attributes:
        scales: of the priors.
        channels: 2 of a log of rates, 3 of one of poses.
        stated_delay: of the steering [s], to which the effect adds.
    """

    atoms: tuple[Atom, ...]
    scales: tuple[float, ...]
    channels: int
    stated_delay: float = 0.0

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return TIRES + len(self.atoms)

    def setting(self, z: Values, rows: Samples) -> Setting:
        """The setting by the coefficients, for each sample."""
        factors = jnp.exp(z[:TIRES]).reshape(2, 2)
        setting = Setting(steering=Steering(delay=self.stated_delay))
        for k, name in enumerate(("stiffness", "friction")):
            setting = scaled_axles(setting, name, factors[:, k])
        for k, atom in enumerate(self.atoms):
            change: Callable[..., Any] = atom.effect.change
            setting = change(setting, self.scales[k] * z[TIRES + k], atom.constants, rows)
        return setting


def logged(channels: int, state: State, reading: Reading, v_x: jax.Array) -> jax.Array:
    """What the log has of a state: (c, ...)."""
    if channels == 2:
        v_y = state.v_y + reading.sideslip * v_x + reading.ahead * state.yaw_rate
        return jnp.stack([v_y, state.yaw_rate + reading.yaw_rate])
    cos, sin = jnp.cos(state.heading), jnp.sin(state.heading)
    place = state.x + reading.ahead * cos, state.y + reading.ahead * sin
    return jnp.stack([state.heading - reading.sideslip, *place])


def as_driven(start: Values | Sequence[Values], reading: Reading, v_x: Values) -> State:
    """The state of which a log has the start state (s, ...): the inverse of :func:`logged`, for
    a true yaw rate."""
    v_y, yaw_rate, *place = start
    heading, x, y = place or jnp.zeros(3)
    heading = heading + reading.sideslip
    v_y = v_y - reading.sideslip * v_x - reading.ahead * yaw_rate
    x, y = x - reading.ahead * jnp.cos(heading), y - reading.ahead * jnp.sin(heading)
    return State(v_y, yaw_rate, heading, x, y)


@partial(jax.jit, static_argnums=0, compiler_options=BRIEF)
def moved(
    model: Model,
    car: Car,
    grid: tuple[Any, Any],
    z: jax.Array,
    ways: jax.Array,
    windows: tuple[jax.Array, Data, Samples, jax.Array],
) -> Moved:
    """The motion at coefficients z, and its derivatives along ``ways`` (p, q).

    Args:
        grid: time between samples [s], and number of steps of the integration from one to the next.
        windows: start states (w, s), data, samples, and forces of both axles to the right [N] along
            the same ways (w, k, 2, q).
    """
    step, parts = grid

    def of_window(start: jax.Array, window: Data, rows: Samples, forces: jax.Array) -> Moved:
        v_x = window.v_x

        def at(along: jax.Array, start: jax.Array) -> tuple[jax.Array, Any]:
            setting, pushed = model.setting(z + ways @ along, rows), forces @ along
            angle = steered(setting.steering, window.steering, rows.across, step)
            front, rear = (
                axle._replace(force=axle.force + pushed[:, k])
                for k, axle in enumerate(setting.car[:2])
            )
            changes = setting.car._replace(front=front, rear=rear)
            first = State(*start, *jnp.zeros(5 - len(start)))
            driven = predicted(car, first, v_x, angle, step, parts, changes)
            seen = logged(model.channels, driven.states, setting.reading, v_x)
            missed = jnp.reshape(seen.T, window.logged.shape) - window.logged
            return missed, (missed, *driven)

        (by, by_start), values = jax.jacfwd(at, (0, 1), has_aux=True)(
            jnp.zeros(ways.shape[1]), start
        )
        return Moved(by, by_start, *values)

    return jax.vmap(of_window)(*windows)
