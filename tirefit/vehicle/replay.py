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

import jax
import jax.numpy as jnp
import numpy as np

from tirefit import __version__
from tirefit.data.merged import merged
from tirefit.data.records import Row, frame
from tirefit.data.vehicle.motion import Motion, not_ahead, road_wheel, with_noise
from tirefit.data.vehicle.track import Track
from tirefit.data.vehicle.vehicle import POSE, Vehicle
from tirefit.diagnosis.effects.state import slope_at_rest
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.display import Record
from tirefit.files import listed
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.source import GivenTire, axle_tire
from tirefit.models import TireInputs
from tirefit.models.mf import Pair
from tirefit.precision import require_x64
from tirefit.results import InputProblem, Outcome, UsageError
from tirefit.vehicle.car import (
    NO_CHANGES,
    Car,
    LinearTire,
    State,
    axle_loads,
    car_of,
    predicted,
    steps_a_sample,
)
from tirefit.vehicle.diagnose import Applied, Steps, applied, with_effects
from tirefit.vehicle.errors import (
    FEWEST,
    QUANTITIES,
    Errors,
    Fans,
    Measured,
    Series,
    errors_of,
    errors_without_slip,
    integrated,
    turning,
)
from tirefit.vehicle.mcap import recorded
from tirefit.vehicle.model import Model
from tirefit.vehicle.windows import (
    LEAD,
    CutLog,
    cut_logs,
    known_vehicle,
    left_out,
    steering_problems,
    stretches,
)

if TYPE_CHECKING:
    import pandas

SCHEMA = "tirefit.replay/1"

HORIZONS = (0.25, 0.5, 1.0, 2.0, 5.0)
"""Times [s] after the start at which the prediction is compared."""

EVERY = 0.25
"""Time [s] from one start to the next."""

_MOST = 10_000
"""Most windows of a log, evenly spread. They overlap, so that more of them hardly change the
errors. With 10,000 windows a replay of 1,000,000 rows at 50 Hz takes 42 s of processor time."""

NOISES = 4
"""Number of draws of the noise of the log, for the floor."""
_AHEAD = 0.5  # horizon [s] at which models are compared; the nearest one is used
_AS_WELL = 1.05  # ratio of two rms errors up to which one model predicts as well as the other
_OFF, _ERRORS = 0.05, 3.0  # smallest error of the turning that is reported, and its standard errors
_NAMES = {"yaw_rate": "yaw rate", "lateral": "lateral position"}


