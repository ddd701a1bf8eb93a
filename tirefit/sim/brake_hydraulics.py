r"""Brake hydraulics: a master cylinder, and an inlet and an outlet valve at each wheel.

The driver's pressure :math:`p_m` rises at a constant rate. An open inlet lets the
wheel's pressure follow it, an open outlet lets it fall, each with the lag of its
orifice and never faster than its rate; the command is the share u of an interval for
which the one (positive) or the other (negative) is open:

.. math:: \dot p = u^+ \min\{(p_m - p)/T, R_+\} - u^- \min\{p/T, R_-\}

A command takes effect after a delay.
"""

from typing import NamedTuple

import jax.numpy as jnp


class Hydraulics(NamedTuple):
    """``demand`` [Pa] of the driver, reached at ``ramp`` [Pa/s]; ``rise``, ``fall``
    [Pa/s]: fastest change through an open valve; ``lag`` T [s] of an orifice; ``delay``
    [s] of a command, rounded to whole samples of the controller."""

    demand: float = 12e6
    ramp: float = 60e6
    rise: float = 40e6
    fall: float = 80e6
    lag: float = 0.02
    delay: float = 0.01

    def master(self, t):
        """Pressure [Pa] of the master cylinder ``t`` [s] after the braking begins."""
        return jnp.minimum(self.demand, self.ramp * jnp.maximum(t, 0.0))

    def flow(self, t, pressure, valve):
        """Rate of the wheels' pressure (w,) [Pa/s] under commands (w,) in [-1, 1]."""
        up = jnp.clip((self.master(t) - pressure) / self.lag, 0.0, self.rise)
        down = jnp.clip(pressure / self.lag, 0.0, self.fall)
        # A driver who asks for less has it at once, past the valve (check valve).
        back = jnp.minimum((self.master(t) - pressure) / self.lag, 0.0)
        turned = jnp.maximum(valve, 0.0) * up - jnp.maximum(-valve, 0.0) * down
        return turned + jnp.maximum(back, -self.fall)

    def queue(self, rate: float) -> int:
        """Samples that a command waits, at ``rate`` a second."""
        return round(self.delay * rate)
