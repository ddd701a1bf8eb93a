"""Sampling the posterior: chains until they agree, or weighted independent points.

The only importer of emcee. Sampling happens in the whitened unconstrained space of the
least-squares fit, where a well-identified posterior is nearly a unit Gaussian; the
prior is flat within the bounds of the natural parameters, or what ``fit.toml`` gives.

A chain is a sequence of chunks of steps. The record holds the random state after each
chunk: a resumed run draws exactly the samples of an uninterrupted one.
"""

import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
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
from tirefit.fitting.uncertainty.chains import Chain, Keeper, extended, identity_of, load_chain
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


def _pack(state: Any) -> np.ndarray:
    """A Mersenne Twister state as one array of 627 floats (all exact below 2^53)."""
    return np.concatenate([state[1].astype(float), state[2:]])


def _start(
    density: Density, size: int, ensembles: int, walkers: int, seed: int
) -> dict[str, np.ndarray]:
    state: dict[str, list[np.ndarray]] = {"coordinates": [], "values": [], "random": []}
    # Full generator states: emcee silently ignores an integer seed.
    for child in np.random.SeedSequence(seed).spawn(ensembles):
        generator = np.random.RandomState(np.random.MT19937(child))
        # Wider than the posterior, so that R-hat can see ensembles that disagree.
        start = 1.3 * generator.standard_normal((walkers, size))
        state["coordinates"].append(start)
        halves = [np.asarray(density(half)) for half in np.split(start, 2)]
        state["values"].append(np.concatenate(halves))
        state["random"].append(_pack(generator.get_state()))
    return {key: np.array(parts) for key, parts in state.items()}


def _chunk(
    density: Density, state: dict[str, np.ndarray], steps: int
) -> tuple[np.ndarray, np.ndarray, float, dict[str, np.ndarray]]:
    """Advance every ensemble by ``steps``: (samples, log density, accepted, state)."""
    import emcee  # here, because importance sampling does not need it

    ensembles, walkers, size = state["coordinates"].shape
    # Differential evolution, with a full jump between modes in one step of ten (ter
    # Braak 2006): a quarter of the autocorrelation time of the stretch move, and no loop
    # over walkers in Python as in the snooker move.
    moves = [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)]
    samples = np.empty((ensembles, steps, walkers, size))
    values = np.empty((ensembles, steps, walkers))
    accepted, after = 0.0, {key: value.copy() for key, value in state.items()}

    def log_prob(u: np.ndarray) -> np.ndarray:
        return np.asarray(density(u))

    for e in range(ensembles):
        sampler = emcee.EnsembleSampler(walkers, size, log_prob, moves=moves, vectorize=True)
        sampler.log_prob_fn = log_prob  # emcee's wrapper prints all walkers at an interrupt
        *keys, position, has_gauss, cached = state["random"][e]
        random = "MT19937", np.array(keys, np.uint32), int(position), int(has_gauss), float(cached)
        start = emcee.State(
            state["coordinates"][e], log_prob=state["values"][e], random_state=random
        )
        run = sampler.sample(start, iterations=steps, skip_initial_state_check=True)
        for step, now in enumerate(run):
            samples[e, step], values[e, step] = now.coords, now.log_prob
        after["coordinates"][e], after["values"][e] = now.coords, now.log_prob
        after["random"][e] = _pack(sampler.random_state)
        accepted += float(np.mean(sampler.acceptance_fraction)) / ensembles
    return samples, values, accepted, after


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
    checkpoint: str | os.PathLike[str] | None = None,
    resume: bool = False,
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
        checkpoint: file that stores the chain during sampling.
        resume: continue from ``checkpoint`` if it exists. Importance sampling has
            nothing to continue: the same seed draws the same samples again.
        progress: called with (share done, message).

    Returns:
        The fit whose ``parameters`` and ``derived`` are those of the posterior, with
        ``chains`` and ``posterior``, the quality of the sampling.

    Raises:
        UsageError: an unknown sampler, too few ensembles, odd walkers, or a checkpoint
            of another fit; or 32-bit floats in use.

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
    size = solved.problem.layout.size
    if sampler is None:
        sampler = "importance" if solved.problem.slip_noise or size > _MANY else "emcee"
    target = effective_samples or _TARGETS[bool(solved.problem.slip_noise)]
    shape = _shape(size, ensembles, walkers)
    path = None if checkpoint is None else Path(checkpoint)
    run = _Run(sampler, seed, shape, target, max_steps, path, resume, progress)
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
        return _sampled(result, solved.problem, run._replace(resume=False))
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
    path: Path | None
    resume: bool
    progress: Callable[[float, str], None] | None


