"""What the engine asks of its subject (:class:`Forward`), and a fitted set of effects."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.special import log_ndtr

from tirefit.diagnosis.effects import Atom
from tirefit.diagnosis.engine import FLAT, ROUNDING
from tirefit.diagnosis.engine.discrepancy import Discrepancy

Key = tuple[str, ...]
"""A set of effects: their ids in order; () means no effect."""


class Start(NamedTuple):
    """Where a refit begins: parameters (p,), amplitudes (k,) in prior scales, and the
    subject's own ``state``."""

    z: np.ndarray
    amplitude: np.ndarray
    state: Any = None


class Folds(NamedTuple):
    """A partition of the data. ``code`` (m,) is the part of each residual, -1 for one that
    is never left out; ``on`` names the parts for the report. ``is_covered``: each part lies where
    the others do, as windows of a car, so that smooth functions of the others predict it."""

    code: np.ndarray
    on: str
    is_covered: bool = False

    @property
    def number(self) -> int:
        return int(self.code.max()) + 1


class Priors(NamedTuple):
    """Priors of the amplitudes of all atoms, (K,) each: center and physical range in prior
    standard deviations, change of the log odds, and ``scale``, the prior standard deviations
    in the units of the amplitudes."""

    center: np.ndarray
    low: np.ndarray
    high: np.ndarray
    odds: np.ndarray
    scale: np.ndarray

    @property
    def sign(self) -> np.ndarray:
        """+1 or -1 where only that sign is physical, which excludes half of the prior."""
        return np.where(self.low >= 0, 1.0, np.where(self.high <= 0, -1.0, 0.0))


