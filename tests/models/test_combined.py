"""Combined slip compared with a two-dimensional patch of bristles, and the sources."""

import csv
import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from tirefit.data.tir.tir import read_tir
from tirefit.models import (
    MODELS,
    AnisotropicBrush,
    Brush,
    CombinedMagicFormula,
    LiuPeng,
    MagicFormula,
    TireForces,
    TireInputs,
    forces,
)
from tirefit.models.base import AbstractTire, largest
from tirefit.models.combined import braking_slope, mu_rate, scaled_to_combined, turned
from tirefit.models.mf import mf_tire
from tirefit.params import parameter_values, with_values
from tirefit.slip import LOCKED

C, MU, FZ, A = 5e4, 0.9, 4000.0, 0.1

# (sigma_x, alpha): sticking, partly and entirely sliding; braking, driving, locked.
SLIPS = np.array(
    [
        (0.005, 0.01), (0.02, -0.03), (-0.03, 0.02), (0.05, 0.06), (-0.07, -0.04),
        (0.0, 0.05), (0.06, 0.0), (0.08, 0.09), (0.3, -0.4), (-0.5, 0.2), (LOCKED, 0.3),
    ]
)  # fmt: skip


def patch(sigma_x, alpha, ratio=1.0, d=0.0, m=1.0, v=20.0, n=200_000):
    """(F_x, F_y, M_z) of n bristles that move through the patch in sequence.

    A bristle that entered a time t ago is deflected by (v_sx t, v_sy t), as its base
    moves with the tread, at Omega R_e, and its tip with the road. From the first one
    whose stress the road cannot hold they slide, m mu p against the deflection.
    """
    tread = v / (1 + sigma_x)
    sliding_speed = np.array([v - tread, v * np.tan(alpha)])
    xi = 1 - (2 * np.arange(n) + 1) / n
    time = A * (1 - xi) / tread
    stress = C / A * np.array([1.0, ratio])[:, None] * sliding_speed[:, None] * time
    size = np.hypot(*stress)
    limit = MU * FZ * 0.75 * (1 - xi**2) * (1 + d * xi)
    slides = np.cumsum(size > limit) > 0
    stress = np.where(slides, stress * m * limit / size, stress) * 2 / n
    return np.array([*stress.sum(axis=1), A * (xi * stress[1]).sum()])


ROWS = 300
"""Of every batch: each size is compiled."""


def resized(slips):
    return np.resize(slips, (ROWS, 2))


def on_slips(model, slips=SLIPS, fz=FZ):
    """Modelled forces, (rows, 2 or 3)."""
    found = forces(model, TireInputs(*resized(slips).T, fz))
    return columns(found)[: len(slips)]


def close(found, expected, tolerance=1e-12, arm=A):
    """Relative to the friction limit, and the moment of it."""
    scale = MU * FZ * np.array([1, 1, arm])[: found.shape[1]]
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=tolerance)


# The brush


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("brush", {}),
        ("brush-m", {"m": 0.7}),
        ("brush-anisotropic", {"stiffness_ratio": 0.6}),
        ("brush-anisotropic", {"stiffness_ratio": 1.7}),
        ("brush-anisotropic-dm", {"stiffness_ratio": 0.6, "d": 0.4, "m": 0.8}),
    ],
)
def test_the_brush_agrees_with_a_patch_of_bristles(name, values):
    tire = with_values(MODELS[name], {"cpa2": C, "mu": MU, "half_length": A, **values})
    kind = {"ratio" if k == "stiffness_ratio" else k: v for k, v in values.items()}
    expected = np.array([patch(*slip, **kind) for slip in SLIPS])
    # Where m < 1 the force jumps at the first sliding bristle, which n rounds.
    close(on_slips(tire), expected, 1e-9 if "m" not in values else 1e-5)
    used = np.hypot(*expected.T[:2]) / (MU * FZ)
    assert used.min() < 0.5 and used.max() > 0.99 * values.get("m", 1.0)


