"""Sampling the posterior: chains until they agree, or weighted independent points.

The only importer of emcee. Sampling happens in the whitened unconstrained space of the
least-squares fit, where a well-identified posterior is nearly a unit Gaussian; the
prior is flat within the bounds of the natural parameters, or what ``fit.toml`` gives.
"""

from collections.abc import Callable
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
from tirefit.fitting.solve.inference import REACH, deviance
from tirefit.fitting.solve.multistart import Solved
from tirefit.fitting.uncertainty.derived import derived_from_draws
from tirefit.fitting.uncertainty.importance import Density, Weighted, draw_weighted
from tirefit.fitting.verdict.judge import judge
from tirefit.params import Values
from tirefit.precision import require_x64
from tirefit.results import Outcome, UsageError

CHUNK = 100  # steps between two checks of convergence

_MANY = 20
"""Parameters above which importance sampling is the default: with 90 of them (45 runs of 60
rows) it takes 10 s of processor time at a k-hat below 0, and emcee did not finish in 600 s."""
_ENSEMBLES, _WALKERS = 4, 64
_RHAT = 1.01
_STEPS_PER_TAU = 50
_TARGETS = {False: 4000, True: 1000}  # effective samples, by whether slips have noise
_LONG = 4096
"""Rows above which importance sampling is the default: 5,000 points, for a chain of 100,000."""
_LONG_NOISY, _FEW_DRAWS = 20_000, 300
"""Rows with noisy slips above which fewer effective samples are drawn, and their number: ends of
intervals scatter by 16 % of a standard deviation, and 100,000 rows take 80 s of processor time."""
_AT_A_TIME = 4
"""Points in one pass over rows with noisy slips: 512 took twice the time of 1 to 8."""
_AT_ONCE = 2**19
"""Largest number of points times rows in one pass: more do not stay in the cache of a core."""