class Forward(Protocol):
    """A subject of a diagnosis: a model of measurements with parameters and effects.

    Attributes:
        atoms: the variants of all effects (K).
        testable: numbers of those that the data can show.
        priors: of the amplitudes; start: of the refit without effects.
        unit: (m,) size of a whitened residual in the unit of the first channel, zero for
            residuals of other channels and for excluded ones.
        floor: mean square of the noise of the first channel, in its unit squared.
        discrepancy: functions for an effect that is not listed.
        given_residual: (m,) whitened residual of a simulator whose parameters are not refitted,
            None for a fitted form.
    """

    @property
    def atoms(self) -> tuple[Atom, ...]: ...

    @property
    def testable(self) -> tuple[int, ...]: ...

    @property
    def priors(self) -> Priors: ...

    @property
    def start(self) -> Start: ...

    @property
    def unit(self) -> np.ndarray: ...

    @property
    def floor(self) -> float: ...

    @property
    def given_residual(self) -> np.ndarray | None: ...

    @property
    def discrepancy(self) -> Discrepancy: ...

    def groups(self) -> dict[str, np.ndarray]:
        """Covariates (m,) in whose groups the size of an effect is compared."""

    def folds(self, effects: Key) -> Folds:
        """The parts of the data that are left out in turn, for the naming of these effects."""

    def refit(self, starts: Sequence[Start], sets: Sequence[tuple[int, ...]]) -> list["Fit"]:
        """Sets of atoms fitted from these starts."""

    def tangents(self, fit: "Fit") -> np.ndarray:
        """Whitened slopes (m, K) of the prediction by the amplitudes of all atoms."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A set of atoms fitted, linearised at its optimum and whitened.

    Nuisances (true slips, states at the start of a window) are projected out of the
    residual and of all columns. Priors are further rows of the same least squares.

    Attributes:
        atoms: their numbers, in order; ``effects`` their ids.
        z: parameters (p,); ``amplitude`` (k,) in prior scales.
        residual: (m,) observed minus predicted.
        columns: (m, p + k) slopes of the prediction by parameters and amplitudes.
        pull: (p + k,) roots of the precisions of the priors; ``off`` (p + k,) distances
            from their centers.
        log_evidence: plus a constant that is the same for all sets of a subject.
        state: the subject's own.
    """

    atoms: tuple[int, ...]
    effects: tuple[str, ...]
    z: np.ndarray
    amplitude: np.ndarray
    residual: np.ndarray
    columns: np.ndarray
    pull: np.ndarray
    off: np.ndarray
    log_evidence: float
    state: Any = None

    @property
    def key(self) -> Key:
        """The ids of its effects in alphabetical order."""
        return tuple(sorted(self.effects))

    @property
    def start(self) -> Start:
        """To begin another refit here."""
        return Start(self.z, self.amplitude, self.state)

    @cached_property
    def _rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Columns and residual with the rows of the priors."""
        return with_priors(self.columns, self.residual, self.pull, self.off)

    @cached_property
    def unit(self) -> np.ndarray:
        """Orthonormal columns (m + p + k, p + k)."""
        return np.linalg.qr(self._rows[0])[0]

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (p + k, p + k) of parameters and amplitudes."""
        columns = self._rows[0]
        return np.linalg.inv(columns.T @ columns)

    @property
    def errors(self) -> np.ndarray:
        """Standard errors (k,) of the amplitudes."""
        return np.sqrt(np.maximum(np.diag(self.covariance)[len(self.z) :], ROUNDING))

    def remainder(self, values: np.ndarray | None = None) -> np.ndarray:
        """The part of the residual, or of other columns (m, ...), that a change of
        parameters and amplitudes does not explain; with the rows of the priors."""
        if values is None:
            whole = self._rows[1]
        else:
            whole = np.concatenate([values, np.zeros((len(self.pull), *values.shape[1:]))])
        return whole - self.unit @ (self.unit.T @ whole)

    def further(self, tangents: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Products (K, K) and scores (K,) of further columns (m, K) beside the set, and
        these columns orthogonal to it."""
        left = self.remainder(tangents)
        return left.T @ left, left.T @ self.remainder(), left

    def without(self, out: np.ndarray) -> np.ndarray:
        """Change (p + k,) of parameters and amplitudes where some residuals (m,) bool are
        left out, by one linear step."""
        columns, residual = self._rows
        kept = np.concatenate([~out, np.ones(len(self.pull), bool)])
        inside = columns[kept]
        return np.linalg.solve(inside.T @ inside, inside.T @ residual[kept])


def without(values: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """The part of values (m, ...) that is orthogonal to columns (m, p)."""
    unit, _ = np.linalg.qr(columns)
    return values - unit @ (unit.T @ values)


def with_priors(
    columns: np.ndarray, residual: np.ndarray, pull: np.ndarray, off: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Columns and residual with a row for each prior."""
    return (np.concatenate([columns, np.diag(pull)]), np.concatenate([residual, -pull * off]))


def fitted(
    subject: Forward,
    atoms: tuple[int, ...],
    start: Start,
    linear: tuple[np.ndarray, np.ndarray],
    precision: float = 0.0,
) -> Fit:
    """A fit from its linearisation.

    Args:
        linear: residual (m,) and columns (m, p + k).
        precision: root of that of the prior of each parameter about zero; 0 without one.
    """
    residual, columns = linear
    p, priors, index = len(start.z), subject.priors, list(atoms)
    off = np.append(precision * start.z, start.amplitude - priors.center[index])
    pull = np.append(np.full(p, precision), np.ones(len(index)))
    pull = np.maximum(pull, np.sqrt(FLAT))  # a parameter at its bound has no slope
    whole, rest = with_priors(columns, residual, pull, off)
    normal = whole.T @ whole
    step = np.linalg.solve(normal, whole.T @ rest)
    asked = start.amplitude + step[p:]
    kept = np.clip(asked, priors.low[index], priors.high[index])
    free = np.append(np.full(p, True), kept == asked)
    step[p:] = kept - start.amplitude
    # The others take their best values beside an amplitude at its bound.
    beside = whole.T @ (rest - whole @ np.where(free, 0.0, step))
    step[free] = np.linalg.solve(normal[np.ix_(free, free)], beside[free])
    left = rest - whole @ step
    value = -0.5 * (left @ left) - 0.5 * np.linalg.slogdet(normal)[1]
    std = np.sqrt(np.maximum(np.diag(np.linalg.inv(normal))[p:], ROUNDING))
    sign = priors.sign[index]
    one_sided = np.log(2) + log_ndtr(sign * (start.amplitude + step[p:]) / std)
    value += np.sum(np.where(sign != 0, one_sided, 0.0))
    value = float(value) if np.isfinite(value) else -np.inf
    effects = tuple(subject.atoms[k].effect.id for k in atoms)
    return Fit(tuple(atoms), effects, *start[:2], residual, columns, pull, off, value, start.state)
