"""The car with effects over windows of its logs, linearised; sets of effects, refitted
and weighed by their evidence.

All results of a fit (evidence of further effects and of an unlisted one, prediction of
windows left out) follow from the products of the columns of its linearisation, for each
window, orthogonal to the start states.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import chdtrc, log_ndtr

from tirefit.diagnosis.effects.record import Atom
from tirefit.diagnosis.negligible import FLAT, NONZERO, ROUNDING, UNSEEN
from tirefit.diagnosis.rows.basis import SCALES, bumps, mean_gain
from tirefit.padding import pad_rows, padded_size
from tirefit.vehicle.car import (
    Car,
    State,
    accelerations,
    delayed,
    lagged,
    predicted,
    slip_angles,
    steps_a_sample,
    with_play,
)
from tirefit.vehicle.effects import Samples, Setting, Steering, scaled_axles
from tirefit.vehicle.shooting import Data, minimised

PARAMETERS = tuple(
    f"{axle}.{name}" for axle, name in product(("front", "rear"), ("stiffness", "friction"))
)
"""Coefficients that are fitted with every set of effects: logarithms of factors on the
tires, each with a prior standard deviation of one."""

MOST = 3
"""Largest number of effects of a set."""

_TIRES = len(PARAMETERS)
_TOLERANCE = 1e-5
"""Relative gain in cost of a step below which a refit ends."""

_STARTS = 3
"""Number of steps to the best start states of a car without a refit."""

_MOST_OFF = 1.5
"""Largest logarithm of a factor on a tire."""

_LEAST_WINDOWS = 48
"""Smallest number of windows for which a diagnosis is compiled."""

_EACH = 6
SHAPES = 5 * _EACH
"""Numbers of functions of each quantity, and of all, on which an unlisted force of an axle
may depend."""


class Cut(NamedTuple):
    """Windows (w, k) of all logs: :class:`Data`, :class:`Samples` of effects, functions
    (w, k, SHAPES) of an unlisted force, and the log (w,) of each."""

    data: Data
    rows: Samples
    shapes: np.ndarray
    log: np.ndarray


class Products(NamedTuple):
    """Products of the whitened columns of a linearisation with each other and with the
    residual, predicted - logged, for each window: (w, q, q), (w, q) and (w,)."""

    gram: np.ndarray
    score: np.ndarray
    square: np.ndarray

    def of(self, windows) -> "Products":
        """The products summed over some windows."""
        return Products(*(part[windows].sum(axis=0) for part in self))

    def some(self, columns) -> "Products":
        """The products of some columns."""
        columns = np.asarray(columns)
        gram = self.gram[..., columns[:, None], columns]
        return Products(gram, self.score[..., columns], self.square)

    def step(self, pull, at) -> np.ndarray:
        """Change (q,) of the coefficients to the optimum, from coefficients ``at`` with
        priors of precision ``pull`` about zero."""
        return -np.linalg.solve(self.gram + np.diag(pull), self.score + pull * at)

    def square_after(self, step) -> float:
        """Sum of squares after a change of the coefficients."""
        return float(self.square + 2 * step @ self.score + step @ self.gram @ step)


def steered(steering: Steering, command, across, step: float):
    """Wheel angle (n,) behind a logged one (l + n,) that begins l samples before.

    Args:
        across: (n,) lateral acceleration over g.
        step: time between samples [s].
    """
    angle = lagged(delayed(command, steering.delay / step), steering.lag, step)
    angle = with_play(angle, steering.play)[-len(across) :]
    return angle * steering.ratio + steering.offset - steering.yields * across


class Model(NamedTuple):
    """The model of a car with all atoms. Its coefficients z are the logarithms of factors
    on the tires, the amplitudes of the atoms in prior scales, and unlisted forces.

    Attributes:
        scales: of the priors.
        channels: 2 of a log of rates, 3 of one of poses.
    """

    atoms: tuple[Atom, ...]
    scales: tuple[float, ...]
    channels: int

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return _TIRES + len(self.atoms) + 2 * SHAPES

    def setting(self, z, rows: Samples, shapes) -> Setting:
        """The setting by the coefficients, for each sample."""
        factors = jnp.exp(z[:_TIRES]).reshape(2, 2)
        setting = Setting()
        for k, name in enumerate(("stiffness", "friction")):
            setting = scaled_axles(setting, name, factors[:, k])
        for k, atom in enumerate(self.atoms):
            amplitude = self.scales[k] * z[_TIRES + k]
            change: Callable = atom.effect.change
            setting = change(setting, amplitude, atom.constants, rows)
        own = z[_TIRES + len(self.atoms) :].reshape(2, -1)
        front, rear = (shapes @ one * rows.weight for one in own)
        car = setting.car
        return setting._replace(
            car=car._replace(
                front=car.front._replace(force=front), rear=car.rear._replace(force=rear)
            )
        )

    def states(self, car: Car, grid, z, start, window: Data, rows: Samples, shapes):
        """Predicted states (k,) of one window, the wheel angle (k,), the setting."""
        setting = self.setting(z, rows, shapes)
        step, parts = grid
        angle = steered(setting.steering, window.steering, rows.across, step)
        whole = State(*start, *jnp.zeros(5 - len(start)))
        found = predicted(car, whole, window.v_x, angle, step, parts, setting.car)
        return found, angle, setting

    def missed(self, car: Car, grid, z, start, window: Data, rows: Samples, shapes):
        """Predicted - logged (k, c) of one window."""
        states, _, setting = self.states(car, grid, z, start, window, rows, shapes)
        reading = setting.reading
        if self.channels == 2:
            v_y = states.v_y + reading.sideslip * window.v_x
            v_y = v_y + reading.ahead * states.yaw_rate
            found = [v_y, states.yaw_rate + reading.yaw_rate]
        else:
            cos, sin = jnp.cos(states.heading), jnp.sin(states.heading)
            place = states.x + reading.ahead * cos, states.y + reading.ahead * sin
            found = [states.heading - reading.sideslip, *place]
        return jnp.stack(found, axis=1) - window.logged


@partial(jax.jit, static_argnums=0)
def _followed(model: Model, car: Car, grid, z, start, data: Data, rows, shapes):
    """Lateral acceleration, yaw rate and both slip angles (w, k) of the predicted car."""

    def one(start, window, rows, shapes):
        states, angle, setting = model.states(car, grid, z, start, window, rows, shapes)
        motion = window.v_x, angle, states.v_y, states.yaw_rate
        changes = jax.tree.map(lambda x: jnp.broadcast_to(x, len(angle)), setting.car)
        lateral, _ = jax.vmap(partial(accelerations, car))(*motion, changes)
        return lateral, states.yaw_rate, *slip_angles(car, *motion)

    return jax.vmap(one)(start, data, rows, shapes)


@partial(jax.jit, static_argnums=0)
def _linearised(model: Model, car, grid, z, ways, start, data: Data, rows: Samples, shapes):
    """Residuals (w, k, c) at z, and their derivatives along ``ways`` (P, q) and by the
    start of the own window: (w, k, c, q) and (w, k, c, s). ``grid`` is the time between
    samples and the number of steps of the integration from one to the next."""

    def one(start, window, rows, shapes):
        def both(along, start):
            found = model.missed(car, grid, z + ways @ along, start, window, rows, shapes)
            return found, found

        nowhere = jnp.zeros(ways.shape[1])
        slopes, found = jax.jacfwd(both, (0, 1), has_aux=True)(nowhere, start)
        return found, *slopes

    return jax.vmap(one)(start, data, rows, shapes)


@dataclass(frozen=True, eq=False)
class Fit:
    """A refitted set of atoms.

    Attributes:
        atoms: their numbers, in order.
        z: all coefficients; starts: (w, s).
        products: of its own columns: the factors on the tires, then its atoms.
        log_evidence: plus a constant that is the same for all sets.
    """

    atoms: tuple[int, ...]
    effects: tuple[str, ...]
    z: np.ndarray
    starts: jax.Array
    products: Products
    log_evidence: float

    @property
    def own(self) -> list[int]:
        """Indices of its coefficients in z."""
        return [*range(_TIRES), *(_TIRES + k for k in self.atoms)]

    @property
    def amplitude(self) -> np.ndarray:
        """Its amplitudes, in prior scales."""
        return self.z[[_TIRES + k for k in self.atoms]]

    @property
    def pull(self) -> np.ndarray:
        """Precisions of the priors of its coefficients."""
        return np.ones(_TIRES + len(self.atoms))

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of its coefficients."""
        return np.linalg.inv(self.products.of(slice(None)).gram + np.diag(self.pull))


