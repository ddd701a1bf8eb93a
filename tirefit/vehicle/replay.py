"""Predict measured logs from measured states: :func:`replay`.

Every quarter of a second the car starts from the measured state and is predicted for up
to five seconds, with speed and steering as measured and without correction. The error at
each horizon is compared with that of a car without slip, of one with linear tires, and
with the floor that the noise of the log sets: the change of the error if noise of the
same size is added to the log.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from tirefit import __version__
from tirefit.data.merged import merged
from tirefit.data.records import Row, frame
from tirefit.data.vehicle.motion import Motion, not_ahead, road_wheel, with_noise
from tirefit.data.vehicle.track import Track
from tirefit.data.vehicle.vehicle import POSE, Vehicle
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.display import Record
from tirefit.files import listed
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.source import GivenTire, axle_tire
from tirefit.models import AbstractTire
from tirefit.models.mf import Pair
from tirefit.precision import require_x64
from tirefit.results import InputProblem, Outcome, UsageError
from tirefit.vehicle.applied import applied
from tirefit.vehicle.car import (
    Car,
    Changes,
    State,
    accelerations,
    axle_loads,
    car_of,
    linear,
    predicted,
    steps_a_sample,
)
from tirefit.vehicle.diagnose import Steps
from tirefit.vehicle.errors import (
    QUANTITIES,
    Errors,
    Fans,
    Measured,
    errors_of,
    errors_without_slip,
    floor_of,
    turning,
)
from tirefit.vehicle.mcap import recorded
from tirefit.vehicle.windows import (
    CutLog,
    cut_logs,
    integrated,
    known_vehicle,
    left_out,
    starts_in,
    steering_problems,
    stretches,
)

if TYPE_CHECKING:
    import pandas


SCHEMA = "tirefit.replay/1"

HORIZONS = (0.25, 0.5, 1.0, 2.0, 5.0)
"""Times [s] after the start at which the prediction is compared."""

EVERY = 0.25
"""Time [s] from one start to the next; a multiple of it in a log of many."""

DRAWS = 24
"""Number of draws of the tires' parameters, for the band."""
NOISES = 4
"""Number of draws of the noise of the log, for the floor."""
_NORMAL_95 = 1.96
_AHEAD = 0.5  # horizon [s] at which models are compared; the nearest one is used


@dataclass(frozen=True, repr=False)
class Replay(Record):
    """The result of :func:`replay`.

    Attributes:
        logs: name of each log -> whether a tire was fitted to it.
        windows: predictions that reach each of ``horizons`` [s].
        models: model -> errors; ``tire``, ``linear tire``, ``no slip``, ``with the
            effects`` if effects were given, and ``floor``: the change of the errors of
            ``tire`` if noise of the same size is added to the log.
        held: quantity -> share of the windows, by horizon, whose measured value is in
            the 95 % band of the tires' parameters; empty if neither tire has one.
        fans: the predictions of each log, for pictures.
        notes: what was assumed.
    """

    text_by: ClassVar[str] = "tirefit.report.vehicle:replay_text"
    plot_by: ClassVar[str] = "tirefit.report.vehicle:plotted"
    page_by: ClassVar[str] = "tirefit.report.vehicle:replay_page"

    logs: Mapping[str, bool]
    horizons: tuple[float, ...]
    windows: tuple[int, ...]
    models: Mapping[str, Errors]
    held: Mapping[str, list[float | None]]
    fans: Mapping[str, Fans]
    notes: tuple[str, ...]

    @property
    def limits(self) -> dict[Outcome, str]:
        """The horizons that no window reaches."""
        off = [f"{h:g} s" for h, n in zip(self.horizons, self.windows, strict=True) if not n]
        return {Outcome.INCOMPLETE: f"no log has {' or '.join(off)} without a gap" if off else ""}

    @property
    def place(self) -> int:
        """Number of the horizon at which models are compared."""
        reached = self.horizons[: sum(count > 0 for count in self.windows)]
        return int(np.argmin([abs(h - _AHEAD) for h in reached]))

    @property
    def turning(self) -> tuple[float, float] | None:
        """Measured over predicted yaw rate with its standard error, see
        :func:`tirefit.vehicle.errors.turning`."""
        return turning(self.fans.values(), self.horizons[self.place])

    def to_dict(self) -> dict[str, Any]:
        """The numbers, as in ``replay.json``."""
        return {
            "schema": SCHEMA,
            "version": __version__,
            "logs": {k: {"fitted": v} for k, v in self.logs.items()},
            "horizons": self.horizons,
            "windows": self.windows,
            "units": QUANTITIES,
            "rms": {name: errors.rms() for name, errors in self.models.items()},
            "held": self.held,
            "notes": self.notes,
        }

    def to_frame(self) -> "pandas.DataFrame":
        """The rms errors as a pandas data frame: columns kind (the model), name (the
        quantity and the horizon in s), value, unit."""
        rows = [
            Row(model, f"{name} {horizon:g}", value, unit=QUANTITIES[name])
            for model, errors in self.models.items()
            for name, values in errors.rms().items()
            for horizon, value in zip(self.horizons, values, strict=True)
        ]
        return frame(rows)[["kind", "name", "value", "unit"]]

    def to_mcap(self) -> bytes:
        """The content of an MCAP file with the measured and the predicted motion of each log, for
        Foxglove and PlotJuggler; see :func:`tirefit.vehicle.mcap.recorded`."""
        return recorded(self)

    def files(self, name: str = "") -> dict[str, str]:
        """``replay.json``."""
        return {"replay.json": self.to_json()}


