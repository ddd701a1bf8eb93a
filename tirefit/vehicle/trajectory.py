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
from typing import Any, ClassVar, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from tirefit import __version__
from tirefit.data.table import TireData
from tirefit.data.vehicle.vehicle import Steering, Vehicle, vehicle_toml
from tirefit.display import Record
from tirefit.door import sealed
from tirefit.files import json_safe, json_text
from tirefit.fitting.estimate import data_record
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.predict import predict_forces
from tirefit.fitting.problem.layout import Layout
from tirefit.fitting.result import SCHEMA as FIT_SCHEMA
from tirefit.fitting.result import TRAJECTORY, Estimate, layout_record
from tirefit.fitting.solve.inference import half_width_95
from tirefit.fitting.source import GivenTire, axle_tire
from tirefit.fitting.uncertainty.identified import limited
from tirefit.fitting.verdict.family import NEAR_PEAK
from tirefit.models import MODELS, AbstractTire, TireInputs, forces
from tirefit.params import Values, constrain, with_values
from tirefit.precision import require_x64
from tirefit.results import DataError, InputProblem, Outcome, UsageError, did_you_mean
from tirefit.vehicle.car import AXLES, Car, car_of, delayed, predicted, steps_a_sample
from tirefit.vehicle.diagnose import Steps
from tirefit.vehicle.effects import Reading
from tirefit.vehicle.model import as_driven, logged
from tirefit.vehicle.replay import replay
from tirefit.vehicle.shooting import (
    AT_BOUND,
    Data,
    Squares,
    linearised,
    minimised_inside,
    profile_ends,
    sandwich,
)
from tirefit.vehicle.windows import (
    CHANNELS,
    cut_in_windows,
    known_vehicle,
    started_tires,
    steering_problems,
)


class Unknown(NamedTuple):
    """An unknown of the car."""

    unit: str
    prior: float  # standard error of a weak prior at zero; of a factor's logarithm
    is_factor: bool
    meaning: str


UNKNOWNS = {
    "yaw_inertia": Unknown("kg m2", 0.5, True, "about the cg"),
    "steering_ratio": Unknown("-", 0.3, True, "of wheel to map"),
    "steering_offset": Unknown("rad", 0.1, False, "added to the angle"),
    "steering_delay": Unknown("s", 0.1, False, "wheels after the log"),
    "sideslip_zero": Unknown("rad", 0.05, False, "logged less the car's"),
}
"""Parameters that may be estimated with the tires."""

WINDOW = 0.5
"""Length [s] of a window."""
_SHAPES = "brush", "brush-d", "magic-formula"  # to compare where the peak is not reached
_ROUNDS = 3  # times that the noise of the channels is estimated again