def _filled(windows):
    """Arrays (w, ...) padded by copies of the first window to a few sizes."""
    return jax.tree.map(
        lambda part: pad_rows(part, padded_size(len(part), _LEAST_WINDOWS)), windows
    )


class Base:
    """A model on windows, with the noise of the channels. The noise is that of the
    remainder times the square root of ``inflation``, as samples are correlated.
    ``testable`` are the numbers of the atoms that the logs can show."""

    def __init__(self, model: Model, car: Car, cut: Cut, step: float, testable):
        self.model, self.cut, self.testable = model, cut, tuple(testable)
        slowest = float(np.min(cut.data.v_x))
        self.grid = jnp.asarray(step), steps_a_sample(car, slowest, 1 / step)
        # As arrays, so that another car uses the same compiled programs.
        self.car = jax.tree.map(lambda x: jnp.asarray(x, float), car)
        self.noise, self.scatter, self.inflation = np.ones(model.channels), 1.0, 1.0
        bounds = np.array(
            [
                np.array(a.effect.bounds[0]) / s
                for a, s in zip(model.atoms, model.scales, strict=True)
            ]
        ).reshape(-1, 2)
        self.low, self.high = bounds.T
        self.one_sided = (self.low >= 0) | (self.high <= 0)

    @cached_property
    def windows(self):
        """The windows of a :class:`Cut`, of few numbers."""
        return _filled((self.cut.data, self.cut.rows, self.cut.shapes))

    def follow(self, fit: Fit) -> None:
        """Make effects and unlisted forces depend on the motion of a fit, as that of the
        log has the noise of the channels that they explain."""
        found = _followed(
            self.model, self.car, self.grid, fit.z, _filled(fit.starts), *self.windows
        )
        lateral, turn, *slips = (np.asarray(x)[: len(self.cut.log)] for x in found)
        rows = self.cut.rows
        rows = rows._replace(
            across=lateral / float(self.car.gravity), turn=turn / self.cut.data.v_x
        )
        others = rows.speed, rows.along, rows.time
        shapes = shapes_of(*([x.ravel() for x in part] for part in (slips, others)))
        shapes = shapes.reshape(*turn.shape, -1)
        self.cut = self.cut._replace(rows=rows, shapes=shapes)
        del self.windows

    def linearised(self, z, starts, columns):
        """:func:`_linearised` along coefficients (q,) of these numbers."""
        # Few columns share one compiled program.
        ways = np.zeros((self.model.size, max(len(columns), _TIRES + MOST)))
        ways[columns, range(len(columns))] = 1.0
        given = self.model, self.car, self.grid, z
        found = _linearised(*given, ways, _filled(starts), *self.windows)
        return tuple(part[: len(self.cut.log)] for part in found)

    def columns(self, now) -> np.ndarray:
        """Whitened columns of a result of :meth:`linearised`, then the residual,
        orthogonal to the start states: (w, m, q + 1)."""
        missed, by, by_start = (np.asarray(part) for part in now)
        weight, w = (1 / self.noise)[:, None], len(missed)
        each = np.concatenate([by, missed[..., None]], axis=3) * weight
        each = each.reshape(w, -1, each.shape[3])
        unit, _ = np.linalg.qr((by_start * weight).reshape(w, each.shape[1], -1))
        return each - unit @ (np.swapaxes(unit, 1, 2) @ each)

    def products(self, now) -> Products:
        """The products of a result of :meth:`linearised`."""
        each = self.columns(now)
        gram = np.swapaxes(each, 1, 2) @ each
        return Products(gram[:, :-1, :-1], gram[:, :-1, -1], gram[:, -1, -1])

    def at_best_starts(self, z):
        """:meth:`linearised` without a refit, from the best start states."""
        starts = np.asarray(self.cut.data.start)
        for _ in range(_STARTS):
            missed, _, slopes = map(np.asarray, self.linearised(z, starts, [0]))
            w, weight = len(missed), (1 / self.noise)[:, None]
            unit, size = np.linalg.qr((slopes * weight).reshape(w, -1, starts.shape[1]))
            rest = (missed * weight[:, 0]).reshape(w, -1, 1)
            best = np.linalg.solve(size, np.swapaxes(unit, 1, 2) @ rest)
            starts = starts - best[..., 0]
        return self.linearised(z, starts, [0])

    def rms(self, z) -> np.ndarray:
        """Rms of predicted - logged by channel, from the best start states."""
        missed, *_ = self.at_best_starts(z)
        return np.sqrt(np.mean(np.asarray(missed) ** 2, axis=(0, 1)))

    def judge_noise(self, fit: Fit) -> None:
        """Set the noise to the remainder of a fit with all listed effects and unlisted
        forces, increased by the ratio of the scatter of sums over windows to that of
        independent samples."""
        now = self.linearised(fit.z, fit.starts, [*range(self.model.size)])
        each, free = self.columns(now), _TIRES + len(self.model.atoms)
        columns, residual = each[..., :-1], each[..., -1]
        own = np.swapaxes(columns, 1, 2) @ columns
        gram = own.sum(axis=0)
        pull = np.ones(self.model.size)
        pull[free:] = np.maximum(np.diag(gram)[free:], FLAT) / SCALES[1] ** 2
        inverse = np.linalg.inv(gram + np.diag(pull))
        score = np.einsum("wmp,wm->p", columns, residual)
        left = residual - columns @ (inverse @ (score + pull * fit.z))
        count = left.size - fit.starts.size - np.sum(inverse * gram)
        squares = left.reshape(*now[0].shape) ** 2
        level = squares.sum(axis=(0, 1)) * len(self.noise) / max(count, 1)
        # Expected sums of white noise over windows, reduced by the fit.
        sums = np.einsum("wmp,wm->wp", columns[..., :free], left) ** 2
        white = np.einsum("wpp->wp", own - own @ inverse @ own)[:, :free]
        there = white.sum(axis=0) > UNSEEN * np.diag(gram)[:free]
        scatter = np.median(sums.sum(axis=0)[there] / white.sum(axis=0)[there])
        self.scatter = float(scatter / level.mean())
        self.inflation = max(self.scatter, 1.0)
        self.noise = self.noise * np.sqrt(level * self.inflation)

    @property
    def p_white(self) -> float:
        """p-value of the scatter of the sums over windows for a white remainder."""
        count = len(self.cut.log)
        return max(float(chdtrc(count, count * self.scatter)), ROUNDING)

    def fitted(self, atoms: tuple[int, ...], z, starts) -> Fit:
        """A set of atoms refitted from coefficients z and start states."""
        size, fill = _TIRES + len(atoms), MOST - len(atoms)
        places = np.array([*range(_TIRES), *(_TIRES + k for k in atoms)])
        origin, begin = np.zeros(self.model.size), np.zeros(_TIRES + MOST)
        begin[:size] = z[places]

        def run(own, starts, _):
            at = origin.copy()
            at[places] = np.asarray(own)[:size]
            return self.linearised(at, starts, places)

        pull = np.ones(_TIRES + MOST)
        sides = [
            np.concatenate([[side] * _TIRES, own[list(atoms)], [0.0] * fill])
            for side, own in ((-_MOST_OFF, self.low), (_MOST_OFF, self.high))
        ]
        own, starts, now, _ = minimised(
            run,
            jnp.asarray(begin),
            starts,
            run(begin, starts, None),
            None,
            jnp.asarray(self.noise),
            pull,
            sides,
            _TOLERANCE,
        )
        found = origin.copy()
        found[places] = np.asarray(own)[:size]
        products = self.products(now).some(range(size))
        ids = tuple(self.model.atoms[k].effect.id for k in atoms)
        fit = Fit(atoms, ids, found, starts, products, 0.0)
        return replace(fit, log_evidence=self._log_evidence(fit))

    def _log_evidence(self, fit: Fit) -> float:
        own, off = fit.z[fit.own], fit.amplitude
        square = fit.products.square.sum() + own @ own
        curvature = -np.linalg.slogdet(fit.covariance)[1]
        error = np.sqrt(np.diag(fit.covariance)[_TIRES:])
        # Half of the prior is excluded if only one sign is physical.
        sided = np.where(self.one_sided[list(fit.atoms)], np.log(2), 0.0)
        side = sided + np.where(sided > 0, log_ndtr(np.abs(off) / error), 0.0)
        found = float(-0.5 * (square + curvature) + side.sum())
        return found if np.isfinite(found) else -np.inf

    def everything(self, fit: Fit) -> Products:
        """Products of all columns at a fit."""
        columns = [*range(self.model.size)]
        return self.products(self.linearised(fit.z, fit.starts, columns))

    def one_more(self, fit: Fit, whole: Products) -> np.ndarray:
        """Log evidence (K,) that each atom adds to a fit, in closed form."""
        left = _beside(whole, fit, [_TIRES + k for k in range(len(self.model.atoms))])
        size, score = np.maximum(np.diag(left.gram), 0.0), left.score
        z = score / np.sqrt(1 + size)
        value = 0.5 * z**2 - 0.5 * np.log1p(size)
        # The score is the slope of the squares, so its sign is opposite to the amplitude.
        sign = np.where(self.low >= 0, -1.0, np.where(self.high <= 0, 1.0, 0.0))
        return value + np.where(sign != 0, np.log(2) + log_ndtr(sign * z), 0.0)

    def unlisted(self, fit: Fit, whole: Products) -> float:
        """Log evidence that an unlisted force of the axles adds to a fit."""
        first = self.model.size - 2 * SHAPES
        left = _beside(whole, fit, [*range(first, self.model.size)])
        return mean_gain(*directions(left))


