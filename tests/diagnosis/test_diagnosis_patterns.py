"""Patterns of unlisted effects, and probabilities calibrated by trials."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from conftest_diagnosis import RIG, brush, patterns_of, record
from scipy.integrate import quad
from scipy.special import expit, logit

from fits.calibration.logistic import lines_of
from tirefit.data.read import read_frame
from tirefit.diagnosis.decide import findings
from tirefit.diagnosis.decide.findings import as_often_right
from tirefit.diagnosis.decide.verdict import Status
from tirefit.diagnosis.engine import diagnose
from tirefit.diagnosis.rows.basis import _scaled, taken_out
from tirefit.diagnosis.rows.patterns import PARAMETERS, looks, patterns, patterns_gain, turns

WAVE = 0.7


def middle(slip, time, fz, v):
    return brush(slip, 5e4, 0.9 * (1 - 0.1 * (fz == 4000.0)), fz)


def waving(slip, time, fz, v):
    return brush(slip, 5e4, 0.9, fz) + 0.06 * fz * np.sin(2 * np.pi * time / WAVE)


def test_evidence_of_a_pattern_agrees_with_the_integral():
    generator = np.random.default_rng(0)
    columns = generator.standard_normal((60, 2)).astype(np.float32)
    columns[:, 1] = 0
    against = np.ones((60, 1))
    residual = generator.standard_normal(60) + 0.7 * columns[:, 0]
    residual -= residual.mean()
    lone = columns[:, 0].astype(float) - columns[:, 0].mean()

    def likelihood(a, scale):
        fit = np.sum((residual - a * lone) ** 2 - residual**2)
        return np.exp(-0.5 * fit - 0.5 * (a / scale) ** 2) / scale / np.sqrt(2 * np.pi)

    one = np.mean([quad(likelihood, -20, 20, args=(s,), points=[0.7])[0] for s in (0.5, 2, 8)])
    # The other one is empty: it has the evidence of nothing.
    gain = patterns_gain(patterns_of(columns), taken_out(against), residual)
    assert gain == pytest.approx(np.log((one + 1) / 2), rel=1e-4)


def test_a_pattern_within_the_fit_is_not_reported():
    generator = np.random.default_rng(1)
    used = generator.standard_normal((80, 3))
    columns = (used @ generator.standard_normal((3, 1))).astype(np.float32)
    residual = generator.standard_normal(80)
    assert looks(patterns_of(columns), used, residual) == []


@pytest.fixture(scope="module")
def some():
    """Patterns of two channels over a range and over time: shapes and waves."""
    generator = np.random.default_rng(3)
    slip_fraction = generator.uniform(-1.5, 1.5, 90)
    time = np.sort(generator.uniform(2.0, 30.0, 90))
    prepared = SimpleNamespace(
        n=90,
        channels=("fx", "fy"),
        has=frozenset(("time", "signs")),
        time=time,
        inputs=SimpleNamespace(fz=np.full(90, 4e3)),
        covariates=None,
    )
    fields = {name: generator.standard_normal(180) for name in PARAMETERS}
    return patterns(prepared, slip_fraction, fields), fields, slip_fraction, time


def test_patterns_are_forces_times_shapes(some):
    """A wave in time by its sine, a threshold of the mirrored slip by hand."""
    among, fields, slip_fraction, time = some

    def first(*wanted):
        return next(k for k, one in enumerate(among.of) if one[:3] == wanted)

    number = first("friction", "time", "wave")
    turned = 2 * np.pi * (time - time.min()) / among.of[number].at
    waves = [
        0.03 * fields["friction"] * np.tile(np.sin(turned + phase), 2)
        for phase in np.pi * np.arange(4) / 4
    ]
    found = among.columns(number + np.arange(4))
    np.testing.assert_allclose(found, np.transpose(waves), atol=1e-7)
    number = first("force", "slip_fraction", "threshold")
    shape = (np.abs(slip_fraction) > among.of[number].at) - 0.5
    force = 0.01 * 4e3 * np.where(slip_fraction < 0, -1, 1) * shape
    expected = fields["force"] * np.tile(force, 2)
    np.testing.assert_allclose(among.columns(np.array([number]))[:, 0], expected)


def test_products_of_patterns_agree_with_their_columns(some):
    among, *_ = some
    columns = among.columns(np.arange(len(among.of)))
    against = np.random.default_rng(4).standard_normal((180, 3))
    size = np.linalg.norm(columns, axis=0)
    np.testing.assert_allclose(among.square, size**2, rtol=1e-5)
    error = among.products(against) - columns.T @ against
    assert np.max(np.abs(error) / size[:, None]) < 1e-5
    assert len(among.log_prior) == len(among.of)
    assert np.sum(np.exp(among.log_prior)) == pytest.approx(1.0)


def test_turns_are_sines_and_cosines():
    share = np.random.default_rng(5).uniform(0, 1, 50)
    counts = np.arange(1, 96.1, 0.5)
    angle = 2 * np.pi * share[:, None] * counts
    found = turns(share, counts)
    np.testing.assert_allclose(found[:, ::2], np.sin(angle), atol=1e-12)
    np.testing.assert_allclose(found[:, 1::2], np.cos(angle), atol=1e-12)


def test_fewer_columns_have_the_same_covariance():
    generator = np.random.default_rng(2)
    x = np.linspace(0, 1, 90)
    wide = np.exp(-0.5 * ((x[:, None] - np.linspace(0, 1, 60)) / 0.2) ** 2)
    scale = generator.uniform(0.5, 2, 90)
    few = _scaled(wide, scale)
    unit = wide * scale[:, None] / np.linalg.norm(wide * scale[:, None], axis=0)
    assert few.shape[1] < 20
    np.testing.assert_allclose(few @ few.T, unit @ unit.T, atol=1e-4)


@pytest.fixture(scope="module")
def strange():
    """Diagnoses of two unlisted effects."""

    def of(truth):
        columns, _ = record(truth, seed=5)
        data = read_frame(columns, "stranger", convention="braking")
        return diagnose(data, rig=RIG)

    return {"wave": of(waving), "middle": of(middle)}


def test_a_wave_in_time_is_reported_with_its_period(strange):
    verdict = strange["wave"].verdict
    assert verdict.status in ("unknown", "incomplete")
    first = verdict.left.looks_like[0]
    assert (first.parameter, first.covariate, first.shape) == ("force", "time", "wave")
    assert first.at == pytest.approx(WAVE, rel=0.1)
    assert abs(first.size) == pytest.approx(0.06, rel=0.25)
    assert first.explains > 0.5
    assert "goes up and down with time" in " ".join(str(strange["wave"]).split())


def test_reported_patterns_are_in_the_document(strange):
    verdict = json.loads(strange["wave"].to_json())["verdict"]
    assert set(verdict["left"]["looks_like"][0]) == {
        "parameter",
        "covariate",
        "shape",
        "at",
        "width",
        "size",
        "probability",
        "explains",
    }


@pytest.mark.parametrize("of", ["wave", "middle"])
def test_text_and_figure_have_the_same_amplitude(strange, of):
    found = strange[of]
    drawn, told = found.look, found.verdict.left.looks_like[0]
    assert drawn.look == told
    amplitude = np.abs(drawn.shape).max()
    assert abs(told.size) == pytest.approx(amplitude, rel=1e-3)


def test_one_differing_load_is_found_with_its_size(strange):
    verdict = strange["middle"].verdict
    assert verdict.status in ("unknown", "incomplete")
    first = verdict.left.looks_like[0]
    assert (first.parameter, first.covariate) == ("friction", "fz")
    assert (first.shape, first.at) == ("local", pytest.approx(4000.0))
    assert first.size == pytest.approx(-0.1, abs=0.02)


def test_no_pattern_is_reported_without_a_remainder(diagnosed):
    found, _ = diagnosed("slip_offset")
    assert found.verdict.left.looks_like == ()


def test_the_calibration_has_every_status():
    assert findings._numbers().keys() <= {*Status, "noise", "unlisted"}
    doubtful, sure = (as_often_right("unlisted", p) for p in (1e-4, 0.999))
    assert doubtful < 0.1 < 0.9 < sure


def test_calibrated_probabilities_match_the_share_of_right_verdicts(monkeypatch):
    """Verdicts that are right less often than stated, except for one status."""
    generator, verdicts = np.random.default_rng(5), []
    for status, offset, slope in (("none", -0.4, 0.5), ("named", 0.0, 1.0)):
        said = generator.uniform(0.2, 0.99, 4000)
        right = generator.uniform(size=4000) < expit(offset + slope * logit(said))
        verdicts += zip([status] * 4000, said, right, strict=True)
    numbers = lines_of(verdicts)
    monkeypatch.setattr(findings, "_numbers", lambda: numbers)
    for said in (0.3, 0.6, 0.95):
        wanted = expit(-0.4 + 0.5 * logit(said))
        assert as_often_right("none", said) == pytest.approx(wanted, abs=0.03)
        assert as_often_right("named", said) == pytest.approx(said, abs=0.03)
        assert as_often_right("unknown", said) == pytest.approx(said)
    assert 0.5 < as_often_right("named", 1.0) < 1.0
