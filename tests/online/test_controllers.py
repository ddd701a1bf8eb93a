"""Brake controllers: the common protocol, and the rules of the conventional one."""

import inspect
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fits.braking.slip_control import SlipControl
from tirefit.online.braking.abs import PHASES, ConventionalABS
from tirefit.online.braking.controller import Measurement, Truth
from tirefit.online.braking.controllers import CONTROLLERS, controller_of
from tirefit.params import by_owner, check_names
from tirefit.results import UsageError

CAR = {
    "radius": np.full(4, 0.3),
    "inertia": np.full(4, 1.2),
    "brake_gain": np.array([1.35e-4, 1.35e-4, 0.75e-4, 0.75e-4]),
    "fz": np.full(4, 3700.0),
    "stiffness": np.full(4, 8e4),
    "rise": 40e6,
    "fall": 80e6,
    "delay": 0.01,
}


def measured(k=0, wheel=None, pressure=2e6, slowing=2.5, truth=True, w=4):
    """A sample at k of a car that slows from 15 m/s, its wheels as given."""
    time = 0.005 * k
    v = 15.0 - slowing * time
    wheel = np.full(w, v) if wheel is None else np.asarray(wheel, float)
    known = [np.full(w, x if truth else np.nan) for x in (v, 0.01, 0.03, 0.3, 3700.0)]
    rows = time, wheel, np.full(w, pressure), slowing, 12e6, 0.0, 0.0, Truth(*known)
    return jax.tree.map(jnp.asarray, Measurement(*rows))


def car(w=4):
    return {k: v[:w] if np.ndim(v) else v for k, v in CAR.items()}


def shaken(k, w=4, truth=True):
    """Wheels with small slip and vibration, each different."""
    phase = np.arange(w) + 0.3 * k
    return measured(k, 14.7 - 0.0125 * k + 0.1 * np.sin(phase), truth=truth, w=w)


@cache
def compiled(name, w):
    """A controller of w wheels; its beginning and its step, each one program."""
    controller = controller_of(SlipControl if name == "slip" else name, car(w))
    return controller, eqx.filter_jit(controller.init), eqx.filter_jit(controller.step)


@pytest.mark.parametrize("name", [*CONTROLLERS, "slip"])
@pytest.mark.parametrize("w", [1, 4])
def test_every_controller_follows_the_protocol(name, w):
    controller, init, step = compiled(name, w)
    assert list(inspect.signature(controller.step).parameters) == ["state", "measurement"]
    state = init(measured(w=w))
    for k in range(30):
        after, command, info = step(state, shaken(k, w))
        assert command.shape == (w,)
        assert np.all(np.abs(command) <= 1.0)
        assert all(np.shape(value) == (w,) for value in info.values())
        # Fixed shapes: what runs in a scan allocates nothing.
        same = jax.tree.map(lambda a, b: np.shape(a) == np.shape(b), after, state)
        assert all(jax.tree.leaves(same))
        state = after


@pytest.mark.parametrize("name", CONTROLLERS)
def test_controllers_do_not_read_the_truth(name):
    _, init, step = compiled(name, 4)
    states = [init(measured(truth=known)) for known in (True, False)]
    for k in range(60):
        valves = []
        for j, known in enumerate((True, False)):
            states[j], command, _ = step(states[j], shaken(k, truth=known))
            valves.append(command)
        np.testing.assert_array_equal(*valves)


begun, stepped = eqx.filter_jit(ConventionalABS.init), eqx.filter_jit(ConventionalABS.step)


def rules(**settings):
    """The conventional controller; arrays, so that all settings share a program."""
    return jax.tree.map(jnp.asarray, ConventionalABS(**settings))


def phases_of(wheels, slowing=2.5, pressure=3e6, **settings):
    """Phase names of a single wheel for given speeds, sample by sample."""
    controller = rules(smoothing=1e-6, **settings)
    state = begun(controller, measured(0, [wheels[0]], w=1))
    names, valves = [], []
    for k, wheel in enumerate(wheels):
        now = measured(k, [wheel], pressure, slowing, w=1)
        state, command, _ = stepped(controller, state, now)
        names.append(PHASES[int(state.phase[0])])
        valves.append(float(command[0]))
    return names, valves