def printed(sigma_x, sigma_y, ratio):
    """O(12)-(20) as printed: F_x, F_y and the friction in use."""
    k_s = 2 * C
    kappa_x, kappa_y = sigma_x, ratio * sigma_y
    kappa = np.sqrt(kappa_x**2 + kappa_y**2)
    theta = np.arctan2(kappa_y, kappa_x)
    xi = np.maximum(0, 1 - k_s * kappa / (3 * MU * FZ))
    force = MU * FZ * (1 - xi**3)
    return force * np.cos(theta), force * np.sin(theta), force / (MU * FZ), kappa


def test_o12_to_o20_give_the_anisotropic_brush():
    rng = np.random.default_rng(1)
    slips = np.column_stack([rng.uniform(-0.2, 0.3, 300), rng.uniform(-0.3, 0.3, 300)])
    sigma_y = np.tan(slips[:, 1]) * (1 + slips[:, 0])
    fx, fy, rate, kappa = printed(slips[:, 0], sigma_y, 0.65)
    tire = AnisotropicBrush(C, MU, A, stiffness_ratio=0.65)
    close(on_slips(tire, slips)[:, :2], np.stack([fx, fy], axis=1))
    found = rate_of(kappa, 2 * C, MU * FZ)
    np.testing.assert_allclose(found, rate, rtol=0, atol=1e-12)
    assert 0.1 < np.mean(rate < 1) < 0.9


rate_of = jax.jit(mu_rate)


@jax.jit
@jax.vmap
@functools.partial(jax.grad, argnums=0)
def slope_at(kappa, stiffness, mu):
    return mu * FZ * mu_rate(kappa, stiffness, mu * FZ)


def brush_force(kappa_x, kappa_y, stiffness, mu):
    """F_x of the anisotropic brush over its own two slips."""
    kappa = jnp.hypot(kappa_x, kappa_y)
    return mu * FZ * mu_rate(kappa, stiffness, mu * FZ) * kappa_x / kappa


def random_slips(seed, n=50):
    """kappa_x, kappa_y, K_s, mu (n,) below full sliding."""
    rng = np.random.default_rng(seed)
    stiffness, mu = rng.uniform(4e4, 2e5, n), rng.uniform(0.2, 1.2, n)
    kappa = rng.uniform(0.05, 0.95, n) * 3 * mu * FZ / stiffness
    angle = rng.uniform(-np.pi, np.pi, n)
    return kappa * np.cos(angle), kappa * np.sin(angle), stiffness, mu


def test_o21_gives_the_slope_along_the_slip():
    x, y, stiffness, mu = random_slips(2)
    kappa = np.hypot(x, y)
    slope = slope_at(kappa, stiffness, mu)
    rate = rate_of(kappa, stiffness, mu * FZ)
    np.testing.assert_allclose(jax.jit(braking_slope)(rate, stiffness), slope, rtol=1e-9)


def test_o22_gives_the_slope_along_the_wheel():
    x, y, stiffness, mu = random_slips(3)
    slope = jax.jit(jax.vmap(jax.grad(brush_force)))(x, y, stiffness, mu)
    rate = rate_of(np.hypot(x, y), stiffness, mu * FZ)
    found = jax.jit(braking_slope)(rate, stiffness, np.arctan2(y, x))
    np.testing.assert_allclose(found, slope, rtol=1e-8)


def test_slopes_are_right_at_the_ends():
    np.testing.assert_allclose(braking_slope(jnp.array([0.0, 1.0]), 2 * C), [2 * C, 0])
    across = braking_slope(jnp.array([0.0, 1.0]), 2 * C, np.pi / 2)
    np.testing.assert_allclose(across, [2 * C, 2 * C / 3])
    for function in (braking_slope, lambda g, k: braking_slope(g, k, 0.3)):
        for rate in (0.0, 1.0):
            assert np.isfinite(jax.grad(function)(rate, 2 * C))


# Liu and Peng


def s21(sigma_x, sigma_y, k_ratio, *, printed):
    """S(21) with 3c = 2 c_p a^2, without S's minus sign; short of full sliding."""
    c, sigma = 2 * C / 3, np.hypot(sigma_x, sigma_y)
    last = (c * sigma) ** 3 / FZ**2 / (MU if printed else MU**2)
    force = 3 * c * sigma - 3 * (c * sigma) ** 2 / (MU * FZ) + last
    length = np.sqrt(sigma_x**2 + (k_ratio * sigma_y) ** 2)
    return np.stack([sigma_x, k_ratio * sigma_y], axis=1) * (force / length)[:, None]


