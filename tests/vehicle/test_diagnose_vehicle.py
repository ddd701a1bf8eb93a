"""Diagnoses of simulated cars with a known missing effect; the simulator is an
independent program (fits/withheld_vehicle/drives.py)."""

import json
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from test_replay import TOML
from typer.testing import CliRunner

import tirefit
from fits.withheld_vehicle import exact
from fits.withheld_vehicle.drives import LISTED, Trial, trial, written
from tirefit.cli.commands import app
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.diagnosis.effects import EFFECTS, Atom
from tirefit.diagnosis.extended import read_document
from tirefit.diagnosis.summary.case import Concluded
from tirefit.diagnosis.summary.result import record_of_document
from tirefit.fitting.source import axle_tire
from tirefit.models import Brush
from tirefit.results import DataError, UsageError
from tirefit.vehicle import subject
from tirefit.vehicle.car import State, cubic, delayed, lagged, with_play
from tirefit.vehicle.diagnose import Applied, applied, with_effects
from tirefit.vehicle.effects import (
    CAR_EFFECTS,
    SIMULATOR_EFFECTS,
    Reading,
    Samples,
    Setting,
    Steering,
)
from tirefit.vehicle.errors import Measured
from tirefit.vehicle.model import Model, as_driven, steered
from tirefit.vehicle.model import logged as seen_in_log
from tirefit.vehicle.windows import cut_in_windows

FEW = ("steering_delay", "yaw_inertia", "steering_offset", "relaxation_length")
LIBRARY = tuple(effect for effect in CAR_EFFECTS if effect.id in FEW)
DELAY = 0.08


def logged(folder, effect, size, number=5, off=1.1):
    """Log, vehicle and tires (stiffness wrong by a factor) of a drive."""
    one = trial(number, "none")
    one = Trial(number, effect, size, one.car, seconds=16.0)
    log, vehicle = written(one, folder)
    tires = [Brush(cpa2=off * c, mu=mu) for c, mu in one.car["tires"]]
    return log, vehicle, tires


