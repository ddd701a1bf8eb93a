"""Importance sampling compared with known posteriors, ArviZ and emcee."""

import jax.numpy as jnp
import numpy as np
import pytest
from recipes import brush_force

from tirefit.fitting.estimate import fit
from tirefit.fitting.uncertainty import posterior
from tirefit.fitting.uncertainty.importance import draw_weighted, smoothed
from tirefit.fitting.uncertainty.posterior import _density, _whitening, sample
from tirefit.report.fit.figures import save_figures
from tirefit.report.fit.report import fit_report
from tirefit.results import Outcome, UsageError


@pytest.fixture(scope="module")
def weighted(given):
    return sample(given, sampler="importance", effective_samples=4000)


def agree(one, other, std, ess):
    """Means and spreads of draws (n, p) differ by less than four standard errors."""
    error = np.abs(one.mean(axis=0) - other.mean(axis=0)) / std
    assert np.all(error < 4 * np.sqrt(2 / ess)), error
    spread = np.abs(one.std(axis=0) / other.std(axis=0) - 1)
    assert np.all(spread < 4 / np.sqrt(ess)), spread


def flat(result):
    return result.walkers.reshape(-1, len(result.labels))


def stds(result):
    return np.array([result.least_squares[label].std for label in result.labels])


def smoothed_by(arviz, log_weights):
    """ArviZ's smoothed log weights and k-hat; version 1 takes log likelihoods, whose sign
    is opposite."""
    if arviz.__version__.startswith("0."):
        return arviz.psislw(log_weights)
    from arviz_stats.base import array_stats

    return array_stats.psislw(-log_weights)


@pytest.mark.parametrize("shape", [0.0, 0.2, 0.5, 0.9, 1.5])
def test_smoothed_weights_agree_with_arviz(arviz, shape):
    # 3 sqrt(4900) is a whole number: versions 0 and 1 round the length of the tail
    # differently.
    spread = np.random.default_rng(0).standard_exponential(4900)
    log_weights = shape * spread if shape else -(spread**2)
    weights, k_hat = smoothed(log_weights)
    expected, k_expected = smoothed_by(arviz, log_weights)
    np.testing.assert_allclose(weights, np.exp(expected), rtol=1e-10)
    assert k_hat == pytest.approx(float(k_expected), rel=1e-10)
    assert weights.sum() == pytest.approx(1)


def test_weights_of_too_few_points_are_rejected():
    lonely = np.full(1000, -np.inf)
    assert smoothed(lonely)[1] == np.inf
    lonely[:3] = 0.0
    weights, k_hat = smoothed(lonely)
    assert k_hat == np.inf and weights[:3] == pytest.approx(1 / 3)


def skewed(u):
    """log density of a log-gamma of shape 8 in every coordinate: mean and variance
    are digamma(8) and trigamma(8)."""
    return jnp.sum(8 * u - jnp.exp(u), axis=-1)


def narrow_and_far(u):
    """Most of the probability is far outside the proposal."""
    return -jnp.sum((u - 12.0) ** 2, axis=-1) / 2e-2


def plain(size):
    """A whitening that changes nothing."""
    return np.zeros(size), np.eye(size)


def heavy(u):
    """Tails of |u|^-1.2, which neither part of the proposal covers."""
    return -0.6 * jnp.sum(jnp.log1p(u**2), axis=-1)


