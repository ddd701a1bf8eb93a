r"""The tire as a sensor, S section 3.6: a small network computes slip angle and used
friction from lateral force and aligning moment, without a measurement of slip.

For the brush S(12), :math:`\theta = 2 c_p a^2 \tan\alpha / (3 F_z)` and :math:`\mu`
determine the force :math:`y = F_y / F_z` and the moment :math:`m = -M_z / (a F_z)`. The
network maps these to :math:`(\theta, \mu_u)` for a tire of any stiffness, load and
length. ``python -m fits.tire_sensor.train`` trains its weights, ``tire_sensor.json``, on friction
from 0.1 to 1.2 and on forces above 3 % of the load; samples that noise cannot have moved from this
range are flagged.
"""

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tirefit.arrays import Number, Numbers
from tirefit.online import base
from tirefit.online.base import AbstractSingleSample, Flag, Method, Sample, Single, flag_of
from tirefit.params import Values, par

WEIGHTS = Path(__file__).with_name("tire_sensor.json")
LEAST_FRICTION, MOST_FRICTION, LEAST_FORCE = 0.1, 1.2, 0.03
"""Range of the training: friction [-], and smallest force over load."""
SCALE = (1.2, 0.13)  # largest force and moment of the training, the scales of the inputs
_STDS = 3.0  # an input is flagged if it is this many standard deviations out of range


def gough(sliding: Numbers, mu: Numbers) -> tuple[Numbers, Numbers]:
    """Force over load y and moment -M_z/(a F_z) m of a brush, S section 3.6.

    Args:
        sliding: theta over mu [-], 0 to 1: the share of the patch that slides.
        mu: friction [-].
    """
    stuck = 1 - sliding
    return mu * (1 - stuck**3), mu * sliding * stuck**3


def network(weights: Sequence[tuple[Values, Values]], y: Array, m: Array) -> tuple[Array, Array]:
    """theta [-] and used friction [-] of one point of the Gough plot.

    Args:
        weights: (matrix, offsets) of each layer.
        y, m: force and moment as in :func:`gough`, both >= 0.
    """
    x: Values = jnp.stack([y / SCALE[0], m / SCALE[1]])
    for matrix, offset in weights[:-1]:
        x = jnp.tanh(matrix @ x + offset)
    matrix, offset = weights[-1]
    x = matrix @ x + offset
    # theta is at least a third of the force, and at most the force of the sliding tire.
    return y * (1 / 3 + jax.nn.sigmoid(x[0]) * 2 / 3), jax.nn.sigmoid(x[1])


@cache
def trained() -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """The layers of the network in the package."""
    layers = json.loads(WEIGHTS.read_text())["layers"]
    return tuple((np.array(k["matrix"]), np.array(k["offset"])) for k in layers)


def seen(y: Numbers, m: Numbers, y_std: Numbers = 0.0, m_std: Numbers = 0.0) -> Bool[Array, "..."]:
    """Whether a point of the Gough plot may be within the range of the training.

    Args:
        y, m: force and moment as in :func:`gough`.
        y_std, m_std: their standard deviations; three of them are allowed for.
    """
    y_room = _STDS * y_std
    # The moment changes at most by a third of a change of the force while the tire sticks.
    m_room = jnp.hypot(_STDS * m_std, y_room / 3)

    def moment(mu: float) -> Numbers:
        return gough(1 - jnp.cbrt(1 - jnp.clip(y / mu, 0.0, 1.0)), mu)[1]

    force_fits = (y + y_room >= LEAST_FORCE) & (y - y_room <= MOST_FRICTION)
    between = (moment(LEAST_FRICTION) - m_room <= m) & (m <= moment(MOST_FRICTION) + m_room)
    return jnp.asarray(force_fits & between)


class TireSensor(AbstractSingleSample):
    """Slip angle and friction from force and moment of every single sample."""

    method: ClassVar[Method] = Method(
        "tire-sensor", "network from lateral force and aligning moment", ("fy", "fz", "mz"),
        ("mu", "alpha", "used"), "50 to 100 % of the friction; below, mu is flagged", "S §3.6",
    )  # fmt: skip

    cpa2: float = base.nominal_stiffness()
    half_length: float = par(0.1, (1e-3, 1.0), "m", "half the contact length")
    force_noise: float = base.force_noise(0.0447)
    moment_noise: float = par(0.005, (1e-6, 1.0), "-", "std of the moment over a F_z", scale="log")
    own_error: float = par(0.01, (0.0, 1.0), "-", "std of the network in mu_u and theta / y")

    def from_sample(self, sample: Sample) -> tuple[Single, Bool[Array, ""], Int[Array, ""]]:
        side = jnp.where(sample["fy"] < 0, -1.0, 1.0)
        y = side * sample["fy"] / sample["fz"]
        m = -side * sample["mz"] / (sample["fz"] * self.half_length)
        share = 1 / jnp.sqrt(sample["count"])
        stds = jnp.stack([share * self.force_noise, share * self.moment_noise])
        inside = seen(y, m, *stds)
        # Noise may give a negative moment for a sliding tire.
        x = jnp.stack([jnp.maximum(y, LEAST_FORCE), jnp.maximum(m, 0.0)])
        stiffness = 2 * self.cpa2 / (3 * sample["fz"])
        value = self._outputs(x, stiffness)
        slope = jax.jacfwd(self._outputs)(x, stiffness)
        network_std = self.own_error * jnp.stack([value[0] / value[2], x[0] / stiffness, 1.0])
        std = jnp.sqrt(((slope * stds[None, :]) ** 2).sum(1) + network_std**2)
        value = value * jnp.stack([1.0, side, 1.0])
        # Far out of the range there is no estimate; near the edge it is flagged.
        return Single(value, std), inside, flag_of((~inside, Flag.OUT_OF_RANGE))

    def _outputs(self, x: Float[Array, "2"], stiffness: Number) -> Float[Array, "3"]:
        """mu, slip angle [rad] and used friction of one point (2,)."""
        theta, used = network(trained(), x[0], x[1])
        return jnp.stack([x[0] / used, jnp.arctan(theta / stiffness), used])
