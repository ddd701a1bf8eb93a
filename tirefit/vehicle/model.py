"""The car with effects over windows of its logs, and its linearisation.

Steering, effects and disturbances act on the car through a few inputs of each sample: the
wheel angle and the :class:`Changes`. The derivatives of both accelerations by motion and
inputs, at every sample, give those of the whole motion by any number of coefficients, as a
linear recursion from sample to sample.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import cumulative_trapezoid

from tirefit.compiled import BRIEF
from tirefit.diagnosis.effects.record import Atom
from tirefit.params import Values
from tirefit.vehicle.car import (
    AT_ONCE,
    Axle,
    Car,
    Changes,
    State,
    accelerations,
    delayed,
    lagged,
    predicted,
    slip_angles,
    with_play,
)
from tirefit.vehicle.effects import Reading, Samples, Setting, Steering, scaled_axles
from tirefit.vehicle.shooting import Data, slopes_and_values

PARAMETERS = ("front.stiffness", "front.friction", "rear.stiffness", "rear.friction")
"""Coefficients that are fitted with every set of effects: logarithms of factors on the
tires, each with a prior standard deviation of one."""

TIRES = len(PARAMETERS)


class Slopes(NamedTuple):
    """Derivatives of the inputs by coefficients (q): of the wheel angle (w, k, q), the
    changes (w, k, f, q) and the errors of the log (w, 3, q)."""

    angle: np.ndarray
    change: np.ndarray
    reading: np.ndarray


class Moved(NamedTuple):
    """The motion in windows (w, k), and derivatives at each sample.

    Attributes:
        missed: predicted - logged (w, k, c).
        by_motion, by_angle, by_change, by_late: of the rates of lateral speed and yaw rate by
            these two, the wheel angle, the changes (f) and the lags of both slip angles,
            (w, k, 2, ...).
        slip: of both slip angles by lateral speed and yaw rate, (w, k, 2, 2).
        reads: of the channels by the state, (w, k, c, 5); by_reading: by the three errors
            of the log.
        states: (w, k) each; late: the lags (w, k, 2) [rad]; angles: both slip angles.
        lateral: acceleration to the left.
    """

    missed: np.ndarray
    by_motion: np.ndarray
    by_angle: np.ndarray
    by_change: np.ndarray
    by_late: np.ndarray
    slip: np.ndarray
    reads: np.ndarray
    by_reading: np.ndarray
    states: State
    late: np.ndarray
    angles: np.ndarray
    lateral: np.ndarray


class Linear:
    """Derivatives of the channels, from those of each sample.

    Between samples, the car is linearised about the middle of the interval, with inputs that
    change linearly; the interval is divided as for the integration.
    """

    def __init__(
        self, now: Moved, v_x: Values, relaxation: np.ndarray, step: float, parts: int
    ) -> None:
        self.motion, self.v_x, self.step, self.parts = now, np.asarray(v_x), step, parts
        width = step / parts
        a, late, slip = _middle(now.by_motion), _middle(now.by_late), _middle(now.slip)
        eye = np.eye(2)
        power = width * a
        # Taylor series of the exponential and of its integral, as by Runge-Kutta.
        inner = eye + power @ (eye / 2 + power @ (eye / 6 + power / 24))
        onward, gain = eye + power @ inner, width * inner
        time = _middle(relaxation / self.v_x)[..., None, None]
        kept = np.exp(-width / np.maximum(time, AT_ONCE))
        self.tied = time * (1 - kept) / width
        top = np.concatenate([onward, gain @ late], axis=-1)
        move = np.concatenate([onward - eye, gain @ late], axis=-1)
        low = np.concatenate([0 * eye + 0 * onward, kept * eye], axis=-1)
        substep = np.concatenate([top, low - self.tied * slip @ move], axis=-2)
        push = np.concatenate([gain, -self.tied * slip @ gain], axis=-2)
        push = np.concatenate([push, np.broadcast_to(np.eye(4)[:, 2:], push.shape)], axis=-1)
        # Of inputs at the first sample, and of their change to the next one.
        self.onward, self.push, self.ramp = substep, push, 0.5 / parts * push
        for part in range(1, parts):
            self.onward, self.push = substep @ self.onward, substep @ self.push + push
            self.ramp = substep @ self.ramp + (part + 0.5) / parts * push
        # Rate of the lags by the relaxation length.
        rate = np.diff(now.angles, axis=1)[..., None] / step
        old = (_middle(now.late)[..., None] + time * rate) * kept
        self.by_relaxation = old * width / np.maximum(time, AT_ONCE) ** 2 - rate * (1 - kept)
        self.by_relaxation /= _middle(self.v_x)[..., None, None]

    def by_inputs(self, slopes: Slopes) -> np.ndarray:
        """Derivatives (w, k, c, q) of the channels from those of the inputs."""
        now, change = self.motion, slopes.change[:, :-1]
        by_angle = now.by_angle[..., None] * slopes.angle[..., None, :]
        first, last = (
            by + of @ change for by, of in zip(_ends(by_angle), _ends(now.by_change), strict=True)
        )
        lags = self.by_relaxation * change[..., None, _RELAXATION, :]
        turned = np.diff(slopes.angle, axis=1) / self.parts
        lags[..., 0, :] += self.tied[..., 0, :] * turned
        return self._channels((first, last, lags)) + now.by_reading @ slopes.reading[:, None]

    def by_force(self, axle: int, sizes: np.ndarray) -> np.ndarray:
        """Derivatives (w, k, c, q) by forces of an axle [N] to the right, of sizes
        (w, k, q) at the samples."""
        first, last = (
            of[..., None] * sizes[:, :-1, None]
            for of in _ends(self.motion.by_change[..., FORCES[axle]])
        )
        return self._channels((first, last, 0 * first))

    def by_start(self, count: int) -> np.ndarray:
        """Derivatives (w, k, c, s) by the first s numbers of the state at the start."""
        none = np.zeros((*self.push.shape[:2], 2, count))
        return self._channels((none, none, none), np.eye(5)[:, :count])

    def _channels(
        self, given: tuple[np.ndarray, np.ndarray, np.ndarray], first: np.ndarray | None = None
    ) -> np.ndarray:
        """Derivatives of the channels from those of the rates at both ends of each interval
        and of the lags (w, k - 1, 2, q), and of the state at the start (5, q)."""
        begin, end, lags = given
        windows, steps, _, count = begin.shape
        first = np.zeros((5, count)) if first is None else first
        push = self.push @ np.concatenate([begin, lags], axis=2)
        push += self.ramp[..., :2] @ (end - begin)
        moved = np.zeros((windows, steps + 1, 4, count))
        moved[:, 0, :2] = first[:2]
        for k in range(steps):
            moved[:, k + 1] = self.onward[:, k] @ moved[:, k] + push[:, k]
        reads, moved = self.motion.reads, moved[:, :, :2]
        if reads.shape[2] == 2:
            return reads[..., :2] @ moved
        s, v = self.motion.states, self.v_x
        integral = partial(cumulative_trapezoid, dx=self.step, axis=1, initial=0)
        heading = first[2] + integral(moved[:, :, 1])
        cos, sin = np.cos(s.heading), np.sin(s.heading)
        by_heading = -v * sin - s.v_y * cos, v * cos - s.v_y * sin
        place = [
            start + integral(side[..., None] * moved[:, :, 0] + by[..., None] * heading)
            for start, side, by in zip(first[3:], (-sin, cos), by_heading, strict=True)
        ]
        whole = np.stack([moved[:, :, 0], moved[:, :, 1], heading, *place], axis=2)
        return reads @ whole


def _ends(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (w, k, ...) at the first and the last sample of each interval."""
    return values[:, :-1], values[:, 1:]


