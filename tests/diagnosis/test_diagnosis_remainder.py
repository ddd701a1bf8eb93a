"""The tests of the remainder: uniform under noise, sensitive to their structure."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest_diagnosis import RIG, brush, record, refitted, weighed_of
from scipy.stats import binom

from tirefit.data.read import read_frame
from tirefit.diagnosis.decide import remainder
from tirefit.diagnosis.decide.remainder import (
    LEAST_P,
    LEVEL,
    _noise,
    _p_value,
    remainder_tests,
    widening,
)
from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.evidence.base import Base, fit_base
from tirefit.diagnosis.evidence.forward import Design
from tirefit.diagnosis.evidence.posterior import LinearFit
from tirefit.diagnosis.noise import FORGETFUL, Memory
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig

ROWS = 240
TIME = np.arange(ROWS)
SLIP = 0.25 * np.sin(2 * np.pi * TIME / 60)
LOADS = np.repeat([2.0, 4.0, 6.0], ROWS // 3)
COLUMNS = np.stack([SLIP, SLIP**3, LOADS * SLIP, np.ones(ROWS)], axis=1)
NOTHING = np.zeros((ROWS, 0))
FRAME = {
    "time": 0.05 * TIME,
    "sigma_x": SLIP,
    "fx": 1e3 * LOADS * np.tanh(20 * SLIP),
    "fz": 1e3 * LOADS,
    "v": np.full(ROWS, 15.0),
}


def prepared(frame):
    data = read_frame(frame, "a", convention="braking")
    return prepare(data, Rig(noise={"sigma_x": 1e-6}), ("fx", "fy", "mz"))


PREPARED = prepared(FRAME)


class Fitted(Base):
    """Rows with their noise: everything that the tests of a remainder need."""

    def __init__(self, rows, memory=FORGETFUL, doubt=NOTHING, keep=None):
        keep = np.ones(rows.n) if keep is None else keep.astype(float)
        noise = {c: SimpleNamespace(memory=(memory,)) for c in rows.channels}
        design = Design(*[None] * len(Design._fields))._replace(keep=keep)
        self.__dict__ |= {"rows": rows, "noise": noise, "design": design, "doubt": doubt}


def judged(residual, seed=0, rows=PREPARED, columns=COLUMNS, **given):
    """The tests of the residual that remains after fitting columns."""
    linear = LinearFit(residual, columns, columns[:, :0], columns[:, :0])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(remainder, "linear_at", lambda base, fit: linear)
        generator = np.random.default_rng(seed)
        return remainder_tests(Fitted(rows, **given), weighed_of({(): 1.0}), (), generator)


def noise_of(seed, rows=ROWS):
    return np.random.default_rng(seed).standard_normal(rows)


def test_pure_noise_has_uniform_p_values():
    found = [judged(noise_of(100 + k), k)._asdict() for k in range(60)]
    low, high = binom.ppf([0.001, 0.999], 60, 0.2)
    for name in ("time", "slip_order", "line", "pure_error", "local"):
        small = sum(one[name] <= 0.2 for one in found)
        assert low <= small <= high, (name, small)


@pytest.mark.parametrize("size", [0.5, 300.0])
def test_a_wrong_noise_level_changes_no_p_value(size):
    assert judged(noise_of(2)) == judged(size * noise_of(2))


def test_correlated_noise_is_accepted_only_if_it_was_estimated():
    generator, noise = np.random.default_rng(3), np.zeros(ROWS)
    for k in range(1, ROWS):
        noise[k] = 0.6 * noise[k - 1] + generator.standard_normal()
    assert judged(noise, memory=Memory(0.6, 1.0)).time > 0.02
    assert judged(noise).time < LEVEL


def test_drawn_noise_has_the_stated_correlation():
    """At each lag, the correlated share decays by its own factor."""
    rows = [np.arange(400)]
    drawn = _noise(400, (Memory(0.7, 0.4),), rows, np.random.default_rng(8))
    for lag in (1, 3):
        together = np.mean(drawn[lag:] * drawn[:-lag])
        assert together == pytest.approx(0.4 * 0.7**lag, abs=0.02)
    assert np.mean(drawn**2) == pytest.approx(1.0, rel=0.02)


LATERAL = {"alpha": SLIP, "fy": FRAME["fx"], "mz": FRAME["fx"] / 50, "fz": FRAME["fz"]}


def test_channels_that_share_a_parameter_are_fitted_together(monkeypatch):
    """The draws include the effect of one channel's noise on the other's residual."""
    shared, seen = np.concatenate([np.ones(ROWS), 0.1 * np.ones(ROWS)])[:, None], []
    tests_of = remainder._p_values

    def listening(residual, draws, *given):
        seen.append(draws.mean(axis=0))
        return tests_of(residual, draws, *given)

    monkeypatch.setattr(remainder, "_p_values", listening)
    none = np.zeros((2 * ROWS, 0))
    judged(noise_of(9, 2 * ROWS), rows=prepared(LATERAL), columns=shared, doubt=none)
    # (1 - H) has 1 - 0.01 / 1.01 / n in the weak channel: its mean is nearly free.
    strong, weak = map(np.var, seen)
    assert weak == pytest.approx((1 - 0.01 / 1.01) / ROWS, rel=0.15)
    assert strong < 0.02 / ROWS


def test_structure_within_the_slip_doubt_is_not_reported():
    off = np.sin(40 * SLIP)
    residual = noise_of(4) + 1.4 * off
    assert judged(residual).slip_order < LEVEL
    assert judged(residual, doubt=1.4 * off[:, None]).slip_order > 0.05


STRUCTURES = {
    "time": 1.2 * (TIME > ROWS // 2),
    "slip_order": 1.4 * np.sin(40 * SLIP),
    "line": 0.9 * np.sin(2 * np.pi * TIME / 5),
    "pure_error": 1.4 * np.sin(40 * SLIP),
    "local": 4.5 * np.exp(-(((SLIP - 0.1) / 0.02) ** 2) / 2) * (LOADS == 4.0),
}


@pytest.mark.parametrize("name", STRUCTURES)
def test_each_test_detects_its_structure(name):
    result = judged(noise_of(4) + STRUCTURES[name])
    assert getattr(result, name) < LEVEL, result


def test_a_wave_is_found_despite_the_correlation_it_causes():
    # The memory that an oscillation seems to give the noise explains its neighbours,
    # not its period. A saw tooth in the second half of every sweep:
    chatter = 3.0 * (2 * (TIME / 12.0 % 1) - 1) * (TIME % 50 > 25)
    result = judged(noise_of(9) + chatter, memory=Memory(0.65, 1.0))
    assert result.line < 1e-4
    assert result.time > LEVEL


def test_a_wave_keeps_its_phase_across_excluded_rows(monkeypatch):
    keep = np.random.default_rng(9).uniform(size=ROWS) > 0.25
    residual = np.where(keep, noise_of(9) + 0.9 * np.sin(2.1 * TIME), 0.0)
    assert judged(residual, keep=keep).line < 1e-3
    # The same rows, put one after the other, do not show it.
    monkeypatch.setattr(remainder, "_orders", lambda *given: [np.cumsum(keep) - 1])
    assert judged(residual, keep=keep).line > 0.01


def test_a_wave_in_distance_is_found_at_varying_speed(monkeypatch):
    speeds = np.linspace(4.0, 12.0, ROWS)
    rows = prepared(FRAME | {"v": speeds})
    distance = 0.05 * np.cumsum(speeds)
    residual = noise_of(3) + 0.9 * np.sin(2 * np.pi * distance / 1.7)
    assert judged(residual, rows=rows).line < 1e-3
    monkeypatch.setattr(remainder, "_orders", lambda *given: [TIME])
    assert judged(residual, rows=rows).line > 0.01


def test_beyond_all_draws_the_p_value_is_extrapolated():
    many = np.random.default_rng(2).exponential(size=(40, 999))
    assert _p_value(1.0, many[0]) == np.mean(np.append(many[0], 1.0) >= 1.0)
    # 999 draws know what one in 3,000 and one in 20,000 exceeds to a factor of two.
    for size in (8.0, 10.0):
        beyond = np.log([_p_value(size, drawn) for drawn in many if drawn.max() < size])
        assert beyond.mean() == pytest.approx(-size, abs=0.25)
        assert beyond.std() < 1.1
    assert _p_value(1e9, many[0]) > 0


def test_fitted_columns_are_not_reported_as_structure():
    fitted = judged(noise_of(5) + COLUMNS @ [30.0, -200.0, 4.0, 7.0])
    assert min(fitted) > LEVEL
    np.testing.assert_allclose(fitted, judged(noise_of(5)), rtol=1e-6)


def test_tests_in_time_need_time_and_settings():
    loads = 4e3 * np.exp(2 * noise_of(6))
    frame = {"sigma_x": SLIP, "fx": loads * np.tanh(20 * SLIP), "fz": loads}
    result = judged(noise_of(7), rows=prepared(frame))
    assert result.time is None and result.pure_error is None and result.local is None
    assert 0 < result.line <= 1


def test_the_floor_of_a_p_value_grows_with_the_channels():
    """The smallest of the channels times their number (Bonferroni)."""
    wave = 9.0 * np.sin(2 * np.pi * TIME / 5)
    rows = prepared(LATERAL | {"time": FRAME["time"]})
    columns, none = np.tile(COLUMNS, (2, 1)), np.zeros((2 * ROWS, 0))
    residual = noise_of(8, 2 * ROWS) + np.concatenate([wave, 0 * wave])
    two = judged(residual, rows=rows, columns=columns, doubt=none)
    assert judged(residual[:ROWS]).line == LEAST_P
    assert two.line == 2 * LEAST_P


def test_the_widening_is_the_mean_square_of_independent_rows():
    base = Fitted(PREPARED)
    assert widening(base, 0.3 * noise_of(1)) == 1.0
    assert widening(base, 2 * noise_of(1)) == pytest.approx(4.0, rel=0.35)
    # Each pair of neighbours says one thing.
    pairs = np.repeat(noise_of(1)[: ROWS // 2], 2)
    assert widening(base, 2 * pairs) == pytest.approx(8.0, rel=0.5)


def test_another_form_of_an_effect_leaves_no_remainder():
    """A slip offset that settles within a tenth of the record, compared with the
    formulas alone, which do not fit, and with their other forms."""

    def settling(slip, time, fz, v):
        return brush(slip + 0.02 * (np.exp(-time / 2.4) - 0.12), 5e4, 0.9, fz)

    frame, _ = record(settling, seed=3)
    base = fit_base(prepare(read_frame(frame), RIG, ("fx",)), "brush", EFFECTS, RIG)
    hypothesis, key = refitted(base, "slip_zero_drift"), ("slip_zero_drift",)
    alone, freed = (
        remainder_tests(
            base,
            weighed_of({key: 1.0}, best_of={key: hypothesis}, other_form=forms),
            key,
            np.random.default_rng(0),
        )
        for forms in (frozenset(), frozenset([key]))
    )
    assert min(alone) <= LEVEL and min(freed) > 5 * LEVEL, (alone, freed)
