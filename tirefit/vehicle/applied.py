"""Apply the effects that a diagnosis of a car names to its prediction."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import model_validator

from tirefit.data.vehicle.motion import Motion
from tirefit.data.vehicle.vehicle import POSE, Vehicle
from tirefit.diagnosis.effects import effects_by_id
from tirefit.diagnosis.effects.record import Atom
from tirefit.diagnosis.extended import AnyDocument, read_checked
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.vehicle.car import Changes, State
from tirefit.vehicle.diagnose import CarExtension
from tirefit.vehicle.effects import CAR_EFFECTS, Samples
from tirefit.vehicle.model import PARAMETERS, Model, as_driven, steered
from tirefit.vehicle.windows import samples_of


@dataclass(frozen=True)
class Applied:
    """Named effects with their sizes.

    Attributes:
        model: with their atoms; z: its coefficients.
        speed: mean speed [m/s] of the logs that were diagnosed.
    """

    model: Model
    z: np.ndarray
    speed: float

    def samples(self, motion: Motion, rows: Any, vehicle: Vehicle, tires: Any) -> Samples:
        """The quantities on which effects depend, at rows (w, k) of the motion of a log;
        the time is the middle of that of the diagnosis."""
        samples = samples_of(motion, rows, vehicle, tires)
        across, turn = motion.a_y[rows] / vehicle.gravity, motion.yaw_rate[rows] / motion.v_x[rows]
        speed = samples.speed / self.speed
        return samples._replace(speed=speed, time=0 * samples.time, across=across, turn=turn)

    def channels(
        self, vehicle: Vehicle, tires: Any, motion: Motion, channels: Any, rows: Any
    ) -> Any:
        """Speed, lateral acceleration, wheel angle and state (n,) of a log with the
        effects of steering and log; and samples at rows (w, k)."""
        v_x, a_y, steer, *state = channels
        steer = self.wheel_angle(steer, motion, vehicle, tires)
        driven = self.corrected(State(*state)._asdict(), v_x, vehicle)
        samples = self.samples(motion, rows, vehicle, tires)
        return (v_x, a_y, steer, *driven.values()), samples

    def wheel_angle(self, steering: Any, motion: Motion, vehicle: Vehicle, tires: Any) -> Any:
        """Road wheel angle (n,) of a log, with the effects of the steering."""
        rows = np.arange(len(motion.time))[None]
        samples = jax.tree.map(lambda x: x[0], self.samples(motion, rows, vehicle, tires))
        of = self.model.setting(self.z, samples).steering
        angle = np.full(len(steering), np.nan)
        for stretch in motion.stretches:
            kept = stretch.start + np.flatnonzero(np.isfinite(steering[stretch]))
            if len(kept) > 2:
                step = 1 / vehicle.filter.sample_rate
                across = np.nan_to_num(samples.across[kept])
                angle[kept] = steered(of, jnp.asarray(steering[kept]), across, step)
        return angle

    def changes(self, samples: Samples) -> Changes:
        """The changes of the car at samples (w, k)."""

        def of_window(samples: Samples) -> Any:
            each = lambda x: jnp.broadcast_to(jnp.asarray(x, float), len(samples.speed))  # noqa: E731
            return jax.tree.map(each, self.model.setting(self.z, samples).car)

        return jax.vmap(of_window)(jax.tree.map(jnp.asarray, samples))

    def corrected(
        self, state: Mapping[str, Any], v_x: np.ndarray, vehicle: Vehicle
    ) -> dict[str, Any]:
        """The states of a log (n,) without the errors of its channels."""
        wheelbase = vehicle.l_f + vehicle.l_r
        none = Samples(*[0.0] * len(Samples._fields))._replace(wheelbase=wheelbase)
        reading = self.model.setting(self.z, none._replace(sliding=np.ones(2))).reading
        fields = State._fields[: 5 if vehicle.columns.motion == POSE else 2]
        logged = dict(state) | {"yaw_rate": state["yaw_rate"] - float(reading.yaw_rate)}
        driven = as_driven([logged[name] for name in fields], reading, v_x)
        return logged | {name: np.asarray(getattr(driven, name)) for name in fields}


def applied(source: Diagnosis | str | os.PathLike[str]) -> Applied:
    """The effects named by a diagnosis of a car, or by its ``vehicle_diagnosis.json``.

    Raises:
        DataError: not a diagnosis of a car, or of another version.
    """
    name, command = "vehicle_diagnosis.json", "tirefit diagnose --vehicle"
    document = read_checked(source, _Document, name, command)
    library, to = effects_by_id(CAR_EFFECTS), document.extension
    atoms = tuple(Atom(library[k], to.variants[k]) for k in document.sizes)
    scales = tuple(atom.effect.scale for atom in atoms)
    of_tires = [np.log(document.extended_parameters[name]) for name in PARAMETERS]
    amplitudes = np.divide([*document.sizes.values()], scales)
    return Applied(Model(atoms, scales, 2), np.array([*of_tires, *amplitudes], float), to.speed)


class _Document(AnyDocument):
    """The parts of ``vehicle_diagnosis.json`` that a prediction needs."""

    extension: CarExtension

    @property
    def sizes(self) -> dict[str, float]:
        """Effect -> amplitude."""
        return {name.partition(": ")[0]: size.value for name, size in self.amplitudes.items()}

    @model_validator(mode="after")
    def _known(self) -> Any:
        library, variants = effects_by_id(CAR_EFFECTS), self.extension.variants
        for name in self.sizes:
            if name not in library or variants.get(name) not in range(len(library[name].variants)):
                raise ValueError(f"{name!r} is not an effect of a car, or has no such form")
        for name in PARAMETERS:
            if not self.extended_parameters.get(name, 0.0) > 0:
                raise ValueError(f"extended_parameters.{name} is not a positive number")
        return self
