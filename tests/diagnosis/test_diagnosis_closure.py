"""Closure against known truths: of draws, of the interval, and on held-out rows."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest_diagnosis import patterns_of, weighed_of
from scipy.special import softmax
from scipy.stats import multivariate_normal

from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.forward import Design, Linear
from tirefit.diagnosis.evidence.search import Hypothesis
from tirefit.diagnosis.rows.basis import Generic, bumps, orthogonal, without
from tirefit.diagnosis.summary import closure
from tirefit.diagnosis.summary.case import Case
from tirefit.diagnosis.summary.closure import (
    closure_elsewhere,
    closure_on_rows,
    drawn_functions,
    plausible_forces,
)

ROWS = 240
ALONE = np.zeros(ROWS, int)


def given_residual(bases, scales, residual):
    """Mean and variance (m,) of a sum of columns whose coefficients have one of these
    standard deviations, by conditioning a dense Gaussian; any basis is as likely."""
    log, means, variances = [], [], []
    for basis in bases:
        for scale in scales:
            covariance = scale**2 * basis @ basis.T
            whole = covariance + np.eye(len(residual))
            log.append(multivariate_normal(cov=whole).logpdf(residual))
            solved = np.linalg.solve(whole, covariance)
            means.append(solved.T @ residual)
            variances.append(np.diag(covariance - covariance @ solved))
    weight = softmax(log)
    mean = weight @ means
    return mean, weight @ (np.array(variances) + np.square(means - mean))


def test_draws_of_a_discrepancy_agree_with_a_dense_gaussian(monkeypatch):
    generator, sizes = np.random.default_rng(0), np.array([0.5, 3.0])
    against = generator.standard_normal((60, 2))
    columns = generator.standard_normal((60, 6)) / 8
    residual = without(2 * columns[:, 0] + generator.standard_normal(60), against)
    monkeypatch.setattr(closure, "_SIZES", sizes)
    parts = columns[:, :4], columns[:, 4:]
    bases = [(*orthogonal(part, against), 0.0) for part in parts]
    drawn = drawn_functions(bases, residual, 8000, generator)
    left = [without(part, against) for part in parts]
    mean, variance = given_residual(left, sizes, residual)
    error = np.sqrt(variance / 8000)
    assert np.max(np.abs(drawn.mean(axis=1) - mean) / error) < 5
    np.testing.assert_allclose(drawn.var(axis=1), variance, rtol=0.2)


class Straight(Base):
    """A base that is linear in its one parameter and in its one effect, fitted to rows
    whose effect has another form; noise of one."""

    def __init__(self, generator):
        x = np.linspace(-1, 1, ROWS)
        columns = np.stack([x, 0.3 * (x**2 - 0.2)], axis=1)
        smooth = bumps(x, 12) / np.linalg.norm(bumps(x, 12), axis=0)
        truth = columns @ [3.0, 12.0] + another_form(columns, smooth, generator)
        observed = {"fx": truth + generator.standard_normal(ROWS)}
        one = SimpleNamespace(effect=SimpleNamespace(id="one", forms=()))
        nothing = Design(*[None] * len(Design._fields))
        design = nothing._replace(
            keep=np.ones(ROWS), scale={"fx": np.ones(ROWS)}, prior_scale=np.ones(1)
        )
        rows = SimpleNamespace(channels=("fx",), n=ROWS, observed=observed, covariates=None)
        sharp = patterns_of(smooth)
        self.__dict__ |= {
            "columns": columns,
            "truth": truth,
            "atoms": (one,),
            "rows": rows,
            "design": design,
            "slip_fraction": x,
            "generic": Generic(smooth, smooth, sharp),
            "doubt": np.zeros((ROWS, 1)),
            "proxies": np.zeros((ROWS, 0)),
        }

    prepared = property(lambda self: self.rows)
    measured = property(lambda self: self)

    def forces(self, z, amplitudes):
        return {"fx": self.columns @ np.append(z, amplitudes)}

    def linearised(self, z, amplitudes):
        residual = self.rows.observed["fx"] - self.forces(z, amplitudes)["fx"]
        fields = np.zeros((ROWS, 1))
        return Linear(residual, self.columns[:, :1], self.columns[:, 1:], fields)

    def fitted(self):
        inverse = np.linalg.inv(self.columns.T @ self.columns)
        z, amplitude = inverse @ self.columns.T @ self.rows.observed["fx"]
        return Hypothesis(
            (0,), ("one",), 9.0, 0.0, np.array([z]), np.array([amplitude]), inverse, 0.0
        )

    def case(self):
        """It is known that the effect is there and no other."""
        key, case = ("one",), object.__new__(Case)
        weighed = weighed_of({key: 1.0}, best_of={key: self.fitted()})
        case.__dict__.update(base=self, weighed=weighed)
        return case


def another_form(columns, smooth, generator):
    """The truth beyond the formula (n,): as large as the estimator expects."""
    part = np.linalg.norm(without(columns[:, 1] * 12, columns[:, :1]))
    left, size = orthogonal(smooth, columns)
    share = np.clip(0.1 * np.exp(generator.standard_normal()), 0.005, 1.0)
    off = left @ (size * generator.standard_normal(len(size)))
    off = off * share * part / np.linalg.norm(size)
    rest = 0.03 * np.exp(generator.standard_normal()) * part / np.sqrt(ROWS)
    return off + rest * generator.standard_normal(ROWS)


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def test_an_interval_of_closure_contains_the_truth_in_90_percent():
    """An effect of another form, mostly below the noise, in 150 files."""
    held, off = [], []
    for seed in range(150):
        generator = np.random.default_rng(seed)
        base = Straight(generator)
        best = base.fitted()
        x = base.columns[:, 0]
        before = x * (x @ base.rows.observed["fx"] / (x @ x))
        after = base.forces(best.z, best.amplitude)["fx"]
        truth = plausible_forces(base.case(), generator)["fx"]
        found = closure_on_rows(truth, before, after, np.ones(ROWS), ALONE, 1.0)
        closed = 1 - rms(base.truth - after) / rms(base.truth - before)
        held.append(found.closed_ci[0] <= closed <= found.closed_ci[1])
        off.append(found.closed - closed)
    assert 0.82 <= np.mean(held) <= 0.97
    assert abs(np.mean(off)) < 0.02 and np.median(np.abs(off)) < 0.06


def test_closure_of_draws_is_computed_from_their_forces():
    generator = np.random.default_rng(0)
    gap = 40 * np.sin(np.arange(ROWS))
    truth = gap[:, None] + generator.standard_normal((ROWS, 200))
    variance = np.full(ROWS, 100.0)
    found = closure_on_rows(truth, 0 * gap, 0.8 * gap, variance, ALONE, 1.0)
    assert found.rms == pytest.approx(40 / np.sqrt(2), rel=0.02)
    # The draws have unit noise: its energy adds to the remainder and to the gap.
    expected = 1 - np.sqrt((0.2**2 * 800 + 1) / (800 + 1))
    assert found.closed == pytest.approx(expected, abs=0.002)
    assert found.closed_ci[0] < expected < found.closed_ci[1] and found.resolvable
    assert found.remaining_rms == pytest.approx((1 - found.closed) * found.rms)
    # No more is claimed than that the gap is not doubled.
    assert closure_on_rows(truth, 0 * gap, 9 * gap, variance, ALONE, 1.0).closed == -1
    tiny = closure_on_rows(truth / 40, 0 * gap, 0 * gap, variance, ALONE, 1.0)
    assert tiny.closed is None and not tiny.resolvable
    # Where one run is closed and another is not, both are all that is known.
    halves = np.repeat([0, 1], ROWS // 2)
    mixed = np.where(halves == 0, gap, 0.2 * gap)
    apart = closure_on_rows(truth, 0 * gap, mixed, variance, halves, 1.0)
    assert apart.closed_ci[0] == -1 and apart.closed_ci[1] == 1


def test_closure_elsewhere_is_right_for_known_energies():
    generator = np.random.default_rng(0)
    n = 4000
    noise, run = 10 * generator.standard_normal(n), np.zeros(4000, int)
    gap, variance = 40 * np.sin(np.arange(n)), np.full(n, 100.0)
    found = closure_elsewhere(gap + noise, 0.2 * gap + noise, variance, run, 1.0, generator)
    assert found.rms == pytest.approx(40 / np.sqrt(2), rel=0.02)
    assert found.closed == pytest.approx(0.8, abs=0.02)
    assert found.closed_ci[0] < 0.8 < found.closed_ci[1]
    tiny = closure_elsewhere(noise, noise, variance, run, 1.0, generator)
    assert tiny.closed is None and not tiny.resolvable
    worse = closure_elsewhere(gap + noise, 3 * gap + noise, variance, run, 1.0, generator)
    assert worse.closed == -1


def test_nine_rows_give_no_certain_closure():
    """They are one block of the bootstrap, which has no spread."""
    generator = np.random.default_rng(2)
    gap, noise = 8 * np.cos(np.arange(9)), generator.standard_normal(9)
    found = closure_elsewhere(
        gap + noise, 0.5 * noise, np.ones(9), np.zeros(9, int), 1.0, generator
    )
    assert 0.6 < found.closed_ci[0] < 0.92 < found.closed_ci[1] < 1.0


def test_closure_elsewhere_contains_the_truth_in_90_percent():
    """The remainder is below the noise or at its level: 200 files."""
    held, off = [], []
    for seed in range(200):
        generator = np.random.default_rng(seed)
        gap = np.sqrt(2) * np.sin(np.arange(ROWS))
        other = np.sqrt(2) * np.cos(1.7 * np.arange(ROWS))
        share = 0.6 * generator.random()
        noise = generator.standard_normal(ROWS)
        found = closure_elsewhere(
            gap + noise, share * other + noise, np.ones(ROWS), ALONE, 1.0, generator
        )
        held.append(found.closed_ci[0] <= 1 - share <= found.closed_ci[1])
        off.append(found.closed - (1 - share))
        # Nobody knows that nothing at all is left.
        assert found.closed < 1
    assert 0.83 <= np.mean(held) <= 0.97
    assert abs(np.mean(off)) < 0.05
