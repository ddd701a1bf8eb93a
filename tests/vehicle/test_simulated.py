"""What a simulator has wrong of a car: faults put into a simulator by hand, found from its output.
Car and simulator are an independent program (fits/withheld_vehicle/drives.py)."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import tirefit
from fits.withheld_vehicle.drives import STEP, Trial, drive, trial, written
from tirefit.cli.commands import app
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.diagnosis.summary.compare import Apart, Number
from tirefit.models import Brush
from tirefit.results import DataError
from tirefit.vehicle import subject
from tirefit.vehicle.effects import CAR_EFFECTS, SIMULATOR_EFFECTS, Samples, Setting
from tirefit.vehicle.simulated import _STATED, _first_of_twins, _forms, _meanings, _no_slip, _spins

FEW = (
    "steering_delay", "yaw_inertia", "centre_of_gravity", "lateral_load_transfer",
    "steering_offset", "relaxation_length",
)  # fmt: skip
LIBRARY = tuple(effect for effect in CAR_EFFECTS if effect.id in FEW)
NUMBER, SECONDS = 5, 24.0
BOTH = "simulator", "car"


@pytest.fixture(scope="module", autouse=True)
def few_windows():
    """Programs of the windows of these logs: padding to 48 takes longer."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subject, "_LEAST_WINDOWS", 24)
        yield


def one_of(effect="", size=0.0, friction=1.0):
    car = trial(NUMBER, "none").car
    tires = [(cpa2, friction * mu) for cpa2, mu in car["tires"]]
    return Trial(NUMBER, effect, size, car | {"tires": tires}, seconds=SECONDS)


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    """Log, vehicle and tires of a car that its vehicle.toml describes."""
    one = one_of()
    log, vehicle = written(one, tmp_path_factory.mktemp("car"))
    return log, vehicle, [Brush(cpa2=1.1 * c, mu=mu) for c, mu in one.car["tires"]]


def simulated(one, folder):
    """The states that a simulator with a fault predicts, without noise: no inputs."""
    time, _, v_y, yaw_rate, _, _ = drive(one)
    every = round(1 / one.rate / STEP)
    columns = np.stack([time[::every], v_y[::every], yaw_rate[::every]], axis=1)
    path = folder / "sim.csv"
    np.savetxt(path, columns, "%.9g", ",", header="t,v_y,yaw_rate", comments="")
    return path


def found_of(car, folder, *fault, **more):
    log, vehicle, tires = car
    sim = simulated(one_of(*fault, **more), folder)
    return tirefit.compare_with_simulator([log], [sim], vehicle, *tires, effects=LIBRARY)


WHEELBASE = (lambda x: x["l_f"] + x["l_r"])(trial(NUMBER, "none").car)
INERTIA = trial(NUMBER, "none").car["inertia"]
# Fault of the simulator -> its size, the quantity, and the car less the simulator.
FAULTS = {
    "centre_of_gravity": (0.06, "l_f", 0.06 * WHEELBASE),
    "yaw_inertia": (0.35, "yaw_inertia", INERTIA * (1 - np.exp(0.35))),
    "steering_delay": (0.08, "steering.delay", -0.08),
    "lateral_load_transfer": (0.5, "amplitude", -0.5),
}


@pytest.mark.long
@pytest.mark.parametrize("effect", FAULTS)
def test_a_fault_put_into_a_simulator_is_found_with_its_size(effect, car, tmp_path):
    size, quantity, truth = FAULTS[effect]
    found = found_of(car, tmp_path, effect, size)
    by_name = {one.name: one for one in found.effects}
    one = by_name.pop(f"{effect}: {quantity}")
    assert one.differs and one.farthest == "car"
    assert abs(one.difference - truth) < 3 * one.std + 0.03 * abs(truth)
    assert not any(other.differs for other in by_name.values())
    simulator, _ = found.sources
    assert simulator.standing[effect] == "named"
    words = effect.replace("_", " ")
    assert f"{words} is named in simulator only; " in str(found)


@pytest.mark.long
@pytest.mark.parametrize(("axle", "quantity"), [("front_axle", "l_f"), ("rear_axle", "l_r")])
def test_an_axle_of_a_simulator_at_another_place_is_found(axle, quantity, car, tmp_path):
    log, vehicle, tires = car
    one = one_of()
    size = 0.1 * one.car[quantity]
    changed = {quantity: one.car[quantity] + size, "known_wheelbase": WHEELBASE}
    sim = simulated(replace(one, car=one.car | changed), tmp_path)
    few = [x for x in SIMULATOR_EFFECTS if x.id in (*FEW, "front_axle", "rear_axle")]
    few += [x for x in SIMULATOR_EFFECTS if x.id in ("steering_ratio", "tracked_point")]
    found = tirefit.compare_with_simulator([log], [sim], vehicle, *tires, effects=few)
    (differing,) = (x for x in (*found.numbers, *found.effects) if x.differs)
    assert differing.name == f"{axle}: {quantity}"
    assert abs(differing.difference + size) < 3 * differing.std


