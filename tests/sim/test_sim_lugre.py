"""The dynamic LuGre tire compared with its steady states and with SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from lugre_response import LUMPED, contact, simulate
from scipy.integrate import solve_ivp

from tirefit.models import LuGre, TireInputs, forces
from tirefit.sim.lugre import Contact, bristle_forces, bristle_rate, distributed

TIRE = LuGre(sigma0=150.0, sigma1=0.08, sigma2=0.002, length=0.25)
LOAD = 4000.0
# As many instants everywhere: each number of them is compiled anew.
N = 61


def course(end):
    """Brake and steer at once: sliding turns back, the wheel slows down; smooth."""
    time = np.linspace(0, end, N)
    sliding = np.stack([1.5 * np.sin(11 * time), 0.8 * np.cos(7 * time) - 0.2], -1)
    rolling = 12 + 8 * np.cos(9 * time)
    return time, Contact(sliding, rolling, LOAD + 800 * np.sin(13 * time))


def at(time, motion, t):
    """The motion at t [s], linear between its samples."""
    x, y = (np.interp(t, time, motion.sliding[:, k]) for k in range(2))
    return np.array([x, y]), np.interp(t, time, motion.rolling)


def give(z, sliding):
    """S(17a) and (17c), written independently; z (..., 2)."""
    speed = np.hypot(*sliding)
    decay = np.exp(-np.sqrt(speed / TIRE.v_st))
    g = TIRE.mu_c + (TIRE.mu_s - TIRE.mu_c) * decay
    return sliding - TIRE.sigma0 * speed / g * z


def force_of(mean, time, motion):
    """S(17b) from mean deflections (t, 2)."""
    each = [
        TIRE.sigma0 * z + TIRE.sigma1 * give(z, v) + TIRE.sigma2 * v
        for z, v in zip(mean, motion.sliding, strict=True)
    ]
    return np.array(each) * motion.fz[:, None]


def by_scipy(rate, start, time, **options):
    """States (t, ...) of a SciPy integration, no step longer than 1 ms."""
    options = {"rtol": 1e-9, "atol": 1e-12} | options
    found = solve_ivp(
        lambda t, z: rate(t, z.reshape(start.shape)).ravel(),
        (time[0], time[-1]),
        start.ravel(),
        "LSODA",
        time,
        max_step=1e-3,
        **options,
    )
    assert found.success
    return found.y.T.reshape(-1, *start.shape)


def upwind(cells, time, motion):
    """Mean deflections (t, 2) by first-order upwind differences."""

    def rate(t, z):
        sliding, rolling = at(time, motion, t)
        inflow = np.vstack([np.zeros((1, 2)), z[:-1]])
        return give(z, sliding) - rolling * cells / TIRE.length * (z - inflow)

    # The bandwidth of a state whose cells alternate between x and y.
    options = {"lband": 2, "uband": 1, "rtol": 1e-7, "atol": 1e-10}
    return by_scipy(rate, np.zeros((cells, 2)), time, **options).mean(1)


def stacked(result):
    return np.stack([result.fx, result.fy], axis=-1)


def held(slip_x, alpha, end):
    """Constant slips at 20 m/s for ``end`` seconds."""
    inputs = TireInputs(slip_x, alpha, LOAD, 20.0)
    steady = jax.tree.map(lambda x: jnp.broadcast_to(x, (N, *x.shape)), contact(inputs))
    return inputs, np.linspace(0, end, N), steady


SLIPS = [
    (1e-4, 0.0, 1.0),
    (0.002, 0.001, 10.0),
    (-0.05, 0.0, 0.5),
    (0.1, 0.05, 0.5),
    (0.4, -0.3, 0.5),
    (20.0, 0.0, 0.5),
    (1e6, 0.1, 0.1),
]


@pytest.mark.parametrize(("slip_x", "alpha", "end"), SLIPS)
def test_the_distributed_model_settles_on_s18(slip_x, alpha, end):
    inputs, time, motion = held(slip_x, alpha, end)
    settled = simulate(TIRE, distributed(), time, motion).forces
    steady = forces(TIRE, inputs)
    size = np.hypot(steady.fx, steady.fy)
    np.testing.assert_allclose(settled.fx[-1], steady.fx, rtol=0, atol=1e-6 * size)
    np.testing.assert_allclose(settled.fy[-1], steady.fy, rtol=0, atol=1e-6 * size)


def test_the_lumped_model_approaches_exponentially():
    _, time, motion = held(0.02, 0.0, 0.5)
    found = simulate(TIRE, LUMPED, time, motion).deflection[:, 0, 0]
    speed = 20 * 0.02 / 1.02
    rate = speed / (TIRE.level(speed) / TIRE.sigma0)
    expected = speed / rate * -np.expm1(-rate * time)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-12)


def test_the_distributed_model_is_the_limit_of_upwind_differences():
    time, motion = course(0.3)
    found = stacked(simulate(TIRE, distributed(), time, motion).forces)
    means = [upwind(cells, time, motion) for cells in (40, 80, 160)]
    # The start is a kink that travels through the patch for 15 ms.
    later = time > 0.05
    first, second, third = (force_of(mean, time, motion)[later] for mean in means)
    errors = [np.abs(x - found[later]).max() for x in (first, second, third)]
    order = np.log2(errors[:2] / np.array(errors[1:]))
    np.testing.assert_allclose(order, 1.0, atol=0.1)
    twice = third * 8 / 3 - second * 2 + first / 3
    np.testing.assert_allclose(found[later], twice, atol=2e-5 * LOAD)


def entry_time(time, motion, t, place):
    """When the bristle now at ``place`` (over the length) entered the patch."""
    fine = np.linspace(time[0], t, 20_001)
    rolling = np.interp(fine, time, motion.rolling)
    way = np.concatenate([[0], np.cumsum((rolling[1:] + rolling[:-1]) / 2)])
    way *= fine[1] - fine[0]
    return np.interp(way[-1] - place * TIRE.length, way, fine)


def test_each_bristle_agrees_with_its_equation():
    time, motion = course(0.3)
    bristles = distributed()
    found = simulate(TIRE, bristles, time, motion).deflection[-1]
    largest = np.abs(found).max()
    # The last of each element's four is its outlet, more exact than those inside.
    for k, allowed in {0: 2e-4, 3: 2e-5, 6: 2e-4, 11: 2e-5, 15: 2e-6}.items():
        entry = entry_time(time, motion, time[-1], bristles.place[k])
        inside = np.concatenate([[entry], time[time > entry]])
        followed = by_scipy(lambda t, z: give(z, at(time, motion, t)[0]), np.zeros(2), inside)[-1]
        np.testing.assert_allclose(found[k], followed, rtol=0, atol=allowed * largest)


def transfer_error(elements, demand, frequency):
    """Relative error of the mean deflection for a harmonic sliding velocity and a
    constant decay rate; both relative to the transit time of a bristle."""
    bristles = distributed(elements)
    n = len(bristles.weight)
    total = demand + 1j * frequency
    z = np.linalg.solve(total * np.eye(n) + bristles.transport, np.ones(n))
    exact = (1 + np.expm1(-total) / total) / total
    return abs(bristles.weight @ z / exact - 1)


@pytest.mark.parametrize(("demand", "frequency"), [(3.0, 0.0), (1.0, 6.0)])
def test_the_error_falls_with_order_seven_in_the_elements(demand, frequency):
    errors = np.array([transfer_error(m, demand, frequency) for m in (2, 4, 8)])
    assert errors[0] < 1e-3
    np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:]), 7.0, atol=0.5)


def test_four_elements_suffice_for_every_demand():
    errors = [transfer_error(4, demand, 0.0) for demand in np.logspace(-1, 7, 200)]
    assert 1e-9 < max(errors) < 1e-7


def test_the_balance_of_the_patch_is_exact():
    """d(mean)/dt is the mean deformation rate minus the flow out of the patch."""
    bristles = distributed(3)
    z = np.random.default_rng(0).normal(size=(12, 2)) * 1e-3
    now = Contact(jnp.array([0.7, -0.4]), jnp.array(15.0), jnp.array(LOAD))
    rate = bristles.weight @ bristle_rate(TIRE, bristles, z, now)
    mean = bristles.weight @ z
    carried = 15.0 / TIRE.length * z[-1]
    np.testing.assert_allclose(rate, give(mean, np.array([0.7, -0.4])) - carried, rtol=1e-11)


def test_a_locked_wheel_deflects_evenly():
    now = Contact(jnp.array([2.0, 0.0]), jnp.array(0.0), jnp.array(LOAD))
    rate = bristle_rate(TIRE, distributed(), jnp.zeros((16, 2)), now)
    np.testing.assert_array_equal(rate, np.tile([2.0, 0.0], (16, 1)))


def test_zero_load_gives_no_force():
    now = Contact(jnp.array([2.0, 0.0]), jnp.array(5.0), jnp.array(-10.0))
    found = bristle_forces(TIRE, distributed(), jnp.ones((16, 2)), now)
    assert float(found.fx) == 0 and float(found.fy) == 0


def test_rotated_motion_rotates_the_force():
    time, motion = course(0.3)
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    ahead = stacked(simulate(TIRE, distributed(), time, motion).forces)
    turned = motion._replace(sliding=motion.sliding @ turn.T)
    found = stacked(simulate(TIRE, distributed(), time, turned).forces)
    np.testing.assert_allclose(found, ahead @ turn.T, atol=1e-6 * LOAD)


def test_the_gradients_of_a_bristle_agree_with_differences():
    """Both modes, of parameters, deflections and motion; sliding, slow, and at zero load."""
    bristles, random = distributed(2), np.random.default_rng(0)
    z = jnp.asarray(1e-3 * random.normal(size=(8, 2)))

    @jax.jit
    def both(tire, z, now):
        return [part(tire, bristles, z, now) for part in (bristle_rate, bristle_forces)]

    for sliding, fz in (([0.7, -0.4], LOAD), ([0.05, 0.0], LOAD), ([0.7, -0.4], -10.0)):
        now = jax.tree.map(jnp.asarray, Contact(jnp.array(sliding), 15.0, fz))
        check_grads(both, (jax.tree.map(jnp.asarray, TIRE), z, now), 1, rtol=1e-4, atol=1e-4)
