"""An unfinished chain: its samples, the state to continue from, and its file.

emcee's HDF backend was tried and is not used: it opens its file at every step, with 3.1
ms of processor time against 0.18 ms of the step itself (64 walkers, two parameters). It
also holds one ensemble per group and no identity of the fit. This file is
replaced as a whole every few seconds: a kill loses the samples since then, which are
drawn again identically.
"""

import io
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tirefit.door import CHAIN, content_of, sealed_bytes, unsealed_bytes
from tirefit.files import replacing
from tirefit.fitting.result import FitResult
from tirefit.results import UsageError

_KIND = "tirefit.chain/1"
_SECONDS_BETWEEN = 5.0


class Chain(NamedTuple):
    """Samples of all ensembles in the whitened space, and the state to continue from."""

    samples: np.ndarray  # (ensembles, steps, walkers, p)
    log_density: np.ndarray  # (ensembles, steps, walkers)
    accepted: float
    state: dict[str, np.ndarray]  # arrays of the sampler


def identity_of(result: FitResult, sampler: str, seed: int, shape: Sequence[int]) -> str:
    """A text that is equal for two chains only if one can continue the other."""
    z, variance = result.z, np.diag(result.covariance)
    numbers = [*(f"{value:.8g}" for value in z), *(f"{value:.4g}" for value in variance)]
    data = result.data["sha256"], result.data["used"]
    return "|".join(map(str, (result.model, *data, sampler, seed, shape, *result.labels, *numbers)))


def save_chain(path: Path, chain: Chain, identity: str) -> None:
    """Write the chain atomically."""
    content: dict[str, Any] = {f"state_{k}": value for k, value in chain.state.items()}
    content |= chain._asdict() | {"identity": identity}
    del content["state"]
    packed = io.BytesIO()
    np.savez(packed, **content)
    with replacing(path) as temporary:
        temporary.write_bytes(sealed_bytes(_KIND, packed.getvalue()))


class Keeper:
    """Stores a chain in its file while it is drawn: every few seconds, and at the end.

    A full disk does not stop the sampling: ``fault`` holds the last error.
    """

    def __init__(self, path: Path | None, identity: str):
        self.fault = ""
        self._path, self._identity = path, identity
        self._last = time.monotonic()

    def now_and_then(self, chain: Chain) -> None:
        if time.monotonic() - self._last > _SECONDS_BETWEEN:
            self.keep(chain)

    def keep(self, chain: Chain) -> None:
        if self._path is None:
            return
        try:
            save_chain(self._path, chain, self._identity)
            self.fault = ""
        except OSError as error:
            there = "an earlier part of it" if self._path.exists() else "nothing"
            self.fault = f"{error.filename}: {error.strerror}; {there} is kept"
        self._last = time.monotonic()


def load_chain(path: Path, identity: str) -> Chain | None:
    """The chain in a file; None if there is no file.

    Raises:
        UsageError: not a chain, a wrong checksum, or the chain of another fit.
    """
    if not path.exists():
        return None
    content = unsealed_bytes(_KIND, content_of(path, CHAIN, UsageError))
    if content is None:
        raise UsageError(
            f"{path} is not a chain stored by tirefit, or is damaged: remove it,"
            " or fit without --resume"
        )
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        if str(file["identity"]) != identity:
            raise UsageError(
                f"{path} holds the chain of another fit (other data, model, seed or"
                " settings): resume with the same ones, or remove the file"
            )
        state = {k[6:]: file[k] for k in file.files if k.startswith("state_")}
        return Chain(file["samples"], file["log_density"], float(file["accepted"]), state)


def extended(
    chain: Chain | None,
    samples: np.ndarray,
    values: np.ndarray,
    accepted: float,
    state: dict[str, np.ndarray],
) -> Chain:
    """The chain with a chunk added."""
    if chain is None:
        return Chain(samples, values, accepted, state)
    steps = chain.samples.shape[1], samples.shape[1]
    rate = float(np.average([chain.accepted, accepted], weights=steps))
    samples = np.concatenate([chain.samples, samples], axis=1)
    return Chain(samples, np.concatenate([chain.log_density, values], axis=1), rate, state)
