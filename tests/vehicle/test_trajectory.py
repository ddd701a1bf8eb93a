"""Fits by trajectory of simulated drives with known tires and unknowns."""

import json
from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp
from scipy.special import stdtrit
from test_car import GRAVITY, INERTIA, L_F, L_R, MASS, TIRES, car, slopes
from test_replay import TOML
from typer.testing import CliRunner

import tirefit
from fits.formulas import brush
from tirefit import fit_trajectory, replay
from tirefit.cli.commands import app
from tirefit.data.read import read_frame
from tirefit.data.vehicle.motion import read_motion, road_wheel
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.models import Brush
from tirefit.results import DataError, Outcome, UsageError
from tirefit.targets.tire import tire_of
from tirefit.vehicle import trajectory
from tirefit.vehicle.shooting import Data
from tirefit.vehicle.trajectory import _Problem
from tirefit.vehicle.windows import CHANNELS, cut_in_windows, derived_rows, lateness

DELAY, OFFSET = 0.06, 0.012  # s, rad
TRUE = {
    "front.cpa2": TIRES["front"][0],
    "front.mu": TIRES["front"][1],
    "rear.cpa2": TIRES["rear"][0],
    "rear.mu": TIRES["rear"][1],
    "steering_delay": DELAY,
    "steering_offset": OFFSET,
}


def steer(time):
    return 0.28 * np.sin(1.7 * time) + 0.12 * np.sin(6.1 * time + 1)