@dataclass(frozen=True, repr=False)
class Replay(Record):
    """The result of :func:`replay`.

    Attributes:
        logs: name of each log -> whether a tire was fitted to it.
        windows: predictions that reach each of ``horizons`` [s].
        models: model -> errors; ``tire``, ``linear tire``, ``no slip``, ``with the
            effects`` if effects were given, and ``floor``: the change of the errors of
            ``tire`` if noise of the same size is added to the log.
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

    @property
    def conclusions(self) -> list[str]:
        """Sentences on what predicts better, and on what limits the prediction; empty where
        nothing can be concluded."""
        sentences = []
        if worse_than_linear := self._worse("tire", "linear tire"):
            missed = f"they miss {worse_than_linear}"
            sentences.append(f"The tires predict worse than linear tires: {missed}.")
        if worse := self._worse("with the effects", "tire"):
            sentences.append(f"The effects make the prediction worse: with them it misses {worse}.")
        rms = {k: of.rms()["yaw_rate"][self.place] or 0.0 for k, of in self.models.items()}
        # Rms error over that of the noise from which models can be compared.
        if rms["tire"] < 2.0 * rms["floor"]:
            return sentences
        if rms["no slip"] <= _AS_WELL * rms["tire"]:
            text = "The tires are not what limits: a car without slip predicts as well."
            sentences.append(text)
        elif not worse_than_linear and rms["linear tire"] <= _AS_WELL * rms["tire"]:
            text = "The tires' bend is not what limits: linear tires predict as well."
            sentences.append(text)
        ratio = self.turning
        if ratio is not None and abs(ratio[0] - 1) > max(_OFF, _ERRORS * ratio[1]):
            text = f"The car turns {ratio[0]:.2f} ± {ratio[1]:.2f} times as much as predicted:"
            text += " `tirefit diagnose --vehicle` tells steering, masses and tires apart."
            sentences.append(text)
        return sentences

    def _worse(self, model: str, other: str) -> str:
        """Where a model predicts worse than another one by the largest ratio, such as ``the yaw
        rate after 5 s by 23 rad/s instead of 0.57``; empty if it is nowhere worse."""
        if model not in self.models:
            return ""
        worst, most = "", _AS_WELL
        errors, reference = (self.models[k].rms() for k in (model, other))
        for name, words in _NAMES.items():
            each = zip(self.horizons, self.windows, errors[name], reference[name], strict=True)
            for horizon, count, wrong, less in each:
                if count >= FEWEST and wrong and less and wrong > most * less:
                    most = wrong / less
                    worst = f"the {words} after {horizon:g} s by {wrong:.2g} {QUANTITIES[name]}"
                    worst += f" instead of {less:.2g}"
        return worst

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
        seed: of the noise that is added.
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
    horizons = _checked(vehicle, horizons)
    tires = axle_tire(front), axle_tire(rear)
    fitted = {run for tire in tires for run in tire.runs}
    generator = np.random.default_rng(seed)
    named = None if effects is None else applied(effects)

    def cut(track: Track, motion: Motion) -> list[Measured] | None:
        """The windows of a log, and the same of the log with noise, :data:`NOISES` times."""
        tell("windows of a log")
        rows = _rows_of(motion, vehicle, horizons)
        if rows is None:
            return None
        at, there, steered = rows
        samples = None if named is None else named.samples(motion, at, vehicle, tires)
        windows = []
        noisy = [with_noise(track, motion, vehicle, generator) for _ in range(NOISES)]
        for log in (motion, *noisy):
            each = _series(log, vehicle).items()
            series = {name: np.where(there, x[at], np.nan) for name, x in each}
            steering = road_wheel(log, vehicle)[steered]
            time = np.where(there, log.time[at], np.nan)
            windows.append(Measured(time, log.v_x[at], steering, series, samples))
        return windows

    long_enough = f"as long as the shortest horizon, {horizons[0]:g} s"
    log_windows = cut_logs(logs, vehicle, cut, long_enough, "shorter horizons")
    joined, *noisy = (
        jax.tree.map(lambda *each: np.concatenate(each), *same)
        for same in zip(*(log.windows for log in log_windows.values()), strict=True)
    )
    car = car_of(vehicle, tires[0].tire, tires[1].tire)
    tell("predictions")
    prediction, _ = _predicted(car, joined, vehicle)
    steps = [round(h * vehicle.filter.sample_rate) for h in horizons]
    tire = errors_of(prediction, joined, steps)
    tell("predictions of other cars")
    models = {"tire": tire, **_others(car, joined, vehicle, steps, named)}
    tell("predictions with noise")
    noised = [errors_of(_predicted(car, noise, vehicle)[0], noise, steps).of for noise in noisy]
    models["floor"] = Errors(
        {k: np.concatenate([of[k] - missed for of in noised]) for k, missed in tire.of.items()}
    )
    left = merged(
        (name, (*log.missing, *left_out(log.motion, not_ahead(log.motion, vehicle), vehicle)))
        for name, log in log_windows.items()
    )
    return Replay(
        {k: not fitted.isdisjoint(log.runs) for k, log in log_windows.items()},
        tuple(horizons),
        tuple(np.isfinite(tire.of["yaw_rate"]).sum(axis=0).tolist()),
        models,
        _fans(log_windows, prediction),
        (*_notes(vehicle, tires), *left),
    )


def _fans(log_windows: Mapping[str, CutLog], prediction: Series) -> dict[str, Fans]:
    """The windows of each log as they are drawn."""
    fans, first = {}, 0
    for name, log in log_windows.items():
        windows = log.windows[0]
        rows = slice(first, first + len(windows.v_x))
        first, of_log = rows.stop, {k: x[rows] for k, x in prediction.items()}
        fans[name] = Fans(windows.time, windows.series, of_log, log.track.epoch)
    return fans


def _others(
    car: Car, windows: Measured, vehicle: Vehicle, steps: Sequence[int], named: Applied | None
) -> dict[str, Errors]:
    """Errors of the car on linear tires, of one without slip, and of the car with effects."""
    speed = float(np.median(windows.v_x[np.isfinite(windows.time)]))
    axles = zip((car.front, car.rear), axle_loads(car), strict=True)
    slopes = [slope_at_rest(tire, TireInputs(fz=load, v=speed), "y") / load for tire, load in axles]
    linear = car_of(vehicle, *map(LinearTire, slopes))
    models = {
        "linear tire": errors_of(_predicted(linear, windows, vehicle)[0], windows, steps),
        "no slip": errors_without_slip(vehicle, windows, steps),
    }
    if named is not None:
        models["with the effects"] = errors_of(*_predicted(car, windows, vehicle, named), steps)
    return models


def _checked(vehicle: Vehicle, horizons: Sequence[float]) -> list[float]:
    problems = steering_problems(vehicle, "a prediction")
    given = [float(h) for h in horizons]
    least = 1 / vehicle.filter.sample_rate
    if not (given and sorted({*given}) == given and least <= given[0] and given[-1] < math.inf):
        reason = f"horizons {', '.join(f'{h:g}' for h in given)} do not rise"
        remedy = f"give times from {least:g} s on, in order, such as 0.5 1 2"
        problems.append(InputProblem(reason, remedy))
    UsageError.raise_for(problems)
    return given


def _notes(vehicle: Vehicle, tires: tuple[GivenTire, ...]) -> list[str]:
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
    return notes


def _rows_of(
    motion: Motion, vehicle: Vehicle, horizons: Sequence[float]
) -> tuple[np.ndarray, ...] | None:
    """Rows of the windows of a log (w, k), from a start every :data:`EVERY` seconds where the log
    is settled and the car fast enough, to the longest horizon; which of them the log has; and the
    rows of the steering (w, l + k). None without a window."""
    rate = vehicle.filter.sample_rate
    most, least = round(horizons[-1] * rate) + 1, round(horizons[0] * rate) + 1
    good = motion.settled & (motion.v_x > vehicle.v_min)
    values = *_series(motion, vehicle).values(), road_wheel(motion, vehicle)
    good &= np.isfinite(values).all(axis=0)
    begun = [
        (k, first, last)
        for first, last in stretches(good, motion.part)
        for k in range(first, last - least + 1, max(round(EVERY * rate), 1))
    ]
    if not begun:
        return None
    even = np.linspace(0, len(begun) - 1, min(len(begun), _MOST)).round().astype(int)
    starts, firsts, ends = np.array(begun)[even].T[:, :, None]
    steered = starts + np.arange(-round(LEAD * rate), most)
    # The last sample is repeated beyond the end, where nothing is compared.
    steered, there = np.clip(steered, firsts, ends - 1), steered[:, -most:] < ends
    return steered[:, -most:], there, steered


def _series(motion: Motion, vehicle: Vehicle) -> dict[str, np.ndarray]:
    """The measured series (n,) of a log."""
    heading, x, y = motion.heading, motion.x, motion.y
    if vehicle.columns.motion != POSE:
        turn, ahead, left = (np.nan_to_num(x) for x in (motion.yaw_rate, motion.v_x, motion.v_y))
        heading, x, y = integrated(turn, ahead, left, vehicle.filter.sample_rate)
    state = State(motion.v_y, motion.yaw_rate, heading, x, y)
    return state._asdict() | {"a_y": motion.a_y}


def _predicted(
    car: Car, windows: Measured, vehicle: Vehicle, named: Applied | None = None
) -> tuple[Series, Measured]:
    """The predicted series of every window; with effects, beside the log without its errors."""
    rate, slowest = vehicle.filter.sample_rate, float(windows.v_x.min())
    parts = steps_a_sample(car, slowest, rate)
    # Numbers as arrays, so that other tires and cars use the same program.
    car = jax.tree.map(lambda x: jnp.asarray(x, float), car)
    model, z = None, np.zeros(0)
    if named is None:
        windows = windows._replace(samples=None)
    else:
        channels = 3 if vehicle.columns.motion == POSE else 2
        model, z = named.model._replace(channels=channels), named.z
    found = _integrated(model, car, windows, z, 1 / rate, parts)
    prediction, series = jax.tree.map(np.asarray, found)
    return prediction, windows if named is None else windows._replace(series=series)


@partial(jax.jit, static_argnames="model")
def _integrated(
    model: Model | None, car: Car, windows: Measured, z: Any, step: Any, parts: Any
) -> tuple[Series, Series]:
    def of_window(window: Measured) -> tuple[Series, Series]:
        changes = NO_CHANGES
        if model is not None:
            window, changes = with_effects(model, z, window, step)
        start = State(*(window.series[name][0] for name in State._fields))
        steering = window.steering[-len(window.v_x) :]
        driven = predicted(car, start, window.v_x, steering, step, parts, changes)
        log = {} if model is None else window.series  # as given, it need not be copied
        return driven.states._asdict() | {"a_y": driven.lateral}, log

    return jax.vmap(of_window)(windows)
