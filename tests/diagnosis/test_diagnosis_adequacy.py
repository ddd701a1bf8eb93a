"""The tests of adequacy: right under noise, each sharp where it should be."""

import numpy as np
import pytest
from scipy.stats import binom
from tirefit.diagnosis.decide.adequacy import (
    LEAST_P,
    LEVEL,
    Adequacy,
    Null,
    _left_out,
    _p_value,
    adequacy,
    null,
    refused,
)
from tirefit.diagnosis.decide.standing import _worst

from tirefit.diagnosis.noise.memory import FORGETFUL, Memory

ROWS = 240
TIME = np.arange(ROWS)
SLIP = 0.25 * np.sin(2 * np.pi * TIME / 60)
LOADS = np.repeat([2.0, 4.0, 6.0], ROWS // 3)
COLUMNS = np.stack([SLIP, SLIP**3, LOADS * SLIP, np.ones(ROWS)], axis=1)


def settings():
    """Rows of each load and direction in the order of slip."""
    turning = np.sign(np.gradient(SLIP))
    code = LOADS * 10 + turning
    order = np.lexsort((SLIP, code))
    return np.split(order, np.flatnonzero(np.diff(code[order])) + 1)


def groups():
    order = np.argsort(SLIP, kind="stable")
    return [order[LOADS[order] == load] for load in (2.0, 4.0, 6.0)]


NOTHING = np.zeros((ROWS, 0))


def judged(residual, seed=0, memory=FORGETFUL, doubt=NOTHING):
    of_noise = null(
        COLUMNS, doubt, [TIME], [1.0], [(memory,)], [TIME], np.random.default_rng(seed)
    )
    return adequacy(residual, of_noise, [TIME], settings(), groups())


def fitted(values):
    """What the columns leave of the values."""
    unit, _ = np.linalg.qr(COLUMNS)
    return values - unit @ (unit.T @ values)


def test_noise_passes_as_often_as_it_should():
    generator = np.random.default_rng(1)
    found = [
        judged(fitted(generator.standard_normal(ROWS)), k)._asdict() for k in range(60)
    ]
    low, high = binom.ppf([0.001, 0.999], 60, 0.2)
    for name in ("time", "slip_order", "line", "pure_error", "local", "held_out"):
        small = sum(one[name] <= 0.2 for one in found)
        assert low <= small <= high, (name, small)


@pytest.mark.parametrize("size", [1e-3, 1.0, 300.0])
def test_a_wrong_noise_level_is_no_finding(size):
    noise = fitted(np.random.default_rng(2).standard_normal(ROWS))
    assert judged(noise) == judged(size * noise)


def test_noise_with_a_memory_is_granted_only_where_it_was_judged_so():
    generator, noise = np.random.default_rng(3), np.zeros(ROWS)
    for k in range(1, ROWS):
        noise[k] = 0.6 * noise[k - 1] + generator.standard_normal()
    assert judged(fitted(noise), memory=Memory(0.6, 1.0)).time > 0.02
    assert judged(fitted(noise)).time < LEVEL


def test_noise_with_a_memory_is_as_long_as_it_says():
    """Lag by lag, the share that has a memory fades by its own factor."""
    part = Memory(0.7, 0.4)
    rows, generator = 400, np.random.default_rng(8)
    of_noise = null(
        np.ones((rows, 1)), np.zeros((rows, 0)), [np.arange(rows)], [2.0], [(part,)],
        [np.arange(rows)], generator,
    )  # fmt: skip
    drawn = of_noise.draws
    for lag in (1, 3):
        together = np.mean(drawn[lag:] * drawn[:-lag]) / 4.0
        assert together == pytest.approx(0.4 * 0.7**lag, abs=0.02)
    assert np.mean(drawn**2) == pytest.approx(4.0, rel=0.02)


def test_channels_that_share_a_parameter_are_fitted_together():
    """What noise of one channel does to the other's residual is in its null."""
    rows = np.arange(50)
    shared = np.concatenate([np.ones(50), 0.1 * np.ones(50)])[:, None]
    parts = [rows, rows + 50]
    of_noise = null(
        shared, np.zeros((100, 0)), parts, [1.0, 1.0], [(FORGETFUL,)] * 2, None,
        np.random.default_rng(9),
    )  # fmt: skip
    # (1 - H) has 1 - 0.01 / 1.01 / 50 in the weak channel: its mean is nearly free.
    mean = of_noise.draws[50:].mean(axis=0)
    assert np.var(mean) == pytest.approx((1 - 0.01 / 1.01) / 50, rel=0.15)
    assert np.var(of_noise.draws[:50].mean(axis=0)) < 0.02 / 50


def test_what_is_in_doubt_is_no_finding():
    off = np.sin(40 * SLIP)
    noise = np.random.default_rng(4).standard_normal(ROWS)
    residual = fitted(noise + 1.4 * off)
    assert judged(residual).slip_order < LEVEL
    assert judged(residual, doubt=1.4 * off[:, None]).slip_order > 0.05


STRUCTURES = {
    "time": 1.2 * (TIME > ROWS // 2),
    "slip_order": 1.4 * np.sin(40 * SLIP),
    "line": 0.9 * np.sin(2 * np.pi * TIME / 5),
    "local": 3.0 * np.exp(-(((SLIP - 0.1) / 0.02) ** 2) / 2) * (LOADS == 4.0),
    "held_out": 2.0 * np.abs(SLIP) / 0.25 * (LOADS == 6.0),
}


@pytest.mark.parametrize("name", STRUCTURES)
def test_each_sees_its_own_structure(name):
    noise = np.random.default_rng(4).standard_normal(ROWS)
    result = judged(fitted(noise + STRUCTURES[name]))
    assert getattr(result, name) < LEVEL, result
    assert not result.passed
    assert name in refused(result)


def chatter(period=12.0):
    """A saw tooth in the second half of every sweep."""
    tooth = 2 * (TIME / period % 1) - 1
    return 3.0 * tooth * (TIME % 50 > 25)


def test_a_wave_shows_in_noise_that_it_gives_a_memory():
    # The memory that an oscillation seems to give the noise explains its neighbours,
    # not its period.
    memory, noise = Memory(0.65, 1.0), np.random.default_rng(9).standard_normal(ROWS)
    result = judged(fitted(noise + chatter()), memory=memory)
    assert result.line < 1e-4
    assert result.time > LEVEL


def test_a_wave_keeps_its_phase_beyond_rows_that_are_set_aside():
    generator = np.random.default_rng(9)
    keep = generator.uniform(size=ROWS) > 0.25
    residual = (generator.standard_normal(ROWS) + 0.9 * np.sin(2.1 * TIME))[keep]
    n = int(keep.sum())
    of_noise = Null(generator.standard_normal((n, 999)), np.zeros((n, 1)))
    order = [np.arange(n)]

    def line(*orders):
        return adequacy(residual, of_noise, order, order, [], orders).line

    assert line(TIME[keep]) < 1e-4
    assert line() > 0.01


def test_a_wave_over_the_way_shows_though_the_speed_changes():
    generator, n = np.random.default_rng(3), 600
    way = np.cumsum(np.linspace(1.0, 3.0, n))
    residual = generator.standard_normal(n) + 0.6 * np.sin(2 * np.pi * way / 8.7)
    of_noise = Null(generator.standard_normal((n, 999)), np.zeros((n, 1)))
    order, places = [np.arange(n)], np.rint(way / way[-1] * (n - 1)).astype(int)

    def line(*orders):
        return adequacy(residual, of_noise, order, order, [], orders).line

    # Two rows in one place of the way add up; it has as many places as there are rows.
    assert len(np.unique(places)) < n
    assert line(np.arange(n), places) < 1e-4
    assert line(np.arange(n)) > 0.01


def test_beyond_all_draws_a_p_value_is_that_of_their_tail():
    generator = np.random.default_rng(2)
    many = generator.exponential(size=(40, 999))
    assert _p_value(1.0, many[0]) == np.mean(np.append(many[0], 1.0) >= 1.0)
    # 999 draws know what one in 3,000 and one in 20,000 exceeds to a factor of two.
    for size in (8.0, 10.0):
        beyond = np.log([_p_value(size, drawn) for drawn in many if drawn.max() < size])
        assert beyond.mean() == pytest.approx(-size, abs=0.25)
        assert beyond.std() < 1.1
    assert _p_value(1e9, many[0]) > 0


def test_what_was_fitted_is_no_structure():
    noise = np.random.default_rng(5).standard_normal(ROWS)
    result = judged(fitted(noise + COLUMNS @ [30.0, -200.0, 4.0, 7.0]))
    assert result.passed
    assert result == judged(fitted(noise))


def test_prediction_without_a_group_is_that_of_a_fit_without_it():
    unit, _ = np.linalg.qr(COLUMNS)
    values = np.random.default_rng(6).standard_normal((ROWS, 3))
    group = groups()[1]
    rest = np.setdiff1d(TIME, group)
    refit, *_ = np.linalg.lstsq(COLUMNS[rest], values[rest], rcond=None)
    left = values - unit @ (unit.T @ values)
    np.testing.assert_allclose(
        _left_out(group, unit)(left), values[group] - COLUMNS[group] @ refit, atol=1e-9
    )


def test_a_group_that_the_fit_rests_on_is_not_predicted():
    columns = np.column_stack([COLUMNS, LOADS == 4.0])
    unit, _ = np.linalg.qr(columns)
    assert _left_out(groups()[1], unit) is None


def test_rows_without_time_and_settings_have_no_such_tests():
    noise = np.random.default_rng(7).standard_normal(ROWS)
    alone = [np.array([k]) for k in range(ROWS)]
    draws = np.random.default_rng(0).standard_normal((ROWS, 99))
    result = adequacy(noise, Null(draws, COLUMNS), None, alone, [])
    assert result.time is None and result.pure_error is None
    assert result.held_out is None and result.local is None


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_the_floor_of_a_p_value_grows_with_the_channels(channels):
    """A report tells it by the channels of the file, tested or not."""
    floor = _p_value(1e9, np.linspace(0.0, 1.0, 999))
    here = Adequacy(None, None, floor, None, None, None, passed=False)
    elsewhere = here._replace(line=0.5)
    worst = _worst([here, *[elsewhere] * (channels - 1)])
    assert worst.line == LEAST_P * channels