@dataclass(frozen=True, repr=False)
class TrajectoryFit(Record):
    """The result of :func:`fit_trajectory`.

    Attributes:
        parameters: ``front.cpa2``, ``yaw_inertia``, ... -> estimate.
        noise: channel -> rms of predicted - logged, used as its noise.
        windows: number of windows; ``blocks`` of them are independent.
        vehicle: with what was found of it.
        strained: unknowns that end further from their usual value than three standard errors
            of their prior.
        converged: whether the search ended where one more step promises no gain.
        axles: ``front``, ``rear`` -> the tire with its uncertainty and the content of a
            ``fit.json``; :func:`tirefit.replay` takes it.
        rows: ``front``, ``rear`` -> slip angle and force as derived, for comparison.
        conclusions: those of :func:`tirefit.replay` of the same logs with the fitted car.
    """

    text_by: ClassVar[str] = "tirefit.report.vehicle:trajectory_text"
    plot_by: ClassVar[str] = "tirefit.report.vehicle:trajectory_figure"

    parameters: Mapping[str, Estimate]
    noise: Mapping[str, float]
    windows: int
    blocks: int
    vehicle: Vehicle
    strained: tuple[str, ...]
    converged: bool
    axles: Mapping[str, GivenTire] = field(default_factory=dict)
    rows: Mapping[str, TireData] = field(default_factory=dict)
    conclusions: tuple[str, ...] = ()

    @property
    def logs(self) -> tuple[str, ...]:
        """Names of the logs."""
        return tuple(self.rows["front"].runs)

    @property
    def reached(self) -> dict[str, float]:
        """Axle -> share of the peak of its tire that the slip angles of its rows reach."""
        return {axle: _reached(tire.tire, self.rows[axle]) for axle, tire in self.axles.items()}

    def force(self, axle: str, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lateral force of an axle, and half of its 95 % interval, both (n,) [N].

        The interval is linear in the parameters: drawn from their covariance, friction and
        stiffness leave the valley of the squares to the side of smaller forces.

        Args:
            axle: "front" or "rear".
            alpha: (n,) slip angles [rad].

        Returns:
            Force and half of the interval.
        """
        tire = self.axles[axle]
        assert tire.fit is not None  # it was fitted
        at = TireInputs(*(np.broadcast_to(x, alpha.shape) for x in _inputs(alpha, self.rows[axle])))
        force, variance = predict_forces(tire.tire, *tire.fit, at, np.zeros(len(alpha), int))
        std = np.sqrt(np.asarray(variance["fy"]))
        return np.asarray(force["fy"]), half_width_95(True, self.blocks - 1) * std

    @property
    def limits(self) -> dict[Outcome, str]:
        """Whether the search converged, the parameters that are not determined, and the
        axles whose friction follows from the shape of the model."""
        shares = ", ".join(
            f"{100 * share:.0f} % ({axle})"
            for axle, share in self.reached.items()
            if share < NEAR_PEAK
        )
        used = {tire.name for tire in self.axles.values()}
        others = " and ".join(f"front={name},rear={name}" for name in _SHAPES if name not in used)
        loose = ", ".join(name for name, of in self.parameters.items() if not of.identified)
        strained = ", ".join(self.strained)
        return {
            Outcome.SYSTEMATIC_MISFIT: strained
            and f"{strained} far from any usual value: an effect that is not fitted, such as a lag"
            " of the steering, acts in its place, and may in that of the tires",
            Outcome.SHAPE_DEPENDENT: shares
            and f"{Outcome.SHAPE_DEPENDENT}: the slip angles reach {shares} of the peak;"
            f" compare with {others}",
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
                "conclusions": self.conclusions,
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
    largest = np.percentile(np.abs(rows["alpha"]), 99.5)  # few of the derived ones are errors
    alpha = np.append(largest, np.linspace(0.0, 1.0, 200) * np.pi / 2)
    force = np.abs(np.asarray(forces(tire, _inputs(alpha, rows)).fy))
    return float(force[0] / force.max())


def _inputs(alpha: np.ndarray, rows: TireData) -> TireInputs:
    """Slip angles (n,) at the load and the mean speed of the rows of an axle."""
    return TireInputs(alpha=alpha, fz=rows["fz"][0], v=rows["v"].mean())


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
    problems = steering_problems(vehicle, "a fit by trajectory")
    for name in (name for name in unknowns if name not in UNKNOWNS):
        remedy = f"{did_you_mean(name, UNKNOWNS)}valid: {', '.join(UNKNOWNS)}"
        problems.append(InputProblem(f"{name!r} is no unknown of a car", remedy))
    for axle, tire in given.items():
        if tire.fit is None and tire.name not in MODELS:
            reason = f"the {axle} tire {tire.name} has no free parameters"
            problems.append(InputProblem(reason, "name a model, such as brush"))
    UsageError.raise_for(problems)
    tell = Steps(progress, 12)  # usual number, four of them intervals
    tell("reading logs")
    log_windows = cut_in_windows(logs, vehicle, window)
    parts = [log.windows[0] for log in log_windows.values()]
    data = Data(*(jnp.concatenate(field) for field in zip(*parts, strict=True)))
    tell("starting with the tires of derive")
    tires, rows, late = started_tires([*given.values()], log_windows, vehicle)
    problem = _Problem(vehicle, tires, tuple(unknowns), data, late)
    fit = problem.solved(dict(zip(AXLES, rows, strict=True)), tell)
    tell("replaying the logs")
    try:
        conclusions = replay(logs, fit.vehicle, *fit.axles.values()).conclusions
    except DataError as error:  # the estimated car contradicts its logs
        conclusions = [f"These logs cannot be replayed with the estimated car: {error}"]
    return replace(fit, conclusions=tuple(conclusions))


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
        return car_of(self.vehicle, self.tire(z, 0), self.tire(z, 1), inertia)

    def missed(self, z: jax.Array, start: jax.Array, window: Data, parts: int) -> jax.Array:
        """Predicted - logged (k, c) of one window."""
        step = 1 / self.vehicle.filter.sample_rate
        lead = window.steering.shape[0] - window.v_x.shape[0]
        delay = self.unknown(z, "steering_delay", self.steering.delay)
        steering = delayed(window.steering, delay / step)[lead:]
        steering = steering * self.unknown(z, "steering_ratio", 1.0)
        steering = steering + self.unknown(z, "steering_offset")
        reading = Reading(sideslip=self.unknown(z, "sideslip_zero"))
        first = as_driven(start, reading, window.v_x[0])
        driven = predicted(self.car(z), first, window.v_x, steering, step, parts)
        return logged(len(self.names), driven.states, reading, window.v_x).T - window.logged

    def solved(self, rows: Mapping[str, TireData], tell: Steps) -> TrajectoryFit:
        tell("compiling")
        start, windows = self.data.start, len(self.data.v_x)
        ones = jnp.ones(len(self.names))
        squares = Squares(self.run, ones, self.pulls(), start, self.data.std)
        end = squares.begun(jnp.asarray(self.z), jnp.asarray(start))
        for k in range(_ROUNDS):
            tell(f"search {k + 1} of {_ROUNDS}, {windows} windows")
            squares = squares._replace(noise=jnp.sqrt(jnp.mean(end.now[0] ** 2, axis=(0, 1))))
            end = minimised_inside(squares, end)
        at, missed = np.asarray(end.z), end.now[0]
        count = missed.shape[0] * missed.shape[1] - len(at) / len(self.names)
        noise = jnp.sqrt(jnp.sum(missed**2, axis=(0, 1)) / max(count, 1))
        squares = squares._replace(noise=noise)
        covariance, blocks, widened = sandwich(squares, end)
        std, reach = np.sqrt(np.diag(covariance)), half_width_95(True, blocks - 1)
        ends = at + reach * np.outer((-1, 1), std)
        # Unknowns further from their usual value than three standard errors of their prior.
        strained = (np.abs(at * np.sqrt(self.pulls())) > 3.0)[self.first[-1] :]
        # Profiles of a search that stopped short would begin at no minimum.
        for k, axle in enumerate(AXLES if end.converged else ()):
            if _reached(self.tire(at, k), rows[axle]) < NEAR_PEAK:
                for e in range(*self.first[k : k + 2]):
                    tell(f"interval of parameter {e + 1}")
                    ends[:, e] = profile_ends(squares, end, e, std[e], reach, widened[e])
        parameters = self.estimates(at, std, ends)
        axles = {
            axle: self.axle(k, at, covariance, parameters, rows[axle])
            for k, axle in enumerate(AXLES)
        }
        return TrajectoryFit(
            parameters,
            {c: float(s) for c, s in zip(self.names, noise, strict=True)},
            windows,
            blocks,
            self.fitted_vehicle(parameters),
            tuple(np.array(self.unknowns)[strained].tolist()),
            bool(end.converged),
            axles,
            rows,
        )

    def pulls(self) -> jax.Array:
        """Precision (p,) of the weak priors of the unknowns at zero."""
        priors = [UNKNOWNS[name].prior ** -2 for name in self.unknowns]
        return jnp.asarray([*np.zeros(self.first[-1]), *priors])

    def estimates(self, z: np.ndarray, std: np.ndarray, ends: np.ndarray) -> dict[str, Estimate]:
        """Estimates of all parameters, from z with its standard errors (p,) and the
        ends (2, p) of the intervals."""
        elements: list[tuple[str, str, Any, Any]] = [
            (f"{axle}.{label}", free.spec.unit, partial(constrain, spec=free.spec), free.spec)
            for axle, layout in zip(AXLES, self.layouts, strict=True)
            for label, free in layout.elements
        ]
        natural = {
            "yaw_inertia": lambda log: self.vehicle.yaw_inertia * np.exp(log),
            "steering_ratio": np.exp,
        }
        for name in self.unknowns:
            elements.append((name, UNKNOWNS[name].unit, natural.get(name, float), None))
        # Identified if below half of the standard error of a prior.
        below = 2 * std * np.sqrt(self.pulls()) < 1
        parameters = {}
        for k, (name, unit, natural, spec) in enumerate(elements):
            low, high = sorted(float(natural(end)) for end in ends[:, k])
            slope = abs(natural(z[k] + 1e-6) - natural(z[k] - 1e-6)) / 2e-6
            identified = below[k] and abs(z[k]) < AT_BOUND
            identified &= spec is None or limited(spec, low, high)
            value, error = float(natural(z[k])), float(slope * std[k])
            parameters[name] = Estimate(value, error, unit, (low, high), bool(identified))
        return parameters

    def fitted_vehicle(self, parameters: Mapping[str, Estimate]) -> Vehicle:
        """The vehicle with the estimated values."""
        vehicle, steering = self.vehicle, self.steering
        of = {name: parameters[name].value for name in self.unknowns}
        ratio, offset = of.get("steering_ratio", 1.0), of.get("steering_offset", 0.0)
        angle = [ratio * angle + offset for angle in steering.angle]
        delay = of.get("steering_delay", steering.delay)
        zero, pose = of.get("sideslip_zero", 0.0), len(self.names) == 3
        name, turned = ("yaw_offset", zero) if pose else ("sideslip_offset", -zero)
        changed = {
            "yaw_inertia": of.get("yaw_inertia", vehicle.yaw_inertia),
            "steering": steering.model_copy(update={"angle": angle, "delay": delay}),
            name: getattr(vehicle, name) + turned,
        }
        return vehicle.model_copy(update=changed)

    def axle(
        self,
        k: int,
        z: np.ndarray,
        covariance: np.ndarray,
        estimates: Mapping[str, Estimate],
        rows: TireData,
    ) -> GivenTire:
        """The tire of an axle, with the content of its ``fit.json``."""
        layout, elements = self.layouts[k], slice(*self.first[k : k + 2])
        fit = layout, z[elements], covariance[elements, elements]
        parameters = {
            name.removeprefix(f"{AXLES[k]}."): asdict(estimate)
            for name, estimate in estimates.items()
            if name.startswith(f"{AXLES[k]}.")
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
