"""Sampling the posterior: chains until they agree, or weighted independent points.

The only importer of emcee. Sampling happens in the whitened unconstrained space of the
least-squares fit, where a well-identified posterior is nearly a unit Gaussian; the
prior is flat within the bounds of the natural parameters, or what ``fit.toml`` gives.

A chain is a sequence of chunks of steps. The same seed draws the same samples again.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.arrays import Scalar
from tirefit.fitting.estimate import with_fixed
from tirefit.fitting.problem.likelihood import FitProblem
from tirefit.fitting.result import Estimate, FitResult, PosteriorSummary
from tirefit.fitting.solve.condense import apart, condensed
from tirefit.fitting.solve.inference import REACH, deviance
from tirefit.fitting.solve.multistart import Solved
from tirefit.fitting.uncertainty.derived import derived_from_draws
from tirefit.fitting.uncertainty.importance import Density, draw_weighted
from tirefit.fitting.verdict.judge import judge
from tirefit.params import Values
from tirefit.precision import require_x64
from tirefit.results import Outcome, UsageError

CHUNK = 100  # steps between two checks of convergence

_MANY = 20
"""Parameters above which importance sampling is the default: with 90 of them (45 runs of 60
rows) it takes 10 s of processor time at a k-hat below 0, and emcee did not finish in 600 s."""
_WALKERS = 64
_RHAT = 1.01
_STEPS_PER_TAU = 50
_TARGETS = {False: 4000, True: 1000}  # effective samples, by whether slips have noise
_AT_A_TIME = 4
"""Points in one pass over rows with noisy slips: 512 took twice the time of 1 to 8."""
_ALIKE = 0.05
"""Largest error of the log density at which no interval moves by more than its sampling
error, in standard deviations of the parameter."""


@jax.jit
def _log_density(
    u: Float[Values, "n p"],
    problem: FitProblem,
    center: Float[Values, " p"],
    root: Float[Values, "p p"],
    base: Scalar,
) -> Float[Array, " n"]:
    def one(u: Values) -> Array:
        z = center + root @ u
        value = deviance(problem, z) - base
        density = -value / 2 + problem.layout.log_volume(z)
        # A point where the model is undefined (NaN) is never accepted.
        return jnp.where(jnp.isfinite(density), density, -jnp.inf)

    if not problem.rows.nodes:
        return jax.vmap(one)(u)
    # An integral for each row: few points at a time, whose arrays the cache of a core holds.
    return jax.lax.map(one, u, batch_size=_AT_A_TIME)


def _whitening(solved: Solved) -> tuple[np.ndarray, np.ndarray]:
    """Center and root of the covariance; the center is kept away from the bounds."""
    values, vectors = np.linalg.eigh(solved.covariance)
    # Half the reach: walkers of an unidentified direction must not start at the bounds.
    root = vectors * np.sqrt(np.clip(values, 1e-12, (REACH / 4) ** 2))
    return np.clip(solved.z, -REACH / 2, REACH / 2), root


def _density(solved: Solved) -> Density:
    """u (walkers, p) -> log density (walkers,) of the whitened posterior."""
    problem = solved.problem
    center, root = _whitening(solved)
    base = deviance(problem, solved.z)
    return partial(_log_density, problem=problem, center=center, root=root, base=base)


def _ensembles(
    density: Density, size: int, ensembles: int, walkers: int, seed: int
) -> tuple[list[Any], list[Any]]:
    """Samplers of emcee, one for each ensemble, and their first states."""
    import emcee  # here, because importance sampling does not need it

    # Differential evolution, with a full jump between modes in one step of ten (ter
    # Braak 2006): a quarter of the autocorrelation time of the stretch move, and no loop
    # over walkers in Python as in the snooker move.
    moves = [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)]
    samplers, states = [], []

    def log_prob(u: np.ndarray) -> np.ndarray:
        return np.asarray(density(u))

    # Full generator states: emcee silently ignores an integer seed.
    for child in np.random.SeedSequence(seed).spawn(ensembles):
        generator = np.random.RandomState(np.random.MT19937(child))
        # Wider than the posterior, so that R-hat can see ensembles that disagree.
        start = 1.3 * generator.standard_normal((walkers, size))
        values = np.concatenate([log_prob(half) for half in np.split(start, 2)])
        random = generator.get_state()
        states.append(emcee.State(start, log_prob=values, random_state=random))
        samplers.append(emcee.EnsembleSampler(walkers, size, log_prob, moves=moves, vectorize=True))
        samplers[-1].log_prob_fn = log_prob  # emcee's wrapper prints all walkers at an interrupt
    return samplers, states


SAMPLERS = ("emcee", "importance")


def split_rhat(samples: np.ndarray) -> np.ndarray:
    """Split R-hat of ensembles, shape (ensembles, steps, walkers, p) -> (p,).

    Each ensemble's first and second half count as one chain each, walkers pooled:
    walkers of one ensemble depend on each other and are not an independent check.
    """
    half = samples.shape[1] // 2
    parts = np.concatenate([samples[:, :half], samples[:, half : 2 * half]])
    means = parts.mean(axis=(1, 2))
    within = parts.var(axis=(1, 2), ddof=1).mean(axis=0)
    between = means.var(axis=0, ddof=1)
    return np.sqrt(1 + between / np.maximum(within, 1e-300))


def _autocorrelation_times(samples: np.ndarray) -> np.ndarray:
    """Integrated autocorrelation time in steps, worst ensemble, (p,)."""
    import emcee

    # In a short chain a walker may not have moved: NaN, treated as infinity.
    with np.errstate(invalid="ignore"):
        times = [
            emcee.autocorr.integrated_time(chain, quiet=True, has_walkers=True, tol=0)
            for chain in samples
        ]
    return np.maximum(np.nan_to_num(np.max(times, axis=0), nan=np.inf), 1.0)


class _Health(NamedTuple):
    kept: np.ndarray
    discarded: int
    tau: np.ndarray
    rhat: np.ndarray
    ess: np.ndarray
    enough: bool


def _health(samples: np.ndarray, target: int) -> _Health:
    """Burn-in, autocorrelation, agreement and effective samples of a chain."""
    steps = samples.shape[1]
    tau = _autocorrelation_times(samples[:, steps // 5 :])
    worst = float(tau.max())
    discarded = int(min(max(5 * worst, steps / 10), steps // 2)) if steps > 1 else 0
    kept = samples[:, discarded:]
    rhat = split_rhat(kept)
    ess = kept.shape[0] * kept.shape[1] * kept.shape[2] / tau
    long_enough = kept.shape[1] >= _STEPS_PER_TAU * worst
    enough = bool(long_enough and np.all(rhat < _RHAT) and np.all(ess >= target))
    return _Health(kept, discarded, tau, rhat, ess, enough)


def sample(
    result: FitResult,
    *,
    sampler: str | None = None,
    ensembles: int = 4,
    walkers: int | None = None,
    effective_samples: int | None = None,
    max_steps: int = 5000,
    seed: int | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> FitResult:
    """Return the same fit with samples of its posterior.

    Args:
        result: a fit from this process (``tirefit.fit``).
        sampler: ``emcee``, or ``importance`` (no chain: independent points, weighted; by far
            the fastest if the posterior is compact), the default for more than 20 parameters
            and for slips with noise, whose likelihood is an integral over the true slip of
            each row. It falls back to emcee if its weights are unreliable, with a note.
        ensembles: independent ensembles, at least 4.
        walkers: walkers per ensemble, an even number; by default 64, more for many
            parameters.
        effective_samples: stop once every parameter has this many, the chain is 50
            autocorrelation times long and split R-hat is below 1.01. By default 4000, or
            1000 for slips with noise: ends of intervals then scatter by 4 or 8 % of a
            standard deviation.
        max_steps: stop here even without convergence, and report it.
        seed: of the sampling; by default that of the fit.
        progress: called with (share done, message).

    Returns:
        The fit whose ``parameters`` and ``derived`` are those of the posterior, with
        ``chains`` and ``posterior``, the quality of the sampling.

    Raises:
        UsageError: an unknown sampler, too few ensembles, odd walkers; or 32-bit floats in
            use.

    Example:
        >>> found = sample(fit(samples / "circles.csv", "brush"), sampler="importance")
        >>> found.source, found.posterior.sampler
        ('posterior median and central 95 %', 'importance')
    """
    require_x64("sampling")
    if sampler not in (None, *SAMPLERS):
        raise UsageError(f"sampler {sampler!r}: one of {', '.join(SAMPLERS)}")
    solved = result.solved
    seed = result.seed if seed is None else seed
    size = solved.problem.layout.size
    if sampler is None:
        sampler = "importance" if solved.problem.slip_noise or size > _MANY else "emcee"
    target = effective_samples or _TARGETS[bool(solved.problem.slip_noise)]
    walkers = walkers or max(_WALKERS, 2 * ((4 * size + 1) // 2))
    if ensembles < 4 or walkers % 2 or walkers < 2 * size + 2:
        raise UsageError(
            f"{ensembles} ensembles of {walkers} walkers: at least 4 ensembles and an"
            f" even number of walkers, at least {2 * size + 2}, are needed"
        )
    run = _Run(sampler, seed, (ensembles, walkers), target, max_steps, progress)
    try:
        cells = condensed(solved, _whitening(solved)[1])
    except KeyboardInterrupt:
        return judge(replace(result, interrupted=True))
    if cells is None:
        return _sampled(result, solved.problem, run)
    done = _sampled(result, cells, run)
    if done.posterior is None:
        return done
    off = apart(done, cells)
    if off > _ALIKE and Outcome.INTERRUPTED not in done.outcomes:
        return _sampled(result, solved.problem, run)
    text = f"{solved.problem.n} rows as {cells.n} cells of like rows, with an error of"
    text += f" {off:.2g} in the log density"
    note = "; ".join(filter(None, (done.posterior.note, text)))
    return replace(done, posterior=replace(done.posterior, note=note))


class _Run(NamedTuple):
    """How to sample: see :func:`sample`; ``shape`` is (ensembles, walkers)."""

    sampler: str
    seed: int
    shape: tuple[int, int]
    target: int
    max_steps: int
    progress: Callable[[float, str], None] | None


def _sampled(result: FitResult, problem: FitProblem, run: _Run) -> FitResult:
    """The fit with the posterior of this problem: its own, or one made of cells."""
    solved, labels, weighted = result.solved, result.labels, None
    density = _density(solved._replace(problem=problem))
    if run.sampler == "importance":
        weighted = draw_weighted(density, *_whitening(solved), run.seed, run.target, run.progress)
        if not weighted.refused:
            count = len(weighted.draws)
            summary = PosteriorSummary(
                "importance", run.seed, 1, 1, weighted.points, 0,
                dict.fromkeys(labels, float(count)), {}, {}, count / weighted.points,
                Outcome.INTERRUPTED if weighted.interrupted else Outcome.CONVERGED,
                weighted.k_hat,
            )  # fmt: skip
            return _with_posterior(result, weighted.draws[None, :, None], summary)
    interrupted = weighted is not None and weighted.interrupted
    samplers, outcome = ([], None) if interrupted else _draw(density, len(labels), run)
    samples = _samples(samplers)
    if outcome is None or not len(samples):
        return judge(replace(result, interrupted=True))
    health, (ensembles, steps, walkers, _) = _health(samples, run.target), samples.shape
    numbers = (health.ess, health.rhat, health.tau)
    ess, rhat, tau = (dict(zip(labels, values.tolist(), strict=True)) for values in numbers)
    accepted = float(np.mean([sampler.acceptance_fraction for sampler in samplers]))
    k_hat, note = None, ""
    if weighted is not None:
        k_hat = weighted.k_hat
        note = f"importance sampling refused ({weighted.refused}): emcee instead"
    summary = PosteriorSummary(
        "emcee", run.seed, ensembles, walkers, steps, health.discarded, ess, rhat, tau,
        accepted, outcome, k_hat, note,
    )  # fmt: skip
    # Nearly independent draws, the same ones for parameters and derived quantities.
    # A walker that never moved has no autocorrelation time: keep one draw of each.
    slowest = min(health.tau.max() / 2, health.kept.shape[1])
    thin = max(int(np.ceil(slowest)), 1)
    return _with_posterior(result, health.kept[:, ::thin], summary)


def _draw(density: Density, size: int, run: _Run) -> tuple[list[Any], Outcome]:
    """Samplers that ran in chunks until the chain converged, reached its limit or was
    interrupted."""
    outcome, samplers = Outcome.CHAIN_TOO_SHORT, list[Any]()
    try:
        samplers, states = _ensembles(density, size, *run.shape, run.seed)
        while True:
            for e, sampler in enumerate(samplers):
                states[e] = sampler.run_mcmc(states[e], CHUNK, skip_initial_state_check=True)
            health, steps = _health(_samples(samplers), run.target), samplers[0].iteration
            if health.enough:
                outcome = Outcome.CONVERGED
            if health.enough or steps >= run.max_steps:
                break
            if run.progress is not None:
                needed = health.discarded + _STEPS_PER_TAU * float(health.tau.max())
                share = min(steps / needed, float(health.ess.min()) / run.target, 0.99)
                run.progress(share, f"{steps} steps, R-hat {health.rhat.max():.3f}")
    except KeyboardInterrupt:
        outcome = Outcome.INTERRUPTED
    return samplers, outcome


def _samples(samplers: Sequence[Any]) -> np.ndarray:
    """Samples (ensembles, steps, walkers, p), of the steps that every ensemble has made."""
    steps = min((sampler.iteration for sampler in samplers), default=0)
    return np.array([sampler.get_chain()[:steps] for sampler in samplers if steps])


def _with_posterior(result: FitResult, u: np.ndarray, summary: PosteriorSummary) -> FitResult:
    """The fit with draws u (ensembles, steps, walkers, p) of the whitened space."""
    solved = result.solved
    center, root = _whitening(solved)
    z = center + u @ root.T
    flat = z.reshape(-1, z.shape[-1])
    kept = solved.problem.layout.vector(flat.T).T.reshape(z.shape)
    estimates = {
        label: Estimate.of_draws(kept[..., i].ravel(), known.unit, known.identified)
        for i, label in enumerate(result.labels)
        for known in [result.least_squares[label]]
    }
    ends = {label: one.ci95 for label, one in estimates.items()}
    return judge(
        replace(
            result,
            parameters=with_fixed(estimates, solved.problem),
            intervals={**result.intervals, "posterior": ends},
            derived=derived_from_draws(solved.problem, flat, result.derived),
            chains=kept.reshape(kept.shape[0], -1, kept.shape[-1]),
            walkers=np.moveaxis(kept, 2, 1),
            posterior=summary,
        )
    )
