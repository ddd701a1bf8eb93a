"""The correlation of a noise, with and without smooth functions removed from it."""

import numpy as np
import pytest

from tirefit.diagnosis.rows.noise import FORGETFUL, Memory, correlation, memory_of
from tirefit.fitting.problem.noise import effective_inflation

ROWS = 1200
TIME = np.linspace(0, 1, ROWS)


def smooth(count):
    """Orthonormal waves, slow ones first: (ROWS, count)."""
    turns = np.arange(1, count // 2 + 1) * 2 * np.pi
    angle = TIME[:, None] * turns
    both = np.concatenate([np.sin(angle), np.cos(angle)], axis=1)
    return np.linalg.qr(both)[0]


def noise(memory, seed):
    generator = np.random.default_rng(seed)
    values, x = np.empty(ROWS), generator.standard_normal()
    for row in range(ROWS):
        values[row] = x
        x = memory.fade * x + np.sqrt(1 - memory.fade**2) * generator.standard_normal()
    return values


def may_be(values, unit, stretches=(np.arange(ROWS),)):
    return memory_of(values - unit @ (unit.T @ values), unit, stretches)


def judged(*given):
    """The likeliest correlation."""
    return may_be(*given)[0]


@pytest.mark.parametrize("count", [4, 200])
def test_independent_rows_have_no_correlation(count):
    unit = smooth(count)
    found = [judged(noise(FORGETFUL, seed), unit) for seed in range(20)]
    assert sum(memory.fade > 0 for memory in found) <= 2


@pytest.mark.parametrize("count", [4, 200])
@pytest.mark.parametrize("memory", [Memory(0.5), Memory(0.65)])
def test_a_correlation_is_found_after_any_fit(memory, count):
    found = [judged(noise(memory, seed), smooth(count)) for seed in range(8)]
    lag_one = np.mean([one.fade for one in found])
    assert lag_one == pytest.approx(memory.fade, abs=0.08)
    each = np.median([one.rows_each for one in found])
    assert each == pytest.approx(memory.rows_each, rel=0.35)


def test_breaks_end_the_correlation():
    values = np.repeat(np.random.default_rng(3).standard_normal(ROWS // 2), 2)
    pairs = list(np.arange(ROWS).reshape(-1, 2))
    assert judged(values, smooth(4)).fade > 0
    assert judged(values, smooth(4), pairs) == FORGETFUL


def test_the_correlation_gives_the_number_of_independent_rows():
    """Variance of the mean of many rows over that of independent ones."""
    memory = Memory(0.6)
    means = [noise(memory, seed).mean() for seed in range(300)]
    assert np.var(means) * ROWS == pytest.approx(memory.rows_each, rel=0.25)


def test_likely_correlations_contain_the_truth():
    """150 rows do not distinguish 0.5 from 0.35: each has its probability."""
    truth, held = Memory(0.5), []
    rows, unit = np.arange(150), np.linalg.qr(smooth(4)[:150])[0]
    for seed in range(12):
        values = noise(truth, seed)[:150]
        found = memory_of(values - unit @ (unit.T @ values), unit, [rows])
        chances = [one.chance for one in found]
        assert sum(chances) == pytest.approx(1) and chances == sorted(chances)[::-1]
        near = [one for one in found if abs(one.rows_each - truth.rows_each) < 1.2]
        held.append(sum(one.chance for one in near))
    assert len(found) > 1 and np.mean(held) > 0.4


@pytest.mark.parametrize("fade", [0.42, 0.6, 0.85])
def test_a_correlation_between_the_grid_values_is_found(fade):
    found = [may_be(noise(Memory(fade), seed), smooth(40)) for seed in range(6)]
    usual = [sum(one.chance * one.fade for one in each) for each in found]
    assert np.mean(usual) == pytest.approx(fade, abs=0.04)


def test_with_known_noise_a_slow_gap_is_not_taken_for_correlation():
    """With a correlation of 0.9, neighbours would differ by a third of the stated
    noise."""
    walk = np.cumsum(np.random.default_rng(1).standard_normal(ROWS)) / 12
    values = noise(FORGETFUL, 2) + walk
    rows, unit = [np.arange(ROWS)], smooth(4)
    values = values - unit @ (unit.T @ values)
    free, held = (memory_of(values, unit, rows, most)[0] for most in (np.inf, 1))
    assert held.rows_each < free.rows_each
    # Noise that is as large as it was stated has the same memory.
    own = noise(Memory(0.6), 3)
    own = own - unit @ (unit.T @ own)
    free, held = (memory_of(own, unit, rows, most)[0] for most in (np.inf, 1.3))
    assert held.fade == free.fade


@pytest.mark.parametrize("fade", [0.0, 0.6, 0.8])
def test_intervals_by_the_number_of_independent_rows_hold(fade):
    """By the contributions to a gradient, as a fit counts, and by the noise alone, as a
    diagnosis weighs; the number itself has an error, which widens some intervals more. 400
    intervals hold in 95 % with a standard error of 1.1 %."""
    generator, held = np.random.default_rng(6), np.zeros(2)
    for seed in range(400):
        x = np.sin(12 * np.pi * TIME + generator.uniform(0, 2 * np.pi))
        values = noise(Memory(fade), seed)
        slope = x @ values / (x @ x)
        rest, run = values - slope * x, np.zeros(ROWS, int)
        each = effective_inflation((rest * x)[:, None], run, TIME), correlation(rest, TIME, run)
        held += abs(slope) < 1.96 * np.sqrt(np.array(each) * np.var(rest) / (x @ x))
    assert np.all((held / 400 > 0.915) & (held / 400 < 0.99))
