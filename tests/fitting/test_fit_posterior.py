"""Posterior: closeness to Laplace, agreement of samplers, seeds, interrupts, files."""

import numpy as np
import pytest
import xarray as xr

from tirefit.fitting.result import Estimate
from tirefit.fitting.store import posterior_content
from tirefit.fitting.uncertainty import posterior
from tirefit.fitting.uncertainty.posterior import sample, split_rhat
from tirefit.results import Outcome, UsageError

LABELS = ("cpa2", "mu")


def test_well_identified_posterior_is_gaussian(given, sampled):
    summary = sampled.posterior
    assert summary.outcome is Outcome.CONVERGED and sampled.status == "ok"
    for label in LABELS:
        ess = summary.ess[label]
        assert ess >= 500 and summary.rhat[label] < 1.01
        assert summary.steps - summary.discarded >= 50 * summary.tau[label]
        draws = sampled.walkers[..., sampled.labels.index(label)].ravel()
        laplace = given.least_squares[label]
        error = abs(draws.mean() - laplace.value) / laplace.std
        assert error < 4 / np.sqrt(ess) + 0.02
        assert abs(draws.std() / laplace.std - 1) < 4 / np.sqrt(2 * ess) + 0.01
        low, high = sampled.intervals["posterior"][label]
        assert sampled.parameters[label].ci95 == (low, high)
        profile = given.intervals["profile"][label]
        np.testing.assert_allclose(
            (low, high), profile, atol=(0.02 + 6 / np.sqrt(ess)) * laplace.std
        )


def test_a_rare_far_mode_does_not_affect_the_std():
    draws = np.random.default_rng(0).normal(10.0, 2.0, 100_000)
    plain = Estimate.of_draws(draws, "N", True)
    # Of a normal's quantile at one sigma the standard error is 1.52 sigma / sqrt(m).
    assert abs(plain.std - 2.0) < 4 * 1.52 * 2.0 / np.sqrt(2 * len(draws))
    draws[:1000] = 1e7
    far = Estimate.of_draws(draws, "N", True)
    assert abs(far.std - 2.0) < 0.05 < 1e5 < draws.std()
    assert Estimate.of_draws(draws, "N", False).std is None


def synthetic_chains(shift=0.0):
    chains = np.random.default_rng(0).standard_normal((4, 500, 32, 2))
    chains[0, ..., 1] += shift
    return chains


def test_split_rhat_agrees_with_its_definition():
    agreeing = split_rhat(synthetic_chains())
    assert agreeing.shape == (2,) and (agreeing >= 1).all() and (agreeing < 1.002).all()
    shifted = split_rhat(synthetic_chains(2.0))
    assert shifted[0] < 1.002 and shifted[1] > 1.1
    # Half of one ensemble that drifts is seen too, though all means agree.
    drifting = synthetic_chains()
    drifting[:, :250, :, 0] += 2.0
    assert split_rhat(drifting)[0] > 1.1


def test_seed_reproduces_bit_for_bit(given, chunk, monkeypatch):
    # Content with few steps: the limit of steps at which it converges is accepted.
    monkeypatch.setattr(posterior, "_STEPS_PER_TAU", 1)
    monkeypatch.setattr(posterior, "_RHAT", 2.0)
    settings = {"effective_samples": 50, "walkers": 16, "max_steps": chunk}
    one, again = (sample(given, **settings) for _ in range(2))
    assert one.posterior.outcome is Outcome.CONVERGED and one.posterior.steps == chunk
    assert np.array_equal(again.walkers, one.walkers)
    assert again.to_json() == one.to_json()
    other = sample(given, **settings, seed=1)
    assert not np.array_equal(other.walkers, one.walkers)


def interrupt_at(count):
    calls = []

    def progress(share, note):
        assert 0 <= share < 1 and "steps" in note
        calls.append(share)
        if len(calls) == count:
            raise KeyboardInterrupt

    return progress


def test_an_interrupted_run_keeps_the_steps_before(given, chunk):
    settings = {"effective_samples": 10**9, "max_steps": 2 * chunk, "walkers": 16}
    whole = sample(given, **settings)
    assert whole.posterior.steps == 2 * chunk
    assert whole.outcomes == (Outcome.CHAIN_TOO_SHORT,)
    broken = sample(given, **settings, progress=interrupt_at(1))
    assert broken.outcomes == (Outcome.INTERRUPTED,)
    first = sample(given, **settings | {"max_steps": chunk})
    assert broken.posterior.steps == first.posterior.steps == chunk
    assert np.array_equal(broken.walkers, first.walkers)


