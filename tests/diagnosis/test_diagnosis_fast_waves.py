"""Hum and chatter: waves in time that are faster than those of the patterns."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest_diagnosis import RIG, brush, record

from tirefit.data.read import read_frame
from tirefit.diagnosis.engine import diagnose
from tirefit.diagnosis.evidence.forms import with_fast_waves
from tirefit.diagnosis.rows.patterns import PARAMETERS, looks, patterns

ROWS, STEP, HUM = 900, 0.005, 1 / 50.3
ONES = np.ones((ROWS, 1))


def record_of(time):
    """Patterns of a record with an oscillating slip."""
    slip_fraction = 1.2 * np.sin(2 * np.pi * np.arange(len(time)) / 90)
    prepared = SimpleNamespace(
        n=len(time),
        channels=("fx",),
        has=frozenset(("time", "signs")),
        time=time,
        inputs=SimpleNamespace(fz=np.full(len(time), 4e3)),
        covariates=None,
    )
    fields = {name: np.full(len(time), 1 / 40.0) for name in PARAMETERS}
    return patterns(prepared, slip_fraction, fields)


def told(time, residual):
    left = residual - residual.mean()
    return looks(with_fast_waves(record_of(time), time, left), ONES, left)


@pytest.mark.parametrize("gaps", [False, True])
def test_hum_is_reported_with_its_period(gaps):
    """Also with missing rows: the others keep their place in the sampling."""
    there = np.arange(ROWS + 300) % 4 != 2 if gaps else np.arange(ROWS) >= 0
    time = 3.0 + np.flatnonzero(there)[:ROWS] * STEP
    noise = np.random.default_rng(7).standard_normal(ROWS)
    hum = 0.5 * np.sin(2 * np.pi * time / HUM + 1.0)
    first = told(time, noise + hum)[0]
    assert (first.parameter, first.covariate, first.shape) == ("force", "time", "wave")
    assert first.at == pytest.approx(HUM, rel=2e-3)
    # In shares of the load: half a standard deviation of 40 N.
    assert abs(first.size) == pytest.approx(0.5 * 40 / 4e3, rel=0.25)
    assert looks(record_of(time), ONES, noise + hum) == []


def test_a_short_record_covers_all_periods():
    """In 90 rows the patterns have waves of five rows and more; this one has three."""
    time = STEP * np.arange(90)
    noise = np.random.default_rng(2).standard_normal(90)
    left = noise + 1.4 * np.sin(2 * np.pi * time / (3.1 * STEP))
    left -= left.mean()
    (first, *_) = looks(with_fast_waves(record_of(time), time, left), ONES[:90], left)
    assert first.at == pytest.approx(3.1 * STEP, rel=5e-3)


def test_noise_gives_no_hum():
    time = STEP * np.arange(ROWS)
    for seed in range(20):
        assert told(time, np.random.default_rng(seed).standard_normal(ROWS)) == []


def test_rows_without_a_sampling_have_no_fast_waves():
    time = np.cumsum(np.random.default_rng(1).exponential(1.0, ROWS) ** 6)
    among = record_of(time)
    assert with_fast_waves(among, time, np.zeros(ROWS)) is among


def test_hum_is_in_the_report():
    def humming(slip, time, fz, v):
        return brush(slip, 5e4, 0.9, fz) + 0.02 * fz * np.sin(2 * np.pi * time / 0.13)

    columns, _ = record(humming, seed=5, rows=80)
    found = diagnose(read_frame(columns, "hum", convention="braking"), rig=RIG, holdout=())
    first = found.verdict.left.looks_like[0]
    assert found.verdict.status == "unknown"
    assert first.covariate == "time" and first.at == pytest.approx(0.13, rel=2e-3)
    assert "with time, period 0.13 s" in " ".join(str(found).split())
    # No smooth function of load, speed and slip holds any of it.
    assert found.gap.rms < 30