def replay(
    logs: Sequence[str | Path],
    vehicle: Vehicle | str | Path,
    front: TireLike | GivenTire,
    rear: TireLike | GivenTire,
    *,
    horizons: Sequence[float] = HORIZONS,
    effects: Diagnosis | str | Path | None = None,
    steering_delay: float | None = None,
    seed: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> Replay:
    """Predict measured logs from their measured states, and compare by horizon.

    Args:
        logs: vehicle logs, as for :func:`tirefit.derive_files`.
        vehicle: a vehicle or its ``vehicle.toml``, with a steering map.
        front: tire of the front axle: a fit of the axle or its ``fit.json``, a tire, or
            the name of a model; or a ``.tir`` file, of each of its two tires.
        rear: likewise, of the rear axle.
        horizons: times [s] after a start at which the prediction is compared.
        effects: a diagnosis of the car, or its ``vehicle_diagnosis.json``: the car is
            also predicted with its effects.
        steering_delay: delay [s] of the wheels behind the logged steering; that of the
            vehicle if None.
        seed: of the draws of the tires' parameters.
        progress: called with the share done and the present step.

    Returns:
        Errors by horizon of the car, of the same with linear tires, of a car without
        slip, and the floor that the noise of the log sets.

    Raises:
        UsageError: a vehicle without a steering map, horizons that do not rise, or a
            tire that cannot be found.
        DataError: a log that cannot be read, or none of whose stretches is as long as
            the shortest horizon.

    Example:
        >>> log, car = samples / "drive.csv", samples / "vehicle.toml"
        >>> result = replay([log], car, "brush", "brush", horizons=[0.5])
        >>> result.windows, sorted(result.models)
        ((38,), ['floor', 'linear tire', 'no slip', 'tire'])
    """
    require_x64("a replay")
    logs = listed(logs)
    tell = Steps(progress, len(logs) + 5)
    tell("reading logs")
    vehicle = known_vehicle(vehicle)
    horizons = _checked(vehicle, horizons, steering_delay or 0.0)
    if steering_delay is not None and vehicle.steering is not None:
        late = vehicle.steering.model_copy(update={"delay": steering_delay})
        vehicle = vehicle.model_copy(update={"steering": late})
    tires = axle_tire(front), axle_tire(rear)
    fitted = {run for tire in tires for run in tire.runs}
    rate, generator = vehicle.filter.sample_rate, np.random.default_rng(seed)
    named = None if effects is None else applied(effects)
    apply = named and partial(named.channels, vehicle, tires)
    thinned: list[str] = []
    log_windows = cut_logs(
        logs,
        vehicle,
        partial(_windows, vehicle, horizons, generator, apply, thinned, tell),
        f"as long as the shortest horizon, {horizons[0]:g} s",
        "shorter horizons",
    )
    joined, *noisy, changed = (
        jax.tree.map(lambda *each: np.concatenate(each), *same)
        for same in zip(*(log.windows for log in log_windows.values()), strict=True)
    )
    steps = [round(h * rate) for h in horizons]
    car: Car = _traced(car_of(vehicle, tires[0].tire, tires[1].tire))
    parts = steps_a_sample(car, float(joined.v_x.min()), rate)
    tell("predictions")
    predict = partial(_predicted, step=1 / rate, parts=parts)

    def compared(car: Car, windows: Measured = joined, **more: Any) -> Errors:
        return errors_of(*predict(car, windows, **more), windows, steps)

    predictions = predict(car, joined)
    tire = errors_of(*predictions, joined, steps)
    tell("predictions of other cars")
    models = {
        "tire": tire,
        "linear tire": compared(_linear(car, joined)),
        "no slip": errors_without_slip(vehicle, joined, steps),
    }
    if named is not None:
        changes = named.changes(changed.samples)
        models["with the effects"] = compared(car, changed, parts=2 * parts, changes=changes)
    tell("predictions with noise")
    models["floor"] = floor_of(tire, [compared(car, windows) for windows in noisy])
    tell("band of the tires' parameters")
    return Replay(
        {k: not fitted.isdisjoint(log.runs) for k, log in log_windows.items()},
        tuple(horizons),
        tuple(np.isfinite(tire.of["yaw_rate"]).sum(axis=0).tolist()),
        models,
        _held(compared, car, tires, generator),
        _fans(log_windows, *predictions),
        _notes(vehicle, tires, thinned, log_windows),
    )


def _checked(vehicle: Vehicle, horizons: Sequence[float], delay: float) -> list[float]:
    problems = steering_problems(vehicle, "a prediction")
    if not 0 <= delay < math.inf:
        reason = f"a steering delay of {delay:g} s"
        problems.append(InputProblem(reason, "give seconds, zero or more"))
    given = [float(h) for h in horizons]
    least = 1 / vehicle.filter.sample_rate
    if not (given and sorted({*given}) == given and least <= given[0] and given[-1] < math.inf):
        reason = f"horizons {', '.join(f'{h:g}' for h in given)} do not rise"
        remedy = f"give times from {least:g} s on, in order, such as 0.5 1 2"
        problems.append(InputProblem(reason, remedy))
    UsageError.raise_for(problems)
    return given


def _notes(
    vehicle: Vehicle,
    tires: tuple[GivenTire, ...],
    thinned: Sequence[str],
    log_windows: Mapping[str, CutLog[Any]],
) -> tuple[str, ...]:
    notes = [
        "speed and steering are those of the log; start states are from the log, low-passed"
        f" at {vehicle.filter.bandwidth:.3g} Hz with zero phase",
        "axle loads are static; the tires carry no drive or brake force",
        *vehicle.columns.notes,
    ]
    notes += [
        f"{axle} axle: the Magic Formula describes one tire; the axle has two, mirror"
        " images of each other, each at half the load"
        for axle, tire in zip(("front", "rear"), tires, strict=True)
        if isinstance(tire.tire, Pair)
    ]
    if vehicle.columns.motion != POSE:
        notes.append(
            "the log has no pose: heading and position are integrals of yaw rate and speeds"
        )
    left = merged(
        (name, (*log.missing, *left_out(log.motion, not_ahead(log.motion, vehicle), vehicle)))
        for name, log in log_windows.items()
    )
    return (*notes, *dict.fromkeys(thinned), *left)


def _traced(module: Any) -> Any:
    """The module with its numbers as arrays, so that others use the same program."""
    return jax.tree.map(lambda x: jnp.asarray(x, float), module)


def replace_tires(car: Car, front: AbstractTire, rear: AbstractTire) -> Car:
    """The same car on other tires."""
    return eqx.tree_at(lambda c: (c.front, c.rear), car, _traced((front, rear)))


def _linear(car: Car, windows: Measured) -> Car:
    """The same car on linear tires."""
    speed = float(np.median(windows.v_x[np.isfinite(windows.a_y)]))
    axles = zip((car.front, car.rear), axle_loads(car), strict=True)
    return replace_tires(car, *(linear(tire, fz, speed) for tire, fz in axles))


def _windows(
    vehicle: Vehicle,
    horizons: Sequence[float],
    generator: np.random.Generator,
    apply: Any,
    thinned: list[str],
    tell: Steps,
    track: Track,
    motion: Motion,
) -> list[Measured] | None:
    """The windows of a log, from a start every :data:`EVERY` seconds where the log is
    settled and the car fast enough, to the longest horizon; None of none. Behind them
    the same windows of the log with noise, :data:`NOISES` times, and with what
    ``apply`` makes of the channels and the rows."""
    tell("windows of a log")
    rate = vehicle.filter.sample_rate
    most, least = round(horizons[-1] * rate) + 1, round(horizons[0] * rate) + 1
    step = max(round(EVERY * rate), 1)
    good = motion.settled & (motion.v_x > vehicle.v_min)
    good &= np.isfinite(_channels(motion, vehicle)).all(axis=0)
    begun, thinner = starts_in(stretches(good, motion.part), least, step)
    if not begun:
        return None
    if thinner > step:
        thinned.append(f"a log is long: its windows start every {thinner / rate:.3g} s")
    starts, ends = np.array(begun).T
    rows = starts[:, None] + np.arange(most)
    there = rows < ends[:, None]
    # The last sample is repeated beyond the end, where nothing is compared.
    rows = np.minimum(rows, ends[:, None] - 1)

    def cut(motion: Motion, apply: Any = None) -> Measured:
        channels, samples = _channels(motion, vehicle), None
        if apply is not None:
            channels, samples = apply(motion, channels, rows)
        v_x, a_y, steer, *state = channels
        *measured, a_y = (np.where(there, x[rows], np.nan) for x in (*state, a_y))
        return Measured(
            motion.time[rows],
            State(*(x[starts] for x in state)),
            v_x[rows],
            steer[rows],
            State(*measured),
            a_y,
            samples,
        )

    noisy = (with_noise(track, motion, vehicle, generator) for _ in range(NOISES))
    return [cut(motion), *map(cut, noisy), cut(motion, apply)]


def _channels(motion: Motion, vehicle: Vehicle) -> tuple[Any, ...]:
    """Speed, lateral acceleration, road wheel angle and the state, (n,) each."""
    heading, x, y = motion.heading, motion.x, motion.y
    if vehicle.columns.motion != POSE:
        heading, x, y = integrated(motion, vehicle.filter.sample_rate)
    steer = road_wheel(motion, vehicle)
    return motion.v_x, motion.a_y, steer, motion.v_y, motion.yaw_rate, heading, x, y


@partial(jax.jit, static_argnames=("step", "parts"))
def _states(
    car: Car,
    start: State,
    v_x: jax.Array,
    steering: jax.Array,
    changes: Changes | None,
    step: float,
    parts: int,
) -> tuple[State, jax.Array]:
    """States (w, k) of every window, and the lateral acceleration (w, k)."""

    def of_window(
        start: State, v_x: jax.Array, steering: jax.Array, changes: Changes | None
    ) -> tuple[State, jax.Array]:
        states, _ = predicted(car, start, v_x, steering, step, parts, changes)
        acting = () if changes is None else (changes,)
        samples = v_x, steering, states.v_y, states.yaw_rate, *acting
        return states, jax.vmap(partial(accelerations, car))(*samples)[0]

    return jax.vmap(of_window)(start, v_x, steering, changes)


def _predicted(
    car: Car, windows: Measured, step: float, parts: int, changes: Changes | None = None
) -> tuple[State, np.ndarray]:
    """The predicted states (w, k), and the lateral acceleration (w, k)."""
    given = windows.start, windows.v_x, windows.steering, changes
    return jax.tree.map(np.asarray, _states(car, *given, step, parts))


def _held(
    compared: Callable[[Car], Errors],
    car: Car,
    tires: tuple[GivenTire, ...],
    generator: np.random.Generator,
) -> dict[str, list[float | None]]:
    """Share of the windows within the band of the tires' parameters, by horizon."""
    if all(tire.fit is None for tire in tires):
        return {}
    pairs = zip(*(tire.drawn(generator, DRAWS) for tire in tires), strict=True)
    drawn = [compared(replace_tires(car, *pair)) for pair in pairs]
    held = {}
    for name in QUANTITIES:
        missed = np.stack([errors.of[name] for errors in drawn])
        inside = np.abs(missed.mean(axis=0)) <= _NORMAL_95 * missed.std(axis=0)
        there = np.isfinite(missed[0])
        held[name] = [
            float(inside[t, k].mean()) if t.any() else None for k, t in enumerate(there.T)
        ]
    return held


def _fans(
    log_windows: Mapping[str, CutLog[Any]], states: State, lateral: np.ndarray
) -> dict[str, Fans]:
    """The windows of the figures, for each log."""
    predicted, fans, first = states._asdict() | {"a_y": lateral}, {}, 0
    for name, log in log_windows.items():
        windows = log.windows[0]
        rows = slice(first, first + len(windows.v_x))
        first = rows.stop
        there = np.isfinite(windows.a_y)
        fans[name] = Fans(
            np.where(there, windows.time, np.nan),
            windows.measured._asdict() | {"a_y": windows.a_y},
            {k: np.where(there, values[rows], np.nan) for k, values in predicted.items()},
            log.epoch,
        )
    return fans