@pytest.mark.parametrize("effect", _STATED)
def test_a_stated_quantity_changes_as_the_car_of_the_effect_does(effect, car):
    vehicle, size = load_vehicle(car[1]), 0.07
    (record,) = (one for one in SIMULATOR_EFFECTS if one.id == effect)
    rows = Samples(*[0.0] * 6, 1.0, vehicle.wheelbase, 1.0)
    by = record.change(Setting(), size, record.variants[0], rows)
    changed = {
        "l_f": vehicle.l_f + by.car.l_f,
        "l_r": vehicle.l_r + by.car.l_r,
        "yaw_inertia": vehicle.yaw_inertia * by.car.inertia,
        "steering.delay": by.steering.delay,
    }
    quantity, _, of = _STATED[effect]
    assert of(vehicle, size) == pytest.approx(float(changed[quantity]))


@pytest.mark.long
def test_tires_of_too_much_friction_are_found(car, tmp_path):
    found = found_of(car, tmp_path, friction=1.3)
    numbers = {one.name: one for one in found.numbers}
    for axle in ("front", "rear"):
        one = numbers[f"{axle}.friction"]
        assert one.differs and abs(one.difference + 0.3) < 3 * one.std + 0.01
        assert not numbers[f"{axle}.stiffness"].differs
    assert not any(one.differs for one in found.effects)


@pytest.mark.long
def test_a_simulator_without_a_fault_does_not_differ(car, tmp_path):
    found = found_of(car, tmp_path)
    assert not any(one.differs for one in (*found.numbers, *found.effects))


def with_states(car, folder, **factors):
    """A simulated log of the car without a fault, its states multiplied."""
    path = simulated(one_of(), folder)
    t, v_y, yaw_rate = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
    states = {"v_y": v_y, "yaw_rate": yaw_rate}
    states = {name: factors.get(name, 1.0) * x for name, x in states.items() if name in factors}
    table = np.stack([t, *states.values()], axis=1)
    np.savetxt(path, table, "%.9g", ",", header=",".join(["t", *states]), comments="")
    log, vehicle, _ = car
    return lambda: tirefit.compare_with_simulator([log], [path], vehicle, effects=LIBRARY)


@pytest.mark.parametrize(
    ("factors", "told"),
    [
        ({"v_y": -1, "yaw_rate": 1}, r"sim\.csv, column 'v_y': v_y is -[01].*the other sign"),
        ({"v_y": 3.6, "yaw_rate": 1}, "v_y is 3.[56].*km/h.*give a_y"),
        ({"v_y": 1, "yaw_rate": -1}, r"sim\.csv, column.*yaw_rate has the wrong sign"),
        ({"v_y": 1, "yaw_rate": np.rad2deg(1)}, "yaw_rate is in deg/s.*the units of its log"),
        ({"v_y": 1}, "it lacks yaw_rate, which the simulator has to predict"),
    ],
)
def test_states_in_other_units_or_missing_are_refused(factors, told, car, tmp_path):
    with pytest.raises(DataError, match=f"(?s){told}"):
        with_states(car, tmp_path, **factors)()


@pytest.mark.long
def test_a_simulator_that_drives_straight_differs(car, tmp_path):
    found = with_states(car, tmp_path, v_y=0.0, yaw_rate=0.0)()
    assert any(one.differs for one in (*found.numbers, *found.effects))


def test_the_measured_acceleration_does_not_check_a_simulator(car, tmp_path, monkeypatch):
    """Twice the lateral speed contradicts the a_y of the car."""

    def begun(*_):
        raise RuntimeError("begun")

    monkeypatch.setattr("tirefit.vehicle.simulated.studied", begun)
    with pytest.raises(RuntimeError, match="begun"):
        with_states(car, tmp_path, v_y=2.0, yaw_rate=1.0)()


def judged(*effects, **twins):
    """A diagnosis by which these effects help."""
    atoms = [SimpleNamespace(effect=SimpleNamespace(id=name)) for name in "abcd"]
    each = {e: SimpleNamespace(twins=twins.get(e, ())) for e in effects}
    fits = [SimpleNamespace(effects=(e,), atoms=(k,)) for k, e in enumerate("abcd")]
    return SimpleNamespace(
        base=SimpleNamespace(atoms=atoms),
        verdict=SimpleNamespace(each=each),
        chosen=SimpleNamespace(effects=effects, atoms=tuple(map("abcd".index, effects))),
        search=SimpleNamespace(ranked=fits),
    )


def test_one_of_two_twins_is_compared_whichever_helps_more():
    cases = judged("b", b=("c", "a")), judged("c", c=("a", "b")), judged("a", a=("b", "c"))
    assert [_first_of_twins(case) for case in cases] == [
        {"a": ("b", "b", "c")}, {"a": ("c", "b", "c")}, {"a": ("a", "b", "c")},
    ]  # fmt: skip
    assert _forms(cases[0], "a") == {"a": 0}


