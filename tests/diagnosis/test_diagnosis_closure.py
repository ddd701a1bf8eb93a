"""Closure against known truths: of energies, and of the interval."""

from types import SimpleNamespace

import numpy as np
import pytest

from tirefit.diagnosis.engine.decide import Status
from tirefit.diagnosis.engine.left_out import NOISE, SMOOTH, Ladder, Step
from tirefit.diagnosis.summary.closure import closure_of, gaps_of, of_the_ladder, on_files
from tirefit.diagnosis.summary.document import _gap
from tirefit.diagnosis.summary.result import Shrinkage

ROWS = 240
ALONE = np.zeros(ROWS, int)


def test_closure_of_known_forces():
    generator = np.random.default_rng(0)
    gap = 40 * np.sin(np.arange(ROWS))
    noise = 10 * generator.standard_normal(ROWS)
    variance = np.full(ROWS, 100.0)
    # No more is claimed than that the gap is not doubled.
    worst = closure_of(noise + gap, noise - 8 * gap, variance, ALONE, 1.0, generator)
    assert worst.closed == -1 and worst.resolvable
    # A gap of 1.2 times the least energy is not resolved by a fifth of the independent rows.
    steady = np.full(ROWS, np.sqrt(1.2 * 3 * np.sqrt(2 / ROWS) * 100.0 + 100.0))
    for rows_each, seen in ((1.0, True), (5.0, False)):
        tiny = closure_of(steady, 0 * gap, variance, ALONE, rows_each, generator)
        assert tiny.resolvable is seen is (tiny.closed is not None)
    # Where one run is closed and another is not, both are all that is known.
    halves = np.repeat([0, 1], ROWS // 2)
    mixed = np.where(halves == 0, 0.0, gap) + noise
    apart = closure_of(gap + noise, mixed, variance, halves, 1.0, generator)
    assert apart.closed_ci[0] == -1 and apart.closed_ci[1] == 1


def test_gaps_are_those_of_the_base_and_of_the_answer_on_the_rows_that_are_used():
    """Two channels; an excluded row; one fitted number, with two rows for an independent one."""
    observed = {"fx": np.array([5.0, 1.0, 900.0]), "mz": np.array([2.0, 2.0, 2.0])}
    level = SimpleNamespace(std=np.ones(3), inflation=2.0, outlier=np.array([False, False, True]))
    rows = SimpleNamespace(channels=("fx", "mz"), observed=observed, n=3, run=np.zeros(3, int))
    forces = {0.0: {"fx": np.zeros(3), "mz": np.zeros(3)}, 7.0: observed}
    noise = {"fx": level, "mz": level}
    base = SimpleNamespace(rows=rows, noise=noise, forces=lambda z: forces[z])
    case = SimpleNamespace(
        base=base, before=(0.0,), numbers_of=lambda fit: (7.0,),
        chosen=SimpleNamespace(pull=np.zeros(1)),
    )  # fmt: skip
    gaps = gaps_of(case, np.random.default_rng(0))
    noise = 1 - 2 / 3
    assert gaps["fx"].rms == pytest.approx(np.sqrt((25 + 1) / 2 - noise))
    assert gaps["mz"].rms == pytest.approx(np.sqrt(4 - noise)) and gaps["mz"].closed > 0.5


def test_without_an_effect_the_gap_is_the_one_that_smooth_functions_locate():
    verdict = SimpleNamespace(key=(), status=Status.UNKNOWN)
    case = SimpleNamespace(verdict=verdict, base=SimpleNamespace(simulator=None))
    gap = Shrinkage(rms=9.0, resolvable=True, closed=0.5, closed_ci=(0.4, 0.6), remaining_rms=4.5)
    alone = _gap(case, gap, np.array([3.0, 4.0, 0.0, 0.0]))
    assert (alone.rms, alone.remaining_rms) == (2.5, 2.5)
    assert (alone.closed, alone.closed_ci, alone.resolvable) == (0.0, (0.0, 0.0), True)
    verdict.status = Status.NONE
    assert not _gap(case, gap, np.ones(4)).resolvable
    verdict.key, verdict.status = ("slip_offset",), Status.NAMED
    assert _gap(case, gap, np.ones(4)) == gap


def test_closure_is_right_for_known_energies():
    generator = np.random.default_rng(0)
    n = 4000
    noise, run = 10 * generator.standard_normal(n), np.zeros(4000, int)
    gap, variance = 40 * np.sin(np.arange(n)), np.full(n, 100.0)
    found = closure_of(gap + noise, 0.2 * gap + noise, variance, run, 1.0, generator)
    assert found.rms == pytest.approx(40 / np.sqrt(2), rel=0.02)
    assert found.closed == pytest.approx(0.8, abs=0.02)
    assert found.closed_ci[0] < 0.8 < found.closed_ci[1]


def test_the_gap_on_parts_left_out_is_that_beyond_the_noise():
    """5^2 = 4^2 + 3^2; 90 % are 1.645 standard errors, within the range of a closure."""
    last = Step(SMOOTH, 4.0, 0.9, 0.0, 0.0, 0.0), Step(NOISE, 3.0, 1.0, 0.0, 0.0, 0.0)
    ends = {0.1: (0.4 - 0.1645, 0.4 + 0.1645), 0.9: (-1.0, 1.0)}
    for std, interval in ends.items():
        steps = Step((), 5.0, 0.0, 0.0, 0.0, 0.0), Step(("one",), 4.2, 0.4, std, 0.0, 0.0)
        found = of_the_ladder(Ladder("parts", (*steps, *last)))
        assert (found.rms, found.closed) == (pytest.approx(4.0), 0.4)
        assert found.remaining_rms == pytest.approx(0.6 * 4.0)
        np.testing.assert_allclose(found.closed_ci, interval, atol=1e-4)


def test_steps_close_the_gap_of_held_out_files_beyond_the_noise():
    """Mean squares of 25, 13 and 40 beside 9 of noise: gaps of 4, 2 and more than 4."""
    sets = (), ("one",), ("one", "two"), SMOOTH
    ladder = Ladder("parts", tuple(Step(x, 5.0, 0.0, 0.0, 0.0, 0.0) for x in sets))
    left = {(): np.array([3.0, -np.sqrt(41)])}
    left |= {sets[1]: np.full(2, 13**0.5), sets[2]: np.full(2, 40**0.5)}
    gap = Shrinkage(rms=4.0, resolvable=True, closed=0.5, closed_ci=(0.4, 0.6), remaining_rms=2.0)
    held, found = on_files(ladder, gap, left, np.full(2, 9.0), "other.csv")
    assert (held.on, held.rms, found.on) == ("other.csv", 4.0, "parts")
    first, one, two, smooth = found.steps
    assert (first.rms_held_out, first.closed_held_out) == (pytest.approx(5.0), 0.0)
    assert (one.rms_held_out, one.closed_held_out) == (pytest.approx(13**0.5), pytest.approx(0.5))
    assert two.closed_held_out == pytest.approx(1 - np.sqrt(31 / 16))
    assert smooth.rms_held_out is None


@pytest.mark.parametrize("rows_each", [5.0, 9.0])
def test_nine_rows_give_no_certain_closure(rows_each):
    """They are one block of the bootstrap, which has no spread: the energy of the noise is
    known to the root of 2 over the number of independent rows."""
    generator = np.random.default_rng(2)
    gap, noise = 8 * np.cos(np.arange(9)), generator.standard_normal(9)
    before, after = gap + noise, 0.5 * noise
    found = closure_of(before, after, np.ones(9), np.zeros(9, int), rows_each, generator)
    left, error = np.mean(after**2) - 1, np.sqrt(2 * rows_each / 9)
    root = np.linspace(0, 6, 6001)
    below = np.cumsum(np.exp(-0.5 * ((root**2 - left) / error) ** 2))
    ends = np.interp([0.95, 0.05], below / below[-1], root) ** 2
    closed = 1 - np.sqrt(ends / (np.mean(before**2 - after**2) + ends))
    np.testing.assert_allclose(found.closed_ci, closed, atol=0.01)


def test_closure_contains_the_truth_in_90_percent():
    """The remainder is below the noise or at its level: 200 files."""
    held, off = [], []
    for seed in range(200):
        generator = np.random.default_rng(seed)
        gap = np.sqrt(2) * np.sin(np.arange(ROWS))
        other = np.sqrt(2) * np.cos(1.7 * np.arange(ROWS))
        share = 0.6 * generator.random()
        noise = generator.standard_normal(ROWS)
        found = closure_of(gap + noise, share * other + noise, np.ones(ROWS), ALONE, 1.0, generator)
        held.append(found.closed_ci[0] <= 1 - share <= found.closed_ci[1])
        off.append(found.closed - (1 - share))
        # Nobody knows that nothing at all is left.
        assert found.closed < 1
    assert 0.83 <= np.mean(held) <= 0.97
    assert abs(np.mean(off)) < 0.05
