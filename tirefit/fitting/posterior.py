"""Sampling the posterior: independent emcee ensembles until they agree.

The only importer of emcee. Sampling happens in the whitened unconstrained space of the
least-squares fit, where a well-identified posterior is nearly a unit Gaussian; the
prior is flat within the bounds of the natural parameters, or what ``fit.toml`` gives.

A run is a sequence of chunks of steps. After each chunk the random state is part of
the record, so an interrupted run that is resumed draws exactly the same samples as one
that was not.
"""

import os
import zipfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.files import replacing
from tirefit.fitting.derived import derived_from_draws
from tirefit.fitting.estimate import with_fixed
from tirefit.fitting.hmc import hmc_chunk, hmc_start
from tirefit.fitting.inference import REACH, deviance
from tirefit.fitting.likelihood import FitProblem
from tirefit.fitting.result import Estimate, FitResult, PosteriorSummary
from tirefit.fitting.solve import Solved
from tirefit.fitting.verdict import judge
from tirefit.precision import require_x64
from tirefit.results import Outcome, UsageError

__all__ = ["CHUNK", "SAMPLERS", "Chain", "sample", "split_rhat"]

CHUNK = 100
"""Steps between two checks of convergence."""

_WALKERS = 64
_RHAT = 1.01
_STEPS_PER_TAU = 50


class Chain(NamedTuple):
    """Samples of all ensembles and what the next chunk starts from.

    ``samples`` (ensembles, steps, walkers, p) and ``log_density`` (ensembles, steps,
    walkers) are in the whitened space; ``state`` is the sampler's own record of arrays.
    """

    samples: np.ndarray
    log_density: np.ndarray
    accepted: float
    state: dict[str, np.ndarray]


@jax.jit
def _log_density(u, problem: FitProblem, center, root, base):
    def one(u):
        z = center + root @ u
        value = deviance(problem, z) - base
        density = -value / 2 + problem.layout.log_volume(z)
        # NaN loses: a point where the model is undefined is never accepted.
        return jnp.where(jnp.isfinite(density), density, -jnp.inf)

    return jax.vmap(one)(u)


def _whitening(solved: Solved) -> tuple[np.ndarray, np.ndarray]:
    """Center and root of the covariance; a center inside the reach of the bounds."""
    values, vectors = np.linalg.eigh(solved.covariance)
    # Half the reach: walkers of an unidentified direction must not start at the bounds.
    root = vectors * np.sqrt(np.clip(values, 1e-12, (REACH / 4) ** 2))
    return np.clip(solved.z, -REACH / 2, REACH / 2), root


def _density(solved: Solved) -> Callable[[np.ndarray], np.ndarray]:
    """u (walkers, p) -> log density (walkers,) of the whitened posterior."""
    problem = solved.problem
    center, root = _whitening(solved)
    base = deviance(problem, solved.z)
    return partial(_log_density, problem=problem, center=center, root=root, base=base)


def _random_states(seed: int, count: int) -> list[tuple]:
    """Full generator states: emcee silently ignores an integer seed."""
    children = np.random.SeedSequence(seed).spawn(count)
    return [
        np.random.RandomState(np.random.MT19937(child)).get_state()
        for child in children
    ]


def _pack(state: tuple) -> np.ndarray:
    """A Mersenne Twister state as one array of 627 floats (all exact below 2^53)."""
    _, keys, position, has_gauss, cached = state
    return np.concatenate([keys.astype(float), [position, has_gauss, cached]])


def _unpack(packed: np.ndarray) -> tuple:
    keys = packed[:624].astype(np.uint32)
    return "MT19937", keys, int(packed[624]), int(packed[625]), float(packed[626])


def _emcee_start(density, size: int, ensembles: int, walkers: int, seed: int):
    coordinates, packed, values = [], [], []
    for state in _random_states(seed, ensembles):
        generator = np.random.RandomState()
        generator.set_state(state)
        # Wider than the posterior, so that R-hat can see ensembles that disagree.
        start = 1.3 * generator.standard_normal((walkers, size))
        halves = [np.asarray(density(half)) for half in np.split(start, 2)]
        coordinates.append(start)
        values.append(np.concatenate(halves))
        packed.append(_pack(generator.get_state()))
    return {
        "coordinates": np.array(coordinates),
        "values": np.array(values),
        "random": np.array(packed),
    }