def test_the_rules_pass_through_their_cycle():
    """A wheel decelerates, is released, accelerates and rolls again, phase by phase."""
    free = [15.0 - 0.0125 * k for k in range(4)]
    dive = [14.85, 14.6, 14.2, 13.7]  # beyond 9 m/s2 at once, then 7 % of slip
    stop = [13.65, 13.65, 13.65]
    back = [13.8, 14.0, 14.3, 14.55]  # faster than 5 m/s2
    rolls = [14.6, 14.6, 14.58, 14.57]
    names, valves = phases_of(free + dive + stop + back + rolls)
    order = [names[0]]
    for name in names:
        if name != order[-1]:
            order.append(name)
    assert order == ["build", "hold", "dump", "wait", "step"]
    by = dict(zip(names, valves, strict=True))
    assert by["build"] == 1.0 and by["hold"] == 0.0 == by["wait"]
    assert by["dump"] == -0.45


def test_a_large_slip_alone_releases_the_pressure():
    """A wheel that never slows by 9 m/s2 is released above 16 % of slip, not of 7 %."""
    wheels = 15.0 - 0.04 * np.arange(80)
    names, _ = phases_of(wheels, slowing=0.0)
    slip = 1 - wheels / (15.0 - 0.3 * 0.005 * np.arange(80))  # the margin of the reference
    deep = int(np.argmax(slip > 0.16))
    assert names[: deep + 1] == ["build"] * deep + ["dump"]


def test_a_wheel_that_stays_slow_gets_less_pressure():
    """On ice a wheel stays slow without decelerating: the pressure is released."""
    names, _ = phases_of([15.0, 14.0, 13.0, 13.0, *[12.99] * 20])
    after = names[names.index("wait") :]
    assert "dump" in after and "step" not in after


def test_the_controller_is_off_at_walking_pace():
    names, valves = phases_of([1.2, 0.6, 0.1, 0.0], slowing=0.0)
    assert set(names) == {"build"} and set(valves) == {1.0}


def test_reference_speed_falls_no_faster_than_the_car():
    """All wheels lock: the reference follows the measured deceleration."""
    controller = rules()
    state = begun(controller, measured(0, [15.0] * 4))
    for k in range(1, 21):
        now = measured(k, [8.0] * 4, slowing=3.0)
        state, _, info = stepped(controller, state, now)
    expected = 15.0 - 20 * 0.005 * (3.0 + 0.3)
    assert float(state.reference) == pytest.approx(expected)
    assert info["reference_speed"].tolist() == pytest.approx([expected] * 4)


def test_the_rear_takes_the_lower_pressure():
    """One rear wheel locks: both rear valves release, the front ones continue."""
    controller = rules(smoothing=1e-6)
    state = begun(controller, measured(0, [15.0] * 4))
    for k, slow in enumerate((15.0, 14.5, 13.5, 12.5)):
        now = measured(k, [14.99, 14.99, slow, 14.99])
        state, command, _ = stepped(controller, state, now)
    assert command[2] == command[3] < 0
    assert command[0] == command[1] == 1.0


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"abs.slip": 7.0}, "abs.slip = 7.0 is outside its bounds"),
        ({"slpi": 0.1}, "none of abs, none has it"),
        ({"slip.gain": 1.0}, "'slip' is not chosen"),
        ({"none.slip": 0.1}, "'none' has no setting 'slip'"),
    ],
)
def test_impossible_settings_are_refused(settings, said):
    with pytest.raises(UsageError) as error:
        by_owner(settings, {name: CONTROLLERS[name]() for name in ("abs", "none")})
    assert said in str(error.value) and error.value.problems[0].remedy


def test_settings_are_passed_to_their_controller():
    asked = {"abs": CONTROLLERS["abs"](), "slip": SlipControl()}
    chosen = by_owner({"slip": 0.05, "slip.gain": 3.0}, asked)
    assert chosen == {"abs": {"slip": 0.05}, "slip": {"gain": 3.0}}
    made = controller_of(SlipControl, CAR, chosen["slip"])
    assert float(made.gain) == 3.0 and made.radius.shape == (4,)
    assert isinstance(made.rise, jax.Array) and made.rate == 200.0


@pytest.mark.parametrize(
    ("names", "said"),
    [("asb", "did you mean 'abs'"), ("abs,abs", "twice"), (" ,", "no controller")],
)
def test_unknown_names_are_refused(names, said):
    with pytest.raises(UsageError) as error:
        check_names("controller", names, CONTROLLERS)
    assert said in str(error.value)
    assert check_names("controller", " abs, none ", CONTROLLERS) == ("abs", "none")