def test_a_chunk_goes_on_where_the_one_before_ended(given, chunk):
    run = posterior._Run(0, 16, 10**9, 2 * chunk, None)
    samples, accepted, outcome = posterior._draw(posterior._density(given.solved), 2, run)
    assert samples.shape == (4, 2 * chunk, 16, 2) and outcome is Outcome.CHAIN_TOO_SHORT
    moved = np.any(np.diff(samples, axis=1) != 0, axis=-1)
    assert accepted == pytest.approx(np.mean(moved), abs=0.01)
    # A walker whose move is refused stays where it was.
    assert 0.2 < np.mean(moved[:, chunk - 1]) < 1
    assert not np.array_equal(samples[:, :chunk], samples[:, chunk:])


def test_few_points_at_a_time_give_the_same_density(given, monkeypatch):
    points = np.random.default_rng(2).standard_normal((24, 2))
    density = posterior._density(given.solved)
    one_by_one = np.concatenate([density(point[None]) for point in points])
    monkeypatch.setattr(posterior, "_AT_ONCE", 5 * 512)  # a program of its own for 24 points
    np.testing.assert_allclose(density(points), one_by_one, rtol=1e-12)


@pytest.mark.parametrize("stage", ["emcee", "importance"])
def test_an_interrupt_before_any_sample_is_reported(given, monkeypatch, stage):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(posterior, "_density", lambda solved: interrupted)
    result = sample(given, sampler=stage)
    assert Outcome.INTERRUPTED in result.outcomes
    assert result.posterior is None


def test_an_interrupt_while_walkers_move_prints_nothing(given, monkeypatch, capsys):
    whole, calls = posterior._density, []

    def interrupted(solved):
        density = whole(solved)

        def later(u):
            calls.append(u)
            if len(calls) > 40:
                raise KeyboardInterrupt
            return density(u)

        return later

    monkeypatch.setattr(posterior, "_density", interrupted)
    assert Outcome.INTERRUPTED in sample(given, sampler="emcee").outcomes
    assert len(calls) == 41 and capsys.readouterr() == ("", "")


def test_a_walker_that_never_moved_has_infinite_autocorrelation_time(given, chunk, monkeypatch):
    """Without a warning; the posterior is one draw per walker."""
    chains = synthetic_chains()
    chains[0, :, 0] = 0
    assert np.all(np.isinf(posterior._autocorrelation_times(chains)))
    monkeypatch.setattr(posterior, "_autocorrelation_times", lambda s: np.full(s.shape[-1], np.inf))
    result = sample(given, max_steps=chunk, walkers=16)
    assert all(ess == 0 for ess in result.posterior.ess.values())
    assert result.chains.shape[1] == result.posterior.walkers


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"walkers": 33}, "33 walkers: an even number, at least 6"),
        ({"walkers": 4}, "4 walkers: an even number, at least 6"),
        ({"sampler": "hmc"}, "emcee, importance"),
    ],
)
def test_unsuitable_settings_are_refused(given, settings, said):
    with pytest.raises(UsageError, match=said):
        sample(given, **settings)


def test_arviz_reads_the_posterior(arviz, sampled, tmp_path):
    path = tmp_path / "posterior.nc"
    path.write_bytes(posterior_content(sampled))
    assert [p.name for p in tmp_path.iterdir()] == ["posterior.nc"]
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        assert {"posterior", "observed_data", "constant_data"} <= set(tree.children)
        posterior = tree["posterior"].to_dataset().load()
        assert tree["observed_data"]["fx"].shape == (400,)
    assert posterior["mu"].dims == ("chain", "draw")
    assert posterior.sizes["chain"] == 4 * sampled.posterior.walkers
    assert posterior["cpa2"].attrs["unit"] == "N"
    assert posterior.attrs["model"] == "brush"
    np.testing.assert_array_equal(posterior["mu"].values.ravel(), sampled.walkers[..., 1].ravel())
    for label in LABELS:
        ess = arviz.ess(posterior[label].values, method="mean")
        # Ours was counted before every second step or so was dropped.
        assert 0.5 < float(ess) / sampled.posterior.ess[label] < 2
        assert float(arviz.rhat(posterior[label].values)) < 1.1
