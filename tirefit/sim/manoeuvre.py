"""A braking manoeuvre of a car with controllers by name: :func:`brake`."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from tirefit import __version__
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.source import given_tire
from tirefit.fitting.tir import remarks
from tirefit.online.braking.controller import AbstractController
from tirefit.online.braking.controllers import CONTROLLERS, controller_of
from tirefit.params import by_owner, check_names
from tirefit.precision import require_x64
from tirefit.sim import brake_request
from tirefit.sim.brake import Plant, Sensors, simulate_stop
from tirefit.sim.brake_result import Braking, Stop, Summary, summarise

_DEFAULT, _VALUES = "brush-m", {"cpa2": 4e4, "m": 0.5}
"""A tire with a peak: the sliding friction is four fifths of the peak, S(33)."""


def brake(
    tire: TireLike | None = None,
    controller: str | Sequence[str] = "xbs-servo,abs",
    *,
    road: str = "mu=0.3",
    speed: float = 15.0,
    steer: float = 0.0,
    vehicle: str = "car",
    values: Mapping[str, float] | None = None,
    signs: str | None = None,
    tune: Mapping[str, float] | None = None,
    plant: Mapping[str, float] | None = None,
    time_limit: float | None = None,
    stops: int = 1,
    seed: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> Braking:
    """Brake a car with one controller or several, with the same noise.

    Args:
        tire: a fit, a ``fit.json``, a ``.tir`` file, a tire, or the name of a model;
            brush-m with a peak by default.
        controller: names of the controllers: xbs-servo, abs, none.
        road: ``mu=0.4``; ``mu=0.3:0.8@20`` changes after 20 m; ``left=0.3,right=0.8``.
        speed: at which braking begins [m/s].
        steer: angle of the front wheels, to the left [rad].
        vehicle: ``car``, or ``quarter``: one wheel with its mass.
        values: parameters of a model or of a ``.tir`` file.
        signs: sign convention of a ``.tir`` file.
        tune: settings of the controllers, by ``name`` or ``controller.name``.
        plant: numbers of hydraulics, sensors and road: demand [Pa], delay [s], ...
        time_limit: [s]; None: from the speed and the road.
        stops: number of seeds, beginning with ``seed``.
        seed: of the noise of the first stop.
        progress: called with the share done and the next step.

    Returns:
        The stops by controller; ``notes`` are warnings, such as a tire of another size.

    Raises:
        UsageError: an unknown name, a value out of its limits, or 32-bit floats.
        DataError: the tire's file cannot be read.

    Example:
        >>> stop = brake(controller="none", speed=3.0, vehicle="quarter")
        >>> stop.stops["none"].summary.reason
        'stopped: slower than 0.1 m/s'
    """
    require_x64("a simulated stop")
    names = check_names("controller", controller, CONTROLLERS)
    chosen = by_owner(tune or {}, {name: CONTROLLERS[name]() for name in names})
    source: Any = tire
    if source is None:
        source, values = _DEFAULT, _VALUES | dict(values or {})
    given = given_tire(source, dict(values or {}), signs)
    named = os.fspath(source) if isinstance(source, str | os.PathLike) else given.name
    notes = [f"{named}: {text}" for text in remarks(given.tir, given.tire)] if given.tir else []
    made = brake_request.Request(
        given.tire, named, road, speed, vehicle, steer, time_limit=time_limit
    )
    request = brake_request.with_numbers(made, plant or {})
    brake_request.check(request)
    car = brake_request.known_to_controllers(request)
    controllers = {n: controller_of(n, car, settings) for n, settings in chosen.items()}
    done = braked(request, controllers, seed=seed, stops=stops, progress=progress)
    return replace(done, notes=(*notes, *brake_request.doubts(request)))


@eqx.filter_jit
def many_stops(
    plants: Plant, controller: AbstractController, sensors: Sensors, speed: Array, keys: Array,
    samples: int, queue: int,
) -> Summary:  # fmt: skip
    """Summaries (k,) of stops in one vmapped run, of plants with leaves (k, ...) and random keys
    (k,); other arguments as in :func:`tirefit.sim.brake.simulate_stop`."""

    def summary_of(given: tuple[Plant, Array]) -> Summary:
        plant, key = given
        log = simulate_stop(plant, controller, sensors, speed, key, samples, queue)
        return summarise(plant, log, 1 / controller.rate)

    # Stops in one batch: more need much memory, and all wait for the slowest one.
    return jax.lax.map(summary_of, (plants, keys), batch_size=50)


def braked(
    request: brake_request.Request, controllers: Mapping[str, Any], *, seed: int = 0,
    stops: int = 1, progress: Callable[[float, str], None] | None = None,
) -> Braking:  # fmt: skip
    """Brake with each of the controllers (name -> record), under the same noise, that of stop k
    from ``seed + k``; other arguments as in :func:`brake`.

    Raises:
        UsageError: a problem of the request; 32-bit floats.
    """
    require_x64("a simulated stop")
    brake_request.check(request)
    plant, sensors = brake_request.plant_of(request), brake_request.arrays(request.sensors)
    speed, wheels = jnp.asarray(request.speed, float), plant.vehicle.wheels
    done, many = {}, {}
    for number, (name, controller) in enumerate(controllers.items()):
        if progress is not None:
            progress(number / len(controllers), name)
        rate = controller.rate
        how = (request.samples(rate), request.hydraulics.queue(rate))
        run = partial(simulate_stop, plant, controller, sensors, speed)
        log = run(jax.random.key(seed), *how)
        summary = jax.jit(summarise, static_argnums=2)(plant, log, 1 / rate)
        end = min(int(np.sum(log.moving)) + 1, len(log.moving))
        kept, numbers = jax.tree.map(np.asarray, (log, summary))
        kept = jax.tree.map(lambda leaf, end=end: leaf[:end], kept)
        settings = {
            key: np.asarray(value).tolist()
            for key, value in vars(controller).items()
            if isinstance(value, int | float | jax.Array | np.ndarray)
        }
        done[name] = Stop(name, kept, numbers, wheels, settings)
        if stops > 1:
            plants = jax.tree.map(lambda x: jnp.repeat(x[None], stops, 0), plant)
            keys = jax.vmap(jax.random.key)(jnp.arange(seed, seed + stops))
            all_ = many_stops(plants, controller, sensors, speed, keys, *how)
            many[name] = jax.tree.map(np.asarray, all_)
    return Braking(request, done, many, seed, __version__)
