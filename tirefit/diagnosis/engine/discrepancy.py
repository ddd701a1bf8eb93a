"""An effect that the library does not list: smooth functions with a Gaussian prior.

Each :class:`Cell` is one quantity of the model (a force, a friction, ...) that varies with one
covariate as a Gaussian process (Matern 3/2). Which cell, its length scale and its size are
averaged over; the same functions show where a gap lies and what is left.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import logsumexp

from tirefit.diagnosis.engine import NONZERO, ROUNDING

if TYPE_CHECKING:
    from tirefit.diagnosis.engine.fit import Fit

LENGTHS = (0.06, 0.2, 0.7)
"""Length scales of the functions over the range of their covariate."""

SIZES = 0.5 * 4.0 ** np.arange(4)
"""Standard deviations of the functions, in usual changes of their quantity."""


class Cell(NamedTuple):
    """A quantity that varies with a covariate, by its values at ``places`` of the covariate;
    ``settings``: these are its only values; ``is_local``: a value belongs to one part of the
    data, and no other part predicts it."""

    quantity: str
    covariate: str
    places: np.ndarray
    settings: bool
    is_local: bool = False


class Component(NamedTuple):
    """A cell in the remainder of a fit: its log evidence, its probability among all, the
    share of the mean square of the remainder that it explains, and the function at the places of
    the cell, in usual changes of its quantity."""

    cell: Cell
    log_evidence: float
    probability: float
    explains: float
    value: np.ndarray


def places_of(
    values: np.ndarray, centers: np.ndarray | None, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Weights (n, k) of the values at evenly spaced places, by linear interpolation; at the
    ``centers`` if the covariate has only these settings. Returns them and the places."""
    if centers is not None:
        nearest = np.abs(values[:, None] - centers).argmin(axis=1)
        return np.eye(len(centers))[nearest], centers
    places = np.linspace(values.min(), values.max(), count)
    share = (values[:, None] - places) / max(places[1] - places[0], NONZERO)
    return np.maximum(1 - np.abs(share), 0.0), places