@pytest.mark.long
def test_a_lag_that_may_be_a_delay_is_compared_as_the_delay(car, tmp_path):
    log, vehicle, tires = car
    sim = simulated(one_of("steering_lag", 0.04), tmp_path)
    few = [effect for effect in CAR_EFFECTS if effect.id in ("steering_delay", "steering_lag")]
    result = tirefit.compare_with_simulator([log], [sim], vehicle, *tires, effects=few)
    simulator, _ = result.sources
    assert simulator.standing == {"steering_delay": "named", "steering_lag": "possible"}
    assert [number.name for number in result.effects] == ["steering_delay: steering.delay"]
    assert any("steering_lag instead" in meaning for meaning in result.meanings)


def test_effects_that_help_together_do_not_replace_each_other():
    two = judged("c", "d", c=("a",), d=("a", "b", "c"))
    assert _first_of_twins(two) == {"a": ("c", "c"), "b": ("d", "d")}
    assert _first_of_twins(judged("a", "b", b=("a",))) == {"a": ("a",), "b": ("b",)}


def differing(pairs):
    """Quantities of a simulator and of a car; unequal ones differ."""
    found = {
        name: Apart(
            name, "-", {k: Number(x, 0.01 * x, "-") for k, x in zip(BOTH, pair, strict=True)}
        )
        for name, pair in pairs.items()
    }
    return [x._replace(differs=len({*pairs[name]}) > 1) for name, x in found.items()]


def meanings(**pairs):
    return [*_meanings({one.name: one for one in differing(pairs)})]


def test_a_common_factor_is_told_as_a_mass_and_a_far_friction_as_no_limit():
    same = {"front.friction": (0.9, 0.9), "rear.friction": (0.9, 0.9)}
    soft = {"front.stiffness": (0.5, 0.65), "rear.stiffness": (1.0, 1.31)}
    inertia = "yaw_inertia: yaw_inertia"
    (said,) = meanings(**same, **soft, **{inertia: (2000, 2590)})
    assert "the mass of the simulator is 1.3 times that of the car" in said
    assert meanings(**same, **soft, **{inertia: (2000, 2200)}) == []
    assert meanings(**same, **soft, **{inertia: (2000, 2000)}) == []
    far = {"front.friction": (4.4, 0.9), "rear.friction": (0.9, 1.2)}
    (said,) = meanings(**far, **soft)
    assert said.startswith("the front tires of the simulator do not saturate")


@pytest.mark.parametrize(("ours", "theirs", "spins"), [(0.2, 1.2, 1), (0.2, 0.6, 0), (1.0, 1.2, 0)])
def test_a_simulated_car_that_spins_is_told(ours, theirs, spins):
    def sliding(angle):
        v_y = np.tan([0.0, angle, 1.5])
        settled = np.array([True, True, False])
        return [SimpleNamespace(motion=SimpleNamespace(v_x=1.0, v_y=v_y, settled=settled))]

    said = [*_spins(sliding(ours), sliding(theirs))]
    assert len(said) == spins
    if spins:
        assert "sideslip reaches 69 deg, that of the car 11 deg" in said[0]


def test_a_simulated_log_without_inputs_needs_the_rows_of_the_log(car, tmp_path):
    log, vehicle, _ = car
    path = simulated(one_of(), tmp_path)
    path.write_text("".join(path.read_text().splitlines(True)[:-5]))
    with pytest.raises(DataError, match=r"(?s)lacks v_x, steer.*row for each row of the log"):
        tirefit.compare_with_simulator([log], [path], vehicle)
    line = ["diagnose", str(log), "--vehicle", str(vehicle), "--sim-log", str(path)]
    done = CliRunner().invoke(app, [*line, "--out", str(tmp_path / "o")])
    assert done.exit_code == 3 and "sim.csv" in done.output
    for more in (["--holdout", str(log)], ["--full"]):
        assert CliRunner().invoke(app, [*line, *more, "--out", str(tmp_path / "o")]).exit_code == 2
    without = ["diagnose", str(log), "--sim-log", str(path), "--out", str(tmp_path / "o")]
    assert "--vehicle" in CliRunner().invoke(app, without).output


@pytest.mark.parametrize("slip", [0.0, 0.05])
def test_a_simulated_car_without_slip_is_told(slip, car):
    """Its yaw rate follows the wheels; with slip it follows them later than the speed sideways."""
    vehicle, time = load_vehicle(car[1]), np.arange(0, 30, 0.02)
    v_x, steer = 15 + np.sin(0.3 * time), 0.05 * np.sin(time) + 0.03 * np.sin(2.7 * time)
    yaw_rate = v_x * np.tan(steer) / 2.9
    v_y = 1.4 * yaw_rate - slip * np.gradient(yaw_rate, time)
    motion = SimpleNamespace(
        settled=time > 1, v_x=v_x, v_y=v_y, yaw_rate=yaw_rate, command=steer, time=time
    )
    text = _no_slip([SimpleNamespace(motion=motion)], vehicle)
    assert bool(text) is (slip == 0.0)
    assert slip or "wheelbase of 2.9 m" in text and "1.4 m ahead of the rear axle" in text
