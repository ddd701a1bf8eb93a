"""Braking stiffness from the vibration of a wheel, with known poles and independent
computations.

The wheels are made by ``shaken`` without a tire; the tire that is simulated with its
brake is in ``tests/sim/test_xbs_in_the_loop.py``.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from shaken import CORNER, RATE, SCALE, speeds

import tirefit
from tirefit.data.read import read_frame
from tirefit.models import TireInputs
from tirefit.models.brush import AnisotropicBrush, Brush
from tirefit.models.combined import braking_slope, mu_rate
from tirefit.online.base import FLAGS, Flag
from tirefit.online.braking.xbs import Xbs, XbsBraking, rate_in_use, relation, speed_spectrum
from tirefit.online.run import Stream, run

SLIDING = 5.0
"""Speed [m/s] about which the wheels turn here."""


def estimator(**settings):
    return Xbs(**({"road_corner": CORNER, "rate": RATE} | settings))


def followed(record, told):
    """(pole, its std, printed) (n, m, 3) and flags after each given sample (n, m)."""
    n, m = told.shape
    # Few sizes, each of which is compiled.
    rows, columns = 1500 if n <= 1500 else 3000, next(x for x in (1, 100, 300) if m <= x)
    padded = np.zeros((rows, columns))
    padded[:n, :m] = told
    numbers, flags = map(np.asarray, _followed(record, padded))
    return numbers[:n, :m], flags[:n, :m]


@jax.jit
def _followed(record, told):
    def one(column):
        def step(state, speed):
            after, made = record.step(state, {"omega": speed / record.radius})
            *numbers, _ = record.pole(after)
            return after, (jnp.stack(numbers), made.flag)

        return jax.lax.scan(step, record.init(), SLIDING + column)[1]

    numbers, flags = jax.vmap(one, 1)(told)
    return jnp.swapaxes(numbers, 0, 1), flags.T


def passed(told, rate=RATE, low=2.0, high=20.0):
    """The band-pass of O by SciPy, from rest at the first sample."""
    sections = [
        scipy.signal.butter(2, edge, kind, fs=rate, output="sos")
        for edge, kind in ((low, "highpass"), (high, "lowpass"))
    ]
    return scipy.signal.sosfilt(np.concatenate(sections), told - told[0])


@eqx.filter_jit
def _stepped(record, state, sample):
    return record.step(state, sample)


def stepped(record, state, speed, reference=0.0, use=1.0):
    """State and estimate after one more sample, by one program."""
    sample = {"omega": speed / 0.3, "reference": reference, "use": use}
    return _stepped(record, state, {key: np.asarray(value) for key, value in sample.items()})


def test_the_filtered_speed_agrees_with_scipy():
    told = 10 - 3 * np.arange(300) / RATE + speeds(np.full(300, 60.0), 1)[:, 0]
    record, state, filtered = estimator(), estimator().init(), []
    for speed in told:
        state, _ = stepped(record, state, speed)
        filtered.append(float(state.filtered))
    np.testing.assert_allclose(filtered, passed(told), atol=1e-12)


def regression(told, settling):
    """y and phi of O(3)-(7) with k r^2/J as the unknown, from the settled rows."""
    v = passed(told)
    increments = np.diff(v, prepend=0.0)
    y = np.diff(increments, prepend=0.0)[settling:]
    return y, -increments[settling - 1 : -1] / RATE


def test_without_forgetting_it_agrees_with_least_squares():
    told = speeds(np.full(700, 60.0), 1, push=10.0)
    record = estimator(forgetting=1.0)
    numbers, _ = followed(record, told)
    y, phi = regression(told[:, 0], settling=80)
    k = np.linalg.lstsq(phi[:, None], y)[0][0]
    np.testing.assert_allclose(numbers[-1, 0, 2], k, rtol=1e-9)


def test_with_forgetting_it_agrees_with_the_recursion_of_the_source():
    told = speeds(np.full(700, 60.0), 1, push=10.0)
    numbers, _ = followed(estimator(forgetting=0.98), told)
    k, gamma = 0.0, 1e12
    for y, phi in zip(*regression(told[:, 0], settling=80), strict=True):
        gain = gamma * phi / (0.98 + phi * gamma * phi)
        k += gain * (y - phi * k)
        gamma = (gamma - gain * phi * gamma) / 0.98
    np.testing.assert_allclose(numbers[-1, 0, 2], k, rtol=1e-6)


@pytest.mark.parametrize("pole", [1.0, 30.0, 300.0])
def test_sampling_alone_makes_the_estimate_two_thirds_of_the_pole(pole):
    angle = (np.arange(200_000) + 0.5) * np.pi / 200_000
    power = speed_spectrum(angle, pole, 0.0, 1 / RATE)
    printed = RATE * (1 - np.mean(power * np.cos(angle)) / np.mean(power))
    # Increments of an integrated first-order process, by their autocovariances.
    x = pole / RATE
    correlation = np.expm1(-x) ** 2 / (2 * (x + np.expm1(-x)))
    np.testing.assert_allclose(printed, RATE * (1 - correlation), rtol=1e-3)
    if x < 0.01:
        assert abs(printed / pole - 2 / 3) < 2e-3


@pytest.mark.parametrize("corner", [0.0, 1.0, 200.0])
def test_the_spectrum_agrees_with_the_aliased_continuous_one(corner):
    angle = np.linspace(0.05, 3.0, 9)
    pole, c = 60.0, 2 * np.pi * corner
    folds = angle + 2 * np.pi * np.arange(-3000, 3001)[:, None]
    omega = folds * RATE
    folded = (1 / ((omega**2 + pole**2) * (omega**2 + c**2))).sum(0)
    expected = folded * (2 - 2 * np.cos(angle))
    ratio = speed_spectrum(angle, pole, c, 1 / RATE) / expected
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)


def test_the_relation_rises_with_the_pole():
    for corner in (0.0, 1.0, 20.0):
        table = relation(RATE, 2.0, 20.0, corner)
        assert np.all(np.diff(table.printed) > 0)
    # What the docstring says of the source's own band.
    table = relation(200.0, 2.0, 20.0, 0.0)
    np.testing.assert_allclose(table.printed[[0, -1]], [3.65, 24.2], atol=0.7)


# 300 wheels know the median of a spread of 30 % to 2.2 %, and a standard deviation by
# quantiles to 6 %. The error of a ratio of two sums, over a memory of 1 s, adds 3 %.
@pytest.mark.parametrize("pole", [15.0, 30.0, 60.0, 120.0, 200.0])
def test_the_pole_is_found_within_the_stated_spread(pole):
    numbers, flags = followed(estimator(), speeds(np.full(1500, pole), 300))
    value, std, printed = np.moveaxis(np.asarray(numbers[-1]), 1, 0)
    spread = np.diff(np.quantile(value, [0.159, 0.841]))[0] / 2
    assert abs(np.median(value) / pole - 1) < 0.1
    assert abs(np.median(std) / spread - 1) < 0.3
    assert 0.55 < np.mean(abs(value - pole) < std) < 0.88
    assert np.mean(abs(value - pole) < 2 * std) > 0.85
    assert 0.15 < spread / pole < 0.65  # and it says something
    # The estimate as printed is nowhere near.
    assert np.mean(printed) < 0.6 * pole
    assert np.mean(np.asarray(flags)[-1] == 0) > 0.9


def test_a_slow_pole_is_not_distinguished_from_none():
    numbers, _ = followed(estimator(), speeds(np.full(1500, 3.0), 200))
    value, std, _ = np.moveaxis(np.asarray(numbers[-1]), 1, 0)
    # Far below the band: the standard deviation is larger than the value.
    assert np.mean(std > 3.0) > 0.9
    assert np.mean(abs(value - 3.0) < 2 * std) > 0.9


@pytest.mark.parametrize(("before", "after", "latest"), [(150, 40, 0.4), (40, 150, 2.0)])
def test_the_delay_is_short_when_the_stiffness_falls(before, after, latest):
    """The noisier estimate has more weight, so that a fall, which leads to locking, is
    detected sooner than a rise: half of it within 0.23 s, with a memory of 1 s."""
    poles = np.r_[np.full(1500, float(before)), np.full(1500, float(after))]
    numbers, _ = followed(estimator(), speeds(poles, 100))
    median = np.median(np.asarray(numbers)[:, :, 0], axis=1)
    half = np.sqrt(before * after)
    crossed = (median[1500:] < half) == (after < before)
    delay = np.argmax(crossed) / RATE
    assert latest / 3 < delay < latest


def test_sensor_noise_is_corrected():
    pole, noise = 60.0, 0.01
    told = speeds(np.full(1500, pole), 200, push=4.0, speed_noise=noise)
    plain, _ = followed(estimator(), told)
    aware, _ = followed(estimator(speed_noise=noise), told)
    off = np.median(np.asarray(plain)[-1, :, 0]) / pole
    value, std = np.moveaxis(np.asarray(aware)[-1, :, :2], 1, 0)
    assert off > 1.2
    assert abs(np.median(value) / pole - 1) < 0.1
    assert abs(np.median(std) / np.std(value) - 1) < 0.3


def test_unreliable_estimates_are_flagged():
    random = np.random.default_rng(0)
    noise = 0.01 * random.normal(size=(1000, 1))
    numbers, flags = followed(estimator(speed_noise=0.01), noise)
    said = {FLAGS[code] for code in np.asarray(flags)[200:, 0]}
    assert said == {Flag.LITTLE_EXCITATION}
    assert np.isnan(np.asarray(numbers)[-1]).all()
    smooth, flags = followed(estimator(), np.zeros((300, 1)))
    assert FLAGS[int(flags[-1, 0])] is Flag.LITTLE_EXCITATION
    told = speeds(np.full(1500, 5000.0), 40)
    _, flags = followed(estimator(), told)
    stiff = np.asarray(flags)[-1] == FLAGS.index(Flag.OUT_OF_RANGE)
    assert 0.2 < np.mean(stiff) < 0.9  # half of them, by chance, just inside
    assert FLAGS[int(flags[60, 0])] is Flag.SETTLING


def test_the_gain_of_the_servo_is_corrected():
    told = speeds(np.full(800, 60.0), 3)
    sample = {"omega": (SLIDING + told[:, 0]) / 0.3, "time": np.arange(800) / RATE}
    free = run(estimator(), sample)[1]
    held = run(estimator(servo_gain=20.0), sample)[1]
    np.testing.assert_allclose(free.value[-1, 0] - held.value[-1, 0], 20 * SCALE)
    np.testing.assert_allclose(free.std[-1, 0], held.std[-1, 0])


def test_the_reference_of_the_servo_is_corrected():
    told = speeds(np.full(200, 60.0), 1)[:, 0]
    path = 3 * np.sin(np.arange(200) / 20)  # in the middle of the band
    record = estimator()
    plain = moved = record.init()
    for speed, reference in zip(told, path, strict=True):
        plain, one = stepped(record, plain, speed)
        moved, two = stepped(record, moved, speed + reference, reference)
    assert np.isfinite(one.value[0])
    np.testing.assert_allclose(one.value[0], two.value[0], rtol=1e-7)


def test_unusable_samples_update_only_the_filter():
    told = speeds(np.full(300, 60.0), 1)[:, 0]
    record = estimator()
    state = record.init()
    for i, speed in enumerate(told):
        before = state
        state, _ = stepped(record, state, speed, use=float(not 150 <= i < 200))
        if i == 170:
            assert float(state.sums[0]) == float(before.sums[0])
            assert float(state.filtered) != float(before.filtered)
    assert float(state.sums[2]) < (1 - 0.995**170) / 0.005 + 1e-6


def test_a_gap_restarts_the_filter_and_reduces_the_past():
    told = SLIDING + speeds(np.full(2000, 60.0), 1)[:, 0]
    time = np.arange(2000) / RATE
    kept = np.r_[:1000, 1040:2000]
    rows = run(estimator(), {"time": time[kept], "omega": told[kept] / 0.3})[1]
    assert FLAGS[rows.flag[1000]] is Flag.GAP
    assert {FLAGS[f] for f in rows.flag[1001:1079]} == {Flag.SETTLING}
    assert rows.flag[1081] == 0
    assert np.all(np.isfinite(rows.value[999:]))
    np.testing.assert_allclose(rows.value[1060, 0], rows.value[1001, 0])


def test_a_log_of_another_rate_is_reported():
    told = SLIDING + speeds(np.full(300, 60.0), 1)[:, 0]
    rows = run(estimator(), {"time": np.arange(300) / 100, "omega": told / 0.3})[1]
    assert FLAGS[rows.flag[-1]] is Flag.GAP


def test_several_wheels_give_the_results_of_each_alone():
    told = SLIDING + speeds(np.full(120, 60.0), 4)
    record = estimator()
    both = jax.jit(jax.vmap(lambda s, w: record.step(s, {"omega": w})))
    states = jax.vmap(lambda _: record.init())(jnp.arange(4))
    for row in told / 0.3:
        states, together = both(states, row)
    for wheel in (0, 3):
        stream = Stream(record)
        for i in range(120):
            alone = stream.push({"time": i / RATE, "omega": told[i, wheel] / 0.3})
        np.testing.assert_allclose(together.value[wheel], alone.value, rtol=1e-9)


def test_a_rise_is_detected_sooner_if_a_noisier_past_is_forgotten():
    poles = np.r_[np.full(1500, 20.0), np.full(1000, 250.0)]
    told, delays = speeds(poles, 100), []
    for quiet in (0.0, 0.3):
        numbers, _ = followed(estimator(quiet=quiet), told)
        median = np.median(np.asarray(numbers)[1500:, :, 0], axis=1)
        delays.append(np.argmax(median > np.sqrt(20 * 250)) / RATE)
    assert delays[1] < 0.7 * delays[0]
    # And where nothing changes it changes nothing.
    still, _ = followed(estimator(quiet=0.15), speeds(np.full(1200, 60.0), 100))
    plain, _ = followed(estimator(), speeds(np.full(1200, 60.0), 100))
    still, plain = np.median(still[-1, :, 0]), np.median(plain[-1, :, 0])
    np.testing.assert_allclose(still, plain, rtol=0.02)


@pytest.mark.parametrize("delay", [0.01, 0.0125])
def test_the_relation_includes_the_delay_of_the_servo(delay):
    """A wheel of pole p under a delayed servo, in small steps of NumPy: the tire's pole
    is found only if the delay is known."""
    gain, pole, m, fine = 60.0, 20.0, 100, 4
    dt, late = 1 / RATE / fine, round(delay * RATE * fine)
    random = np.random.default_rng(0)
    kept = np.exp(-2 * np.pi * CORNER * dt)
    d, x = random.normal(size=m), np.zeros(m)
    past, rows = [np.zeros(m)] * late, []
    for i in range(1800 * fine):
        past.append(x)
        x = x + dt * (d - pole * x - gain * past[i])
        d = kept * d + np.sqrt(1 - kept**2) * random.normal(size=m)
        if i % fine == fine - 1:
            rows.append(x)
    told = np.array(rows)
    known = estimator(servo_gain=gain, servo_delay=delay)
    right = np.median(followed(known, told)[0][-1, :, 0])
    wrong = np.median(followed(estimator(servo_gain=gain), told)[0][-1, :, 0])
    assert abs(right / (gain + pole) - 1) < 0.12
    assert abs(wrong / (gain + pole) - 1) > 1.5 * abs(right / (gain + pole) - 1)
    assert abs(wrong / (gain + pole) - 1) > 0.15


@pytest.mark.parametrize("rate", [100.0, 400.0])
def test_the_rate_of_a_log_is_found(rate):
    time = np.arange(round(4 * rate)) / rate
    told = 10 + speeds(np.full(round(4 * RATE), 60.0), 1)[:, 0]
    columns = {
        "time": time,
        "omega": np.interp(time, time[-1] * np.linspace(0, 1, 800), told) / 0.3,
    }
    columns |= {"fz": np.full(len(time), LOAD)}
    data = read_frame(columns, curve=False, convention="braking")
    done = tirefit.estimate(data, "xbs")
    assert done["xbs"].settings["rate"] == pytest.approx(rate)
    assert np.mean(done["xbs"].flag == 0) > 0.6


@pytest.mark.parametrize("settings", [{"low": 20.0, "high": 2.0}, {"high": 120.0}])
def test_a_band_above_the_sample_rate_is_refused(settings):
    with pytest.raises(ValueError, match="edges must rise and lie below 100 Hz"):
        estimator(**settings)


# O(22) and the friction that follows from it.

BRUSH = Brush(cpa2=3e4, mu=0.35)
LOAD = 4000.0


@pytest.mark.parametrize("direction", [0.0, 0.4, 1.2])
@pytest.mark.parametrize("rate", [0.05, 0.5, 0.9, 0.999])
def test_the_use_of_friction_inverts_the_slope(rate, direction):
    slope = braking_slope(rate, 6e4, direction)
    np.testing.assert_allclose(rate_in_use(slope, 6e4, direction), rate, rtol=1e-9)


def test_impossible_slopes_give_no_use_of_friction():
    assert float(rate_in_use(-1e3, 6e4)) == 1.0
    assert float(rate_in_use(7e4, 6e4)) == 0.0


@pytest.mark.parametrize("sigma", [0.005, 0.03, 0.06])
def test_the_slope_agrees_with_the_derivative_of_the_brush(sigma):
    rate = mu_rate(sigma, 6e4, 0.35 * LOAD)
    along = jax.grad(lambda x: BRUSH(TireInputs(x, 0.0, LOAD)).fx)(sigma)
    np.testing.assert_allclose(braking_slope(rate, 6e4, 0.0), along, rtol=1e-9)
    force = float(BRUSH(TireInputs(sigma, 0.0, LOAD)).fx)
    friction = force / (rate_in_use(along, 6e4) * LOAD)
    np.testing.assert_allclose(friction, 0.35, rtol=1e-9)


def test_the_combined_slope_agrees_with_the_derivative_at_fixed_lateral_slip():
    tire = AnisotropicBrush(3e4, 0.35, stiffness_ratio=0.7)
    x, side = 0.03, 0.04  # kappa_x and kappa_y = 0.7 sigma_y

    def fx(sigma):
        angle = jnp.arctan(side / 0.7 / (1 + sigma))
        return tire(TireInputs(sigma, angle, LOAD)).fx

    rate = mu_rate(np.hypot(x, side), 6e4, 0.35 * LOAD)
    slope = braking_slope(rate, 6e4, np.arctan2(side, x))
    np.testing.assert_allclose(slope, jax.grad(fx)(x), rtol=1e-9)


def test_at_a_given_vehicle_speed_the_slope_is_one_plus_the_slip_larger():
    """v_w k of O(22) ignores that the slip is relative to the wheel's own speed."""
    v, turning = 15.0, 14.4
    k = -jax.grad(lambda w: BRUSH(TireInputs(v / w - 1, 0.0, LOAD)).fx)(turning)
    sigma = v / turning - 1
    rate = mu_rate(sigma, 6e4, 0.35 * LOAD)
    np.testing.assert_allclose(turning * k, (1 + sigma) * braking_slope(rate, 6e4, 0.0), rtol=1e-9)


