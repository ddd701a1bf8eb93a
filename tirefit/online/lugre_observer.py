r"""An observer of friction from the wheel speed by the LuGre tire, S section 3.4.

The level of friction is :math:`\theta g`; :math:`p = 1/\theta` is adapted. The state of the patch
is its mean deflection, which the tread carries out at the rate c:

.. math::
   \dot z &= v_s - p a z - c z, \quad a = \sigma_0 |v_s| / g(|v_s|),
       \quad c = \kappa |\omega R| / L \\
   J \dot\omega &= R F_z [\sigma_0 z + \sigma_1 (v_s - p a z) + \sigma_2 v_s] - T

With :math:`b = R F_z / J, \tau = \sigma_0/\sigma_1` and errors :math:`e_x = x - \hat x` the
observer is

.. math::
   \dot{\hat z} &= v_s - \hat p a \hat z - c \hat z, \quad
   \dot{\hat\omega} = (R \hat F - T)/J + (\tau + c) e_\omega, \quad
   \dot{\hat p} = -\gamma b \sigma_1 a \hat z e_\omega

For :math:`V = (e_\omega^2 + \varrho \eta^2 + e_p^2/\gamma)/2`, :math:`\eta = e_\omega - b
\sigma_1 e_z` and constant load and friction,

.. math:: -\dot V = (c + pa) e_\omega^2 + (\tau - pa) e_\omega \eta
    + \varrho (\tau + c) \eta^2

is positive at every slip and speed for :math:`\varrho > (\tau - pa)^2 / 4 (c + pa)(\tau + c)`;
with another gain than :math:`\tau + c` there is no such :math:`\varrho` for some tires. Steps are
implicit, so that fast bristles do not make the sampled observer diverge.

Unless ``kappa`` is given, it is that of the patch at the present :math:`\hat p`, :math:`\kappa =
\varphi_1(x)/\varphi_2(x)` at :math:`x = \hat p a L/|\omega R|`, with which the mean has the steady
force of S(18); it depends on p at most a third as much as pa. V shows that the error vanishes
without noise. The error with noise is a covariance computed from the slopes of the step.
"""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tirefit.arrays import Number, Scalar
from tirefit.models import LuGre, TireInputs
from tirefit.models.lugre import patch_means
from tirefit.online import base
from tirefit.online.run import LOCKED_SLIP
from tirefit.params import par

_SUBSTEPS = 4
_JUMP = 0.03  # jump of the torque over R F_z after which the motion is initialised again
_LEAST, _MOST = 0.05, 4.0  # limits of theta
_PRIOR = 0.5  # relative std of theta at first
_SLIPS = np.geomspace(0.01, 3.0, 64)
"""Slips at which the peak of the steady force is searched: in steps of 9 %."""


def peak_share(tire: LuGre, theta: float, v: Scalar) -> Number:
    """Largest steady force over the load [-] of S(18) with theta g, at a speed [m/s].

    Args:
        tire: with theta = 1; theta: factor of g.
    """
    ones = jnp.ones(len(_SLIPS))
    at = TireInputs(sigma_x=jnp.asarray(_SLIPS), fz=ones, v=v * ones)
    return jnp.max(jnp.asarray(tire.scaled(theta)(at).fx))


class Course(NamedTuple):
    """Quantities of the observer's equations at one instant, see the module."""

    v_s: Any
    a: Any
    c: Any
    b: Any


class ObserverState(NamedTuple):
    """Estimates, their covariance, and the values from which they were computed."""

    x: Float[Array, "7"]  # z [m], omega [rad/s], p [-]; last omega, v, fz, torque
    covariance: Float[Array, "7 7"]  # of their errors
    smooth: Number  # [s] from the last jump of the torque until then
    sum: Number  # of the latest surprises
    summed: Number  # their number
    peak: Float[Array, "2"]  # mu and its slope over theta at the peak