def below_sliding(seed):
    rng = np.random.default_rng(seed)
    sigma = rng.uniform(0.01, 0.99, 40) * 3 * MU * FZ / (2 * C)
    angle = rng.uniform(-np.pi, np.pi, 40)
    sigma_x, sigma_y = sigma * np.cos(angle), sigma * np.sin(angle)
    alpha = np.arctan(sigma_y / (1 + sigma_x))
    return sigma_x, sigma_y, np.column_stack([sigma_x, alpha])


@pytest.mark.parametrize("k_ratio", [1.0, 0.5, 2.0])
def test_liu_peng_agrees_with_corrected_s21(k_ratio):
    sigma_x, sigma_y, slips = below_sliding(4)
    found = on_slips(LiuPeng(C, MU, k_ratio), slips)
    close(found, s21(sigma_x, sigma_y, k_ratio, printed=False))
    full = on_slips(LiuPeng(C, MU, k_ratio), [(0.5, 0.5), (-0.6, 0.9)])
    np.testing.assert_allclose(np.hypot(*full.T), MU * FZ, rtol=1e-12)


def test_s21_as_printed_does_not_give_the_brush():
    """Its last term lacks a mu: 10 % error, and not mu F_z at full sliding."""
    sigma_x, sigma_y, slips = below_sliding(5)
    wrong = s21(sigma_x, sigma_y, 1.0, printed=True)
    miss = np.hypot(*(wrong - on_slips(Brush(C, MU, A), slips)[:, :2]).T)
    rho = 2 * C * np.hypot(sigma_x, sigma_y) / (3 * MU * FZ)
    np.testing.assert_allclose(miss, (1 - MU) * MU * FZ * rho**3, rtol=1e-9)
    assert miss.max() > 300


# The semi-empirical scaling: the five properties of S §2.3, and what else it promises


MF = CombinedMagicFormula(14.0, 1.6, 1.1, 0.4, 9.0, 1.4, 0.95, -0.5)
ALONG = MagicFormula(14.0, 1.6, 1.1, 0.4)
ACROSS = MagicFormula(9.0, 1.4, 0.95, -0.5)


DRIVEN = MagicFormula(14.0, 1.6, 0.8, 0.4)


class OneSided(AbstractTire):
    """A measured tire that drives worse than it brakes."""

    def __call__(self, inputs: TireInputs) -> TireForces:
        fx = jnp.where(inputs.sigma_x < 0, DRIVEN(inputs).fx, ALONG(inputs).fx)
        return TireForces(fx, ACROSS(inputs).fy, None)