def test_friction_is_estimated_from_pressure_and_vibration():
    """A wheel at 85 % of the friction of a road of 0.35, at a constant speed."""
    rate, speed = 0.85, 12.0
    force = rate * 0.35 * LOAD
    pole = float(braking_slope(rate, 6e4, 0.0)) / speed / SCALE
    told = speed + speeds(np.full(3000, pole), 40)[-2000:]
    record = XbsBraking(rate=RATE, road_corner=CORNER, stiffness=6e4, gain=4e-4)
    ends = []
    for column in told.T:
        log = {"time": np.arange(2000) / RATE, "omega": column / 0.3}
        log |= {"brake_pressure": np.full(2000, force / 4e-4), "fz": np.full(2000, LOAD)}
        rows = run(record, log)[1]
        ends.append(np.r_[rows.value[-1], rows.std[-1]])
    ends = np.array(ends)
    used, mu, used_std, mu_std = ends[:, [1, 2, 4, 5]].T
    assert abs(np.median(used) - rate) < 0.02
    assert abs(np.median(mu) - 0.35) < 0.01
    for value, truth, std in ((used, rate, used_std), (mu, 0.35, mu_std)):
        # The stiffness, which is known to 10 %, has no error here.
        assert np.sqrt(np.mean(((value - truth) / std) ** 2)) < 1.3
        assert np.median(std) < 0.15