def test_weighted_draws_have_the_right_moments():
    from scipy.special import polygamma

    weighted = draw_weighted(lambda u: skewed(u + 2.0), *plain(3), 0, 40_000)
    assert weighted.refused == "" and weighted.k_hat < 0.7
    count = len(weighted.draws)
    assert 40_000 <= count < weighted.points
    mean, variance = polygamma(0, 8) - 2.0, polygamma(1, 8)
    error = 4 * np.sqrt(variance / count)
    assert np.all(np.abs(weighted.draws.mean(axis=0) - mean) < error)
    np.testing.assert_allclose(weighted.draws.var(axis=0), variance, rtol=4 * np.sqrt(3 / count))
    # In random order: a thinned picture of them is a picture of all.
    half = weighted.draws[: count // 2].mean(axis=0)
    assert np.all(np.abs(half - mean) < np.sqrt(2) * error)


def test_draws_are_as_good_as_independent_ones():
    def drawn(seed):
        return draw_weighted(lambda u: skewed(u + 2.0), *plain(1), seed, 1000)

    means = [drawn(seed).draws[:1000].mean() for seed in range(200)]
    weighted = drawn(0)
    independent = weighted.draws.std() / np.sqrt(1000)
    # The spread of 200 means is known to 5 %.
    assert np.std(means) < 1.2 * independent


def test_unreliable_weights_are_refused():
    assert "k-hat" in draw_weighted(narrow_and_far, *plain(2), 0, 1000).refused
    nowhere = draw_weighted(lambda u: np.full(len(u), -np.inf), *plain(2), 0, 1000)
    assert "k-hat inf" in nowhere.refused
    assert 0.7 < draw_weighted(heavy, *plain(2), 0, 1000).k_hat < np.inf
    # 40 coordinates of half the spread: too few of the points count.
    narrow = draw_weighted(lambda u: -2 * np.sum(u**2, axis=1), *plain(40), 0, 1000)
    assert narrow.refused


def test_a_mode_far_from_the_optimum_is_detected():
    """A narrow optimum, and 100 times its probability 40 of its spreads away."""

    def two(u):
        near = -jnp.sum(u**2, axis=-1) / 2
        far = jnp.log(100.0 / 16) - jnp.sum((u - 40.0) ** 2, axis=-1) / 32
        return jnp.logaddexp(near, far)

    weighted = draw_weighted(two, np.zeros(2), np.eye(2) / 20, 0, 1000)
    assert weighted.refused or np.mean(weighted.draws[:, 0] > 20) > 0.9


def test_interrupted_points_are_kept():
    calls, shares = [], []

    def interrupted(u):
        calls.append(len(u))
        if sum(calls) > 5120:  # the first round of 1.25 x 4,000 points is complete
            raise KeyboardInterrupt
        return -2 * np.sum(u**2, axis=1)

    weighted = draw_weighted(
        interrupted, *plain(6), 0, 4000, lambda share, note: shares.append(share)
    )
    assert weighted.interrupted and weighted.refused == ""
    assert weighted.points == 5120 and 100 < len(weighted.draws) < 4000
    assert shares == [pytest.approx(len(weighted.draws) / 4000, abs=1e-3)]


def test_importance_agrees_with_emcee(given, sampled, weighted):
    summary = weighted.posterior
    assert summary.sampler == "importance" and summary.outcome is Outcome.CONVERGED
    assert summary.k_hat < 0.7 and summary.rhat == {} and summary.tau == {}
    assert summary.note == ""
    assert len(flat(weighted)) == min(summary.ess.values()) >= 4000
    agree(flat(weighted), flat(sampled), stds(given), min(sampled.posterior.ess.values()))
    assert weighted.status == sampled.status == "ok"


def test_importance_is_reproduced_by_its_seed_alone(given, weighted):
    settings = {"sampler": "importance"}
    again = sample(given, **settings)
    assert np.array_equal(again.walkers, weighted.walkers)
    other = sample(given, **settings, seed=1)
    assert not np.array_equal(other.walkers[:, :, :50], weighted.walkers[:, :, :50])


def test_refused_importance_sampling_falls_back_to_emcee_with_a_note(given, chunk, monkeypatch):
    real = draw_weighted

    def far(density, *arguments):
        return real(heavy, *arguments)

    monkeypatch.setattr(posterior, "draw_weighted", far)
    settings = {"max_steps": chunk, "walkers": 16}
    result = sample(given, sampler="importance", **settings)
    assert np.array_equal(result.walkers, sample(given, **settings).walkers)
    summary = result.posterior
    assert summary.sampler == "emcee" and summary.k_hat > 0.7
    assert "importance sampling refused (k-hat" in summary.note
    assert "importance sampling refused (k-hat" in fit_report(result)
    content = result.to_dict()["posterior"]
    assert content["k_hat"] == summary.k_hat and content["note"] == summary.note


@pytest.mark.parametrize(("limit", "value"), [("_MANY", 1), ("_LONG", 399)])
def test_importance_is_the_default_for_many_parameters_and_rows(given, monkeypatch, limit, value):
    monkeypatch.setattr(f"tirefit.fitting.uncertainty.posterior.{limit}", value)
    drawn = sample(given, effective_samples=500).posterior
    assert (drawn.sampler, drawn.note) == ("importance", "")


def test_importance_reports_that_it_has_no_trace(weighted, tmp_path):
    written = {path.name for path in save_figures(weighted, tmp_path)}
    assert "corner.png" in written and "trace.png" not in written
    with pytest.raises(UsageError, match="no chain"):
        weighted.plot("trace")
    text = " ".join(fit_report(weighted).split())
    assert "k-hat" in text and "no chain" in text and "R-hat" not in text


def test_slips_with_noise_are_sampled_by_points_like_a_grid(monkeypatch):
    """Each evaluation integrates over the true slip of every row: a chain takes minutes."""
    generator = np.random.default_rng(3)
    slip = np.linspace(-0.12, 0.12, 60)
    columns = {
        "alpha": np.arctan(slip) + 0.01 * generator.standard_normal(60),
        "fy": brush_force(slip, 3e4, 0.95, fz=4000.0) + 200 * generator.standard_normal(60),
        "fz": np.full(60, 4000.0),
    }
    found = fit(columns, config={"model": "brush", "noise": {"fy": 200.0, "alpha": 0.01}})
    drawn = sample(found)
    assert drawn.posterior.sampler == "importance" and not drawn.posterior.note
    # The same density on a grid over six standard deviations.
    axis = np.linspace(-6, 6, 41)
    u = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    log = np.asarray(_density(found.solved)(u))
    weight = np.exp(log - log.max())
    center, root = _whitening(found.solved)
    z = center + u @ root.T
    values = np.asarray(found.problem.layout.vector(z.T)).T
    mean = weight @ values / weight.sum()
    std = np.sqrt(weight @ (values - mean) ** 2 / weight.sum())
    draws = flat(drawn)
    assert np.all(np.abs(draws.mean(axis=0) - mean) < 0.06 * std)  # 4000 draws: 0.016
    np.testing.assert_allclose(draws.std(axis=0), std, rtol=0.06)
    # A long file is sampled with fewer points.
    targets = []
    monkeypatch.setattr(posterior, "_LONG_NOISY", 59)
    monkeypatch.setattr(posterior, "draw_weighted", lambda *asked: targets.append(asked[4]))
    with pytest.raises(AttributeError):
        sample(found)
    assert targets == [300]