def test_property_1_pure_slip_is_the_empirical_model():
    slip = np.array([-0.6, -0.1, -1e-3, 0.0, 1e-9, 0.02, 0.15, 0.9, 20.0, LOCKED])
    straight = np.stack([slip, 0 * slip], axis=1)
    fx, fy = on_slips(MF, straight).T
    np.testing.assert_allclose(fx, on_slips(ALONG, straight)[:, 0], rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(fy, 0.0)
    alpha = np.array([-1.2, -0.2, -1e-3, 0.0, 1e-9, 0.05, 0.4, 1.5])
    aside = np.stack([0 * alpha, alpha], axis=1)
    fx, fy = on_slips(MF, aside).T
    np.testing.assert_allclose(fy, on_slips(ACROSS, aside)[:, 1], rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(fx, 0.0)


def test_property_2_small_slip_goes_smoothly_over_to_large_slip():
    """Two independent stiffnesses, then a force against the sliding velocity."""

    def force(size, angle):
        sigma_x, sigma_y = size * jnp.cos(angle), size * jnp.sin(angle)
        inputs = TireInputs(sigma_x, jnp.arctan(sigma_y / (1 + sigma_x)), FZ)
        return jnp.stack(MF(inputs)[:2])

    each = jax.jit(jax.vmap(lambda *at: (force(*at), jax.jacfwd(force)(*at))))
    angles = np.linspace(-3, 3, 13)
    ahead = angles[np.abs(angles) < 1.4]
    across = np.array([0.3, 1.1, 2.0])
    sizes = np.linspace(0.01, 0.5, 2001)
    blocks = [(1e-6, angles), (50.0, ahead), (50.0, np.array([0.0, np.pi / 2]))]
    blocks += [(sizes, np.full(len(sizes), angle)) for angle in across]
    blocks = [np.broadcast_arrays(*block) for block in blocks]
    values, slopes = map(np.asarray, each(*np.concatenate(blocks, axis=1)))
    ends = np.cumsum([len(block[0]) for block in blocks])[:-1]
    (small, large, pure, *lines), slopes = np.split(values, ends), np.split(slopes, ends)[3:]
    stiffness = FZ * np.array([14 * 1.6 * 1.1, 9 * 1.4 * 0.95])
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    np.testing.assert_allclose(small / 1e-6, stiffness * directions, rtol=0, atol=5)
    # The ends of the two curves are the half-axes of an ellipse.
    expected = np.diag(pure) * np.stack([np.cos(ahead), np.sin(ahead)], axis=1)
    np.testing.assert_allclose(large, expected, rtol=0, atol=0.02 * FZ)
    # Value and slope are continuous in between and at full sliding.
    for value, slope in zip(lines, slopes, strict=True):
        steps = np.abs(np.diff(slope, axis=0)).max()
        assert steps < 0.01 * stiffness.max()
        drawn = np.diff(value, axis=0) / float(sizes[1] - sizes[0])
        middle = (slope[1:] + slope[:-1]) / 2
        np.testing.assert_allclose(drawn, middle, rtol=0, atol=0.002 * stiffness.max())


def test_property_3_nothing_is_added_but_two_slips_of_full_sliding():
    names = set(parameter_values(MF)) - {f"{p}{a}" for p in "BCDE" for a in "xy"}
    assert names == {"sliding_x", "sliding_y"}
    # They are what they say: a longer way to full sliding, in combined slip alone.
    longer = with_values(MF, {"sliding_y": 1.5})
    limit = 1.5 * 3 / (9.0 * 1.4)
    pure = [(0.1, 0.0), (0.0, 0.2)]
    np.testing.assert_allclose(on_slips(longer, pure), on_slips(MF, pure), rtol=1e-12)
    slips = [(0.01, np.arctan(share * limit) / 1.01) for share in (0.98, 1.02)]
    partly, fully = on_slips(longer, slips)
    change = on_slips(longer, [(0.05, 0.1)]) - on_slips(MF, [(0.05, 0.1)])
    assert np.abs(change).max() > 50

    def on_ellipse(row, slip):
        sigma_y = np.tan(slip[1]) * (1 + slip[0])
        psi = np.hypot(slip[0] / (3 / (14 * 1.6)), sigma_y / limit)
        sigma = np.hypot(slip[0], sigma_y)
        reach = 3 / (14 * 1.6) * psi
        brake, drive = on_slips(ALONG, [(reach, 0.0), (-reach, 0.0)])[:, 0] * [1, -1]
        cos = slip[0] / sigma
        side = on_slips(ACROSS, [(0.0, np.arctan(limit * psi))])[0, 1]
        end = ((1 + cos) * brake + (1 - cos) * drive) / 2
        return np.hypot(row[0] / end, row[1] / side)

    np.testing.assert_allclose(on_ellipse(fully, slips[1]), 1.0, rtol=1e-12)
    assert on_ellipse(partly, slips[0]) < on_ellipse(fully, slips[1])


def test_the_largest_value_has_the_slope_of_one_value():
    value, slope = jax.jit(jax.value_and_grad(largest))(np.array([1.0, 3.0, 2.0, 3.0]))
    assert value == 3.0 and slope.tolist() == [0.0, 1.0, 0.0, 0.0]


def test_property_5_braking_and_driving_keep_their_curves():
    tire, sliding = OneSided(), (3 / (14 * 1.6), 3 / (9 * 1.4))
    slip = np.array([-0.3, -0.05, 0.05, 0.3])

    def combined(along, slips):
        return scaled(along, ACROSS, slips, sliding).fx

    pure = combined(tire, np.stack([slip, 0 * slip], axis=1))
    expected = on_slips(tire, np.stack([slip, 0 * slip], axis=1))[:, 0]
    np.testing.assert_allclose(pure, expected, rtol=1e-9)
    # With some side slip too, braking is still of the one curve, driving of the other.
    for sigma_x, own, other in ((0.3, ALONG, DRIVEN), (-0.3, DRIVEN, ALONG)):
        at = (sigma_x, 0.05)
        assert abs(combined(tire, at) - combined(own, at)) < 0.02 * FZ
        assert abs(combined(tire, at) - combined(other, at)) > 0.15 * FZ
    # And one formula on kappa is two curves on sigma, which is what slides: the same
    # kappa takes more of the friction when it brakes, and leaves less to the side.
    braked, driven = on_slips(MF, [(0.2 / 0.8, 0.1), (-0.2 / 1.2, 0.1)])
    assert braked[1] < driven[1] - 50


def curves(along, across, at):
    """The pure-slip fx and fy of two tires as functions of one slip, at one input."""
    zero = 0.0 * at.fz

    def braked(slip):
        return along(at._replace(sigma_x=slip, alpha=zero)).fx

    return braked, lambda slip: across(at._replace(sigma_x=zero, alpha=jnp.arctan(slip))).fy


def scaled(along, across, slip, sliding):
    """Of two tires, at one slip (2,) or a batch of them (n, 2)."""
    slip = np.atleast_2d(slip)
    found = _scaled(along, across, resized(slip), sliding)
    return jax.tree.map(lambda part: np.asarray(part)[: len(slip)], found)


@jax.jit
def _scaled(along, across, slips, sliding):
    def sample(slip):
        at = TireInputs(slip[0], slip[1], FZ)
        return scaled_to_combined(*curves(along, across, at), at, sliding)

    return jax.vmap(sample)(slips)


def columns(found):
    return np.stack([part for part in found if part is not None], axis=1)


@pytest.mark.parametrize("m", [None, 0.8])
def test_scaled_brush_curves_give_the_brush(m):
    """Isotropic: both forces, also for curves that are not parabolic."""
    name, values = ("brush", {}) if m is None else ("brush-m", {"m": m})
    tire = with_values(MODELS[name], {"cpa2": C, "mu": MU, "half_length": A, **values})
    sliding = (3 * MU * FZ / (2 * C),) * 2
    slips = SLIPS[SLIPS[:, 0] > -0.5]  # no curve of pure driving goes to sigma = -1
    found = columns(scaled(tire, tire, slips, sliding))
    close(found, on_slips(tire, slips)[:, :2], 1e-9)


def test_the_share_of_the_bristles_that_stick_turns_the_force():
    """Their force over that of all, summed over a patch that slides to the share psi."""
    xi = np.linspace(-1, 1, 200_001)
    for psi in (0.02, 0.4, 0.8, 1.3):
        need, limit = 1.5 * psi * (1 - xi), 0.75 * (1 - xi**2)
        stress = np.minimum(need, limit)
        share = stress[need < limit].sum() / stress.sum()
        found = turned(psi, 0.3, 0.9)
        np.testing.assert_allclose(found, share * 0.3 + (1 - share) * 0.9, atol=1e-4)


def sliding_patch(sigma_x, sigma_y, ratio, n=1000):
    """(F_x, F_y) of bristles whose friction opposes their own sliding velocity.

    Going back from the leading edge each deflection grows by the slip, less what the
    bristle slides: along its stress, so far that the stress is the limit.
    """
    step, deflection, total = 2 / n, np.zeros(2), np.zeros(2)
    stiffness = C * np.array([1.0, ratio])
    for xi in 1 - step * (np.arange(n) + 0.5):
        limit = MU * FZ * 0.75 * (1 - xi**2)
        free = deflection + step * np.array([sigma_x, sigma_y])

        def excess(slide, free=free, limit=limit):
            return np.hypot(*(stiffness * free / (1 + slide * stiffness))) - limit

        slide = 0.0
        if excess(0.0) > 0:
            high = np.hypot(*free) / limit
            slide = brentq(excess, 0.0, high, xtol=1e-18, rtol=1e-13)
        deflection = free / (1 + slide * stiffness)
        total += stiffness * deflection * step
    return total


def test_scaling_accounts_for_the_turning_of_a_sliding_bristle():
    """The anisotropic brush neglects it: 0.32 mu F_z in full sliding; the scaling
    rotates sliding bristles at once, and is right there."""
    tire, misses = AnisotropicBrush(C, MU, A, stiffness_ratio=0.5), []
    full = 3 * MU * FZ / (2 * C)
    for size in (0.005, 0.02, 0.15, 0.5):
        slip = (size, np.arctan(size / (1 + size)))
        true = sliding_patch(size, size, 0.5)
        kept = on_slips(tire, [slip])[0, :2]
        turned = columns(scaled(tire, tire, slip, (full, full / 0.5)))[0]
        misses.append([np.hypot(*(x - true)) / (MU * FZ) for x in (kept, turned)])
    kept, turned = np.array(misses).T
    assert kept[0] < 0.005 and kept[1] < 0.02 and 0.3 < kept[3] < 0.32
    assert turned[0] < 0.005 and turned[1] < 0.025 and turned[3] < 0.01
    assert turned[2] < kept[2] / 3


def test_an_isotropic_bristle_does_not_turn():
    slip = (0.05, np.arctan(0.05 / 1.05))
    found = on_slips(Brush(C, MU, A), [slip])[:, :2]
    close(found, sliding_patch(0.05, 0.05, 1.0)[None], 1e-3)


TIR = Path(__file__).parents[1] / "data" / "tir"


def combined_rows(name):
    """(inputs, F_x and F_y (n, 2)) of a file's reference values in combined slip.

    They are of its own combined-slip coefficients, by other implementations.
    """
    names = ("kappa", "alpha", "fz", "v", "p", "fx", "fy")
    with open(TIR / "reference.csv") as file:
        rows = [
            [float(row[key] or 0) for key in names]
            for row in csv.DictReader(file)
            if (row["tir"], row["angles"]) == (name, "raw") and row["fx"] and row["fy"]
            if float(row["gamma"]) == 0 and float(row["kappa"]) * float(row["alpha"])
        ]
    kappa, alpha, fz, v, pressure, fx, fy = np.array(rows).T
    inputs = TireInputs(-kappa / (1 + kappa), alpha, fz, v, 0 * fz, pressure, 0 * fz)
    # ISO-W: driving slip and its force are positive.
    return inputs, -np.stack([fx, fy], axis=1)


@pytest.mark.parametrize(
    ("number", "least_gain"), [pytest.param(52, 3.5, marks=pytest.mark.long), (61, 5.0)]
)
def test_scaling_predicts_the_combined_slip_of_measured_tires(number, least_gain):
    """From their pure-slip curves alone: an RMS error of 4 to 5 % of the load."""
    name = f"mfeval_julia/MagicFormula{number}_Parameters.tir"
    file = read_tir(TIR / name)
    tire = mf_tire(file.version, file.numbers)
    inputs, expected = combined_rows(name)
    assert len(expected) > 20

    slips = jnp.geomspace(1e-4, 3.0, 400)

    def sample(row):
        both = curves(tire, tire, row)
        full = [3 * jnp.max(jax.vmap(force)(slips)) / jax.grad(force)(0.0) for force in both]
        return jnp.stack(scaled_to_combined(*both, row, (full[0], full[1]))[:2])

    found = jax.jit(jax.vmap(sample))(inputs)
    pure = np.stack(
        [
            forces(tire, inputs._replace(alpha=0 * inputs.fz)).fx,
            forces(tire, inputs._replace(sigma_x=0 * inputs.fz)).fy,
        ],
        axis=1,
    )
    miss, gap = (
        np.sqrt(np.mean(((x - expected) / inputs.fz[:, None]) ** 2)) for x in (found, pure)
    )
    assert miss < 0.05 and gap > least_gain * miss
