"""``slip-slope`` compared with dense Gaussian conditioning, and roads of known kind."""

import numpy as np
import pytest
from scipy.stats import norm

from tirefit.online.base import FLAGS, Flag, code
from tirefit.online.methods import estimator_of
from tirefit.online.run import run
from tirefit.online.slip_slope import ROADS, road_of

LOAD = 4e3


def drive(slope, n=4000, offset=0.001, radius=0.0, seed=0, slip_noise=0.001, use=0.15):
    """A log of gentle driving and braking on a linear tire; slope (n,) or one."""
    random = np.random.default_rng(seed)
    time = np.arange(n) / 100
    share = use * np.sin(2 * np.pi * time / 3)
    noise = np.hypot(slip_noise, radius) * random.normal(size=n)
    return {
        "time": time,
        "sigma_x": share / slope + offset + noise,
        "fx": share * LOAD,
        "fz": np.full(n, LOAD),
        "brake_pressure": np.maximum(share, 0) * LOAD / 5e-4,
    }


SETTINGS = {"force_noise": 1e-5, "slip_noise": 0.001, "slope": 20.0}


def test_the_filter_agrees_with_gaussian_conditioning():
    data = drive(18.0, n=300)
    still = {"drift_slope": 0.0, "drift_offset": 0.0, "average": 1}
    state, estimate = run(estimator_of("slip-slope", LOAD, SETTINGS | still), data)
    # A mean square error that is above the stated noise scales it; so take it fixed.
    rows = np.c_[data["fx"] / LOAD, np.ones(300)]
    prior = np.diag([(0.5 / 20) ** 2, 0.005**2])
    noise = 0.001**2 + (1e-5 / 20) ** 2
    p = np.linalg.inv(np.linalg.inv(prior) + rows.T @ rows / noise)
    mean = np.array([1 / 20, 0.0])
    mean = mean + p @ rows.T @ (data["sigma_x"] - rows @ mean) / noise
    inner = state.inner
    # The noise that is seen differs from the stated one by what 50 samples leave open.
    np.testing.assert_allclose(inner.x[0], mean[0], rtol=0.01)
    np.testing.assert_allclose(inner.x[1], mean[1], atol=1e-4)
    np.testing.assert_allclose(inner.covariance[0, 0], p[0, 0], rtol=0.4)
    assert estimate.value[-1, 0] == 1 / float(inner.x[0])


def test_slope_and_offset_lie_within_the_stated_spread():
    estimator = estimator_of("slip-slope", LOAD, SETTINGS)
    ends = [run(estimator, drive(16.0, seed=seed))[1] for seed in range(20)]
    for k, truth in enumerate((16.0, 0.001)):
        pulls = [(end.value[-1, k] - truth) / end.std[-1, k] for end in ends]
        # The random walk allows for changes that do not come: not above one, with the
        # 0.16 that 20 runs leave open.
        assert np.sqrt(np.mean(np.square(pulls))) < 1.35
    assert ends[0].std[-1, 0] < 0.05 * 16


def test_the_variance_of_the_radius_is_found():
    for radius in (0.002, 0.005):
        estimator = estimator_of("slip-slope", LOAD, SETTINGS)
        ends = [run(estimator, drive(20.0, radius=radius, seed=k))[1] for k in range(8)]
        seen = [end.value[-1, 2] for end in ends]
        assert abs(np.mean(seen) - radius) < 0.15 * radius
        assert np.std(seen) < 2 * ends[0].std[-1, 2]


@pytest.mark.parametrize(
    ("slope", "radius", "road"),
    [(20, 0, "asphalt"), (18, 0.006, "gravel"), (12, 0, "snow"), (6, 0, "ice")],
)
def test_the_road_is_classified_by_the_rule(slope, radius, road):
    data = drive(slope, radius=radius, n=8000)
    _, estimate = run(estimator_of("slip-slope", LOAD, SETTINGS), data)
    assert ROADS[int(estimate.value[-1, 3]) - 1] == road
    assert 0 <= estimate.std[-1, 3] < 1


@pytest.mark.parametrize(("slope", "radius"), [(15.0, 0.0), (9.0, 0.0), (9.0, 0.006)])
def test_the_spread_of_the_road_is_that_of_the_slope_about_its_limits(slope, radius):
    data = drive(slope, radius=radius)
    _, estimate = run(estimator_of("slip-slope", LOAD, SETTINGS), data)
    seen, std, road = estimate.value[-1, 0], estimate.std[-1, 0], estimate.value[-1, 3]
    stiff, soft = norm.sf((np.array([0.75, 0.45]) * 20 - seen) / std)
    # Numbers of asphalt, gravel, snow and ice, on a smooth or on a rough road.
    chances = [0, soft, 1 - soft, 0] if radius else [stiff, 0, soft - stiff, 1 - soft]
    expected = np.sqrt(np.sum(chances * (np.arange(1, 5) - road) ** 2))
    assert expected > 0.01
    np.testing.assert_allclose(estimate.std[-1, 3], expected, rtol=0.05)


def test_the_rule_of_the_roads_is_right_at_its_limits():
    cases = {(0.75, False): 1, (0.74, False): 3, (0.45, False): 3, (0.44, False): 4}
    cases |= {(0.75, True): 2, (0.45, True): 2, (0.44, True): 3}
    for (relative, rough), number in cases.items():
        assert float(road_of(relative, rough)) == number


def test_a_change_of_the_road_is_detected_and_tracked():
    slope = np.where(np.arange(8000) < 4000, 20.0, 9.0)
    data = drive(slope, n=8000, use=0.25)
    estimator = estimator_of("slip-slope", LOAD, SETTINGS)
    _, estimate = run(estimator, data)
    alarms = data["time"][estimate.flag == code(Flag.CHANGED)]
    assert len(alarms) and 40 < alarms[0] < 46
    assert abs(estimate.value[-1, 0] - 9) < 4 * estimate.std[-1, 0]
    # Without the raised covariance the walk alone is slower.
    two = np.searchsorted(data["time"], alarms[0] + 4)
    assert abs(estimate.value[two, 0] - 9) < 2


def test_only_braking_takes_the_force_from_the_pressure():
    settings = SETTINGS | {"gain": 5e-4, "gain_spread": 0.1}
    estimator = estimator_of("slip-slope-braking", LOAD, settings)
    _, estimate = run(estimator, drive(20.0, use=0.4))
    value, std = estimate.value[-1, 0], estimate.std[-1, 0]
    assert abs(value - 20) < 0.05 * 20
    assert 0.1 * value <= std < 0.12 * value  # the gain's own spread stays
    outside = np.flatnonzero(drive(20.0, use=0.4)["brake_pressure"] == 0)
    flags = {FLAGS[k] for k in estimate.flag[outside[outside > 400]][::50]}
    assert Flag.OUT_OF_RANGE in flags
    wrong = estimator_of("slip-slope-braking", LOAD, settings | {"gain": 4e-4})
    _, biased = run(wrong, drive(20.0, use=0.4))
    assert abs(biased.value[-1, 0] / value - 0.8) < 0.02  # an error of the gain is one


def test_force_beyond_the_linear_part_is_not_used():
    data = drive(20.0, use=0.8, n=2000)
    _, estimate = run(estimator_of("slip-slope", LOAD, SETTINGS), data)
    large = np.abs(data["fx"]) > 0.5 * LOAD
    held = estimate.flag[large] == code(Flag.OUT_OF_RANGE)
    assert held.mean() > 0.8
