"""Slip definitions and sign conventions, by hand."""

import numpy as np
import pytest

from tirefit.models import MODELS, TireInputs, forces
from tirefit.slip import (
    CONVENTIONS,
    LOCKED,
    SLIP_DEFINITIONS,
    kappa_from_sigma,
    lateral_slip,
    sigma_from_kappa,
    sigma_from_slip_ratio,
    slip_ratio_from_sigma,
)

# Forward speed, circumferential speed Omega R_e, and by hand: sigma = v_sx / Omega R_e,
# kappa = v_sx / v, slip ratio = v_sx / max(v, Omega R_e).
TABLE = [
    (10.0, 10.0, 0.0, 0.0, 0.0),
    (10.0, 8.0, 0.25, 0.2, 0.2),
    (10.0, 5.0, 1.0, 0.5, 0.5),
    (10.0, 1.0, 9.0, 0.9, 0.9),
    (8.0, 10.0, -0.2, -0.25, -0.2),
    (5.0, 10.0, -0.5, -1.0, -0.5),
    (1.0, 10.0, -0.9, -9.0, -0.9),
]


@pytest.mark.parametrize(("v", "omega_r", "sigma", "kappa", "ratio"), TABLE)
def test_definitions_agree_with_hand_calculation(v, omega_r, sigma, kappa, ratio):
    v_sx = v - omega_r
    assert (v_sx / omega_r, v_sx / v) == pytest.approx((sigma, kappa))
    assert sigma_from_kappa(kappa) == pytest.approx(sigma, rel=1e-14)
    assert kappa_from_sigma(sigma) == pytest.approx(kappa, rel=1e-14)
    assert sigma_from_slip_ratio(ratio) == pytest.approx(sigma, rel=1e-14)
    assert slip_ratio_from_sigma(sigma) == pytest.approx(ratio, rel=1e-14)


@pytest.mark.parametrize("name", sorted(SLIP_DEFINITIONS))
def test_every_definition_has_an_exact_inverse(name):
    to_sigma, from_sigma = SLIP_DEFINITIONS[name]
    sigma = np.concatenate([np.linspace(-0.95, 20.0, 400), [-1e-12, 0.0, 1e-12]])
    np.testing.assert_allclose(to_sigma(from_sigma(sigma)), sigma, rtol=1e-13, atol=0)
    given = np.concatenate([np.linspace(-0.95, 0.95, 400), [-1e-12, 0.0, 1e-12]])
    np.testing.assert_allclose(from_sigma(to_sigma(given)), given, rtol=1e-13, atol=0)
    assert from_sigma(sigma).shape == sigma.shape
    assert isinstance(to_sigma(0.5), float)


def test_definitions_give_different_values():
    found = {name: to(0.5) for name, (to, _) in SLIP_DEFINITIONS.items()}
    assert found == {"sigma_x": 0.5, "kappa": 1.0, "s": 1.0, "slip_ratio": 1.0}
    found = {name: to(-0.5) for name, (to, _) in SLIP_DEFINITIONS.items()}
    assert found["sigma_x"] == found["slip_ratio"] == -0.5
    assert found["kappa"] == found["s"] == pytest.approx(-1 / 3)


def test_a_locked_wheel_has_a_finite_slip():
    # kappa of a locked wheel is one; LOCKED represents it to a part in a million.
    assert 1 - kappa_from_sigma(LOCKED) == pytest.approx(1e-6, rel=1e-5)
    np.testing.assert_allclose(sigma_from_kappa(kappa_from_sigma(LOCKED)), 1e6, 1e-9)


def test_lateral_slip_follows_its_definition():
    # v_x = 10, v_y = 2, Omega R_e = 8: sigma_y = v_y / Omega R_e, tan(alpha) = v_y/v_x.
    assert lateral_slip(0.2, 0.25) == pytest.approx(2 / 8)
    assert lateral_slip(0.2) == 0.2
    assert lateral_slip(-0.2, -0.2) == pytest.approx(-2 / 12.5)


# One wheel, one moment, four notations: it moves forward at 10 m/s and to the *left*
# (slip angle 0.05 rad), brakes (circumferential speed 9.5 m/s, 5 % of v), leans to the
# right, and the road pushes it back, to the right, 30 mm behind the wheel centre, and
# carries it 10 mm to the right of it and 3 mm before it.
EVENT = {
    # z up, y left: F_y = -800 N; M_z = x F_y = (-0.03)(-800); driving slip positive.
    # M_x = y F_z = (-0.01)(4000), M_y = -x F_z = -(0.003)(4000).
    "iso-w": {
        "slip": -0.05, "alpha": 0.05, "gamma": 0.02,
        "fx": -2000.0, "fy": -800.0, "fz": 4000.0, "mz": 24.0, "mx": -40.0, "my": -12.0,
    },
    # z down, y right: travel to the left is a negative slip angle, F_y = +800 N.
    "sae": {
        "slip": -0.05, "alpha": -0.05, "gamma": 0.02,
        "fx": -2000.0, "fy": 800.0, "fz": -4000.0, "mz": -24.0, "mx": -40.0, "my": 12.0,
    },
    # As SAE, but tan(alpha) = -v_y / v_x and the load counted positive.
    "adapted-sae": {
        "slip": -0.05, "alpha": 0.05, "gamma": 0.02,
        "fx": -2000.0, "fy": 800.0, "fz": 4000.0, "mz": -24.0, "mx": -40.0, "my": 12.0,
    },
    # The drawing in slip.py.
    "braking": {
        "slip": 0.05, "alpha": 0.05, "gamma": 0.02,
        "fx": 2000.0, "fy": 800.0, "fz": 4000.0, "mz": -24.0, "mx": 40.0, "my": 12.0,
    },
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(CONVENTIONS))
def test_every_convention_gives_the_same_canonical_values(name):
    signs = CONVENTIONS[name]
    canonical = {field: value * getattr(signs, field) for field, value in EVENT[name].items()}
    assert canonical == EVENT["braking"]


def test_conventions_only_change_signs_and_describe_themselves():
    for convention in CONVENTIONS.values():
        assert set(convention[1:]) <= {-1, 1}
        assert len(convention.description) > 30
    assert len({convention[1:] for convention in CONVENTIONS.values()}) == 4
    assert CONVENTIONS["braking"][1:] == (1,) * 9


@pytest.mark.parametrize(
    ("name", "fy_over_alpha", "mz_over_alpha"),
    [("braking", 1, -1), ("iso-w", -1, 1), ("sae", -1, 1), ("adapted-sae", 1, -1)],
)
def test_slopes_are_named_in_each_convention(name, fy_over_alpha, mz_over_alpha):
    """The signs of a file at a small slip angle, from the model's own forces."""
    signs = CONVENTIONS[name]
    angle = 0.01  # in the file
    result = forces(MODELS["brush"], TireInputs(0.0, signs.alpha * angle, 4000.0))
    assert np.sign(result.fy * signs.fy) == fy_over_alpha
    assert np.sign(result.mz * signs.mz) == mz_over_alpha
    driving = forces(MODELS["brush"], TireInputs(signs.slip * 0.01, 0.0, 4000.0))
    assert driving.fx * signs.fx > 0
