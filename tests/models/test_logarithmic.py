"""Friction that changes with the logarithm of the sliding speed (``brush-ln``)."""

import numpy as np

import tirefit

LOAD, STIFFNESS, FRICTION, GAIN = 8.0, 40.0, 0.7, 0.2
ALPHA = np.tile(np.linspace(-0.35, 0.35, 60), 4)
SPEED = np.repeat([0.5, 1.0, 2.0, 4.0], 60)


def written_out(alpha, speed):
    """The parabolic brush with the friction of its sliding speed, all of it kinetic or static."""
    slip = np.abs(np.tan(alpha))
    mu = FRICTION * (1 + GAIN * np.log(speed * slip + 0.02))
    share = np.minimum(2 * STIFFNESS * slip / (3 * mu * LOAD), 1.0)
    return np.sign(alpha) * mu * LOAD * (3 * share - 3 * share**2 + share**3)


def rows(**more):
    return {"alpha": ALPHA, "fz": np.full(len(ALPHA), LOAD), "v": SPEED, **more}


def test_the_friction_is_that_of_the_sliding_speed():
    true = {"cpa2": STIFFNESS, "mu": FRICTION, "g": GAIN}
    found = tirefit.predict("brush-ln", rows(), true)["fy"]
    np.testing.assert_allclose(found, written_out(ALPHA, SPEED), rtol=1e-9)
    sliding = np.abs(ALPHA) > 0.34
    np.testing.assert_allclose(  # full sliding at 4 m/s: F = mu F_z
        np.abs(found[sliding & (SPEED == 4.0)]) / LOAD,
        FRICTION * (1 + GAIN * np.log(4.0 * np.tan(0.35) + 0.02)),
        rtol=1e-9,
    )


def test_a_fit_finds_the_gain_and_a_brush_does_not_describe_the_rows():
    noise = np.random.default_rng(5).normal(0, 0.1, len(ALPHA))
    measured = rows(fy=written_out(ALPHA, SPEED) + noise)
    config = {"noise": {"fy": 0.1}}
    fit = tirefit.fit(measured, "brush-ln", config=config)
    for name, true in {"cpa2": STIFFNESS, "mu": FRICTION, "g": GAIN}.items():
        one = fit.parameters[name]
        assert abs(one.value - true) < 3 * one.std < 0.2 * true, name
    assert 0.8 < fit.statistics.rmse / 0.1 < 1.2
    assert tirefit.fit(measured, "brush", config=config).statistics.rmse > 1.5 * fit.statistics.rmse
