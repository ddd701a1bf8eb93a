"""Parameter fields: bounds as a bijection, their Jacobian, nested models."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tirefit.models import MODELS, Asymmetric, Brush, Exponential, Friction, Kinetic
from tirefit.params import (
    Spec,
    constrain,
    log_jacobian,
    par,
    parameter_values,
    specs,
    unconstrain,
    with_values,
)

LINEAR = Spec(0.0, -0.25, 1.5, "-", "a share", "S(1)", "x", True, "linear")
LOG = Spec(5e4, 1e-2, 1e9, "N", "a stiffness", "S(1)", "c", True, "log")
BOTH = pytest.mark.parametrize("spec", [LINEAR, LOG], ids=["linear", "log"])
Z = np.linspace(-12.0, 12.0, 49)


@BOTH
def test_unconstrain_inverts_constrain(spec):
    np.testing.assert_allclose(unconstrain(constrain(Z, spec), spec), Z, atol=1e-9)


def test_constrain_inverts_unconstrain():
    x = np.linspace(-0.2499, 1.4999, 31)
    np.testing.assert_allclose(constrain(unconstrain(x, LINEAR), LINEAR), x, atol=1e-13)
    x = np.logspace(-1.99, 8.99, 31)
    np.testing.assert_allclose(constrain(unconstrain(x, LOG), LOG), x, rtol=1e-12)


def test_transforms_agree_with_hand_calculation():
    np.testing.assert_allclose(constrain(0.0, LINEAR), 0.625)  # the middle
    np.testing.assert_allclose(constrain(0.0, LOG), np.sqrt(1e-2 * 1e9))
    np.testing.assert_allclose(constrain(np.log(3.0), LINEAR), -0.25 + 0.75 * 1.75)


@BOTH
def test_bounds_are_respected(spec):
    x = np.asarray(constrain(Z, spec))
    assert (x > spec.lower).all() and (x < spec.upper).all()
    assert (np.diff(x) > 0).all()
    extreme = np.asarray(constrain(np.array([-800.0, 800.0]), spec))
    np.testing.assert_allclose(extreme, spec.bounds, rtol=1e-12)
    assert spec.bounds == (spec.lower, spec.upper)


@BOTH
def test_a_value_at_a_bound_is_moved_just_inside(spec):
    for bound, sign in ((spec.lower, -1), (spec.upper, 1)):
        z = float(unconstrain(bound, spec))
        assert np.isfinite(z) and sign * z > 15
        np.testing.assert_allclose(constrain(z, spec), bound, rtol=3e-8)
        slope = jax.grad(lambda x: unconstrain(x, spec))(bound)
        assert np.isfinite(slope)


@BOTH
def test_the_log_jacobian_agrees_with_constrain(spec):
    slope = jax.vmap(jax.grad(lambda z: constrain(z, spec)))(jnp.asarray(Z))
    difference = np.asarray(log_jacobian(Z, spec) - jnp.log(slope))
    np.testing.assert_allclose(difference, difference[0], atol=1e-10)


def test_the_log_jacobian_is_finite_far_out():
    assert np.isfinite(log_jacobian(np.array([-700.0, 700.0]), LINEAR)).all()
    assert np.isfinite(log_jacobian(np.array([-700.0, 700.0]), LOG)).all()


@pytest.mark.parametrize(
    ("default", "bounds"),
    [
        (2.0, (0.0, 1.0)),
        (-1.0, (0.0, 1.0)),
        (1.0, (1.0, 1.0)),
        (0.5, (1.0, 0.0)),
        (float("nan"), (0.0, 1.0)),
    ],
)
def test_wrong_default_or_bounds_raise(default, bounds):
    with pytest.raises(ValueError, match="outside the bounds"):
        par(default, bounds, "-", "meaning", "S(1)", "x")


def test_default_at_a_bound_is_allowed():
    class Edge(eqx.Module):
        x: float = par(1.0, (0.0, 1.0), "-", "at its bound", "S(1)", "x")

    assert specs(Edge())["x"].default == Edge().x == 1.0
    assert specs(Edge())["x"].free and specs(Edge())["x"].scale == "linear"


NESTED = Brush(pressure=Asymmetric(), friction=Friction((Kinetic(), Exponential())))


def test_nested_parameters_follow_the_order_of_the_fields():
    names = ["cpa2", "mu", "half_length", "d", "m", "h", "v_st", "exponent"]
    assert list(specs(NESTED)) == names
    assert list(parameter_values(NESTED)) == names
    assert list(specs(MODELS["brush-m-peak"])) == ["cpa2", "mu_peak", "half_length", "m"]
    free = [name for name, spec in specs(NESTED).items() if spec.free]
    assert free == ["cpa2", "mu", "d", "m", "h"]


def test_with_values_reaches_nested_parts():
    new = {"cpa2": 1.0, "d": 0.2, "m": 0.3, "exponent": 0.4}
    changed = with_values(NESTED, new)
    assert parameter_values(changed) == {**parameter_values(NESTED), **new}
    assert changed.pressure.d == 0.2
    assert [type(law) for law in changed.friction.laws] == [Kinetic, Exponential]
    assert parameter_values(NESTED)["d"] == 0.0  # the given model is untouched
    assert parameter_values(with_values(NESTED, {})) == parameter_values(NESTED)


def test_with_values_keeps_static_fields():
    changed = with_values(MODELS["brush-ns"], {"n": 0.01})
    assert changed.friction.laws[0].static_too is True
    assert changed.friction.laws[0].n == 0.01


def test_with_values_names_every_unknown_parameter():
    with pytest.raises(KeyError, match=r"Brush has no parameter \['d', 'x'\]"):
        with_values(MODELS["brush"], {"d": 0.1, "mu": 1.0, "x": 2.0})


def test_with_values_is_differentiable():
    def peak(mu):
        return with_values(MODELS["brush"], {"mu": mu}).pure(5.0, 4000.0, 0.0)[0]

    np.testing.assert_allclose(jax.grad(peak)(0.8), 4000.0)
