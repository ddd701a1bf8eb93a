"""The flexible carcass compared with the independent ``fits.flexible_carcass.patch``.

``solved`` finds the free breakaway point by collocation and says whether the friction
holds where bristles stick and is asked for where they slide; ``bristle_by_bristle``
does not know of a breakaway point.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fits.flexible_carcass.patch import (
    GRID,
    Tire,
    bristle_by_bristle,
    differences,
    slopes_at_rest,
    solved,
)
from tirefit.data.table import TireData
from tirefit.fitting.estimate import fit
from tirefit.models import (
    MODELS,
    Asymmetric,
    BeamCarcass,
    Brush,
    ParabolicCarcass,
    Quartic,
    ThreadCarcass,
    TireInputs,
    Uniform,
    forces,
)
from tirefit.params import specs, with_values
from tirefit.slip import LOCKED

CARCASSES = {"thread": ThreadCarcass, "beam": BeamCarcass, "parabola": ParabolicCarcass}
EVERY = pytest.mark.parametrize("kind", CARCASSES)
# The program of the beam takes longest to compile; the contract differentiates it, too.
DERIVED = pytest.mark.parametrize(
    "kind", ["thread", "parabola", pytest.param("beam", marks=pytest.mark.long)]
)
LAWS = {
    "parabolic": (Asymmetric(0.0), lambda xi: 3 / 4 * (1 - xi**2)),
    "d = -1/3": (Asymmetric(-1 / 3), lambda xi: 3 / 4 * (1 - xi**2) * (1 - xi / 3)),
    "d = 1": (Asymmetric(1.0), lambda xi: 3 / 4 * (1 - xi**2) * (1 + xi)),
    "quartic": (Quartic(), lambda xi: 5 / 8 * (1 - xi**4)),
    "uniform": (Uniform(), lambda xi: 0.5 + 0 * xi),
}
# In consistent units, none of them one.
STIFFNESS, MU, LOAD, HALF = 2.1, 0.9, 1.3, 0.7
CPA2, LIMIT = STIFFNESS * HALF**2, MU * LOAD
ROWS = 64


def upper(kind):
    return specs(CARCASSES[kind]())["flexibility"].upper


def evaluated(tire, slip, load=LOAD):
    """(F_y, M_z) of a batch of slips; of one shape, to compile little."""
    slip = np.asarray(slip, float)
    padded = np.resize(np.arctan(slip), ROWS)
    result = forces(jax.tree.map(jnp.asarray, tire), TireInputs(0.0, padded, load))
    return tuple(np.asarray(part)[: len(slip)] for part in (result.fy, result.mz))


def tire_of(kind, flexibility, pressure):
    return CARCASSES[kind](CPA2, MU, HALF, pressure, flexibility)


def full_sliding(kind, flexibility):
    """Demand ratio above which all bristles slide with parabolic pressure."""
    return 1.5 + flexibility * {"thread": 1 / 2, "beam": 1 / 5, "parabola": 2}[kind]


def numeric(kind, flexibility, density):
    """The same tire in terms of S, EI or K_c."""
    power = {"thread": 2, "beam": 4, "parabola": 1}[kind]
    carcass = STIFFNESS * HALF**power / flexibility
    return Tire(kind, STIFFNESS, LIMIT, HALF, carcass, density)


# Every law on one carcass, and the extremes of them on every carcass.
@pytest.mark.parametrize(
    ("kind", "law"),
    [("thread", law) for law in LAWS]
    + [(kind, law) for kind in ("beam", "parabola") for law in ("d = -1/3", "quartic")],
)
def test_the_breakaway_point_solves_the_patch(kind, law):
    """Force and moment, and that one breakaway point *is* the solution: sticking
    bristles need less than the friction, sliding ones fall back increasingly."""
    pressure, density = LAWS[law]
    for share in (0.02, 0.3, 1.0):
        flexibility = share * upper(kind)
        # To 0.6 of full sliding, at which the first of the pressures slides entirely.
        rho = np.array([0.2, 0.35, 0.5, 0.6]) * full_sliding(kind, flexibility)
        slip = rho * LIMIT / CPA2
        fy, mz = evaluated(tire_of(kind, flexibility, pressure), slip)
        for i, one in enumerate(slip):
            found = solved(numeric(kind, flexibility, density), one)
            np.testing.assert_allclose(
                [fy[i], mz[i]], [found.force, found.moment], rtol=1e-12, atol=1e-12
            )
            assert found.stuck < 1
            assert found.slid > 0
            assert found.lag > 0


@EVERY
@pytest.mark.parametrize("law", ["parabolic", "d = -1/3"])
def test_individual_bristles_agree(kind, law):
    """A grid of 160 bristles, each free to slide either way: errors of 1/GRID^2."""
    pressure, density = LAWS[law]
    flexibility = upper(kind)
    rho = np.array([0.05, 0.3, 0.5, 0.8]) * full_sliding(kind, flexibility)
    slip = rho * LIMIT / CPA2
    fy, mz = evaluated(tire_of(kind, flexibility, pressure), slip)
    for i, one in enumerate(slip):
        z, wanted, held = bristle_by_bristle(numeric(kind, flexibility, density), one)
        slides = np.abs(wanted) >= held
        first = int(np.argmax(slides)) if slides.any() else GRID
        assert slides[first:].all()
        stress = np.clip(wanted, -held, held)
        np.testing.assert_allclose(fy[i], z[0] * stress.sum(), atol=5e-4 * LIMIT)
        moment = z[0] * stress @ (HALF - z)
        np.testing.assert_allclose(mz[i], moment, atol=5e-4 * LIMIT * HALF)


@pytest.mark.parametrize(("kind", "largest"), [("beam", 76.0), ("parabola", 2.8)])
def test_above_the_bound_the_leading_edge_slides(kind, largest):
    """The reason for the bound on the flexibility; the thread never needs it."""
    density = LAWS["d = -1/3"][1]
    worst = {}
    for flexibility in (upper(kind), largest):
        rho = np.linspace(0.3, 1.05, 60) * full_sliding(kind, flexibility)
        tire = numeric(kind, flexibility, density)
        worst[flexibility] = max(solved(tire, x).stuck for x in rho * LIMIT / CPA2)
    assert worst[upper(kind)] < 1 < worst[largest]


# Every law on one carcass, and on every carcass those whose programs the patch needs.
@pytest.mark.parametrize(
    ("kind", "law"),
    [
        pytest.param(kind, law, marks=pytest.mark.long)
        if kind != "thread" and law in ("quartic", "uniform")
        else (kind, law)
        for kind in CARCASSES
        for law in LAWS
    ],
)
def test_infinite_stiffness_gives_the_rigid_brush(kind, law):
    pressure = LAWS[law][0]
    slip = np.array([1e-9, 1e-3, 0.1, 0.35, 0.6, 0.9, 1.2, 3.0, 1e6]) * LIMIT / CPA2
    rigid = evaluated(Brush(CPA2, MU, HALF, pressure), slip)
    for flexibility, tolerance in ((0.0, 1e-10), (1e-10, 1e-9)):
        soft = evaluated(tire_of(kind, flexibility, pressure), slip)
        np.testing.assert_allclose(soft[0], rigid[0], rtol=tolerance, atol=1e-12)
        np.testing.assert_allclose(soft[1], rigid[1], rtol=tolerance, atol=1e-9)


@EVERY
def test_full_sliding_gives_kinetic_friction(kind):
    flexibility = 0.4 * upper(kind)
    tire = tire_of(kind, flexibility, LAWS["parabolic"][0])
    slip = np.array([0.99, 1.0001, 50.0, 1e6]) * full_sliding(kind, flexibility)
    fy, mz = evaluated(tire, slip * LIMIT / CPA2)
    assert fy[0] < LIMIT * (1 - 1e-9)
    np.testing.assert_allclose(fy[1:], LIMIT, rtol=1e-14)
    np.testing.assert_allclose(mz[1:], 0.0, atol=1e-14)


def test_the_printed_equation_would_stiffen_the_tire():
    """S(15) as printed, S w'' = +p_y: every bristle sticking, tan for tanh."""
    s = np.arange(1, GRID + 1) * 2 / (GRID + 1)
    full, _ = differences("thread", s[0])
    slopes = {}
    for sign in (1, -1):
        w = np.linalg.solve(sign * full + np.eye(GRID), s)
        slopes[sign] = (s[0] * (s - w).sum() + s[0]) / 2
    assert slopes[1] == pytest.approx(np.tanh(1.0), rel=1e-4)
    assert slopes[-1] == pytest.approx(np.tan(1.0), rel=1e-3)
    assert slopes[-1] > 1 > slopes[1]


def test_references_hold_at_zero_slip():
    """The closed forms that the contract of the models also uses."""
    for flexibility in (0.1, 4.0, 25.0):
        k = np.sqrt(flexibility)
        force, moment = slopes_at_rest("thread", flexibility)
        assert force == pytest.approx(np.tanh(k) / k, rel=1e-13)
        # Integral of (1 - s) sinh(k s) / sinh(2 k) over [0, 2].
        assert moment == pytest.approx(1 / k**2 - 1 / (k * np.tanh(k)), rel=1e-12)
    for kind in CARCASSES:
        assert slopes_at_rest(kind, 1e-6) == pytest.approx((1, -1 / 3), rel=1e-5)
    assert slopes_at_rest("parabola", 0.3)[0] == pytest.approx(1 / 1.4, rel=1e-13)


@functools.cache
def differentiated(kind):
    """One program: outputs (n, 2), their slopes by reverse mode (n, 2, 8), and along a
    direction by forward mode (n, 2), of rows (n, 8) of parameters and inputs."""

    def outputs(row):
        cpa2, mu, half, d, flexibility, sigma_x, alpha, fz = row
        tire = CARCASSES[kind](cpa2, mu, half, Asymmetric(d), flexibility)
        result = tire(TireInputs(sigma_x, alpha, fz))
        return jnp.stack([result.fy, result.mz])

    def everything(row):
        along = jax.jvp(outputs, (row,), (1 + jnp.abs(row),))[1]
        return outputs(row), jax.jacrev(outputs)(row), along

    program = jax.jit(jax.vmap(everything))

    def run(rows):
        padded = np.zeros((128, 8), rows.dtype)
        padded[:, :5] = rows[0, :5]
        padded[: len(rows)] = rows
        return tuple(np.asarray(part)[: len(rows)] for part in program(padded))

    return run


@DERIVED
def test_slopes_agree_with_finite_differences(kind):
    rows = []
    for share in (0.0, 0.1, 0.9):
        flexibility = share * upper(kind)
        # Nearly at rest, partly sliding, and in full sliding.
        for part in (0.01, 0.4, 0.7, 1.3):
            slip = part * full_sliding(kind, flexibility) * LIMIT / CPA2 / 1.2
            # Not at the bound: the difference is central.
            row = CPA2, MU, HALF, 0.1, max(flexibility, 0.01), 0.2, np.arctan(slip)
            rows.append([*row, LOAD])
    rows = np.array(rows)
    run = differentiated(kind)
    _, slopes, along = run(rows)
    scale = np.abs(slopes).max(axis=(0, 2))[:, None]
    for k in range(8):
        step = np.zeros(8)
        step[k] = 1e-5
        difference = (run(rows + step)[0] - run(rows - step)[0]) / 2e-5
        np.testing.assert_allclose(slopes[:, :, k] / scale.T, difference / scale.T, atol=2e-8)
    expected = np.einsum("nok,nk->no", slopes, 1 + np.abs(rows))
    np.testing.assert_allclose(along, expected, rtol=1e-10, atol=1e-10)


@DERIVED
def test_slope_at_zero_slip_agrees_with_closed_form(kind):
    shares = np.array([1e-3, 0.1, 1.0])
    rows = np.array([[CPA2, MU, HALF, 0.1, s * upper(kind), 0, 0, LOAD] for s in shares])
    values, slopes, _ = differentiated(kind)(rows)
    np.testing.assert_array_equal(values, 0)
    for row, found in zip(rows, slopes[:, :, 6], strict=True):
        force, moment = slopes_at_rest(kind, row[4])
        expected = 2 * CPA2 * force, 2 * CPA2 * HALF * moment
        np.testing.assert_allclose(found, expected, rtol=1e-11)
    np.testing.assert_array_equal(np.delete(slopes, 6, axis=2), 0)


@DERIVED
def test_forces_and_gradients_are_finite_everywhere(kind):
    alpha = [0.0, 1e-12, 0.02, -0.3, 1.4]
    grid = np.stack(np.meshgrid(alpha, [0.0, LOCKED], [0.0, 1e-6, 4e3], [0.0, 0.3, 1]))
    alpha, sigma_x, fz, share = grid.reshape(4, -1)
    known = np.tile([5e4, 1.0, 0.1, 1.0], (len(fz), 1))
    rows = np.column_stack([known, upper(kind) * share, sigma_x, alpha, fz])
    for part in (found := differentiated(kind)(rows)):
        assert np.isfinite(part).all()
    force, moment = found[0].T
    silent = (alpha == 0) | (fz == 0)
    np.testing.assert_array_equal(force[silent], 0)
    np.testing.assert_array_equal(moment[silent], 0)
    assert (np.abs(force) <= fz * (1 + 1e-12)).all()
    assert (force[~silent] * alpha[~silent] > 0).all()


def test_lateral_slip_grows_with_braking_slip():
    tire = MODELS["carcass-thread"]
    rows = (np.resize(x, ROWS) for x in ([0.25, 0.0], np.arctan([0.04, 0.05])))
    fy = np.asarray(forces(jax.tree.map(jnp.asarray, tire), TireInputs(*rows, 4e3)).fy)
    assert fy[0] == pytest.approx(fy[1], rel=1e-12)


@pytest.mark.long
def test_fit_recovers_the_carcass():
    """Force and moment together distinguish the carcass from the bristles.

    The thread is fitted in ``fits/flexible_carcass``.
    """
    name = "carcass-parabola"
    truth = {"cpa2": 9e4, "mu": 0.95, "flexibility": 0.3}
    rng = np.random.default_rng(4)
    alpha = rng.uniform(-0.2, 0.2, 400)
    exact = forces(with_values(MODELS[name], truth), TireInputs(0.0, alpha, 4e3))
    data = TireData(
        "carcass",
        {
            "alpha": alpha,
            "fz": np.full(400, 4e3),
            "fy": np.asarray(exact.fy) + 20 * rng.standard_normal(400),
            "mz": np.asarray(exact.mz) + 0.5 * rng.standard_normal(400),
        },
        np.ones(400, bool),
        np.zeros(400, int),
        ("carcass",),
    )
    config = {"force": ["fy", "mz"], "noise": {"fy": 20.0, "mz": 0.5}}
    result = fit(data, name, config=config)
    for key, value in truth.items():
        estimate = result.parameters[key]
        assert abs(estimate.value - value) < 4 * estimate.std
        assert estimate.std < 0.1 * value
        assert estimate.identified
    # The cornering stiffness is that of both in series, not 2 c_p a^2.
    stiffness = result.derived["C_alpha"]
    true = 2 * truth["cpa2"] / (1 + 4 / 3 * truth["flexibility"])
    assert stiffness.ci95[0] < true < stiffness.ci95[1]
    assert stiffness.ci95[1] < 2 * truth["cpa2"]
