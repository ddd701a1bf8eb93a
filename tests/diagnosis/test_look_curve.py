"""The figure of the remainder: bins of a change compared with its truth."""

import numpy as np
import pytest
from scipy.optimize import minimize

from tirefit.diagnosis.evidence.posterior import LinearFit
from tirefit.diagnosis.rows.patterns import Look, Pattern, _over, settings_of
from tirefit.diagnosis.summary.views import curve_of, equally_known, shape_of

N = 400


def look(parameter, covariate, shape, at, width=0.0):
    return Look(parameter, covariate, shape, at, width, 0.1, 1.0, 0.9)


def left_of(truth, field, known, generator):
    """The remainder of a truth with unit noise after fitting the ``known`` columns."""
    residual = np.ravel(truth) + generator.standard_normal(field.size)
    fitted = np.linalg.lstsq(known, residual, rcond=None)[0]
    none = np.zeros((field.size, 0))
    return LinearFit(residual - known @ fitted, known, none, none)


@pytest.mark.parametrize(
    ("covariate", "values"),
    [
        ("slip", np.random.default_rng(0).uniform(-2, 3, N)),
        ("time", np.linspace(5, 65, N)),
        ("fz", np.tile((2e3, 4e3, 6e3, 7e3), N // 4)),
    ],
)
def test_the_drawn_shape_is_the_tested_one(covariate, values):
    settings = settings_of(covariate, values)
    assert (settings is not None) == (covariate == "fz")
    low, span = values.min(), np.ptp(values)
    over = _over(covariate, values, {"force": 0})
    assert len(over.listed) >= 5
    every = over.shapes.T
    for listed, expected in zip(over.listed, every, strict=True):
        shape = shape_of(Pattern("force", covariate, *listed), values, low, span)
        # A wave of any phase is one of sine and cosine.
        weight, *_ = np.linalg.lstsq(shape, expected, rcond=None)
        # The patterns' shapes are held in single precision.
        np.testing.assert_allclose(shape @ weight, expected, atol=1e-6)
        assert np.linalg.norm(weight) == pytest.approx(1.0, rel=1e-5)


def test_bins_determine_the_parameter_equally_well():
    generator = np.random.default_rng(1)
    place, information = generator.uniform(0, 1, 4000), generator.uniform(0, 5, 4000)
    codes = equally_known(place, information)
    known = np.bincount(codes, information)
    np.testing.assert_allclose(known, information.sum() / 13, rtol=0.02)
    ends = [(place[codes == k].min(), place[codes == k].max()) for k in range(13)]
    assert all(end < start for (_, end), (start, _) in zip(ends, ends[1:], strict=False))


def test_points_have_the_stated_errors():
    """A step of a tenth in friction, with a fit that absorbs any constant change: only
    differences between bins are determined."""
    generator, speed = np.random.default_rng(2), np.linspace(5, 25, N)
    scaled = []
    for _ in range(60):
        field = generator.uniform(2, 20, (2, N))
        truth = 0.1 * (speed > 15)
        known = np.ravel(field)[:, None]
        linear = left_of(field * truth, field, known, generator)
        panel = curve_of(look("friction", "v", "threshold", 15.0), speed, field, linear)
        assert panel.look.size == pytest.approx(0.1, abs=0.03)
        away = panel.change - 0.1 * (panel.center > 15) + 0.05
        # One bin lies on both sides of the step.
        scaled.append((away / panel.std)[np.abs(panel.center - 15) > 1])
    assert len(panel.center) >= 8 and not panel.is_folded and not panel.at_settings
    scaled = np.concatenate(scaled)
    # The step has taken up two of the bins' degrees of freedom, or a bit less.
    assert np.abs(scaled.mean()) < 0.1
    assert 0.8 < np.sqrt(np.mean(scaled**2)) < 1.2
    steps = panel.shape[np.searchsorted(panel.x, [14.9, 15.1])]
    np.testing.assert_allclose(steps, [-panel.look.size / 2, panel.look.size / 2])


def test_points_show_a_truth_of_another_shape():
    generator, speed = np.random.default_rng(3), np.linspace(5, 25, N)
    field = np.full((1, N), 40.0)
    truth = 0.1 * np.sin(2 * np.pi * (speed - 5) / 20)
    linear = left_of(field * truth, field, np.zeros((N, 1)) + 1e-9, generator)
    panel = curve_of(look("friction", "v", "threshold", 15.0), speed, field, linear)
    wanted = 0.1 * np.sin(2 * np.pi * (panel.center - 5) / 20)
    np.testing.assert_allclose(panel.change, wanted, atol=4 * panel.std.max() + 0.01)
    assert np.ptp(panel.change[panel.center < 15]) > 0.05  # the line is level there


def test_a_wave_is_fitted_with_its_phase_and_folded():
    generator, time = np.random.default_rng(4), np.linspace(3, 23, N)
    field = np.full((1, N), 100.0)

    def panel_of(period):
        truth = 0.02 * np.cos(2 * np.pi * (time - 3) / period + 0.4)
        linear = left_of(field * truth, field, np.ones((N, 1)), generator)
        return curve_of(look("slip", "time", "wave", period), time, field, linear)

    short, long = panel_of(1.0), panel_of(5.0)
    for panel, period in ((short, 1.0), (long, 5.0)):
        assert panel.is_folded
        assert 0 <= panel.center.min() and panel.center.max() < period
        assert (panel.x[0], panel.x[-1]) == (0.0, period)
        wanted = 0.02 * np.cos(2 * np.pi * panel.x / period + 0.4)
        np.testing.assert_allclose(panel.shape, wanted, atol=0.003)
        assert panel.look.size == pytest.approx(0.02, abs=0.002)
        assert len(panel.center) >= 6


def test_the_part_absorbed_by_the_base_fit_is_restored():
    """A kink over the slip, largely absorbed by the base's parameters: SciPy fits both
    together."""
    generator, slip = np.random.default_rng(5), np.linspace(0, 3, N)
    field = 10 + 5 * slip[None]
    known = np.stack([field[0], field[0] * slip], axis=1)
    kink = np.maximum(slip - 1.5, 0) / 3
    linear = left_of(field * 0.3 * kink, field, known, generator)
    panel = curve_of(look("friction", "slip", "kink", 1.5), slip, field, linear)

    def miss(x):
        return np.sum((linear.residual - known @ x[:2] - x[2] * field[0] * kink) ** 2)

    best = minimize(miss, np.zeros(3), method="BFGS").x
    # The kink comes to half its slope at the end of the range.
    assert panel.look.size == pytest.approx(best[2] / 2, rel=1e-4)
    assert panel.change[-1] == pytest.approx(0.15, abs=0.05)


def test_settings_of_a_rig_are_used_as_bins():
    generator = np.random.default_rng(6)
    fz = np.repeat((2e3, 4e3, 6e3), 80) * generator.uniform(0.999, 1.001, 240)
    field = np.full((1, 240), 50.0)
    truth = -0.1 * (np.abs(fz - 4e3) < 100)
    linear = left_of(field * truth, field, field.T, generator)
    at = float(np.median(fz[80:160]))
    panel = curve_of(look("friction", "fz", "local", at), fz, field, linear)
    assert panel.at_settings and len(panel.x) == 3
    np.testing.assert_allclose(panel.center, [2e3, 4e3, 6e3], rtol=1e-3)
    np.testing.assert_allclose(panel.change, [0, -0.1, 0], atol=0.01)
    np.testing.assert_allclose(panel.std, 1 / np.sqrt(80 * 50.0**2))
    np.testing.assert_allclose(panel.shape, [0, panel.look.size, 0])