def write_drive(path, turned, logged, seed):
    """Write poses with noise of a car whose wheels are turned so, and the logged angle; returns
    time (n,) and true states (5, n)."""
    time, generator = np.arange(0, 24, 0.01), np.random.default_rng(seed)
    true = solve_ivp(
        slopes,
        (0, time[-1]),
        np.zeros(5),
        t_eval=time,
        rtol=1e-8,
        atol=1e-8,
        max_step=0.01,
        args=[lambda t: 3.0, turned],
    )
    _, _, yaw, x, y = true.y
    noisy = [
        values + std * generator.standard_normal(len(time))
        for values, std in ((x, 1e-3), (y, 1e-3), (yaw, 2e-3))
    ]
    rows = np.stack([time, *noisy, logged(time)], axis=1)
    np.savetxt(path, rows, "%.9g", ",", header="t,x,y,yaw,steer", comments="")
    return time, true.y


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A folder with a vehicle file and a log of poses with noise."""
    folder = tmp_path_factory.mktemp("trajectory")
    (folder / "vehicle.toml").write_text(TOML)
    true = write_drive(folder / "drive.csv", lambda t: steer(t - DELAY) + OFFSET, steer, 3)
    np.savez(folder / "true.npz", *true)
    return folder


@pytest.fixture(scope="module")
def found(drive):
    return fit_trajectory([drive / "drive.csv"], drive / "vehicle.toml")


def test_the_tires_and_the_steering_are_recovered(found):
    assert found.converged and found.windows > 40
    for name, true in TRUE.items():
        one = found.parameters[name]
        assert abs(one.value - true) < 3 * one.std, (name, one)
        assert one.std < 0.1 * true and one.ci95[0] < one.value < one.ci95[1]
        assert one.identified
    # The noise of each channel is that of the log.
    assert found.noise["heading"] == pytest.approx(2e-3, rel=0.15)
    assert found.noise["x"] == pytest.approx(1e-3, rel=0.15)
    text = found.summary()
    assert "steering_delay" in text and "NOT IDENTIFIED" not in text


def stating(drive, delay):
    """The vehicle with a stated delay."""
    vehicle = load_vehicle(drive / "vehicle.toml")
    steering = vehicle.steering.model_copy(update={"delay": delay})
    return vehicle.model_copy(update={"steering": steering})


@pytest.mark.parametrize("gap", [False, True])
def test_the_steering_of_windows_is_as_logged_and_begins_before_the_stated_delay(
    drive, tmp_path, gap
):
    """No window has that of before a gap."""
    head, *rows = (drive / "drive.csv").read_text().splitlines()
    path = tmp_path / "drive.csv"
    path.write_text("\n".join([head, *rows[: 900 if gap else 1000], *rows[1000:]]) + "\n")
    (cut,) = cut_in_windows([path], stating(drive, DELAY), 0.5).values()
    data, rows = cut.windows
    angle = np.asarray(data.steering)
    lead = angle.shape[1] - rows.shape[1]
    time = cut.motion.time[rows[:, :1] + np.arange(-lead, rows.shape[1])]
    np.testing.assert_allclose(angle, steer(time), atol=1e-8)
    assert np.all(time[:, lead] - time[:, 0] > DELAY + 0.28)  # the longest delay that is searched
    assert np.all(np.ptp(time, axis=1) < angle.shape[1] / 100)
    assert np.any((time > 9.05) & (time < 9.95)) != gap


def test_the_error_of_a_start_state_is_stated(drive):
    """The filter has no part in it that matters: it is far above the frequencies of this drive."""
    (cut,) = cut_in_windows([drive / "drive.csv"], stating(drive, DELAY), 0.5).values()
    data, rows = cut.windows
    time, true = np.load(drive / "true.npz").values()
    there = np.array([np.interp(cut.motion.time[rows[:, 0]], time, one) for one in true])
    error = np.sqrt(np.mean((np.asarray(data.start) - there.T) ** 2, axis=0))
    np.testing.assert_allclose(error, data.std[0], rtol=0.35)  # three errors of 46 windows


def test_a_late_steering_is_not_a_reversed_one(tmp_path):
    """So late that the force of the front axle falls with its slip angle as logged."""
    (tmp_path / "vehicle.toml").write_text(TOML)
    vehicle = load_vehicle(tmp_path / "vehicle.toml")

    def quick(time):
        return 0.12 * np.sin(8.0 * time) + 0.08 * np.sin(11.3 * time + 1)

    logs = {}
    for name, late, sign in (("late", 0.2, 1.0), ("reversed", 0.0, -1.0), ("prompt", 0.0, 1.0)):
        log = tmp_path / f"{name}.csv"
        write_drive(log, quick, lambda t, by=late, sign=sign: sign * quick(t + by), 5)
        logs[name] = log
    cut = cut_in_windows([logs["late"]], vehicle, 0.5)
    assert 0.2 <= lateness(cut, vehicle) < 0.28  # the car follows its wheels a little later
    rows = derived_rows(cut, vehicle, "front", lateness(cut, vehicle))
    assert np.corrcoef(rows["alpha"], rows["fy"])[0, 1] > 0.5  # -0.24 of the logged steering
    with pytest.raises(DataError, match="wrong sign"):
        cut_in_windows([logs["reversed"]], vehicle, 0.5)
    (prompt,) = cut_in_windows([logs["prompt"]], vehicle, 0.5).values()
    turned = replace(prompt.motion, command=-prompt.motion.command)
    turned = {"reversed": prompt._replace(motion=turned)}
    assert lateness(turned, vehicle) == 0.0
    with pytest.raises(DataError, match="signs contradict"):
        derived_rows(turned, vehicle, "front", 0.0)


def test_a_window_is_predicted_with_the_unknowns_of_steering_and_log(drive):
    """Against SciPy: delay, ratio and offset of the steering; a larger sideslip is logged as a
    smaller heading."""
    values = {"steering_delay": 0.05, "steering_ratio": 1.1, "steering_offset": 0.01}
    values |= {"sideslip_zero": 0.02}
    vehicle, time, lead = load_vehicle(drive / "vehicle.toml"), np.arange(-20, 51) / 100, 20
    start, speed = np.array([-0.2, 0.5, 0.3, 1.0, 2.0]), np.full(51, 3.0)
    window = Data(speed, steer(time), np.zeros((51, 3)), start, np.ones(5))
    problem = SimpleNamespace(
        vehicle=vehicle,
        steering=vehicle.steering,
        names=CHANNELS[3],
        unknown=lambda z, name, default=0.0: values.get(name, default),
        car=lambda z: car(),
    )
    window = Data(*map(jnp.asarray, window))
    found = _Problem.missed(problem, None, jnp.asarray(start), window, 4)
    given = [lambda t: 3.0, lambda t: 1.1 * steer(t - 0.05) + 0.01]
    begin = start + np.array([-0.02 * 3.0, 0, 0.02, 0, 0])
    true = solve_ivp(slopes, (0, 0.5), begin, t_eval=time[lead:], rtol=1e-9, atol=1e-9, args=given)
    np.testing.assert_allclose(found.T, true.y[2:] - [[0.02], [0], [0]], atol=5e-6)


@pytest.mark.parametrize("poses", [True, False])
def test_the_written_vehicle_undoes_what_was_found(tmp_path, poses):
    """Driving straight ahead, its sensor turned: the car of the written file has no sideslip, and
    its wheels have the angle that was found."""
    zero, time = 0.03, np.arange(0, 4, 0.01)
    columns = {"t": time, "steer": steer(time), "x": 3.0 * time, "y": 0 * time}
    columns |= {"yaw": 0 * time - zero, "vx": 0 * time + 3 * np.cos(zero), "r": 0 * time}
    columns |= {"vy": 0 * time + 3 * np.sin(zero)}
    log, file = tmp_path / "straight.csv", tmp_path / "vehicle.toml"
    np.savetxt(log, np.stack([*columns.values()], axis=1), "%.12g", ",",
               header=",".join(columns), comments="")  # fmt: skip
    rates = 'v_x = "vx"\nv_y = "vy"\nyaw_rate = "r"'
    file.write_text(TOML if poses else TOML.replace('x = "x"\ny = "y"\nyaw = "yaw"', rates))
    vehicle, names = load_vehicle(file), CHANNELS[3 if poses else 2]
    values = {"steering_ratio": 1.2, "steering_offset": 0.01, "steering_delay": 0.06}
    values |= {"sideslip_zero": zero, "yaw_inertia": 0.2}
    found = {name: SimpleNamespace(value=value) for name, value in values.items()}
    problem = SimpleNamespace(
        vehicle=vehicle, steering=vehicle.steering, unknowns=tuple(found), names=names
    )
    written = _Problem.fitted_vehicle(problem, found)
    _, motion, _ = read_motion(str(log), written)
    good = motion.settled
    np.testing.assert_allclose(motion.v_y[good], 0.0, atol=1e-9)
    np.testing.assert_allclose(
        road_wheel(motion, written)[good], 1.2 * steer(motion.time[good] - 0.06) + 0.01, atol=1e-3
    )
    assert written.yaw_inertia == 0.2


def test_the_band_of_the_figure_is_that_of_the_force_on_both_sides_of_the_curve(found):
    """Its standard error by differences of S(12)."""
    alpha = np.array([-0.15, -0.02, 0.05, 0.2])
    for axle in TIRES:
        layout, z, covariance = found.axles[axle].fit
        load, step = found.rows[axle]["fz"][0], 1e-5 * np.eye(2)

        def force(z, layout=layout, load=load):
            cpa2, mu = (float(layout.natural(z)[name]) for name in ("cpa2", "mu"))
            return np.sign(alpha) * brush(np.tan(np.abs(alpha)), load, 3.0, cpa2, mu)

        by = np.array([(force(z + h) - force(z - h)) / 2e-5 for h in step])
        value, half = found.force(axle, alpha)
        std = half / stdtrit(found.blocks - 1, 0.975)
        np.testing.assert_allclose(value, force(z), rtol=1e-9)
        np.testing.assert_allclose(std, np.sqrt(np.sum(by * (covariance @ by), axis=0)), rtol=1e-5)
    axes = found.plot().axes[0]
    (band,) = (one for one in axes.collections if one.get_label() == "95 %")
    (curve,) = (one for one in axes.lines if one.get_label() == "brush")
    x, y = band.get_paths()[0].vertices.T
    for end in (0, -1):
        at, force = (values[end] for values in curve.get_data())
        sides = np.unique(y[np.isclose(x, at)]) - force
        assert sides[0] < 0 < sides[-1] and sides[0] == pytest.approx(-sides[-1], rel=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("stated", [DELAY, 2 * DELAY])
def test_a_stated_delay_does_not_change_the_estimate(drive, found, stated):
    tires = found.axles.values()
    again = fit_trajectory([drive / "drive.csv"], stating(drive, stated), *tires)
    for name in ("steering_delay", "steering_offset"):
        one = found.parameters[name]  # of other windows
        assert again.parameters[name].value == pytest.approx(one.value, abs=2 * one.std)


def test_a_friction_above_all_slip_angles_rests_on_the_shape_of_the_model(found):
    assert found.status == Outcome.SHAPE_DEPENDENT
    rear = found.rows["rear"]
    alpha = np.percentile(np.abs(rear["alpha"]), 99.5)
    cpa2, mu = (found.parameters[f"rear.{name}"].value for name in ("cpa2", "mu"))
    of_full = np.tan(alpha) * 2 * cpa2 / (3 * mu * rear["fz"][0])
    assert found.reached["rear"] == pytest.approx(1 - (1 - of_full) ** 3, rel=1e-6)
    assert f"{100 * found.reached['rear']:.0f} % (rear) of the peak" in " ".join(str(found).split())
    columns = {"alpha": np.linspace(-0.9, 0.9, 100), "v": np.full(100, 3.0)}
    rows = read_frame(columns | {"fy": columns["alpha"], "fz": np.full(100, rear["fz"][0])})
    slid = replace(found, rows={"front": rows, "rear": rows})
    assert slid.status == Outcome.OK and min(slid.reached.values()) > 0.98


def test_profiles_below_the_peak_agree_with_the_covariance_where_the_squares_are_quadratic(found):
    """They are in the stiffness, whose intervals differ by at most 8 % of their half-widths. They
    are not in the friction: more of it than the rows reach changes the forces less and less."""
    reach = stdtrit(found.blocks - 1, 0.975)
    for axle in ("front", "rear"):
        one = found.parameters[f"{axle}.cpa2"]
        half = np.log(one.ci95) - np.log(one.value)
        np.testing.assert_allclose(half, reach * one.std / one.value * np.array([-1, 1]), rtol=0.08)
        one = found.parameters[f"{axle}.mu"]
        low, high = one.value - one.ci95[0], one.ci95[1] - one.value
        assert low < reach * one.std < high < 2 * one.std * reach


@pytest.mark.long
def test_intervals_of_a_more_general_tire_contain_the_truth(drive):
    """A brush is a brush-d whose d is 0. Where the search of a point ended at a bound of d, the
    friction was 0.71 to 0.83 for a true 0.95."""
    found = fit_trajectory([drive / "drive.csv"], drive / "vehicle.toml", "brush-d", "brush-d")
    for axle, (cpa2, mu) in TIRES.items():
        for name, true in (("cpa2", cpa2), ("mu", mu), ("d", 0.0)):
            low, high = found.parameters[f"{axle}.{name}"].ci95
            assert low < true < high, (axle, name, low, high)


@pytest.mark.long
def test_a_friction_far_above_the_slip_angles_has_only_a_lower_end(drive, tmp_path):
    """Steered a tenth as much, the tires reach a quarter of their peak: from these rows the
    friction has no upper end below that of the model (5), and a lower end below the truth."""

    def gently(time):
        return 0.1 * steer(time)

    path = tmp_path / "gentle.csv"
    write_drive(path, gently, gently, 5)
    found = fit_trajectory([path], drive / "vehicle.toml")
    assert max(found.reached.values()) < 0.5
    for axle, (_, mu) in TIRES.items():
        one = found.parameters[f"{axle}.mu"]
        assert not one.identified and one.ci95[0] < mu < one.ci95[1] == 5.0, one


@pytest.mark.long
def test_an_unknown_far_from_its_usual_value_is_a_systematic_misfit(found, drive, tmp_path):
    """A steering sensor that is off by 20 degrees."""
    assert found.strained == ()
    head, *rows = (drive / "drive.csv").read_text().splitlines()
    cells = np.array([row.split(",") for row in rows[:800]], float)
    cells[:, 4] -= 0.35
    path = tmp_path / "off.csv"
    np.savetxt(path, cells, "%.9g", ",", header=head, comments="")
    off = fit_trajectory([path], drive / "vehicle.toml", *found.axles.values())
    one = off.parameters["steering_offset"]
    assert abs(one.value - OFFSET - 0.35) < 3 * one.std < 0.02
    assert off.strained == ("steering_offset",) and off.status == Outcome.SYSTEMATIC_MISFIT
    assert "steering_offset far from any usual value" in " ".join(off.summary().split())


def test_the_saved_fit_predicts_the_log(found, drive, tmp_path):
    names = {path.name for path in found.save(tmp_path)}
    assert names == {"front.json", "rear.json", "vehicle.toml", "trajectory.json"}
    saved = (tmp_path / f"{axle}.json" for axle in ("front", "rear"))
    again = replay([drive / "drive.csv"], tmp_path / "vehicle.toml", *saved, horizons=(0.5,))
    assert again.logs == {"drive": True}
    true = (Brush(cpa2=cpa2, mu=mu) for cpa2, mu in TIRES.values())
    steering = {"delay": DELAY, "angle": [-1 + OFFSET, 1 + OFFSET]}
    vehicle = load_vehicle(drive / "vehicle.toml")
    known = vehicle.steering.model_copy(update=steering)
    vehicle = vehicle.model_copy(update={"steering": known})
    best = replay([drive / "drive.csv"], vehicle, *true, horizons=(0.5,))
    for name in ("yaw_rate", "lateral"):
        own, least = (r.models["tire"].rms()[name][0] for r in (again, best))
        assert own < 1.1 * least, name


def test_the_answer_begins_with_what_a_replay_of_the_logs_concludes(found, drive, monkeypatch):
    """The same logs, with the fitted car and its tires."""
    replayed = []

    def concluding(*given):
        replayed.append(given)
        return SimpleNamespace(conclusions=["The tires predict worse."])

    monkeypatch.setattr(trajectory, "replay", concluding)
    monkeypatch.setattr(trajectory._Problem, "solved", lambda *_: found)
    logs, tires = [drive / "drive.csv"], [*found.axles.values()]
    worse = fit_trajectory(logs, drive / "vehicle.toml", *tires)
    ((again, car, *axles),) = replayed
    assert again == logs and car is found.vehicle
    assert all(one is other for one, other in zip(axles, tires, strict=True))
    assert str(worse).split("ANSWER\n")[1].strip().startswith("The tires predict worse.")
    assert worse.to_dict()["conclusions"] == ["The tires predict worse."]


def test_the_saved_fit_is_accepted_by_the_other_commands(found, tmp_path):
    found.save(tmp_path)
    alpha = np.linspace(-0.2, 0.2, 9)
    load = MASS * GRAVITY * L_R / (L_F + L_R)
    rows = {"alpha": alpha, "fz": np.full(9, load), "v": np.full(9, 3.0)}
    predicted = tirefit.predict(
        tirefit.load_fit(tmp_path / "front.json"), tirefit.read_frame(rows, forces=False)
    )
    cpa2, mu = (found.parameters[f"front.{name}"].value for name in ("cpa2", "mu"))
    force = np.sign(alpha) * [brush(np.tan(abs(a)), load, 3.0, cpa2, mu) for a in alpha]
    np.testing.assert_allclose(predicted["fy"], force, rtol=1e-9, atol=1e-9)
    assert tire_of(tmp_path / "front.json").spread["mu"] > 0


@pytest.mark.long
def test_the_inertia_is_found(drive):
    vehicle = load_vehicle(drive / "vehicle.toml")
    found = fit_trajectory(
        [drive / "drive.csv"],
        vehicle.model_copy(update={"yaw_inertia": 1.3 * INERTIA}),
        unknowns=("steering_delay", "steering_offset", "yaw_inertia"),
    )
    inertia = found.parameters["yaw_inertia"]
    assert abs(inertia.value - INERTIA) < 3 * inertia.std < 0.5 * INERTIA
    assert found.vehicle.yaw_inertia == inertia.value


def test_the_command_writes_files_that_other_commands_read(drive, tmp_path):
    line = [
        "fit", f"{drive}/drive.csv", "--vehicle", str(drive / "vehicle.toml"),
        "--model", "front=brush,rear=brush", "--out", str(tmp_path / "out"), "--html",
    ]  # fmt: skip
    done = CliRunner().invoke(app, line)
    assert "FIT BY TRAJECTORY" in (tmp_path / "out" / "trajectory.html").read_text()
    assert done.exit_code == 6 and "FIT BY TRAJECTORY: front brush, rear brush" in done.stdout
    content = json.loads((tmp_path / "out" / "trajectory.json").read_text())
    assert content["schema"] == "tirefit.trajectory/1"
    assert set(content["parameters"]) == set(TRUE)
    assert (tmp_path / "out" / "trajectory.png").stat().st_size > 10_000
    line_of = ["export", f"{tmp_path}/out/trajectory.json", "--to", "autoware"]
    done = CliRunner().invoke(app, [*line_of, "--out", f"{tmp_path}/car.yaml"])
    of_autoware = yaml.safe_load((tmp_path / "car.yaml").read_text())["/**"]["ros__parameters"]
    delay, bias = (content["parameters"][f"steering_{n}"]["value"] for n in ("delay", "offset"))
    assert of_autoware["steer_time_delay"] == pytest.approx(delay)
    assert of_autoware["steer_bias"] == pytest.approx(-bias)
    bad = CliRunner().invoke(app, [*line, "--joint", "--slip", "s"])
    assert bad.exit_code == 2 and "--joint, --slip with --vehicle" in bad.stderr
    bad = CliRunner().invoke(app, [*line[:2], "--window", "1"])
    assert bad.exit_code == 2 and "without --vehicle" in bad.stderr


def test_an_interrupted_fit_says_where_it_stood(drive, tmp_path, monkeypatch):
    def stopped(*given, progress, **how):
        progress(0.5, "search 2 of 3")
        raise KeyboardInterrupt

    monkeypatch.setattr(trajectory, "fit_trajectory", stopped)
    out = tmp_path / "out"
    car = str(drive / "vehicle.toml")
    line = ["fit", f"{drive}/drive.csv", "--vehicle", car, "--out", str(out)]
    done = CliRunner().invoke(app, line)
    assert done.exit_code == 130 and not out.exists()
    assert done.stderr.startswith("fit: 1 %, loading")


def test_wrong_requests_are_refused(drive):
    given = [drive / "drive.csv"], drive / "vehicle.toml"
    with pytest.raises(UsageError, match="the front tire Brush has no free parameters"):
        fit_trajectory(*given, Brush())
    with pytest.raises(UsageError, match="(?s)no unknown of a car.*steering_delay"):
        fit_trajectory(*given, unknowns=["steering_dela"])
    with pytest.raises(DataError, match="no stretch above 1 m/s is 60 s long"):
        fit_trajectory(*given, window=60.0)