def _emcee_chunk(density, state: dict, steps: int):
    """Advance every ensemble by ``steps``: (samples, log density, accepted, state)."""
    import emcee

    ensembles, walkers, size = state["coordinates"].shape
    # Differential evolution, with full jumps between modes one time in ten (ter Braak
    # 2006): a quarter of the stretch move's autocorrelation time, and no loop over
    # walkers in Python as in the snooker move.
    moves = [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)]
    samples = np.empty((ensembles, steps, walkers, size))
    values = np.empty((ensembles, steps, walkers))
    accepted, after = 0.0, {key: value.copy() for key, value in state.items()}
    for e in range(ensembles):
        sampler = emcee.EnsembleSampler(
            walkers, size, lambda u: np.asarray(density(u)), moves=moves, vectorize=True
        )
        start = emcee.State(
            state["coordinates"][e], log_prob=state["values"][e],
            random_state=_unpack(state["random"][e]),
        )  # fmt: skip
        run = sampler.sample(start, iterations=steps, skip_initial_state_check=True)
        for step, now in enumerate(run):
            samples[e, step], values[e, step] = now.coords, now.log_prob
        after["coordinates"][e], after["values"][e] = now.coords, now.log_prob
        after["random"][e] = _pack(sampler.random_state)
        accepted += float(np.mean(sampler.acceptance_fraction)) / ensembles
    return samples, values, accepted, after


SAMPLERS = {
    "emcee": (_emcee_start, _emcee_chunk),
    "hmc": (hmc_start, hmc_chunk),
}
"""Sampler name -> (start, chunk); every one fills the same :class:`Chain`."""


