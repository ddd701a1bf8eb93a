"""Fit the tires and unknown parameters of a car to its trajectories: :func:`fit_trajectory`.

A log is cut into windows. In each the car of :mod:`tirefit.vehicle.car` runs freely
from a start state of its own, which was measured: that of the filtered log, with the error that the
noise of its channels causes. The tires of both axles, the unknowns of the car and all start
states together minimise the squares of predicted less logged, and of start states less measured.
The start states are eliminated window by
window (a Schur complement); the covariance of the rest is the sandwich of the scores of
blocks of windows, which holds where residuals are correlated within a block.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import stdtrit

from tirefit import __version__
from tirefit.data.table import TireData
from tirefit.data.vehicle.vehicle import Steering, Vehicle, vehicle_toml
from tirefit.display import Record
from tirefit.door import sealed
from tirefit.files import json_safe, json_text
from tirefit.fitting.estimate import data_record
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.problem.layout import Layout
from tirefit.fitting.result import SCHEMA as FIT_SCHEMA
from tirefit.fitting.result import TRAJECTORY, Estimate, layout_record
from tirefit.fitting.source import GivenTire, axle_tire
from tirefit.fitting.uncertainty.identified import limited
from tirefit.fitting.verdict.family import NEAR_PEAK
from tirefit.models import MODELS, AbstractTire, TireInputs, forces
from tirefit.params import Values, constrain, with_values
from tirefit.precision import require_x64
from tirefit.results import InputProblem, Outcome, UsageError, did_you_mean
from tirefit.vehicle.car import Car, car_of, delayed, predicted, steps_a_sample
from tirefit.vehicle.effects import Reading
from tirefit.vehicle.model import as_driven, logged
from tirefit.vehicle.shooting import (
    AT_BOUND,
    Data,
    Squares,
    left_to_gain,
    linearised,
    minimised_inside,
    profile_ends,
    sandwich,
)
from tirefit.vehicle.start import UNKNOWNS, started, within
from tirefit.vehicle.windows import (
    CHANNELS,
    cut_in_windows,
    derived_rows,
    known_vehicle,
    lateness,
    steering_problems,
)

WINDOW = 0.5
"""Length [s] of a window."""
_SHAPES = "brush", "brush-d", "magic-formula"  # to compare where the peak is not reached
_ROUNDS = 3  # times that the noise of the channels is estimated again
_LEFT = 1e-3
"""Share of the squares that one more step may promise where a search has converged: 1e-9 on the
f1tenth car, 0.15 where start states and tires explain the same."""
_FAR = 3.0  # standard errors of its prior from which the value of an unknown is reported
_MOST_SLIPS = 99.5
"""Percentile of the derived slip angles that counts as their largest: few are errors."""


@dataclass(frozen=True, repr=False)
class TrajectoryFit(Record):
    """The result of :func:`fit_trajectory`.

    Attributes:
        front, rear: the tires of the axles.
        parameters: ``front.cpa2``, ``yaw_inertia``, ... -> estimate.
        noise: channel -> rms of predicted - logged, used as its noise.
        windows: number of windows; ``blocks`` of them are independent.
        vehicle: with what was found of it.
        strained: unknowns that end further from their usual value than three standard errors
            of their prior.
        converged: whether the search ended where one more step promises less than 0.1 % of the
            squares.
        axles: ``front``, ``rear`` -> the tire with its uncertainty and the content of a
            ``fit.json``; :func:`tirefit.replay` takes it.
        rows: ``front``, ``rear`` -> slip angle and force as derived, for comparison.
    """

    text_by: ClassVar[str] = "tirefit.report.vehicle:trajectory_text"
    plot_by: ClassVar[str] = "tirefit.report.vehicle:trajectory_figure"

    front: AbstractTire
    rear: AbstractTire
    parameters: Mapping[str, Estimate]
    noise: Mapping[str, float]
    windows: int
    blocks: int
    vehicle: Vehicle
    strained: tuple[str, ...]
    converged: bool
    axles: Mapping[str, GivenTire] = field(default_factory=dict)
    rows: Mapping[str, TireData] = field(default_factory=dict)

    @property
    def logs(self) -> tuple[str, ...]:
        """Names of the logs."""
        return tuple(self.rows["front"].runs)

    @property
    def reached(self) -> dict[str, float]:
        """Axle -> share of the peak of its tire that the slip angles of its rows reach."""
        return {axle: _reached(tire.tire, self.rows[axle]) for axle, tire in self.axles.items()}

    @property
    def limits(self) -> dict[Outcome, str]:
        """Whether the search converged, the parameters that are not determined, and the
        axles whose friction follows from the shape of the model."""
        loose = ", ".join(
            name for name, parameter in self.parameters.items() if not parameter.identified
        )
        below = [
            f"{100 * share:.0f} % ({axle})"
            for axle, share in self.reached.items()
            if share < NEAR_PEAK
        ]
        used = {tire.name for tire in self.axles.values()}
        others = (f"front={name},rear={name}" for name in _SHAPES if name not in used)
        shape = (
            f"{Outcome.SHAPE_DEPENDENT}: the slip angles reach {', '.join(below)} of the peak;"
            f" compare with {' and '.join(others)}"
        )
        strained = (
            f"{', '.join(self.strained)} far from any usual value: an effect that is not fitted,"
            " such as a lag of the steering, acts in its place, and may in that of the tires"
        )
        return {
            Outcome.SYSTEMATIC_MISFIT: strained if self.strained else "",
            Outcome.SHAPE_DEPENDENT: shape if below else "",
            Outcome.NOT_CONVERGED: "" if self.converged else "the search did not converge",
            Outcome.NOT_IDENTIFIED: loose and f"these logs do not determine {loose}",
        }

    def to_dict(self) -> dict[str, Any]:
        """The numbers, as in ``trajectory.json``."""
        return json_safe(
            {
                "schema": TRAJECTORY,
                "version": __version__,
                "logs": self.logs,
                "windows": self.windows,
                "blocks": self.blocks,
                "converged": self.converged,
                "strained": self.strained,
                "parameters": {k: asdict(v) for k, v in self.parameters.items()},
                "noise": dict(self.noise),
                "vehicle": self.vehicle.model_dump(),
            }
        )

    def files(self, name: str = "") -> dict[str, str]:
        """``front.json`` and ``rear.json`` (each a ``fit.json``), ``vehicle.toml`` with
        the estimated values, and ``trajectory.json``."""
        note = "with values that tirefit fit estimated from trajectories of the car"
        return {
            **{
                f"{axle}.json": json_text(sealed(dict(tire.content)))
                for axle, tire in self.axles.items()
            },
            "vehicle.toml": vehicle_toml(self.vehicle, note),
            "trajectory.json": self.to_json(),
        }


def _reached(tire: AbstractTire, rows: TireData) -> float:
    """Share of the peak of a tire that the slip angles of its rows reach."""
    largest = np.percentile(np.abs(rows["alpha"]), _MOST_SLIPS)
    alpha = np.append(largest, np.linspace(0.0, 1.0, 200) * np.pi / 2)
    at = TireInputs(alpha=alpha, fz=rows["fz"][0], v=rows["v"].mean())
    force = np.abs(np.asarray(forces(tire, at).fy))
    return float(force[0] / force.max())


def fit_trajectory(
    logs: Sequence[str | Path],
    vehicle: Vehicle | str | Path,
    front: TireLike | GivenTire = "brush",
    rear: TireLike | GivenTire = "brush",
    *,
    unknowns: Sequence[str] = ("steering_delay", "steering_offset"),
    window: float = WINDOW,
    progress: Callable[[float, str], None] | None = None,
) -> TrajectoryFit:
    """Fit both axles' tires, and unknowns of the car, to windows of its logs.

    Args:
        logs: vehicle logs, as for :func:`tirefit.derive_files`.
        vehicle: a vehicle or its ``vehicle.toml``, with a steering map.
        front: the model of the tire of the axle; or a fit of the axle, or its
            ``fit.json``, as the start of the search.
        rear: likewise.
        unknowns: names of :data:`UNKNOWNS` to estimate with the tires.
        window: length of a window [s].
        progress: called with the share done and the present step.

    Returns:
        Tires and unknowns with standard errors and intervals; its ``save`` writes what
        ``tirefit replay`` reads.

    Raises:
        UsageError: an unknown that is not known, a vehicle without a steering map, or a
            tire without a free parameter.
        DataError: a log that cannot be read, or no window in it.

    Example:
        >>> result = fit_trajectory([samples / "drive.csv"], samples / "vehicle.toml")
        >>> low, high = result.parameters["front.cpa2"].ci95
        >>> str(result.status), low < 43.6e3 < high  # [N], that of the simulated car
        ('friction rests on the shape of the model', True)
    """
    require_x64("a fit by trajectory")
    vehicle = known_vehicle(vehicle)
    given = {"front": axle_tire(front), "rear": axle_tire(rear)}
    _check(vehicle, unknowns, given)
    tell = progress or (lambda share, note: None)
    tell(0.02, "reading logs")
    log_windows = cut_in_windows(logs, vehicle, window)
    parts = [log.windows[0] for log in log_windows.values()]
    data = Data(*(jnp.concatenate(field) for field in zip(*parts, strict=True)))
    rows = {axle: derived_rows(log_windows, vehicle, axle) for axle in given}
    tell(0.05, "starting with the tires of derive")
    tires = [within(started(tire, rows[axle]), tire, rows[axle]) for axle, tire in given.items()]
    late = lateness(log_windows, vehicle)
    return _Problem(vehicle, tires, tuple(unknowns), data, late).solved(rows, tell)


def _check(vehicle: Vehicle, unknowns: Sequence[str], given: Mapping[str, GivenTire]) -> None:
    problems = steering_problems(vehicle, "a fit by trajectory")
    for name in (name for name in unknowns if name not in UNKNOWNS):
        remedy = f"{did_you_mean(name, UNKNOWNS)}valid: {', '.join(UNKNOWNS)}"
        problems.append(InputProblem(f"{name!r} is no unknown of a car", remedy))
    for axle, tire in given.items():
        if tire.fit is None and tire.name not in MODELS:
            reason = f"the {axle} tire {tire.name} has no free parameters"
            problems.append(InputProblem(reason, "name a model, such as brush"))
    UsageError.raise_for(problems)


class _Problem:
    """Squares of predicted - logged over all windows.

    z holds the tires' parameters in their unconstrained space, then the unknowns.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        tires: Sequence[GivenTire],
        unknowns: tuple[str, ...],
        data: Data,
        late: float,
    ) -> None:
        self.vehicle, self.tires, self.unknowns, self.data = vehicle, tires, unknowns, data
        fits = [tire.fit for tire in tires if tire.fit is not None]  # each has one
        self.steering = cast(Steering, vehicle.steering)
        self.layouts: list[Layout] = [fit[0] for fit in fits]
        self.first = np.cumsum([0, *(layout.size for layout in self.layouts)])
        first = {"steering_delay": self.steering.delay + late}
        of_car = [first.get(name, 0.0) for name in unknowns]
        self.z = np.concatenate([*(fit[1] for fit in fits), of_car])
        self.names = CHANNELS[data.logged.shape[-1]]
        rate, slowest = vehicle.filter.sample_rate, float(np.min(data.v_x))
        run = linearised(self.missed, steps_a_sample(self.car(self.z), slowest, rate))
        self.run = lambda z, starts: run(z, starts, data)

    def unknown(self, z: Values, name: str, default: float = 0.0) -> jax.Array | float:
        """The value of an unknown, in its unit; its neutral value if not estimated."""
        if name not in self.unknowns:
            return default
        value = z[self.first[-1] + self.unknowns.index(name)]
        return jnp.exp(value) if UNKNOWNS[name].is_factor else value

    def tire(self, z: Values, axle: int) -> AbstractTire:
        first, last = self.first[axle : axle + 2]
        values = self.layouts[axle].natural(z[first:last])
        return with_values(self.tires[axle].tire, values)

    def car(self, z: Values) -> Car:
        inertia = self.unknown(z, "yaw_inertia", 1.0)
        car = car_of(self.vehicle, self.tire(z, 0), self.tire(z, 1), inertia)
        ahead = self.unknown(z, "cg_ahead")
        return replace(car, l_f=car.l_f - ahead, l_r=car.l_r + ahead)

    def missed(self, z: jax.Array, start: jax.Array, window: Data, parts: int) -> jax.Array:
        """Predicted - logged (k, c) of one window."""
        step = 1 / self.vehicle.filter.sample_rate
        lead = window.steering.shape[0] - window.v_x.shape[0]
        delay = self.unknown(z, "steering_delay", self.steering.delay)
        steering = delayed(window.steering, delay / step)[lead:]
        steering = steering * self.unknown(z, "steering_ratio", 1.0)
        steering = steering + self.unknown(z, "steering_offset")
        # The log is for the point at which the centre of gravity was assumed.
        ahead = -self.unknown(z, "cg_ahead")
        reading = Reading(sideslip=self.unknown(z, "sideslip_zero"), ahead=ahead)
        first = as_driven(start, reading, window.v_x[0])
        states, _ = predicted(self.car(z), first, window.v_x, steering, step, parts)
        return logged(len(self.names), states, reading, window.v_x).T - window.logged

    def solved(self, rows: Mapping[str, TireData], tell: Callable[..., None]) -> TrajectoryFit:
        tell(0.1, "compiling")
        start, windows = self.data.start, len(self.data.v_x)
        ones = jnp.ones(len(self.names))
        squares = Squares(self.run, ones, self.pulls(), start, self.data.std)
        end = squares.begun(jnp.asarray(self.z), jnp.asarray(start))
        for k in range(_ROUNDS):
            tell(0.15 + 0.1 * k, f"search {k + 1} of {_ROUNDS}, {windows} windows")
            squares = squares._replace(noise=jnp.sqrt(jnp.mean(end.now[0] ** 2, axis=(0, 1))))
            end = minimised_inside(squares, end)
        at, missed = np.asarray(end.z), end.now[0]
        count = missed.shape[0] * missed.shape[1] - len(at) / len(self.names)
        noise = jnp.sqrt(jnp.sum(missed**2, axis=(0, 1)) / max(count, 1))
        squares = squares._replace(noise=noise)
        covariance, blocks, widened = sandwich(squares, end)
        std, reach = np.sqrt(np.diag(covariance)), stdtrit(max(blocks - 1, 1), 0.975)
        ends, car = at + reach * np.outer((-1, 1), std), self.car(at)
        # Distance of each unknown from its usual value, in standard errors of its prior.
        strain = np.abs(at * np.sqrt(self.pulls()))[self.first[-1] :]
        # Profiles of a search that stopped short would begin at no minimum.
        converged = bool(end.converged) and left_to_gain(squares, end) < _LEFT
        for k, axle in enumerate(("front", "rear") if converged else ()):
            if _reached((car.front, car.rear)[k], rows[axle]) < NEAR_PEAK:
                for e in range(*self.first[k : k + 2]):
                    level = reach**2 * widened[e]
                    tell(0.4 + 0.5 * e / self.first[-1], f"interval of parameter {e + 1}")
                    ends[:, e] = profile_ends(squares, end, e, std[e], level)
        parameters = self.estimates(at, std, ends)
        axles = {
            axle: self.axle(k, axle, at, covariance, parameters, rows[axle])
            for k, axle in enumerate(("front", "rear"))
        }
        return TrajectoryFit(
            car.front,
            car.rear,
            parameters,
            {c: float(s) for c, s in zip(self.names, noise, strict=True)},
            windows,
            blocks,
            self.found_vehicle(parameters),
            tuple(n for n, off in zip(self.unknowns, strain, strict=True) if off > _FAR),
            converged,
            axles,
            rows,
        )

    def pulls(self) -> jax.Array:
        """Precision (p,) of the weak priors of the unknowns at zero."""
        scale = {"cg_ahead": self.vehicle.l_f + self.vehicle.l_r}
        priors = [(UNKNOWNS[name].prior * scale.get(name, 1.0)) ** -2 for name in self.unknowns]
        return jnp.asarray([*np.zeros(self.first[-1]), *priors])

    def estimates(self, z: np.ndarray, std: np.ndarray, ends: np.ndarray) -> dict[str, Estimate]:
        """Estimates of all parameters, from z with its standard errors (p,) and the
        ends (2, p) of the intervals."""
        parameters = {}

        Of = Callable[..., Any]

        def add(name: str, unit: str, k: int, natural: Of, identified: Of) -> None:
            low, high = sorted(float(natural(end)) for end in ends[:, k])
            slope = abs(natural(z[k] + 1e-6) - natural(z[k] - 1e-6)) / 2e-6
            value, error = float(natural(z[k])), float(slope * std[k])
            known = bool(identified(low, high) and abs(z[k]) < AT_BOUND)
            parameters[name] = Estimate(value, error, unit, (low, high), known)

        for axle, layout in enumerate(self.layouts):
            for k, (label, free) in enumerate(layout.elements):
                add(
                    f"{('front', 'rear')[axle]}.{label}",
                    free.spec.unit,
                    self.first[axle] + k,
                    partial(constrain, spec=free.spec),
                    partial(limited, free.spec),
                )
        for k, name in enumerate(self.unknowns):
            unknown, at = UNKNOWNS[name], self.first[-1] + k
            scale = self.vehicle.yaw_inertia if name == "yaw_inertia" else 1.0
            by = (lambda log, scale=scale: scale * np.exp(log)) if unknown.is_factor else float
            # Identified if below half of the prior standard error.
            wide = 0.5 / np.sqrt(self.pulls()[at])
            add(name, unknown.unit, at, by, lambda *_, k=at, wide=wide: std[k] < wide)
        return parameters

    def found_vehicle(self, parameters: Mapping[str, Estimate]) -> Vehicle:
        """The vehicle with the estimated values."""
        vehicle, steering = self.vehicle, self.steering

        def value(name: str, default: float = 0.0) -> float:
            return parameters[name].value if name in parameters else default

        ratio, offset = value("steering_ratio", 1.0), value("steering_offset")
        steering = steering.model_copy(
            update={
                "angle": [ratio * angle + offset for angle in steering.angle],
                "delay": value("steering_delay", steering.delay),
            }
        )
        zero, ahead = value("sideslip_zero"), value("cg_ahead")
        pose = len(self.names) == 3
        name, turned = ("yaw_offset", zero) if pose else ("sideslip_offset", -zero)
        changed = {
            "yaw_inertia": value("yaw_inertia", vehicle.yaw_inertia),
            "l_f": vehicle.l_f - ahead,
            "l_r": vehicle.l_r + ahead,
            "steering": steering,
            name: getattr(vehicle, name) + turned,
        }
        if ahead:
            changed |= {"mass_front": None, "mass_rear": None}
        return vehicle.model_copy(update=changed)

    def axle(
        self,
        k: int,
        axle: str,
        z: np.ndarray,
        covariance: np.ndarray,
        estimates: Mapping[str, Estimate],
        rows: TireData,
    ) -> GivenTire:
        """The tire of an axle, with the content of its ``fit.json``."""
        layout, elements = self.layouts[k], slice(*self.first[k : k + 2])
        fit = layout, z[elements], covariance[elements, elements]
        parameters = {
            name.removeprefix(f"{axle}."): asdict(estimate)
            for name, estimate in estimates.items()
            if name.startswith(f"{axle}.")
        }
        content = {
            "schema": FIT_SCHEMA,
            "version": __version__,
            "model": self.tires[k].name,
            "forces": ["fy"],
            "source": "trajectories of the car",
            "data": data_record(rows, rows.n, ()),
            # No force was measured, so predictions have only the parameter uncertainty.
            "noise": {"fy": {"median_std": 0.0}},
            "parameters": parameters,
            "reference": {"fz": float(rows["fz"][0])},
            "prediction": {
                "labels": layout.labels,
                "z": fit[1],
                "covariance": fit[2],
                "layout": layout_record(layout, self.tires[k].tire),
            },
        }
        return replace(self.tires[k], tire=self.tire(z, k), fit=fit, content=json_safe(content))