class LuGreObserver(base.AbstractEstimator):
    """Lyapunov observer of the level of friction of a LuGre tire."""

    method: ClassVar[base.Method] = base.Method(
        "lugre-observer", "Lyapunov observer of LuGre's friction from wheel speed",
        ("omega", "v", "fz", "torque"), ("mu", "theta"),
        "40 to 100 % of the friction; below, mu is flagged", "S §3.4", "lugre",
    )  # fmt: skip

    average: float = 1.0
    tire: LuGre = LuGre()
    radius: float = par(0.5, (0.01, 2.0), "m", "effective rolling radius")
    inertia: float = par(15.0, (1e-6, 1e3), "kg m2", "of the wheel")
    kappa: float = par(0.0, (0.0, 4.0), "-", "c of the patch over omega R/L; 0: S(18)")
    adaptation: float = par(1e6, (0.0, 1e12), "1/s2", "speed of adaptation, gamma b^2", scale="log")
    theta: float = par(1.0, (_LEAST, _MOST), "-", "theta at first")
    least_use: float = par(0.1, (0.0, 1.0), "-", "smallest force over load to adapt theta")
    omega_std: float = par(0.18, (1e-6, 10.0), "rad/s", "of omega")
    v_std: float = par(0.03, (0.0, 10.0), "m/s", "of v")
    load_std: float = par(0.02, (0.0, 1.0), "-", "of fz, over fz")
    torque_std: float = par(0.01, (0.0, 1.0), "-", "of the torque, over fz R")

    def init(self) -> ObserverState:
        x, none = jnp.zeros(7).at[2].set(1 / self.theta), jnp.zeros(())
        return ObserverState(x, self._first(), none, none, none, self._peak(self.theta, 20.0))

    def wait(self, state: ObserverState, dt: Number, steps: Number) -> ObserverState:
        # The variance of p grows with time; a usable sample continues with its update. The
        # relative random walk of theta is 0.02 / sqrt(s).
        walked = (0.02 * state.x[2]) ** 2 * dt
        return state._replace(covariance=state.covariance.at[2, 2].add(walked))

    def open(self, state: ObserverState) -> ObserverState:
        """The initial uncertainty of theta is restored."""
        p = jnp.maximum(state.covariance[2, 2], (_PRIOR * state.x[2]) ** 2)
        kept = state.covariance.at[2, :].set(0.0).at[:, 2].set(0.0)
        return state._replace(covariance=kept.at[2, 2].set(p))

    def update(self, state: ObserverState, sample: base.Sample) -> base.Updated:
        u = jnp.stack([sample[name] for name in self.method.inputs])
        # The time of a jump of the torque and the speed in between are not known; the
        # torque at a locked wheel only holds it.
        jump = jnp.abs(u[3] - state.x[6]) > _JUMP * self.radius * jnp.abs(u[2])
        jump |= self._locked(u)
        smooth = jnp.where(jump, 0.0, jnp.minimum(state.smooth + sample["dt"], 1e3))
        # Time [s] until a wheel follows a jump of the torque: three times J v / R^2 C_x of the
        # wheel of S section 5.
        anew = (sample["dt"] > base.LONGEST) | (smooth < 0.015)
        dt = jnp.clip(sample["dt"], 1e-6, base.LONGEST)

        def flat(x: Float[Array, "7"], u: Float[Array, "4"]) -> Float[Array, "8"]:
            return jnp.append(*self.moved(x, u, dt))

        after_step = flat(state.x, u)
        x, error = after_step[:7], after_step[7]
        into, noise_into = jax.jacfwd(flat, argnums=(0, 1))(state.x, u)
        fz = jnp.maximum(u[2], 0.0)
        stds = (self.omega_std, self.v_std, self.load_std * fz, self.torque_std * fz * self.radius)
        noise = jnp.diag(base.floats(*stds) ** 2)
        spread = into @ state.covariance @ into.T + noise_into @ noise @ noise_into.T
        surprise = error / jnp.sqrt(spread[7, 7])
        # Limit a surprise to four standard deviations, so that spikes do not move theta.
        trust = jnp.minimum(1.0, 4.0 / jnp.maximum(jnp.abs(surprise), 1e-9))
        x = x.at[2].set(state.x[2] + trust * (x[2] - state.x[2]))
        first = self._first().at[2, 2].set(state.covariance[2, 2])
        held = state._replace(smooth=smooth)
        # The bristles in their steady state at the inputs.
        p = state.x[2]
        now = self.course(u, p)
        z = now.v_s / jnp.maximum(p * now.a + now.c, 1e-3)
        at_rest = jnp.concatenate([jnp.stack([z, u[0], p]), u])
        began = held._replace(x=at_rest, covariance=first)
        # Noise of an input enters the intervals before and after it, so their errors are
        # correlated (by a quarter with slip noise of S section 5.1): a sum of n has variance
        # 1.5 n. The standardised sum of ten is reported.
        count, total = state.summed + 1, state.sum + jnp.clip(surprise, -4.0, 4.0)
        full = count >= 10.0  # number of surprises that are reported as one
        reported = jnp.where(full & ~anew, total / jnp.sqrt(1.5 * count), jnp.nan)
        total, count = jnp.where(full, 0.0, total), jnp.where(full, 0.0, count)
        moved = held._replace(x=x, covariance=spread[:7, :7], sum=total, summed=count)
        after = base.choose(anew, began, moved)
        peak = self._peak(1 / after.x[2], jnp.maximum(jnp.abs(u[1]), 0.5))
        return after._replace(peak=peak), jnp.zeros((), int), reported

    def course(self, u: Float[Array, "4"], p: Number) -> Course:
        """Coefficients at inputs (4,) omega, v, fz, torque, and p for the patch."""
        omega, v, fz, _ = u
        v_s = v - omega * self.radius
        speed = jnp.abs(v_s)
        a = self.tire.sigma0 * speed / self.tire.level(speed)
        through = jnp.maximum(jnp.abs(omega) * self.radius, 1e-6) / self.tire.length
        first, second = patch_means(p * a / through)
        c = jnp.where(self.kappa > 0, self.kappa, first / second) * through
        return Course(v_s, a, c, self.radius * fz / self.inertia)

    def share(self, z: Number, p: Number, now: Course) -> Number:
        """Force over load [-] of a mean deflection z [m]."""
        tire, give = self.tire, now.v_s - p * now.a * z
        return tire.sigma0 * z + tire.sigma1 * give + tire.sigma2 * now.v_s

    def moved(
        self, x: Float[Array, "7"], u: Float[Array, "4"], dt: Number
    ) -> tuple[Float[Array, "7"], Number]:
        """One interval of dt [s], at whose end the inputs are u (4,).

        Returns:
            x (7,) at its end, and the mean acceleration [rad/s2] of the measured wheel
            speed that the observer's force does not explain.
        """
        h, missed = dt / _SUBSTEPS, (u[0] - x[3]) / dt
        z, omega, p = x[0], x[1], x[2]
        for k in range(1, _SUBSTEPS + 1):
            there = x[3:] + (u - x[3:]) * (k / _SUBSTEPS)
            now = self.course(there, x[2])
            z = (z + h * now.v_s) / (1 + h * (p * now.a + now.c))
            share = self.share(z, p, now)
            pushed = now.b * share - there[3] / self.inertia
            missed = missed - pushed / _SUBSTEPS
            # Backward Euler of omega and p together, solved: for an error e_omega, p
            # changes by h phi e_omega, and the force with it.
            idle = jnp.abs(share) < self.least_use
            gamma = jnp.where(idle, 0.0, self.adaptation / now.b**2)
            phi = now.b * self.tire.sigma1 * now.a * z
            lead = self.tire.sigma0 / self.tire.sigma1 + now.c  # l_1
            off = there[0] - omega - h * pushed
            off = off / (1 + h * lead + h * h * gamma * phi * phi)
            omega = there[0] - off
            p = jnp.clip(p - h * gamma * phi * off, 1 / _MOST, 1 / _LEAST)
        return jnp.concatenate([jnp.stack([z, omega, p]), u]), missed

    def _peak(self, theta: Scalar, v: Scalar) -> Float[Array, "2"]:
        """mu at a speed [m/s], and its slope by theta."""
        at, tangent = (jnp.asarray(theta, float),), (jnp.ones(()),)
        return jnp.stack(jax.jvp(lambda t: peak_share(self.tire, t, v), at, tangent))

    def _locked(self, u: Float[Array, "4"]) -> Bool[Array, ""]:
        return u[1] > (1 + LOCKED_SLIP) * self.radius * u[0]

    def _first(self) -> Float[Array, "7 7"]:
        stds = [0.001, self.omega_std, _PRIOR / self.theta] + [0.0] * 4
        return jnp.diag(base.floats(*stds) ** 2)

    def estimate(self, state: ObserverState) -> base.Estimate:
        x, p = state.x, state.x[2]
        theta = 1 / p
        theta_std = theta * theta * jnp.sqrt(state.covariance[2, 2])
        mu, mu_std = state.peak[0], state.peak[1] * theta_std
        share = self.share(x[0], p, self.course(x[3:], p))
        flag = base.flag_of(
            ((theta <= _LEAST) | (theta >= _MOST), base.Flag.OUT_OF_RANGE),
            (jnp.abs(share) < self.least_use, base.Flag.LITTLE_EXCITATION),
            (self._locked(x[3:]), base.Flag.LOCKED),
        )
        return base.Estimate(jnp.stack([mu, theta]), jnp.stack([mu_std, theta_std]), flag)