def _root(cell: Cell, length: float) -> np.ndarray:
    """Root (k, k) of the prior covariance of the values at the places of a cell."""
    count = len(cell.places)
    if cell.settings:
        return np.eye(count)
    apart = np.sqrt(3) * np.abs(np.subtract.outer(*2 * [np.linspace(0, 1, count)])) / length
    return np.linalg.cholesky((1 + apart) * np.exp(-apart) + 1e-9 * np.eye(count))


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Columns (m, q), one for each place of each cell in turn, whitened, for usual changes of
    their quantities."""

    columns: np.ndarray
    cells: tuple[Cell, ...]

    @cached_property
    def slices(self) -> list[slice]:
        """The columns of each cell."""
        ends = np.cumsum([len(cell.places) for cell in self.cells]).tolist()
        return [slice(first, end) for first, end in pairwise([0, *ends])]

    @cached_property
    def _roots(self) -> np.ndarray:
        """Roots (cells, lengths, k, k) of the priors, padded with zeros."""
        most = max((len(cell.places) for cell in self.cells), default=0)
        roots = np.zeros((len(self.cells), len(LENGTHS), most, most))
        for k, cell in enumerate(self.cells):
            size = len(cell.places)
            for j, length in enumerate(LENGTHS):
                roots[k, j, :size, :size] = _root(cell, length)
        return roots

    def _gains(self, fit: "Fit") -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Log evidence (cells, lengths, sizes) beside a fit, and what gives the functions."""
        if not self.cells:
            return np.zeros((0, len(LENGTHS), len(SIZES))), ()
        roots, most = self._roots, self._roots.shape[-1]
        used = self.columns.T @ fit.unit[: len(self.columns)]
        score = self.columns.T @ fit.remainder()[: len(self.columns)]
        # Products (cells, k, k) and scores (cells, k) of each cell.
        grams, scores = np.zeros((len(self.cells), most, most)), np.zeros((len(self.cells), most))
        for k, (part, gram) in enumerate(zip(self.slices, self._grams, strict=True)):
            inside, size = used[part], len(gram)
            grams[k, :size, :size] = gram - inside @ inside.T
            scores[k, :size] = score[part]
        turned = np.swapaxes(roots, 2, 3) @ grams[:, None] @ roots
        values, vectors = np.linalg.eigh(turned)
        values = np.maximum(values, 0.0)[..., None, :]
        along = np.einsum("clij,cli->clj", roots @ vectors, np.tile(scores[:, None], (1, 3, 1)))
        t = SIZES[:, None] ** 2
        gains = 0.5 * (t * along[..., None, :] ** 2 / (1 + t * values) - np.log1p(t * values))
        return gains.sum(axis=-1), (roots @ vectors, values, along)

    @cached_property
    def _grams(self) -> list[np.ndarray]:
        parts = (self.columns[:, part] for part in self.slices)
        return [part.T @ part for part in parts]

    def log_evidence(self, fit: "Fit") -> float:
        """Log evidence of an unlisted effect beside a fit, over none: each cell is equally
        likely."""
        gains = self._gains(fit)[0]
        return float(_averaged(gains, (0, 1, 2))) if gains.size else -np.inf

    def local_share(self, fit: "Fit") -> float:
        """Share of the evidence beside a fit that local cells have."""
        components = self.components(fit, len(self.cells))
        return sum(part.probability for part in components if part.cell.is_local)

    def components(self, fit: "Fit", most: int = 3) -> list[Component]:
        """The most probable functions in the remainder of a fit, the first one first."""
        gains, parts = self._gains(fit)
        rest, components = fit.remainder(), list[Component]()
        energy = max(float(rest @ rest), ROUNDING)
        for k, (cell, log) in enumerate(zip(self.cells, _averaged(gains, (1, 2)), strict=True)):
            size = len(cell.places)
            j, s = np.unravel_index(np.argmax(gains[k]), gains[k].shape)
            ways, values, along = (part[k, j] for part in parts)
            t = SIZES[s] ** 2
            shrunk = t / (1 + t * values[0])
            value = (ways @ (shrunk * along))[:size]
            explains = min(float(np.sum(shrunk * along**2)) / energy, 1.0)
            components.append(Component(cell, float(log), 0.0, explains, value))
        logs = np.array([part.log_evidence for part in components])
        chances = np.exp(logs - logsumexp(logs)) if components else logs
        ranked = np.argsort(-logs, kind="stable")[:most]
        return [components[k]._replace(probability=float(chances[k])) for k in ranked]

    @cached_property
    def additive(self) -> np.ndarray:
        """Columns (m, q) whose coefficients have unit prior variance each: the sum of all
        cells, with the middle length scale, at usual size."""
        parts = [
            self.columns[:, part] @ _root(cell, LENGTHS[1])
            for cell, part in zip(self.cells, self.slices, strict=True)
        ]
        many = max(len(parts), 1) ** 0.5
        return np.concatenate([self.columns[:, :0], *parts], axis=1) / many


def _averaged(logs: np.ndarray, axis: int | tuple[int, ...]) -> np.ndarray:
    """Logarithm of the mean of exponentials."""
    axes = (axis,) if isinstance(axis, int) else axis
    count = np.prod([logs.shape[a] for a in axes])
    if not logs.size:
        return np.zeros(0)
    return logsumexp(logs, axis=axis) - np.log(count)


def likeliest_beside(columns: np.ndarray, fit: "Fit") -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (q,) of further columns (m, q) beside a fit, and root (q, q) of their
    covariance, for a normal prior of the likeliest of ``SIZES``."""
    left = fit.remainder(columns)
    values, ways = np.linalg.eigh(left.T @ left)
    along = ways.T @ (left.T @ fit.remainder())
    curved = 1 + SIZES[:, None] ** 2 * np.maximum(values, 0.0)
    variances = SIZES[:, None] ** 2 / curved  # (sizes, q) of each direction
    logs = 0.5 * np.sum(variances * along**2 - np.log(curved), axis=1)
    variance = variances[int(np.argmax(logs))]
    return ways @ (variance * along), ways * np.sqrt(variance)