@pytest.fixture(scope="module", autouse=True)
def few_windows():
    """Programs of the fifteen windows of these logs: padding to 48 takes longer."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subject, "_LEAST_WINDOWS", 16)
        yield


@pytest.fixture(scope="module")
def late(tmp_path_factory):
    log, vehicle, tires = logged(tmp_path_factory.mktemp("late"), "steering_delay", DELAY)
    return log, vehicle, tires


@pytest.fixture(scope="module")
def found(late):
    log, vehicle, tires = late
    return tirefit.diagnose_vehicle([log], vehicle, *tires, effects=LIBRARY)


def test_a_steering_delay_is_named_with_its_size(found):
    assert found.verdict.effects == ("steering_delay",)
    value, std, unit, _ = found.amplitudes["steering_delay: amplitude"]
    assert unit == "s" and abs(value - DELAY) < 4 * std + 1e-3


@pytest.mark.parametrize("stated", [DELAY, 2 * DELAY])
def test_the_effect_is_the_change_of_the_stated_delay(late, tmp_path, stated):
    log, vehicle, tires = late
    car = tmp_path / "vehicle.toml"
    text = vehicle.read_text()
    assert text.count("[steering]\n") == 1
    car.write_text(text.replace("[steering]\n", f"[steering]\ndelay = {stated}\n"))
    few = [effect for effect in LIBRARY if effect.id in ("steering_delay", "steering_offset")]
    found = tirefit.diagnose_vehicle([log], car, *tires, effects=few)
    if stated == DELAY:
        assert found.verdict.status == "none"
        return
    assert found.verdict.effects == ("steering_delay",)
    value, std, *_ = found.amplitudes["steering_delay: amplitude"]
    assert abs(value - (DELAY - stated)) < 4 * std + 1e-3


def test_a_named_delay_is_exported_to_autoware(found, late, tmp_path):
    done = tirefit.export(found, "autoware", tmp_path / "car.yaml", vehicle=late[1])
    value = found.amplitudes["steering_delay: amplitude"].value
    assert f"steer_time_delay: {value:.12g}" in done.path.read_text()


def test_the_effect_reduces_the_error_to_the_noise(found):
    for channel, noise in found.noise.forces.items():
        gap = found.gap.channels[channel]
        assert gap.rms > noise  # beyond the noise
        assert gap.remaining_rms < 0.5 * noise
    given, tires, delay = (step.rms_left_out for step in found.ladder.steps[:3])
    assert given > tires > 1.5 and delay < 1.15


def test_the_tires_are_recovered_with_the_effect(found):
    for axle in ("front", "rear"):
        change = found.verdict.parameters[f"{axle}.stiffness"]
        assert change.simulated == 1.0 and change.differs
        assert abs(change.measured - 1 / 1.1) < 5 * change.std


def test_the_record_prints_draws_and_saves(found, tmp_path):
    assert "steering delay" in found.summary().partition("HOW FAR")[0]
    assert len(found.summary().splitlines()) < 60
    paths = found.save(tmp_path)
    content = json.loads(paths[0].read_text())
    assert content["verdict"]["effects"] == ["steering_delay"]
    assert len(found.plot().axes) == 1  # the ladder
    record = record_of_document(paths[0])
    amplitude = next(row for row in record.rows if row.kind == "effect")
    assert (amplitude.name, amplitude.unit) == ("steering_delay: amplitude", "s")


def test_the_document_has_the_keys_of_rows_of_forces(found, tmp_path):
    slip = np.tile(np.linspace(-0.2, 0.2, 32), 3)
    rows = {"sigma_x": slip, "fz": np.repeat([2000.0, 4000.0, 6000.0], 32)}
    force = tirefit.predict("brush", rows, {"cpa2": 5e4, "mu": 0.9})["fx"]
    force += np.random.default_rng(1).normal(0, 20, len(slip))
    few = [one for one in EFFECTS if one.id == "slip_offset"]
    of_rows = tirefit.diagnose(rows | {"fx": force}, effects=few).to_dict()
    of_car = found.to_dict()
    assert of_car.keys() == of_rows.keys()
    (tmp_path / "rows.json").write_text(json.dumps(of_rows))
    with pytest.raises(DataError, match="not vehicle_diagnosis.json of.*extension.speed"):
        applied(tmp_path / "rows.json")
    with pytest.raises(DataError, match="not NAME.json of.*extension.mode"):
        read_document(found)
    for key in ("schema", "version", "seed"):
        assert of_car[key] == of_rows[key]
    for key in ("data", "gap", "verdict", "settings"):
        assert of_car[key].keys() == of_rows[key].keys(), key
    for key in ("ladder", "candidates", "budget"):
        assert of_car[key][0].keys() == of_rows[key][0].keys(), key


@pytest.mark.long
def test_a_replay_with_the_effects_reaches_the_noise(late, found, tmp_path):
    log, vehicle, tires = late
    found.save(tmp_path)
    given = tmp_path / "vehicle_diagnosis.json"
    replayed = tirefit.replay([log], vehicle, *tires, horizons=(0.5, 1.0), effects=given)
    rms = {name: errors.rms() for name, errors in replayed.models.items()}
    for quantity in ("yaw_rate", "lateral"):
        for k in (0, 1):
            before, after, floor = (
                rms[name][quantity][k] for name in ("tire", "with the effects", "floor")
            )
            assert after < 0.6 * before and after < 2 * floor, quantity
    assert "With the effects" in replayed.summary()
    given.write_text('{"schema": "tirefit.diagnosis/4"}')
    with pytest.raises(DataError, match="not vehicle_diagnosis.json of"):
        tirefit.replay([log], vehicle, *tires, effects=given)


@pytest.mark.long
def test_no_effect_is_named_if_none_is_missing(tmp_path):
    log, vehicle, tires = logged(tmp_path, "", 0.0, number=6)
    found = tirefit.diagnose_vehicle([log], vehicle, *tires, effects=LIBRARY)
    assert found.verdict.status.value == "none" and not found.verdict.effects


@pytest.mark.long
@pytest.mark.parametrize("way", exact.WAYS)
def test_a_car_that_the_model_describes_exactly_has_no_effect(way):
    """Integrated in steps of 0.2 ms. With l_f and l_r exchanged (a shift by 15 % of the
    wheelbase), the centre of gravity and the tracked point are twins."""
    numbers = (2,) if way == "swapped" else (0, 3)
    cars = [trial(number, "none").car for number in numbers]
    for number, car, rows in zip(numbers, cars, exact.driven(cars), strict=True):
        found = exact.judged(number, car, rows, way)
        if way != "swapped":
            assert found["status"] == "none", found
            continue
        names = {e for effect, (_, twins) in found["each"].items() for e in (effect, *twins)}
        assert "centre_of_gravity" in names <= {"centre_of_gravity", "tracked_point"}, found


def test_the_command_refuses_wrong_use_and_writes_results(late, tmp_path):
    log, vehicle, _ = late
    command = ["diagnose", log, "--vehicle", vehicle, "--out", tmp_path / "out"]
    bad = {
        (3, "none.csv"): ["--holdout", log.parent / "none.csv"],
        (2, "--rig, --convention with --vehicle"): ["--rig", "rig.toml", "--convention", "iso-w"],
        (2, "--full, --seed with --sim-log"): ["--sim-log", log, "--full", "--seed", "1"],
    }
    for (code, said), more in bad.items():
        done = CliRunner().invoke(app, [*map(str, [*command, *more])])
        assert done.exit_code == code and said in done.stderr


def test_an_unknown_effect_and_a_log_without_windows_are_refused(late):
    log, vehicle, tires = late
    with pytest.raises(UsageError, match="steering_dely"):
        tirefit.diagnose_vehicle([log], vehicle, *tires, without=["steering_dely"])
    with pytest.raises(DataError, match="shorter window"):
        tirefit.diagnose_vehicle([log], vehicle, *tires, window=100.0)
    with pytest.raises(DataError, match="3 windows of 5 s; a diagnosis needs 8"):
        tirefit.diagnose_vehicle([log], vehicle, *tires, window=5.0)


ROWS = Samples(1.1, 0.2, 0.4, 0.3, 0.25, 0.7, 1e4, 2.5, sliding=jnp.array([0.2, 0.1]))
SPEED, ALONG, ACROSS, TURN, TIME, HEADING, WEIGHT, WHEELBASE, _ = ROWS
A = 0.1
OF_AXLES = {
    # id: (number of an axle, its value with the amplitude)
    "lateral_load_transfer": ("friction", 1 - A * ACROSS**2),
    "aerodynamic_load": ("load", 1 + A * (SPEED**2 - 1)),
    "friction_speed": ("friction", 1 - A * (SPEED - 1)),
    "sliding_friction": ("fall", A),
    "friction_drift": ("friction", 1 + A * TIME),
    "drive_force": ("friction", 1 - A * ALONG**2),
}
CHANGED = {
    # id: {number: its value with the amplitude} of each variant, by the formula of the manual
    "steering_ratio": [{"steering.ratio": 1 + A}],
    "steering_offset": [{"steering.offset": A}],
    "steering_delay": [{"steering.delay": A}],
    "steering_lag": [{"steering.lag": A}],
    "steering_play": [{"steering.play": A}],
    "compliance_steer": [{"steering.yields": A}],
    "yaw_inertia": [{"car.inertia": np.exp(A)}],
    "centre_of_gravity": [{"car.l_f": -A * WHEELBASE, "car.l_r": A * WHEELBASE}],
    "front_axle": [{"car.l_f": A * WHEELBASE}],
    "rear_axle": [{"car.l_r": A * WHEELBASE}],
    "longitudinal_load_transfer": [
        {"car.front.load": 1 - 2 * A * ALONG, "car.rear.load": 1 + 2 * A * ALONG}
    ],
    "relaxation_length": [{"car.relaxation": A * WHEELBASE}],
    "yaw_resistance": [{"car.moment": -A * WEIGHT * WHEELBASE**2 * TURN}],
    "bank": [{"car.force": A * WEIGHT}],
    "floor_slope": [
        {"car.force": A * WEIGHT * size * np.sin(towards - HEADING)}
        for size, towards in ((1, 0), (1, np.pi / 2), (0.98995, np.pi / 4), (0.98995, -np.pi / 4))
    ],
    "sideslip_zero": [{"reading.sideslip": A}],
    "yaw_rate_zero": [{"reading.yaw_rate": A}],
    "tracked_point": [{"reading.ahead": A * WHEELBASE}],
} | {
    id: [
        {f"car.{axle}.{name}": value for axle in axles}
        for axles in (("front", "rear"), ("front",), ("rear",))
    ]
    for id, (name, value) in OF_AXLES.items()
}  # fmt: skip


@pytest.mark.parametrize("effect", SIMULATOR_EFFECTS, ids=lambda effect: effect.id)
def test_an_effect_changes_its_number_by_its_formula(effect):
    for constants, changed in zip(effect.variants, CHANGED[effect.id], strict=True):
        for size, right in ((0.0, {}), (A, changed)):
            found = dict(_leaves(effect.change(Setting(), size, constants, ROWS)))
            wanted = dict(_leaves(Setting())) | right
            if effect.id == "sliding_friction":
                wanted |= {"car.front.sliding": 0.2, "car.rear.sliding": 0.1}
            assert {k: float(x) for k, x in found.items()} == pytest.approx(wanted, rel=1e-5)


def _leaves(setting, name=""):
    for key, value in setting._asdict().items():
        if hasattr(value, "_asdict"):
            yield from _leaves(value, f"{name}{key}.")
        else:
            yield f"{name}{key}", value


@pytest.mark.parametrize("spread", [0.01, 1.0])
def test_the_error_of_an_amplitude_is_at_least_that_between_parts(spread):
    """The jackknife gives root(F - 1) times the scatter over F parts."""
    key = ("one",)
    fit = SimpleNamespace(
        key=key, effects=key, amplitude=np.ones(1), errors=np.array([0.2]), z=np.zeros(0)
    )
    each = 1 + spread * np.array([[-1.0], [0.0], [1.0], [0.0]])
    out = SimpleNamespace(sets={key: SimpleNamespace(amplitude=each)})
    weighed = SimpleNamespace(best_of={key: fit}, log_weight={key: 0.0})
    verdict = SimpleNamespace(
        key=key, effects=key, each={"one": SimpleNamespace(probability=1.0, twins=())}
    )
    _, std = Concluded(None, weighed, out, verdict, ()).sizes
    assert std == pytest.approx(max(0.2, np.sqrt(3) * spread * np.sqrt(0.5)))


@pytest.fixture(scope="module")
def errors_of_the_log():
    """A model of errors of the sideslip (0.02 rad), the yaw rate (0.03 rad/s) and the point
    (a tenth of the wheelbase), and its coefficients."""
    sizes = {"sideslip_zero": 0.02, "yaw_rate_zero": 0.03, "tracked_point": 0.1}
    atoms = tuple(Atom(one) for one in CAR_EFFECTS if one.id in sizes)
    scales = tuple(atom.effect.scale for atom in atoms)
    z = np.append(np.zeros(4), np.divide([sizes[atom.effect.id] for atom in atoms], scales))
    return Model(atoms, scales, 2), z


@pytest.mark.parametrize("poses", [False, True])
def test_a_log_is_corrected_for_its_errors(late, tmp_path, errors_of_the_log, poses):
    """Written with errors of the sideslip, the yaw rate and the point."""
    (tmp_path / "poses.toml").write_text(TOML)
    vehicle = load_vehicle(tmp_path / "poses.toml" if poses else late[1])
    v_x, ahead = np.array([2.0, 3.0]), 0.1 * (vehicle.l_f + vehicle.l_r)
    true = {"v_y": np.array([0.3, -0.2]), "yaw_rate": np.array([0.5, 0.8])}
    logged = {
        "v_y": true["v_y"] + 0.02 * v_x + ahead * true["yaw_rate"],
        "yaw_rate": true["yaw_rate"] + 0.03,
    }
    place, heading = np.array([1.0 + 2.0j, -3.0j]), np.array([0.4, -2.0])
    true |= {"heading": heading, "x": place.real, "y": place.imag, "a_y": np.array([1.0, 2.0])}
    moved = place + ahead * np.exp(1j * heading) * poses
    logged |= {"heading": heading - 0.02 * poses, "x": moved.real, "y": moved.imag}
    logged |= {"a_y": true["a_y"]}
    rows = Samples(*[np.zeros(2)] * 6, 1e4, 10 * ahead, np.full(2, 0.1))
    window = Measured(np.zeros(2), v_x, np.zeros(5), logged, rows)
    model, z = errors_of_the_log
    model = model._replace(channels=3 if poses else 2)
    found, _ = with_effects(model, z, window, 0.01)
    for name, right in true.items():
        np.testing.assert_allclose(found.series[name], right, rtol=1e-9, err_msg=name)


def test_effects_applied_to_a_log_depend_on_its_own_motion(late, errors_of_the_log):
    """Over the mean speed and about the middle of the time of the logs that were diagnosed."""
    log, vehicle, tires = late
    vehicle, tires = load_vehicle(vehicle), [axle_tire(one) for one in tires]
    (cut,) = cut_in_windows([log], vehicle, 1.0).values()
    motion, rows = cut.motion, np.arange(200, 240)[None]
    found = Applied(*errors_of_the_log, 7.5).samples(motion, rows, vehicle, tires)
    np.testing.assert_allclose(found.speed, motion.v_x[rows] / 7.5)
    np.testing.assert_allclose(found.across, motion.a_y[rows] / vehicle.gravity)
    np.testing.assert_allclose(found.turn, motion.yaw_rate[rows] / motion.v_x[rows])
    np.testing.assert_array_equal(found.time, 0.0)


def test_what_a_log_has_of_a_state_follows_its_errors():
    """The velocity of a point ahead, turned by a small angle to the left; a larger sideslip
    is a smaller heading."""
    state, error = State(0.3, 0.5, 0.4, 1.0, 2.0), Reading(1e-6, 0.03, 0.25)
    seen = (2.0 + 1j * (0.3 + 0.25 * 0.5)) * np.exp(1e-6j)
    rates = seen_in_log(2, state, error, 2.0)
    np.testing.assert_allclose(rates, [seen.imag, 0.53], rtol=1e-11)
    place = (1 + 2j) + 0.25 * np.exp(0.4j)
    poses = seen_in_log(3, state, error, 2.0)
    np.testing.assert_allclose(poses, [0.4 - 1e-6, place.real, place.imag], rtol=1e-12)
    # A start state, which has no error of the yaw rate, is seen through the same errors.
    error, start = Reading(0.2, 0.0, 0.25), np.array([0.3, 0.5, 0.4, 1.0, 2.0])
    driven = as_driven(start, error, 2.0)
    np.testing.assert_allclose(seen_in_log(2, driven, error, 2.0), start[:2], rtol=1e-12)
    np.testing.assert_allclose(seen_in_log(3, driven, error, 2.0), start[2:], rtol=1e-12)


def test_wheels_turn_by_ratio_and_offset_and_yield_to_the_side_force():
    command, across = np.linspace(-0.2, 0.3, 60), np.linspace(0.5, -0.4, 50)
    of = Steering(ratio=1.2, offset=0.03, yields=0.04)
    found = steered(of, jnp.asarray(command), jnp.asarray(across), 0.01)
    np.testing.assert_allclose(found, 1.2 * command[10:] + 0.03 - 0.04 * across, atol=1e-7)


def test_every_withheld_effect_is_one_of_the_library():
    assert {*LISTED} <= {effect.id for effect in CAR_EFFECTS}


def test_a_delayed_cubic_is_exact():
    time = np.arange(9.0)
    curve = np.poly1d([0.3, -1.0, 0.5, 2.0])
    shifted = delayed(jnp.asarray(curve(time)), 0.3)
    np.testing.assert_allclose(shifted[2:-1], curve(time[2:-1] - 0.3), rtol=1e-12)
    assert float(cubic(0.5, 0.0, 1.0, 0.0, 0.0)) == 0.5


def test_a_lag_of_a_ramp_is_its_time_and_play_holds_still():
    ramp = jnp.asarray(0.01 * np.arange(400.0))
    np.testing.assert_allclose(lagged(ramp, 0.2, 0.01), ramp - 0.2, atol=1e-9)
    np.testing.assert_allclose(lagged(ramp, 0.0, 0.01), ramp)
    wave = np.sin(np.linspace(0, 20, 2000))
    held = np.asarray(with_play(jnp.asarray(wave), 0.3))
    assert np.max(held[400:]) == pytest.approx(0.7, abs=1e-5)
    assert np.abs(held - wave).max() < 0.3 + 1e-6