def split_rhat(samples: np.ndarray) -> np.ndarray:
    """Split R-hat of ensembles, shape (ensembles, steps, walkers, p) -> (p,).

    Each ensemble's first and second half count as one chain each, walkers pooled:
    walkers of one ensemble depend on each other and prove nothing alone.
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

    times = [
        emcee.autocorr.integrated_time(ensemble, quiet=True, has_walkers=True, tol=0)
        for ensemble in samples
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


def _identity(result: FitResult, sampler: str, seed: int, shape) -> str:
    parts = (
        result.model, result.data["sha256"], str(result.data["used"]), sampler,
        str(seed), str(shape), *result.labels, *(f"{value:.8g}" for value in result.z),
        *(f"{value:.4g}" for value in np.diag(result.covariance)),
    )  # fmt: skip
    return "|".join(parts)


def _save(path: Path, chain: Chain, identity: str) -> None:
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(
            file, samples=chain.samples, log_density=chain.log_density,
            accepted=chain.accepted, identity=identity,
            **{f"state_{key}": value for key, value in chain.state.items()},
        )  # fmt: skip


def _load(path: Path, identity: str) -> Chain | None:
    if not path.exists():
        return None
    try:
        opened = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError, zipfile.BadZipFile):
        raise UsageError(
            f"{path} is not a chain that tirefit kept: remove it, or fit without"
            " --resume"
        ) from None
    with opened as file:
        if str(file["identity"]) != identity:
            raise UsageError(
                f"{path} holds the chain of another fit (other data, model, seed or"
                " settings): resume with the same ones, or remove the file"
            )
        state = {k[6:]: file[k] for k in file.files if k.startswith("state_")}
        return Chain(
            file["samples"], file["log_density"], float(file["accepted"]), state
        )


def _extended(chain: Chain | None, samples, values, accepted, state) -> Chain:
    if chain is None or chain.samples.shape[1] == 0:
        return Chain(samples, values, accepted, state)
    before, added = chain.samples.shape[1], samples.shape[1]
    return Chain(
        np.concatenate([chain.samples, samples], axis=1),
        np.concatenate([chain.log_density, values], axis=1),
        (before * chain.accepted + added * accepted) / (before + added),
        state,
    )


def sample(
    result: FitResult,
    *,
    sampler: str = "emcee",
    ensembles: int = 4,
    walkers: int | None = None,
    effective_samples: int = 4000,
    max_steps: int = 5000,
    seed: int | None = None,
    checkpoint: str | os.PathLike | None = None,
    resume: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> FitResult:
    """The same fit with its posterior.

    Args:
        result: a fit from this process (``tirefit.fit``).
        sampler: ``emcee``, or ``hmc`` (gradients, inside JAX; far faster).
        ensembles: independent ensembles, at least 4.
        walkers: walkers per ensemble, even; by default 64, more for many parameters.
        effective_samples: stop once every parameter has as many, the chain is 50
            autocorrelation times long and split R-hat is below 1.01.
        max_steps: give up there, and say so.
        seed: of the sampling; the fit's own if None.
        checkpoint: file that keeps the samples while they are drawn.
        resume: continue from ``checkpoint`` if it is there.
        progress: called with (share done, message).

    Raises:
        UsageError: too few ensembles, odd walkers, or a checkpoint of another fit; or
            32-bit floats in use.
    """
    require_x64("sampling")
    solved: Solved = result.solved
    size = solved.problem.layout.size
    walkers = walkers or max(_WALKERS, 2 * ((4 * size + 1) // 2))
    if ensembles < 4 or walkers % 2 or walkers < 2 * size + 2:
        raise UsageError(
            f"{ensembles} ensembles of {walkers} walkers: at least 4 ensembles and an"
            f" even number of walkers, at least {2 * size + 2}, are needed"
        )
    seed = result.seed if seed is None else seed
    shape = (ensembles, walkers)
    identity = _identity(result, sampler, seed, shape)
    path = None if checkpoint is None else Path(checkpoint)
    chain = _load(path, identity) if resume and path is not None else None
    chain, outcome = _draw(
        _density(solved), SAMPLERS[sampler], size, shape, seed, chain,
        effective_samples, max_steps, path, identity, progress,
    )  # fmt: skip
    if chain is None:
        return judge(replace(result, interrupted=True))
    return _with_posterior(result, chain, outcome, sampler, seed, effective_samples)


def _draw(
    density,
    sampler,
    size,
    shape,
    seed,
    chain,
    target,
    max_steps,
    path,
    identity,
    progress,
) -> tuple[Chain | None, Outcome]:
    """Chunks until the chain is good, the limit is reached or the user interrupts."""
    import time

    begin, advance = sampler
    saved = time.monotonic()
    outcome = Outcome.CHAIN_TOO_SHORT
    try:
        state = begin(density, size, *shape, seed) if chain is None else chain.state
        while True:
            if chain is not None:
                health = _health(chain.samples, target)
                if health.enough:
                    outcome = Outcome.CONVERGED
                    break
                if chain.samples.shape[1] >= max_steps:
                    break
                if progress is not None:
                    progress(*_share(chain, health, target))
            chain = _extended(chain, *advance(density, state, CHUNK))
            state = chain.state
            if path is not None and time.monotonic() - saved > 5:
                _save(path, chain, identity)
                saved = time.monotonic()
    except KeyboardInterrupt:
        outcome = Outcome.INTERRUPTED
    if path is not None and chain is not None:
        _save(path, chain, identity)
    return chain, outcome


def _share(chain: Chain, health: _Health, target: int) -> tuple[float, str]:
    steps = chain.samples.shape[1]
    needed = health.discarded + _STEPS_PER_TAU * float(health.tau.max())
    share = min(steps / needed, float(health.ess.min()) / target, 0.99)
    return share, f"{steps} steps, R-hat {health.rhat.max():.3f}"


def _with_posterior(
    result: FitResult, chain: Chain, outcome: Outcome, sampler, seed, target
) -> FitResult:
    solved: Solved = result.solved
    center, root = _whitening(solved)
    health = _health(chain.samples, target)
    # Nearly independent draws; parameters and derived quantities are of the same ones.
    thin = max(int(np.ceil(health.tau.max() / 2)), 1)
    z = center + health.kept[:, ::thin] @ root.T
    flat = z.reshape(-1, z.shape[-1])
    natural = jax.jit(jax.vmap(solved.problem.layout.vector))
    kept = np.asarray(natural(jnp.asarray(flat))).reshape(z.shape)
    labels = result.labels
    estimates, ends = {}, {}
    for i, label in enumerate(labels):
        draws = kept[..., i].ravel()
        low, high = (float(end) for end in np.quantile(draws, [0.025, 0.975]))
        least_squares = result.least_squares[label]
        ends[label] = (low, high)
        estimates[label] = Estimate(
            float(np.median(draws)),
            float(draws.std()) if least_squares.identified else None,
            least_squares.unit, (low, high), least_squares.identified,
        )  # fmt: skip
    summary = PosteriorSummary(
        sampler, seed, chain.samples.shape[0], chain.samples.shape[2],
        chain.samples.shape[1], health.discarded,
        dict(zip(labels, health.ess.tolist(), strict=True)),
        dict(zip(labels, health.rhat.tolist(), strict=True)),
        dict(zip(labels, health.tau.tolist(), strict=True)),
        chain.accepted, outcome,
    )  # fmt: skip
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