def directions(left: Products) -> tuple[np.ndarray, np.ndarray]:
    """Scores (d,) and sizes (d,) of the orthonormal directions of some columns, which
    have unit size before."""
    norm = np.sqrt(np.maximum(np.diag(left.gram), NONZERO))
    values, vectors = np.linalg.eigh(left.gram / np.outer(norm, norm))
    kept = values > UNSEEN * values.max()
    size = np.sqrt(values[kept])
    return (left.score / norm) @ vectors[:, kept] / size, size


def _beside(whole: Products, fit: Fit, columns: Sequence[int]) -> Products:
    """Products of columns orthogonal to those of a fit."""
    total = whole.of(slice(None))
    own, pull = fit.own, fit.pull
    gram = total.gram[np.ix_(own, own)] + np.diag(pull)
    across = total.gram[np.ix_(own, columns)]
    used = np.linalg.solve(gram, across)
    score = total.score[own] + pull * fit.z[own]
    return Products(
        total.gram[np.ix_(columns, columns)] - across.T @ used,
        total.score[columns] - used.T @ score,
        np.asarray(total.square),
    )


def shapes_of(angles: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> np.ndarray:
    """Functions (n, SHAPES) for an unlisted force over the weight of the car: smooth ones
    of both slip angles and of three other quantities, (n,) each."""
    each = [np.clip(a, *np.quantile(a, [0.01, 0.99])) for a in angles]
    return np.concatenate([bumps(x, _EACH) for x in (*each, *others)], axis=1)
