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
from tirefit.vehicle.errors import PARTS
from tirefit.vehicle.model import TIRES, Model, Moved, moved
from tirefit.vehicle.shooting import Data, Squares, minimised
from tirefit.vehicle.windows import JoinedWindows

_TOLERANCE, _STEPS = 1e-4, 10
"""Relative gain in cost of a step below which a refit ends, one unit of chi square at ten
thousand residuals; largest number of its steps."""

_MOST_OFF = 1.5  # largest logarithm of a factor on a tire

_COLUMNS = TIRES + MOST_EFFECTS
"""Number of columns of the compiled program that differentiates the inputs."""

_LEAST_WINDOWS = 48  # smallest number of windows for which programs are compiled

LEAST_LOGS = 4
"""Smallest number of logs of which each is left out in turn; of fewer, :data:`errors.PARTS`."""

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

    floor: float = 1.0  # mean square of the noise, over itself

    # --- the linearised car ------------------------------------------------------------

    @cached_property
    def _given(self) -> tuple[Car, tuple[jax.Array, int], Data, Samples]:
        """Car, grid, windows and samples for :func:`moved`, of few shapes."""
        # As arrays, so that another car uses the same compiled program.
        car = jax.tree.map(lambda x: jnp.asarray(x, float), self.car)
        slowest = float(np.min(self.cut.data.v_x))
        # Twice the step of a replay: one time constant of the car, of 2.8 that are stable.
        steps = steps_a_sample(self.car, slowest, 2.0 / self.step)
        grid = jnp.asarray(self.step), steps
        return car, grid, *_filled((self.cut.data, self.cut.rows))

    def linear(
        self,
        z: np.ndarray,
        starts: Values,
        columns: Sequence[int] = (),
        forces: np.ndarray | None = None,
    ) -> Moved:
        """The motion from all coefficients and start states (w, s), and its derivatives by some
        coefficients, or by forces of both axles to the right (w, k, 2, q) [N]."""
        car, grid, data, rows = self._given
        size = len(columns) if forces is None else forces.shape[-1]
        ways = np.zeros((self.model.size, max(size, 1)))
        ways[list(columns), range(len(columns))] = 1.0
        along = np.zeros((*self._shape[:2], 2, ways.shape[1])) if forces is None else forces
        parts = []
        for first in range(0, ways.shape[1], _COLUMNS):
            some = (ways[:, first : first + _COLUMNS], along[..., first : first + _COLUMNS])
            empty = _COLUMNS - some[0].shape[1]  # sets of every size share the compiled program
            way, force = (np.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, empty)]) for x in some)
            windows = _filled(starts), data, rows, _filled(force)
            parts.append(moved(self.model, car, grid, jnp.asarray(z), way, windows))
        now: Moved = jax.tree.map(lambda x: np.asarray(x)[: self._shape[0]], parts[-1])
        by = np.concatenate([part.by for part in parts], axis=-1)
        return now._replace(by=by[: self._shape[0], ..., :size])

    def coefficients(
        self,
        z: Values | tuple[Any, ...] = (),
        atoms: Sequence[int] = (),
        amplitude: Values | tuple[Any, ...] = (),
    ) -> np.ndarray:
        """All coefficients (4 + K,) of the factors on the tires and of some atoms."""
        whole = np.zeros(self.model.size)
        whole[: len(z)] = z
        whole[[TIRES + k for k in atoms]] = amplitude
        return whole

    def at(self, fit: Fit, columns: Sequence[int] = ()) -> Moved:
        """:meth:`linear` at a fit."""
        z = self.coefficients(fit.z, fit.atoms, fit.amplitude)
        return self.linear(z, fit.state, columns)

    @property
    def _shape(self) -> tuple[int, ...]:
        """Numbers of windows, samples and channels."""
        return self.cut.data.logged.shape

    @property
    def _states(self) -> int:
        """Number of start states of a window."""
        return self.cut.data.start.shape[1]

    def projected(self, by_start: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Columns (w, k, c, q) whitened and orthogonal to the start states: (m, q)."""
        weight = 1 / (self.noise * np.sqrt(self.inflation))[:, None]
        flat = [(x * weight).reshape(len(x), -1, x.shape[3]) for x in (columns, by_start)]
        unit, _ = np.linalg.qr(flat[1])
        left = flat[0] - unit @ (np.swapaxes(unit, 1, 2) @ flat[0])
        return left.reshape(-1, columns.shape[3])

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

    @cached_property
    def unit(self) -> np.ndarray:
        """(m,) from residuals to the rms over the noise of all channels, for samples that
        the start states leave free."""
        each = int(np.prod(self._shape[1:]))
        scale = np.sqrt(self.inflation * each / (each - self._states))
        return np.full(len(self.cut.log) * each, scale)

    @cached_property
    def given_residual(self) -> np.ndarray:
        """(m,) whitened residual of the car as given."""
        return self.residual_of(self.coefficients())

    def residual_of(self, z: np.ndarray) -> np.ndarray:
        """(m,) whitened residual at all coefficients without a refit, from the measured start
        states: what these explain is projected out, so that no window ends worse than it was."""
        now = self.linear(z, self.cut.data.start)
        return self.projected(now.by_start, -now.missed[..., None])[:, 0]

    def over_noise(self, residual: np.ndarray) -> np.ndarray:
        """Errors (n, c) of each sample over the noise, of a whitened residual (m,)."""
        return (residual * self.unit).reshape(-1, self.model.channels)

    def folds(self, effects: Key) -> Folds:
        """Logs, or blocks of time if there are few logs."""
        part, count, what = self.cut.log, len(self.cut.log), "logs"
        number = int(part.max()) + 1
        if number < LEAST_LOGS:
            number, what = min(PARTS, count), "blocks of time"
            part = np.arange(count) * number // count
        each = int(np.prod(self._shape[1:]))
        # Every part has the slips and speeds of the others.
        return Folds(np.repeat(part, each), f"{number} {what} left out in turn", is_covered=True)

    def refit(self, starts: Sequence[Start], sets: Sequence[tuple[int, ...]]) -> list[Fit]:
        """Sets of atoms fitted from these starts, see :class:`engine.fit.Forward`."""
        fits = []
        for start, atoms in zip(starts, sets, strict=True):
            fits.append(self._refit(start, atoms))
            self.tick()
        return fits

    def _refit(self, start: Start, atoms: tuple[int, ...]) -> Fit:
        places = [*range(TIRES), *(TIRES + k for k in atoms)]

        def run(z: Values, starts: Values) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            now = self.linear(self.coefficients(z[:TIRES], atoms, z[TIRES:]), starts, places)
            return now.missed, now.by, now.by_start

        index, priors = list(atoms), self.priors
        bounds = [
            np.concatenate([[of_tires] * TIRES, of_atoms[index]])
            for of_tires, of_atoms in ((-_MOST_OFF, priors.low), (_MOST_OFF, priors.high))
        ]
        noise = jnp.asarray(self.noise * np.sqrt(self.inflation))
        squares = Squares(run, noise, jnp.ones(len(places)))
        first = squares.begun(jnp.asarray([*start.z, *start.amplitude]), jnp.asarray(start.state))
        end = minimised(squares, first, bounds, _TOLERANCE, _STEPS)
        z, (missed, by, by_start) = np.asarray(end.z), map(np.asarray, end.now)
        columns = np.concatenate([-missed[..., None], by], axis=3)
        linear = self.projected(by_start, columns)
        found = Start(z[:TIRES], z[TIRES:], np.asarray(end.starts))
        return fitted(self, atoms, found, (linear[:, 0], linear[:, 1:]), precision=1.0)

    def tangents(self, fit: Fit) -> np.ndarray:
        """Whitened slopes (m, K) by the amplitudes of all atoms at a fit."""
        now = self.at(fit, range(TIRES, self.model.size))
        return self.projected(now.by_start, now.by)

    @cached_property
    def covariates(self) -> dict[str, np.ndarray]:
        """Quantities (w, k) that vary over the windows, at the start fit."""
        front, rear = np.moveaxis(self._at_start.angles, 2, 0)
        rows = self.cut.rows
        values = {"front slip": front, "rear slip": rear, "speed over its mean": rows.speed,
                  "forward acceleration": rows.along, "share of the time": rows.time}  # fmt: skip
        return {k: np.asarray(v) for k, v in values.items() if np.ptp(v) > UNSEEN}

    @cached_property
    def _at_start(self) -> Moved:
        return self.linear(self.coefficients(self.start.z), self.start.state)

    @cached_property
    def discrepancy(self) -> Discrepancy:
        """An unlisted force: of each axle, as a function of one covariate, and of both
        axles, of any course in time."""
        now, start = self._at_start, self.start
        loads = np.array(axle_loads(self.car))[:, None]
        columns, cells = list[np.ndarray](), list[Cell]()

        def by_force(axles: slice, shapes: np.ndarray) -> np.ndarray:
            """Derivatives (w, k, c, q) by forces of these shapes (w k, q)."""
            forces = np.zeros((*self._shape[:2], 2, shapes.shape[1]))
            sizes = _USUAL * shapes.reshape(*self._shape[:2], 1, -1)
            forces[:, :, axles] = sizes * loads[axles]
            return self.linear(self.coefficients(start.z), start.state, forces=forces).by

        def add(quantity: str, covariate: str, by: np.ndarray, places: np.ndarray) -> None:
            columns.append(self.projected(now.by_start, by))
            settings = covariate == "window"
            cells.append(Cell(quantity, covariate, places, settings, settings))

        for covariate, values in self.covariates.items():
            ends = np.quantile(values, [0.01, 0.99]) if "slip" in covariate else (-np.inf, np.inf)
            # Number of places at which an unlisted force has its values.
            count = 12 if covariate == "share of the time" else 8
            shapes, places = places_of(np.clip(values, *ends).ravel(), None, count)
            for axle, quantity in enumerate(("front force", "rear force")):
                add(quantity, covariate, by_force(slice(axle, axle + 1), shapes), places)
        windows = np.arange(self._shape[0])
        of_all = by_force(slice(None), np.ones((self._shape[0] * self._shape[1], 1)))
        add("side force", "window", of_all * np.eye(len(windows))[:, None, None], windows)
        return Discrepancy(np.concatenate(columns, axis=1), tuple(cells))

    def groups(self) -> dict[str, np.ndarray]:
        """Covariates (m,) by whose values the size of an effect may differ."""
        shape = self._shape
        values = {**self.covariates, "yaw rate": self._at_start.states.yaw_rate}
        if self.cut.log.max():
            values["log"] = np.repeat(self.cut.log[:, None], shape[1], axis=1)
        return {
            name: np.repeat(x[..., None], shape[2], axis=2).ravel() for name, x in values.items()
        }

    # --- noise and motion from a fit ------------------------------------------------------

    def following(self, fit: Fit) -> "Windows":
        """The same windows with effects that depend on the motion of a fit."""
        now = self.at(fit)
        rows = self.cut.rows._replace(
            across=now.lateral / float(self.car.gravity),
            turn=now.states.yaw_rate / np.asarray(self.cut.data.v_x),
        )
        return replace(self, cut=self.cut._replace(rows=rows), begin=fit.start)

    def with_noise_of(self, fit: Fit) -> "Windows":
        """The same windows with the noise of the remainder of a fit with all listed effects
        and unlisted forces, and with the ratio of the scatter of sums over windows to that
        of independent samples as inflation."""
        atoms, shape = self.tangents(fit), self._shape
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
