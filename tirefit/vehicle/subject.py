"""The subject "windows of a car" of the diagnosis engine: :class:`Windows`.

A window is predicted from its own start state, which is projected out of residuals and
columns. Effects and unlisted forces depend on the predicted motion, as that of the log has
the noise of the channels that they explain.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects import Atom
from tirefit.diagnosis.engine import UNSEEN
from tirefit.diagnosis.engine.discrepancy import SIZES, Cell, Discrepancy, places_of
from tirefit.diagnosis.engine.fit import Fit, Folds, Key, Priors, Start, fitted
from tirefit.diagnosis.engine.search import MOST_EFFECTS
from tirefit.padding import pad_rows, padded_size
from tirefit.params import Values
from tirefit.vehicle.car import Car, axle_loads, steps_a_sample
from tirefit.vehicle.effects import Samples
from tirefit.vehicle.model import TIRES, Linear, Model, Slopes, inputs, moved
from tirefit.vehicle.shooting import Data, Squares, minimised
from tirefit.vehicle.windows import JoinedWindows

_COARSER = 2.0
"""Step of the integration over that of a replay: one time constant of the car at its slowest
speed, where the method is stable up to 2.8."""

_TOLERANCE, _STEPS = 1e-4, 10
"""Relative gain in cost of a step below which a refit ends, one unit of chi square at ten
thousand residuals; largest number of its steps."""

_STARTS, _SHORTER = 5, 4.0
"""Number of trials of the best start states of a car without a refit; a step that makes a
window worse is divided by the second number."""

_MOST_OFF = 1.5  # largest logarithm of a factor on a tire

_FAR = 0.7
"""Logarithm of a factor on the tires from which a refit also begins at the tires as given:
without an effect, the tires are distorted to replace it."""

_COLUMNS = TIRES + MOST_EFFECTS
"""Number of columns of the compiled program that differentiates the inputs."""

_LEAST_WINDOWS = 48  # smallest number of windows for which programs are compiled

LEAST_LOGS = 4
"""Smallest number of logs of which each is left out in turn."""

_BLOCKS = 8  # number of parts of the time that are left out in turn if there are fewer logs

_USUAL = 0.03  # usual change of a force over the load of its axle


def _filled(windows: Values | tuple[Data, Samples]) -> np.ndarray | tuple[Data, Samples]:
    """Arrays (w, ...) padded by copies of the first window to a few sizes."""
    return jax.tree.map(
        lambda part: pad_rows(part, padded_size(len(part), _LEAST_WINDOWS)), windows
    )


@dataclass(frozen=True, eq=False)
class Windows:
    """A car on windows: the subject of a search, see :class:`engine.fit.Forward`.

    Attributes:
        model, car, cut: with their effects and windows; step: time between samples [s].
        testable: numbers of the atoms that the logs can show.
        noise: of the channels (c,): the remainder of all functions together;
            ``inflation``: samples per independent sample.
        begin: the fit without effects from which others start.
        tick: called at every refit.
    """

    model: Model
    car: Car
    cut: JoinedWindows
    step: float
    testable: tuple[int, ...]
    noise: np.ndarray
    inflation: float = 1.0
    begin: Start | None = None
    tick: Callable[[], None] = field(default=lambda: None)

    # --- the linearised car ------------------------------------------------------------

    @cached_property
    def _given(self) -> tuple[Car, tuple[jax.Array, int], Data, Samples]:
        """Car, grid, windows and samples for :func:`moved`, of few shapes."""
        # As arrays, so that another car uses the same compiled program.
        car = jax.tree.map(lambda x: jnp.asarray(x, float), self.car)
        slowest = float(np.min(self.cut.data.v_x))
        steps = steps_a_sample(self.car, slowest, _COARSER / self.step)
        grid = jnp.asarray(self.step), steps
        return car, grid, *_filled((self.cut.data, self.cut.rows))

    def linear(
        self, z: np.ndarray, starts: Values, columns: Sequence[int] = ()
    ) -> tuple[Linear, np.ndarray]:
        """The motion from all coefficients and start states (w, s), linearised, and its
        derivatives (w, k, c, q) by some coefficients."""
        car, grid, data, rows = self._given
        count, slopes, columns = len(self.cut.log), [], list(columns)
        for first in range(0, max(len(columns), 1), _COLUMNS):
            some = columns[first : first + _COLUMNS]
            ways = np.zeros((self.model.size, _COLUMNS))
            ways[some, range(len(some))] = 1.0
            given, more = inputs(self.model, grid[0], jnp.asarray(z), ways, data, rows)
            slopes.append([np.asarray(x)[:count, ..., : len(some)] for x in more])
        motion = moved(self.model.channels, car, grid, _filled(starts), data, given)
        now = jax.tree.map(lambda part: np.asarray(part)[:count], motion)
        relaxation = np.asarray(given[1])[:count, :, -1]
        now = Linear(now, self.cut.data.v_x, relaxation, self.step, grid[1])
        joined = [np.concatenate(x, axis=-1) for x in zip(*slopes, strict=True)]
        return now, now.by_inputs(Slopes(*joined))

    def coefficients(
        self,
        z: np.ndarray | tuple[Any, ...] = (),
        atoms: Sequence[int] = (),
        amplitude: np.ndarray | tuple[Any, ...] = (),
    ) -> np.ndarray:
        """All coefficients (4 + K,) of the factors on the tires and of some atoms."""
        whole = np.zeros(self.model.size)
        whole[: len(z)] = z
        whole[[TIRES + k for k in atoms]] = amplitude
        return whole

    def at(self, fit: Fit, columns: Sequence[int] = ()) -> tuple[Linear, np.ndarray]:
        """:meth:`linear` at a fit."""
        z = self.coefficients(fit.z, fit.atoms, fit.amplitude)
        return self.linear(z, fit.state, columns)

    @property
    def is_covered(self) -> bool:
        """Windows of every part have the slips and speeds of the others."""
        return True

    @property
    def _states(self) -> int:
        """Number of start states of a window."""
        return self.cut.data.start.shape[1]

    def projected(self, now: Linear, columns: np.ndarray) -> np.ndarray:
        """Columns (w, k, c, q) whitened and orthogonal to the start states: (m, q)."""
        weight = 1 / (self.noise * np.sqrt(self.inflation))[:, None]
        by_start = now.by_start(self._states)
        flat = [(x * weight).reshape(len(x), -1, x.shape[3]) for x in (columns, by_start)]
        unit, _ = np.linalg.qr(flat[1])
        left = flat[0] - unit @ (np.swapaxes(unit, 1, 2) @ flat[0])
        return left.reshape(-1, columns.shape[3])

    def _residual(self, now: Linear) -> np.ndarray:
        """(m,) logged - predicted, whitened and orthogonal to the start states."""
        return -self.projected(now, now.motion.missed[..., None])[:, 0]

    def at_best_starts(self, z: np.ndarray) -> Linear:
        """:meth:`linear` without a refit, from the best start states found: a window that a
        step makes worse goes back and tries a shorter one."""
        best, weight = np.asarray(self.cut.data.start), (1 / self.noise)[:, None]
        least, step = np.full(len(best), np.inf), np.zeros(best.shape)
        for _ in range(_STARTS):
            now, w = self.linear(z, best - step)[0], len(best)
            rest = (now.motion.missed * weight[:, 0]).reshape(w, -1)
            squares = np.sum(rest**2, axis=1)
            better = squares < least
            slopes = (now.by_start(self._states) * weight).reshape(w, -1, self._states)
            unit, size = np.linalg.qr(slopes)
            onward = np.linalg.solve(size, np.swapaxes(unit, 1, 2) @ rest[..., None])[..., 0]
            best = np.where(better[:, None], best - step, best)
            step = np.where(better[:, None], onward, step / _SHORTER)
            least = np.where(better, squares, least)
        return self.linear(z, best)[0]

    def rms(self, z: np.ndarray) -> np.ndarray:
        """Rms (c,) of predicted - logged, from the best start states."""
        return np.sqrt(np.mean(self.at_best_starts(z).motion.missed ** 2, axis=(0, 1)))

    # --- what the engine asks of its subject ---------------------------------------------

    @property
    def atoms(self) -> tuple[Atom, ...]:
        """The variants of all effects (K)."""
        return self.model.atoms

    @cached_property
    def priors(self) -> Priors:
        """Of the amplitudes of all atoms."""
        scale = np.array(self.model.scales)
        low, high = np.array([a.effect.bounds[0] for a in self.atoms]).reshape(-1, 2).T / scale
        # The stated delay may be too long.
        of_delay = np.array([a.effect.id == "steering_delay" for a in self.atoms])
        low = np.where(of_delay, -self.model.stated_delay / scale, low)
        return Priors(0 * scale, low, high, 0 * scale, scale)

    @property
    def start(self) -> Start:
        """Of the refit without effects; at first the tires and the states as given."""
        return self.begin or Start(np.zeros(TIRES), np.zeros(0), self.cut.data.start)

    @property
    def floor(self) -> float:
        """Mean square of the noise, over itself."""
        return 1.0

    @cached_property
    def unit(self) -> np.ndarray:
        """(m,) from residuals to the rms over the noise of all channels, for samples that
        the start states leave free."""
        each = int(np.prod(self.cut.data.logged.shape[1:]))
        scale = np.sqrt(self.inflation * each / (each - self._states))
        return np.full(len(self.cut.log) * each, scale)

    @cached_property
    def given_residual(self) -> np.ndarray:
        """(m,) whitened residual of the car as given."""
        return self.residual_of(self.coefficients())

    def residual_of(self, z: np.ndarray) -> np.ndarray:
        """(m,) whitened residual at all coefficients, from the best start states."""
        return self._residual(self.at_best_starts(z))

    def over_noise(self, residual: np.ndarray) -> np.ndarray:
        """Errors (n, c) of each sample over the noise, of a whitened residual (m,)."""
        return (residual * self.unit).reshape(-1, self.model.channels)

    def folds(self, effects: Key) -> Folds:
        """Logs, or blocks of time if there are few logs."""
        part, count, what = self.cut.log, len(self.cut.log), "logs"
        number = int(part.max()) + 1
        if number < LEAST_LOGS:
            number, what = min(_BLOCKS, count), "blocks of time"
            part = np.arange(count) * number // count
        each = int(np.prod(self.cut.data.logged.shape[1:]))
        return Folds(np.repeat(part, each), f"{number} {what} left out in turn")

    def refit(self, starts: Sequence[Start], sets: Sequence[tuple[int, ...]]) -> list[Fit]:
        """Sets of atoms fitted from these starts, see :class:`engine.fit.Forward`."""
        fits = []
        for start, atoms in zip(starts, sets, strict=True):
            tries = [self._refit(start, atoms)]
            if np.max(np.abs(start.z)) > _FAR:
                fresh = Start(0 * start.z, start.amplitude, self.cut.data.start)
                tries.append(self._refit(fresh, atoms))
            fits.append(max(tries, key=lambda fit: fit.log_evidence))
            self.tick()
        return fits

    def _refit(self, start: Start, atoms: tuple[int, ...]) -> Fit:
        size, fill = TIRES + len(atoms), MOST_EFFECTS - len(atoms)
        places = [*range(TIRES), *(TIRES + k for k in atoms)]
        # Sets of every size share the compiled programs.

        def run(fitted_z: Values, starts: Values) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            z = np.zeros(self.model.size)
            z[places] = np.asarray(fitted_z)[:size]
            now, by = self.linear(z, starts, places)
            by = np.pad(by, ((0, 0), (0, 0), (0, 0), (0, fill)))
            return now.motion.missed, by, now.by_start(self._states)

        index, priors = list(atoms), self.priors
        sides = [
            np.concatenate([[of_tires] * TIRES, of_atoms[index], [0.0] * fill])
            for of_tires, of_atoms in ((-_MOST_OFF, priors.low), (_MOST_OFF, priors.high))
        ]
        begun = jnp.asarray([*start.z, *start.amplitude, *[0.0] * fill])
        noise = jnp.asarray(self.noise * np.sqrt(self.inflation))
        squares = Squares(run, noise, jnp.ones(len(begun)))
        first = squares.begun(begun, jnp.asarray(start.state))
        end = minimised(squares, first, sides, _TOLERANCE, _STEPS)
        z, states = np.asarray(end.z)[:size], end.starts
        now, by = self.linear(self.coefficients(z[:TIRES], atoms, z[TIRES:]), states, places)
        return fitted(
            atoms,
            [self.atoms[k].effect.id for k in atoms],
            Start(z[:TIRES], z[TIRES:], np.asarray(states)),
            (self._residual(now), self.projected(now, by)),
            np.ones(size),
            z,
            priors.sign[index],
            (priors.low[index], priors.high[index]),
        )

    def tangents(self, fit: Fit) -> np.ndarray:
        """Whitened slopes (m, K) by the amplitudes of all atoms at a fit."""
        return self.projected(*self.at(fit, range(TIRES, self.model.size)))

    @cached_property
    def covariates(self) -> dict[str, np.ndarray]:
        """Quantities (w, k) that vary over the windows, at the start fit."""
        front, rear = np.moveaxis(self._at_start.motion.angles, 2, 0)
        rows = self.cut.rows
        values = {"front slip": front, "rear slip": rear, "speed over its mean": rows.speed,
                  "forward acceleration": rows.along, "share of the time": rows.time}  # fmt: skip
        return {k: np.asarray(v) for k, v in values.items() if np.ptp(v) > UNSEEN}

    @cached_property
    def _at_start(self) -> Linear:
        return self.linear(self.coefficients(self.start.z), self.start.state)[0]

    @cached_property
    def discrepancy(self) -> Discrepancy:
        """An unlisted force: of each axle, as a function of one covariate, and of both
        axles, of any course in time."""
        now, loads = self._at_start, axle_loads(self.car)
        shape = now.motion.missed.shape[:2]
        columns, cells = list[np.ndarray](), list[Cell]()
        kinds: list[tuple[str, list[int], str, np.ndarray, np.ndarray]] = []
        for covariate, values in self.covariates.items():
            ends = np.quantile(values, [0.01, 0.99]) if "slip" in covariate else (-np.inf, np.inf)
            # Number of places at which an unlisted force has its values.
            count = 12 if covariate == "share of the time" else 8
            by = places_of(np.clip(values, *ends).ravel(), None, count)
            kinds += [("front force", [0], covariate, *by), ("rear force", [1], covariate, *by)]
        window = np.repeat(np.eye(shape[0]), shape[1], axis=0)
        kinds.append(("side force", [0, 1], "window", window, np.arange(shape[0])))
        for quantity, axles, covariate, shapes, places in kinds:
            sizes = _USUAL * shapes.reshape(*shape, -1)
            each = [now.by_force(k, sizes * float(loads[k])) for k in axles]
            columns.append(self.projected(now, np.sum(each, axis=0)))
            first, settings = cells[-1].end if cells else 0, covariate == "window"
            end = first + len(places)
            cells.append(Cell(quantity, covariate, first, end, places, settings, settings))
        return Discrepancy(np.concatenate(columns, axis=1), tuple(cells))

    def groups(self) -> dict[str, np.ndarray]:
        """Covariates (m,) by whose values the size of an effect may differ."""
        shape = self.cut.data.logged.shape
        values = {**self.covariates, "yaw rate": self._at_start.motion.states.yaw_rate}
        if self.cut.log.max():
            values["log"] = np.repeat(self.cut.log[:, None], shape[1], axis=1)
        return {
            name: np.repeat(x[..., None], shape[2], axis=2).ravel() for name, x in values.items()
        }

    # --- noise and motion from a fit ------------------------------------------------------

    def following(self, fit: Fit) -> "Windows":
        """The same windows with effects that depend on the motion of a fit."""
        now, rows = self.at(fit)[0], self.cut.rows
        rows = rows._replace(
            across=now.motion.lateral / float(self.car.gravity),
            turn=now.motion.states.yaw_rate / self.cut.data.v_x,
        )
        return replace(self, cut=self.cut._replace(rows=rows), begin=fit.start)

    def with_noise_of(self, fit: Fit) -> "Windows":
        """The same windows with the noise of the remainder of a fit with all listed effects
        and unlisted forces, and with the ratio of the scatter of sums over windows to that
        of independent samples as inflation."""
        atoms, shape = self.tangents(fit), self.cut.data.logged.shape
        seen = np.concatenate([fit.columns, atoms, self.discrepancy.additive], axis=1)
        of_fit, listed = len(fit.pull), len(fit.pull) + atoms.shape[1]
        pull = np.full(seen.shape[1], SIZES[1] ** -2.0)
        pull[:of_fit], off = fit.pull**2, np.zeros(len(pull))
        off[:of_fit] = pull[:of_fit] * fit.off
        gram = seen.T @ seen
        inverse = np.linalg.inv(gram + np.diag(pull))
        rest = fit.residual - seen @ (inverse @ (seen.T @ fit.residual - off))
        free = len(rest) - shape[0] * self._states - np.sum(inverse * gram)
        squares = rest.reshape(shape) ** 2
        level = np.mean(squares, axis=(0, 1)) * len(rest) / max(free, 1.0)
        # Sums over windows of white noise, which the fit reduces, and of the remainder.
        each = seen.reshape(shape[0], -1, len(pull))
        cross = np.swapaxes(each[..., :listed], 1, 2) @ each
        size = np.diag(gram)[:listed]
        white = size - np.einsum("wpq,qr,wpr->p", cross, inverse, cross, optimize=True)
        sums = np.einsum("wmp,wm->wp", each[..., :listed], rest.reshape(shape[0], -1)) ** 2
        there = white > UNSEEN * size
        scatter = np.median(sums.sum(axis=0)[there] / white[there]) / level.mean()
        noise = self.noise * np.sqrt(self.inflation * level)
        return replace(self, noise=noise, inflation=max(float(scatter), 1.0))