def _sampled(result: FitResult, problem: FitProblem, run: _Run) -> FitResult:
    """The fit with the posterior of this problem: its own, or one made of cells."""
    solved: Solved = result.solved
    density, weighted = _density(solved._replace(problem=problem)), None
    size = solved.problem.layout.size
    if run.sampler == "importance":
        weighted = draw_weighted(density, *_whitening(solved), run.seed, run.target, run.progress)
        if weighted.interrupted or not weighted.refused:
            return _of_weighted(result, weighted, run.seed)
    identity = identity_of(result, "emcee", run.seed, run.shape)
    chain, keeper = None, Keeper(run.path, identity)
    if run.resume and run.path is not None:
        chain = load_chain(run.path, identity)
    chain, outcome = _draw(density, size, run, chain, keeper)
    if chain is None:
        return judge(replace(result, interrupted=True))
    notes = []
    if weighted is not None:
        refused = f"importance sampling refused ({weighted.refused})"
        notes.append(f"{refused}: emcee instead")
    if keeper.fault:
        notes.append(f"the chain was not kept for --resume: {keeper.fault}")
    return _of_chain(result, chain, outcome, run, weighted, notes)


def _shape(size: int, ensembles: int, walkers: int | None) -> tuple[int, int]:
    """(ensembles, walkers) of a run; UsageError if the sampler cannot use them."""
    walkers = walkers or max(_WALKERS, 2 * ((4 * size + 1) // 2))
    if ensembles < 4 or walkers % 2 or walkers < 2 * size + 2:
        raise UsageError(
            f"{ensembles} ensembles of {walkers} walkers: at least 4 ensembles and an"
            f" even number of walkers, at least {2 * size + 2}, are needed"
        )
    return ensembles, walkers


def _draw(
    density: Density, size: int, run: _Run, chain: Chain | None, keeper: Keeper
) -> tuple[Chain | None, Outcome]:
    """Sample chunks until the chain converged, reached its limit or was interrupted."""
    outcome = Outcome.CHAIN_TOO_SHORT
    try:
        state = _start(density, size, *run.shape, run.seed) if chain is None else chain.state
        while True:
            if chain is not None:
                health = _health(chain.samples, run.target)
                if health.enough:
                    outcome = Outcome.CONVERGED
                    break
                if chain.samples.shape[1] >= run.max_steps:
                    break
                if run.progress is not None:
                    steps, least = chain.samples.shape[1], float(health.ess.min())
                    needed = health.discarded + _STEPS_PER_TAU * float(health.tau.max())
                    share = min(steps / needed, least / run.target, 0.99)
                    run.progress(share, f"{steps} steps, R-hat {health.rhat.max():.3f}")
            chain = extended(chain, *_chunk(density, state, CHUNK))
            state = chain.state
            keeper.now_and_then(chain)
    except KeyboardInterrupt:
        outcome = Outcome.INTERRUPTED
    if chain is not None:
        keeper.keep(chain)
    return chain, outcome


def _of_chain(
    result: FitResult,
    chain: Chain,
    outcome: Outcome,
    run: _Run,
    weighted: Weighted | None,
    notes: list[str],
) -> FitResult:
    """The posterior of a chain; ``weighted`` is the rejected weighted sample, if any."""
    health = _health(chain.samples, run.target)
    ensembles, steps, walkers, _ = chain.samples.shape
    numbers = (health.ess, health.rhat, health.tau)
    ess, rhat, tau = (dict(zip(result.labels, x.tolist(), strict=True)) for x in numbers)
    k_hat = None if weighted is None else weighted.k_hat
    summary = PosteriorSummary(
        "emcee", run.seed, ensembles, walkers, steps, health.discarded, ess, rhat,
        tau, chain.accepted, outcome, k_hat, "; ".join(notes),
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