def _middle(values: np.ndarray) -> np.ndarray:
    """Means (w, k - 1, ...) of neighbouring samples."""
    return 0.5 * (values[:, 1:] + values[:, :-1])


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


_TREE = jax.tree.structure(Changes())
_OF_AXLE = len(Axle._fields)
FORCES = Axle._fields.index("force"), Axle._fields.index("force") + _OF_AXLE
"""Places of the forces of the front and the rear axle among the numbers of the changes."""

_RELAXATION = len(jax.tree.leaves(Changes())) - 1
"""Place of the relaxation length among them."""


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


_Inputs = tuple[jax.Array, jax.Array, jax.Array]
"""Of each window: wheel angle (w, k), changes (w, k, f) and errors of the log (w, 3)."""


@partial(jax.jit, static_argnums=0, compiler_options=BRIEF)
def inputs(
    model: Model, step: jax.Array, z: jax.Array, ways: jax.Array, data: Data, rows: Samples
) -> tuple[_Inputs, Slopes]:
    """The inputs at coefficients z, and their :class:`Slopes` along ``ways`` (p, q)."""

    def of_window(window: Data, rows: Samples) -> tuple[_Inputs, Slopes]:
        def at(along: jax.Array) -> _Inputs:
            setting = model.setting(z + ways @ along, rows)
            angle = steered(setting.steering, window.steering, rows.across, step)
            leaves = [jnp.broadcast_to(x, angle.shape) for x in jax.tree.leaves(setting.car)]
            reading = jnp.stack([jnp.asarray(x, float) for x in setting.reading])
            return angle, jnp.stack(leaves, axis=1), reading

        slopes, values = slopes_and_values(at)(jnp.zeros(ways.shape[1]))
        return values, Slopes(*slopes)

    return jax.vmap(of_window)(data, rows)


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
    channels: int, car: Car, grid: tuple[Any, Any], start: jax.Array, data: Data, given: _Inputs
) -> Moved:
    """The motion from start states (w, s) with the inputs that :func:`inputs` gives.

    ``grid`` is the time between samples and the number of steps of the integration from
    one to the next.
    """

    def of_window(
        start: jax.Array, window: Data, angle: jax.Array, changes: jax.Array, reading: jax.Array
    ) -> Moved:
        split = jax.tree.unflatten(_TREE, [*changes.T])
        first = State(*start, *jnp.zeros(5 - len(start)))
        step, parts = grid
        states, late = predicted(car, first, window.v_x, angle, step, parts, split)

        def rates(
            motion: jax.Array, angle: jax.Array, change: jax.Array, late: jax.Array, v_x: jax.Array
        ) -> tuple[jax.Array, jax.Array]:
            changed: Changes = jax.tree.unflatten(_TREE, [*change])
            v_y, turn = motion
            lateral, yaw = accelerations(car, v_x, angle, v_y, turn, changed, late)
            return jnp.stack([lateral - v_x * turn, yaw]), lateral

        def slips(
            motion: jax.Array, angle: jax.Array, change: Changes, v_x: jax.Array
        ) -> jax.Array:
            return jnp.stack(slip_angles(car, v_x, angle, motion[0], motion[1], change))

        def read(state: jax.Array, reading: jax.Array, v_x: jax.Array) -> jax.Array:
            return logged(channels, State(*state), Reading(*reading), v_x)

        state, v_x = jnp.stack(states, axis=1), window.v_x
        motion, each = state[:, :2], jax.vmap(jax.jacfwd(rates, (0, 1, 2, 3), has_aux=True))
        (by_motion, by_angle, by_change, by_late), lateral = each(motion, angle, changes, late, v_x)
        slip, angles = jax.vmap(slopes_and_values(slips))(motion, angle, split, v_x)
        reader = jax.vmap(slopes_and_values(read, (0, 1)), (0, None, 0))
        (reads, by_reading), values = reader(state, reading, v_x)
        fields: tuple[Any, ...] = (
            values - window.logged, by_motion, by_angle, by_change, by_late, slip, reads,
            by_reading, states, late, angles, lateral,
        )  # fmt: skip
        return Moved(*fields)

    return jax.vmap(of_window)(start, data, *given)
