"""Combined slip by similarity: pure forces and limiting cases."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.models.test_mf import GRID, MF52, MF61, iso, jacobian, tire_of, values_of
from tirefit.models import TireInputs, modelled
from tirefit.models.mf import mf_tire
from tirefit.params import specs

RANDOM = np.random.default_rng(41)
KAPPA, ALPHA = RANDOM.uniform(-0.9, 0.9, 256), RANDOM.uniform(-0.6, 0.6, 256)
COMBINED = ("RB", "RC", "RE", "RH", "RV")


def similar(name, starred=False, **other):
    tire = tire_of(name)
    values = {k: v for k, v in values_of(name).items() if k[:2] not in COMBINED}
    return mf_tire(tire.version, values | other, starred=starred)


EACH = pytest.mark.parametrize(("name", "starred"), [(MF52, True), (MF61, False)])
"""The programs of this file: each with similarity, and with its own weights."""


@EACH
def test_pure_slip_gives_the_pure_force(name, starred):
    tire, whole = similar(name, starred), tire_of(name, starred)
    assert tire.similarity == ("fx", "fy") and whole.similarity == ()
    for gamma in (0.0, 0.04):
        found, pure = (iso(t, KAPPA, 0.0, gamma=gamma).fx for t in (tire, whole))
        np.testing.assert_allclose(found, pure, atol=1e-3)  # of some 5,000 N
        found, pure = (iso(t, 0.0, ALPHA, gamma=gamma) for t in (tire, whole))
        np.testing.assert_allclose(found.fy, pure.fy, atol=1e-3)


ISOTROPIC = {
    "FNOMIN": 4000.0, "PCX1": 1.5, "PCY1": 1.5, "PDX1": 1.1, "PDY1": 1.1, "PEX1": -0.5,
    "PEY1": -0.5, "PKX1": 20.0, "PKY1": -20.0, "PKY2": 1.0, "PKY4": 2.0,
}  # fmt: skip


def isotropic():
    return mf_tire("6.1", ISOTROPIC | {"QSX1": 0.0, "QSY1": 0.0})


def test_the_force_turns_from_the_deflection_to_the_sliding_velocity():
    """Unlike stiffnesses and frictions, without shifts: the pure forces of the resultant s of
    the normalised slips, in a direction that a share of the sticking bristles mixes."""
    values = ISOTROPIC | {"PKX1": 30.0, "PDX1": 1.3, "QSX1": 0.0, "QSY1": 0.0}
    limits, slips = (1.3 / 30, 1.1 / 20), (KAPPA, np.tan(ALPHA))
    stuck = [slip / limit for slip, limit in zip(slips, limits, strict=True)]
    s, slid = np.hypot(*stuck), np.hypot(*slips)
    psi = np.minimum(s / 3, 1.0)
    share = 3 * (1 - psi) ** 2 / (3 - 3 * psi + psi**2)
    found = iso(mf_tire("6.1", values), KAPPA, ALPHA)
    # The lateral curve is over alpha, the longitudinal one over kappa.
    arguments = 30 / (1.5 * 1.3) * s * limits[0], 20 / (1.5 * 1.1) * np.arctan(s * limits[1])
    for k, (force, mu) in enumerate(((found.fx, 1.3), (-found.fy, 1.1))):
        x = arguments[k]
        curve = mu * 4000.0 * np.sin(1.5 * np.arctan(x + 0.5 * (x - np.arctan(x))))
        cosine = share * stuck[k] / s + (1 - share) * slips[k] / slid
        np.testing.assert_allclose(force, curve * cosine, atol=1e-3)


@EACH
def test_the_combined_force_stays_within_the_ellipse_of_the_pure_forces(name, starred):
    tire = similar(name, starred)
    with_ones = mf_tire(
        tire.version,
        values_of(name) | dict.fromkeys([k for k in specs(tire) if k[:2] in COMBINED], 0.0),
        starred=starred,
    )
    grid = np.concatenate([-np.geomspace(0.02, 0.99, 128), np.geomspace(0.02, 3.0, 128)])
    for fz in (2000.0, 4000.0, 8000.0):
        largest_x = np.max(np.abs(iso(tire, grid, 0.0, fz).fx))
        largest_y = np.max(np.abs(iso(tire, 0.0, np.arctan(grid), fz).fy))

        def filled(one, fz=fz, largest=(largest_x, largest_y)):
            found = iso(one, KAPPA, ALPHA, fz)
            return np.max((found.fx / largest[0]) ** 2 + (found.fy / largest[1]) ** 2)

        # The other shift at zero slip decays independently of the ellipse.
        assert filled(tire) < 1.002
        assert filled(with_ones) > 1.7


@EACH
def test_similarity_is_close_to_measured_combined_slip(name, starred):
    """From the pure curves alone; independent pure forces are far off."""
    values = {k: v for k, v in values_of(name).items() if k[:2] not in COMBINED}
    true, found, ones = (
        iso(tire, 0.3 * KAPPA, 0.4 * ALPHA)
        for tire in (
            tire_of(name, starred),
            similar(name, starred),
            mf_tire(tire_of(name).version, values, combination="none", starred=starred),
        )
    )
    misses = [
        np.sqrt(np.mean((x.fx - true.fx) ** 2 + (x.fy - true.fy) ** 2)) / values["FNOMIN"]
        for x in (found, ones)
    ]
    assert misses[0] < 0.07 and misses[1] > 4 * misses[0]


def test_values_and_gradients_are_finite_everywhere():
    """In 32 bit, in which squares of small slips are zero."""
    value, slopes = jacobian(similar(MF61, starred=True, LMUV=0.1), dtype=jnp.float32)
    assert np.isfinite(value).all()
    for leaf in slopes:
        bad = ~np.isfinite(leaf)
        assert not bad.any(), GRID[bad][:3]


def test_slope_at_zero_slip_is_the_slip_stiffness():
    tire = isotropic()

    def found(slips):
        return jnp.stack(tire(TireInputs(slips[0], slips[1], 4000.0))[:2])

    slope = np.asarray(jax.jit(jax.jacfwd(found))(jnp.zeros(2)))
    np.testing.assert_allclose(slope, 80000.0 * np.eye(2), rtol=1e-6, atol=1e-3)


def test_given_coefficients_determine_which_forces_use_similarity():
    values = dict(ISOTROPIC, RBX1=10.0, RCX1=1.0)
    assert mf_tire("6.1", values).similarity == ("fy",)
    assert mf_tire("6.1", dict(values, RBY1=0.0, RCY1=0.0)).similarity == ()
    assert mf_tire("6.1", values, combination="none").similarity == ()
    both = mf_tire("6.1", values, combination="similarity")
    assert set(both.similarity) == {"fx", "fy"}
    lateral = mf_tire("6.1", ISOTROPIC, lacks=["fx"])
    assert lateral.similarity == () and modelled(lateral) == ("fy", "mz")
    with pytest.raises(ValueError, match="none, similarity, ellipse"):
        mf_tire("6.1", values, combination="circle")