@jax.jit
def _log_density(
    u: Float[Values, "n p"],
    problem: FitProblem,
    center: Float[Values, " p"],
    root: Float[Values, "p p"],
    base: Scalar,
) -> Float[Array, " n"]:
    def density_at(u: Values) -> Array:
        z = center + root @ u
        value = deviance(problem, z) - base
        density = -value / 2 + problem.layout.log_volume(z)
        # A point where the model is undefined (NaN) is never accepted.
        return jnp.where(jnp.isfinite(density), density, -jnp.inf)

    together = max(_AT_ONCE // problem.rows.weight.size, 1)
    if problem.rows.nodes:  # an integral for each row
        together = min(together, _AT_A_TIME)
    if together >= len(u):
        return jax.vmap(density_at)(u)
    return jax.lax.map(density_at, u, batch_size=together)


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
            the fastest if the posterior is compact), the default for more than 20 parameters,
            for more than 4096 rows and for slips with noise, whose likelihood is an integral
            over the true slip of each row. It falls back to emcee if its weights are
            unreliable, with a note.
        walkers: of each of the four independent ensembles, an even number; by default 64,
            more for many parameters.
        effective_samples: stop once every parameter has this many, the chain is 50
            autocorrelation times long and split R-hat is below 1.01. By default 4000, or
            1000 for slips with noise (300 above 20,000 rows): ends of intervals then scatter
            by 4, 8 or 16 % of a standard deviation.
        max_steps: stop here even without convergence, and report it.
        seed: of the sampling; by default that of the fit.
        progress: called with (share done, message).

    Returns:
        The fit whose ``parameters`` and ``derived`` are those of the posterior, with
        ``chains`` and ``posterior``, the quality of the sampling.

    Raises:
        UsageError: an unknown sampler, too few or an odd number of walkers; or 32-bit floats.

    Example:
        >>> found = sample(fit(samples / "circles.csv", "brush"), sampler="importance")
        >>> found.source, found.posterior.sampler
        ('posterior median and central 95 %', 'importance')
    """
    require_x64("sampling")
    if sampler not in (None, *SAMPLERS):
        raise UsageError(f"sampler {sampler!r}: one of {', '.join(SAMPLERS)}")
    solved: Solved = result.solved
    seed = result.seed if seed is None else seed
    problem, size = solved.problem, solved.problem.layout.size
    is_noisy = bool(problem.slip_noise)
    if sampler is None:
        is_slow = is_noisy or size > _MANY or problem.n > _LONG
        sampler = "importance" if is_slow else "emcee"
    usual = _FEW_DRAWS if is_noisy and problem.n > _LONG_NOISY else _TARGETS[is_noisy]
    walkers = walkers or max(_WALKERS, 2 * ((4 * size + 1) // 2))
    if walkers % 2 or walkers < 2 * size + 2:
        reason = f"{walkers} walkers: an even number, at least {2 * size + 2}, is needed"
        raise UsageError(reason)
    run = _Run(seed, walkers, effective_samples or usual, max_steps, progress)
    density, weighted = _density(solved), None
    if sampler == "importance":
        weighted = draw_weighted(density, *_whitening(solved), seed, run.target, progress)
        if weighted.interrupted or not weighted.refused:
            return _of_weighted(result, weighted, seed)
    samples, accepted, outcome = _draw(density, size, run)
    if samples is None:
        return judge(replace(result, interrupted=True))
    return _of_chain(result, samples, accepted, outcome, run, weighted)


class _Run(NamedTuple):
    """How to draw a chain: see :func:`sample`."""

    seed: int
    walkers: int
    target: int
    max_steps: int
    progress: Callable[[float, str], None] | None


class _SideBySide:
    """A move for emcee: one step of each of several ensembles, which do not know each other, with
    the densities of all of them in one call: half of the time of one ensemble after the other.

    Differential evolution, with a full jump between modes in one step of ten (ter Braak 2006): a
    quarter of the autocorrelation time of the stretch move.
    """

    def __init__(self, generators: list[np.random.RandomState]):
        from emcee.moves import DEMove  # here, because importance sampling does not need it

        self.generators, self.moves = generators, (DEMove(), DEMove(gamma0=1.0))

    def propose(self, model: Any, state: Any) -> tuple[Any, np.ndarray]:
        """The state after one step, and which walkers moved (walkers,)."""
        places, values = state.coords, state.log_prob
        accepted = np.zeros(len(places), bool)
        moves, halves = [], []
        for walkers, generator in zip(
            np.split(np.arange(len(places)), len(self.generators)), self.generators, strict=True
        ):
            moves.append(generator.choice(self.moves, p=[0.9, 0.1]))
            moves[-1].setup(places)
            half = np.arange(len(walkers)) % 2
            generator.shuffle(half)
            halves.append((walkers[half == 0], walkers[half == 1]))
        for turn in (0, 1):
            moving = np.concatenate([half[turn] for half in halves])
            proposed = np.concatenate(
                [
                    move.get_proposal(places[half[turn]], [places[half[1 - turn]]], generator)[0]
                    for move, half, generator in zip(moves, halves, self.generators, strict=True)
                ]
            )
            reached, _ = model.compute_log_prob_fn(proposed)
            chance = [generator.rand(len(moving) // len(halves)) for generator in self.generators]
            better = reached - values[moving] > np.log(np.concatenate(chance))
            accepted[moving] = better
            places[moving[better]], values[moving[better]] = proposed[better], reached[better]
        return state, accepted


def _ensembles(density: Density, size: int, run: _Run) -> tuple[Any, Any]:
    """The emcee sampler of all ensembles and its first state."""
    import emcee

    def log_prob(u: np.ndarray) -> np.ndarray:
        return np.asarray(density(u))

    # Full generator states: emcee silently ignores an integer seed.
    generators = [
        np.random.RandomState(np.random.MT19937(child))
        for child in np.random.SeedSequence(run.seed).spawn(_ENSEMBLES)
    ]
    # Wider than the posterior, so that R-hat can see ensembles that disagree.
    start = 1.3 * np.concatenate([g.standard_normal((run.walkers, size)) for g in generators])
    values = np.concatenate([log_prob(half) for half in np.split(start, 2)])
    moves = [_SideBySide(generators)]
    sampler = emcee.EnsembleSampler(len(start), size, log_prob, moves=moves, vectorize=True)
    sampler.log_prob_fn = log_prob  # emcee's wrapper prints all walkers at an interrupt
    return sampler, emcee.State(start, log_prob=values)


def _draw(density: Density, size: int, run: _Run) -> tuple[np.ndarray | None, float, Outcome]:
    """Draw chunks of steps until the chain converged, reached its limit or was interrupted.

    Returns:
        Samples (ensembles, steps, walkers, p), None if interrupted before the first ones; the
        share of accepted steps; the outcome.
    """
    samples: np.ndarray | None = None
    accepted = 0.0
    try:
        sampler, state = _ensembles(density, size, run)
        while True:
            sampler.run_mcmc(state, CHUNK, skip_initial_state_check=True)
            state = None  # goes on where it ended
            samples = np.stack(np.split(sampler.get_chain(), _ENSEMBLES, axis=1))
            accepted = float(np.mean(sampler.acceptance_fraction))
            health, steps = _health(samples, run.target), samples.shape[1]
            if health.enough:
                return samples, accepted, Outcome.CONVERGED
            if steps >= run.max_steps:
                return samples, accepted, Outcome.CHAIN_TOO_SHORT
            if run.progress is not None:
                needed = health.discarded + _STEPS_PER_TAU * float(health.tau.max())
                share = min(steps / needed, float(health.ess.min()) / run.target, 0.99)
                run.progress(share, f"{steps} steps, R-hat {health.rhat.max():.3f}")
    except KeyboardInterrupt:
        return samples, accepted, Outcome.INTERRUPTED


def _of_chain(
    result: FitResult,
    samples: np.ndarray,
    accepted: float,
    outcome: Outcome,
    run: _Run,
    weighted: Weighted | None,
) -> FitResult:
    """The posterior of a chain; ``weighted`` is the rejected weighted sample, if any."""
    health = _health(samples, run.target)
    ensembles, steps, walkers, _ = samples.shape
    numbers = (health.ess, health.rhat, health.tau)
    ess, rhat, tau = (dict(zip(result.labels, x.tolist(), strict=True)) for x in numbers)
    k_hat, note = None, ""
    if weighted is not None:
        k_hat, note = weighted.k_hat, f"importance sampling refused ({weighted.refused})"
        note += ": emcee instead"
    summary = PosteriorSummary(
        "emcee", run.seed, ensembles, walkers, steps, health.discarded, ess, rhat,
        tau, accepted, outcome, k_hat, note,
    )  # fmt: skip
    # Nearly independent draws, the same ones for parameters and derived quantities.
    # A walker that never moved has no autocorrelation time: keep one draw of each.
    slowest = min(health.tau.max() / 2, health.kept.shape[1])
    thin = max(int(np.ceil(slowest)), 1)
    return _with_posterior(result, health.kept[:, ::thin], summary)


def _of_weighted(result: FitResult, weighted: Weighted, seed: int) -> FitResult:
    """The posterior of weighted points: one chain of independent draws."""
    if weighted.refused:
        return judge(replace(result, interrupted=True))
    count = len(weighted.draws)
    summary = PosteriorSummary(
        "importance", seed, 1, 1, weighted.points, 0,
        dict.fromkeys(result.labels, float(count)), {}, {}, count / weighted.points,
        Outcome.INTERRUPTED if weighted.interrupted else Outcome.CONVERGED,
        weighted.k_hat,
    )  # fmt: skip
    return _with_posterior(result, weighted.draws[None, :, None], summary)


def _with_posterior(result: FitResult, u: np.ndarray, summary: PosteriorSummary) -> FitResult:
    """The fit with draws u (ensembles, steps, walkers, p) of the whitened space."""
    solved: Solved = result.solved
    center, root = _whitening(solved)
    z = center + u @ root.T
    flat = z.reshape(-1, z.shape[-1])
    kept = solved.problem.layout.vector(flat.T).T.reshape(z.shape)
    estimates = {
        label: Estimate.of_draws(kept[..., i].ravel(), known.unit, known.identified)
        for i, label in enumerate(result.labels)
        for known in [result.least_squares[label]]
    }
    ends = {label: estimate.ci95 for label, estimate in estimates.items()}
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
