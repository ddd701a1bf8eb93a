"""Replays of logs of a known car."""

import io
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_car import GRAVITY, INERTIA, L_F, L_R, MASS, TIRES, slopes
from typer.testing import CliRunner

import tirefit
from tirefit.cli.commands import app
from tirefit.data.tir.tir import read_tir
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.fitting.source import axle_tire
from tirefit.fitting.tir import tire_of
from tirefit.models import Brush, TireInputs
from tirefit.report.vehicle import replay_text
from tirefit.results import DataError, UsageError
from tirefit.vehicle import replay as module
from tirefit.vehicle.errors import QUANTITIES, Errors, Measured, errors_without_slip, integrated
from tirefit.vehicle.replay import EVERY, HORIZONS, replay
from tirefit.vehicle.windows import cut_in_windows

FRONT, REAR = (Brush(cpa2=cpa2, mu=mu) for cpa2, mu in TIRES.values())
ROOT = Path(__file__).parents[2]
LATE = 0.08  # s
TOML = f"""
mass = {MASS}
l_f = {L_F}
l_r = {L_R}
yaw_inertia = {INERTIA}
gravity = {GRAVITY}
[columns]
time = "t"
x = "x"
y = "y"
yaw = "yaw"
steering = "steer"
[steering]
command = [-1.0, 1.0]
angle = [-1.0, 1.0]
[filter]
cutoff = 15.0
sample_rate = 100.0
[keep]
v_min = 1.0
"""


def steer(time):
    return 0.1 * np.sin(2.0 * time) + 0.04 * np.sin(5.1 * time)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A vehicle file, and logs of a car with immediate and with delayed steering."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "vehicle.toml").write_text(TOML)
    time = np.arange(0, 14, 0.01)
    for name, delay in (("exact", 0.0), ("late", LATE)):
        true = solve_ivp(
            slopes,
            (0, time[-1]),
            np.zeros(5),
            t_eval=time,
            rtol=1e-9,
            atol=1e-9,
            max_step=0.01,
            args=[lambda t: 2.5, lambda t, d=delay: steer(t - d)],
        )
        _, _, yaw, x, y = true.y
        rows = np.stack([time, x, y, yaw, steer(time)], axis=1)
        np.savetxt(folder / f"{name}.csv", rows, "%.9g", ",", header="t,x,y,yaw,steer", comments="")
    return folder


@pytest.fixture(scope="module")
def exact(drive):
    return replay([drive / "exact.csv"], drive / "vehicle.toml", FRONT, REAR)


def test_the_true_car_predicts_its_log(exact):
    rms = exact.models["tire"].rms()
    # The filter takes a little of the fastest steering.
    assert max(rms["yaw_rate"]) < 0.01 and max(rms["sideslip"]) < 0.002
    assert rms["lateral"][2] < 0.005 and rms["a_y"][2] < 0.05
    linear, without = (exact.models[m].rms() for m in ("linear tire", "no slip"))
    assert without["lateral"][2] > linear["lateral"][2] > 5 * rms["lateral"][2]
    assert exact.horizons == HORIZONS and list(rms) == list(QUANTITIES)
    # 14 s, 0.1 s lost at either end, a start every quarter of a second.
    assert exact.windows == (55, 54, 52, 48, 36)


def test_what_keep_excludes_is_neither_replayed_nor_fitted(drive, exact, tmp_path):
    """Two seconds pushed by hand with the wheels turned, and a jump of the motion tracking."""
    rows = np.loadtxt(drive / "exact.csv", delimiter=",", skiprows=1)
    driven = (rows[:, 0] < 5) | (rows[:, 0] > 7)
    rows[~driven, 4] -= 0.2
    rows[1000, 2] += 0.05
    log, vehicle = tmp_path / "exact.csv", tmp_path / "vehicle.toml"
    rows = np.column_stack([rows, driven])
    np.savetxt(log, rows, "%.9g", ",", header="t,x,y,yaw,steer,on", comments="")
    vehicle.write_text(TOML + "margin = 0.1\n")
    worst = replay([log], vehicle, FRONT, REAR).models["tire"].rms()["yaw_rate"][0]
    vehicle.write_text(TOML + 'margin = 0.1\nactive = "on"\na_y_max = 12\n')
    kept = replay([log], vehicle, FRONT, REAR)
    assert worst > 0.1 > 0.01 > kept.models["tire"].rms()["yaw_rate"][0]
    assert kept.windows[0] < exact.windows[0] - 8
    notes = " ".join(kept.notes)
    assert "2.01 s are left out as not active" in notes and "near |a_y| above 12 m/s2" in notes
    (cut,) = cut_in_windows([log], load_vehicle(vehicle), 0.5).values()
    time = cut.motion.time[cut.windows[1]]
    assert not np.any((time > 5) & (time < 7)) and not np.any(np.abs(time - 10) < 0.1)


def test_rates_of_a_drifting_circle_are_integrated_to_its_path():
    """Sideways at half of the speed ahead; to the trapezoidal rule at 100 Hz."""
    time, speed, turn = np.arange(0, 3, 0.01), 2.0 + 1.0j, 0.8
    even = (np.full(len(time), value) for value in (turn, speed.real, speed.imag))
    heading, x, y = integrated(*even, 100.0)
    np.testing.assert_allclose(heading, turn * time, atol=1e-12)
    path = speed * (np.exp(1j * turn * time) - 1) / (1j * turn)
    np.testing.assert_allclose(x + 1j * y, path, atol=1e-4)


def test_a_wrong_steering_ratio_is_seen_in_the_turning(drive, exact):
    """Of a car without slip, r = v tan(delta) / L: a map that reads .8 of the angle gives
    1.25 times the predicted yaw rate, but for the bend of the tangent (2 %)."""
    ratio, error = exact.turning
    assert ratio == pytest.approx(1.0, abs=0.005) and error < 0.01 and exact.conclusions == []
    toml = drive / "less.toml"
    toml.write_text(TOML.replace("angle = [-1.0, 1.0]", "angle = [-0.8, 0.8]"))
    stiff = Brush(cpa2=1e7, mu=10.0)
    found = replay([drive / "exact.csv"], toml, stiff, stiff, horizons=(0.5,))
    log = np.loadtxt(drive / "exact.csv", delimiter=",", skiprows=1)
    yaw, wheel = np.gradient(log[:, 3], log[:, 0]), 2.5 * np.tan(0.8 * log[:, 4]) / (L_F + L_R)
    expected = (yaw @ wheel) / (wheel @ wheel)
    assert found.turning[0] == pytest.approx(expected, rel=0.03)
    limits, turned = found.conclusions
    assert limits == "The tires are not what limits: a car without slip predicts as well."
    assert turned.startswith(f"The car turns {found.turning[0]:.2f} ± ")
    assert limits in " ".join(replay_text(found).split())


def test_linear_tires_that_predict_as_well_are_said(exact):
    """The same error of both, above that of the noise."""
    tire = exact.models["tire"]
    models = dict(exact.models) | {
        "tire": exact.models["linear tire"],
        "floor": Errors({name: 0.1 * values for name, values in tire.of.items()}),
    }
    (said,) = replace(exact, models=models).conclusions
    assert said == "The tires' bend is not what limits: linear tires predict as well."


@pytest.mark.parametrize(
    ("worse", "said"), [("tire", "The tires predict worse"), ("with the effects", "The effects")]
)
def test_what_predicts_worse_is_said_first(exact, worse, said):
    """After one second these tires, or the effects, miss the yaw rate by three times as much;
    by 4 % more is as well."""
    generator = np.random.default_rng(1)
    missed = {k: generator.standard_normal(v.shape) for k, v in exact.models["tire"].of.items()}
    models = dict(exact.models) | dict.fromkeys(("tire", "linear tire", worse), Errors(missed))
    for model, size in (("floor", 0.1), ("no slip", 10.0)):
        models[model] = Errors({name: size * values for name, values in missed.items()})
    for factor in (1.04, 3.0):
        far = missed["yaw_rate"] * np.array([1.0, 1.0, factor, 1.0, 1.0])
        models[worse] = Errors(missed | {"yaw_rate": far})
        first, *others = replace(exact, models=models).conclusions
        assert first.startswith(said) is (factor > 2)
        assert not first.startswith("The tires") or not any("bend" in text for text in others)
    wrong, less = (np.sqrt(np.mean(x[:, 2] ** 2)) for x in (far, missed["yaw_rate"]))
    assert f"the yaw rate after 1 s by {wrong:.2g} rad/s instead of {less:.2g}" in first


def test_a_steering_delay_is_detected_and_can_be_declared(drive):
    given = [drive / "late.csv"], drive / "vehicle.toml", FRONT, REAR
    found = replay(*given, horizons=(0.5,))
    as_logged, (fan,) = found.models["tire"].rms(), found.fans.values()
    ahead, behind = (one["x"] + 1j * one["y"] for one in (fan.predicted, fan.measured))
    across = ((ahead - behind) * np.exp(-1j * fan.measured["heading"])).imag[:, 50]
    np.testing.assert_allclose(found.models["tire"].of["lateral"][:, 0], across, atol=1e-9)
    toml = drive / "late.toml"
    toml.write_text(TOML.replace("[filter]", f"delay = {LATE}\n[filter]"))
    stated = replay(given[0], toml, *given[2:], horizons=(0.5,)).models["tire"].rms()
    assert stated["yaw_rate"][0] < 0.2 * as_logged["yaw_rate"][0]
    assert stated["lateral"][0] < 0.2 * as_logged["lateral"][0]


@pytest.mark.long
def test_a_log_to_which_the_tires_were_fitted_is_named(drive):
    """Tires fitted to the derived axles of the same log."""
    fits = []
    for axle in ("front", "rear"):
        out = drive / f"{axle}.csv"
        tirefit.derive_files([drive / "exact.csv"], drive / "vehicle.toml", out, axle)
        fits.append(tirefit.fit(tirefit.read(out), "brush"))
    logs = [drive / "exact.csv", drive / "late.csv"]
    found = replay(logs, drive / "vehicle.toml", *fits, horizons=(0.5,))
    assert found.logs == {"exact": True, "late": False}


def test_the_command_writes_numbers_and_figure(drive, tmp_path):
    line = [
        "replay", str(drive / "exact.csv"),
        "--vehicle", str(drive / "vehicle.toml"), "--front", "brush", "--rear", "brush",
        "--horizon", "0.5", "--html", "--out", str(tmp_path / "out"),
    ]  # fmt: skip
    done = CliRunner().invoke(app, line)
    assert (
        done.exit_code == 0
        and "0.5 s after a start, the predicted car has an rms error of" in done.stdout
    )
    assert done.stderr.startswith("replay: 17 %, reading logs")  # at once
    content = json.loads((tmp_path / "out" / "replay.json").read_text())
    assert content["schema"] == "tirefit.replay/1" and content["horizons"] == [0.5]
    assert set(content["rms"]) == {"tire", "linear tire", "no slip", "floor"}
    for name in ("replay.png", "series.png"):
        assert (tmp_path / "out" / name).stat().st_size > 10_000
    page = (tmp_path / "out" / "replay.html").read_text()
    assert page.count("data:image/png;base64,") == 5 and "http:" not in page
    assert "0.5 s after a start, the predicted car has an rms error of" in page


def test_the_error_of_the_true_car_is_the_noise_floor(drive, tmp_path):
    log = np.loadtxt(drive / "exact.csv", delimiter=",", skiprows=1)
    generator = np.random.default_rng(5)
    log[:, 1:4] += [2e-3, 2e-3, 4e-3] * generator.standard_normal((len(log), 3))
    noisy = tmp_path / "noisy.csv"
    np.savetxt(noisy, log, "%.9g", ",", header="t,x,y,yaw,steer", comments="")
    found = replay([noisy], drive / "vehicle.toml", FRONT, REAR)
    tire, floor = (found.models[name].rms() for name in ("tire", "floor"))
    for name in QUANTITIES:
        # 36 windows at 5 s, which overlap: a rms of some twenty independent numbers.
        np.testing.assert_allclose(tire[name], floor[name], rtol=0.35, err_msg=name)


def test_the_axle_of_a_tir_file_has_two_tires():
    path = ROOT / "tests/data/tir/mfeval_julia/MagicFormula61_Parameters.tir"
    alpha, fz, v = 0.05, 6000.0, 20.0

    def one(slip):
        columns = {"alpha": [slip], "fz": [fz / 2], "v": [v]}
        data = tirefit.read_frame(columns, forces=False)
        return tirefit.predict(tire_of(read_tir(path)), data)["fy"][0]

    found = axle_tire(path).tire(TireInputs(alpha=alpha, fz=fz, v=v)).fy
    # The other tire is the mirror image: its force is that of the reverse slip.
    assert one(alpha) != pytest.approx(-one(-alpha), rel=1e-3)
    assert float(found) == pytest.approx(one(alpha) - one(-alpha), rel=1e-9)


def messages(content):
    """Topic -> times [s], and values by name, as the library reads them."""
    reader = pytest.importorskip("mcap.reader")
    found = {}
    for schema, channel, message in reader.make_reader(io.BytesIO(content)).iter_messages():
        assert schema.encoding == "jsonschema" and channel.message_encoding == "json"
        values = json.loads(message.data)
        assert set(values) <= set(json.loads(schema.data)["properties"])
        found.setdefault(channel.topic, []).append({"t": message.log_time / 1e9, **values})
    return {
        topic: {key: np.array([row[key] for row in rows]) for key in rows[0]}
        for topic, rows in found.items()
    }


def test_the_channels_of_mcap_are_the_log_and_have_the_errors_of_the_replay(drive, tmp_path):
    """Predicted less measured at the same time has the rms of the replay, which is of a linear
    tire here, so that it is no rounding. The stamps are absolute, as those of the log."""
    head, *rows = (drive / "exact.csv").read_text().splitlines()
    log = np.array([row.split(",") for row in rows], float)
    log[:, 0] += 1.7e9
    path = tmp_path / "exact.csv"
    np.savetxt(path, log, "%.17g", ",", header=head, comments="")
    weak = Brush(cpa2=0.7 * FRONT.cpa2, mu=FRONT.mu)
    result = replay([path], drive / "vehicle.toml", weak, REAR)
    found = messages(result.to_mcap())
    measured = found.pop("/exact/measured")
    for k, name in ((1, "x_m"), (2, "y_m"), (3, "heading_rad")):
        np.testing.assert_allclose(
            measured[name], np.interp(measured["t"], log[:, 0], log[:, k]), atol=0.01
        )
    rms = result.models["tire"].rms()
    assert [*found] == [f"/exact/predicted_{1000 * h:.0f}_ms_ahead" for h in HORIZONS]
    units = {"yaw_rate": "rad_per_s", "a_y": "m_per_s2", "heading": "rad"}
    for k, (topic, one) in enumerate(found.items()):
        assert len(one["t"]) == result.windows[k]
        for name, unit in units.items():
            at = np.searchsorted(measured["t"], one["t"] - 1e-6)
            missed = one[f"{name}_{unit}"] - measured[f"{name}_{unit}"][at]
            assert np.sqrt(np.mean(missed**2)) == pytest.approx(rms[name][k], rel=1e-6), topic
    assert rms["yaw_rate"][2] > 0.02


def test_the_command_writes_mcap_and_replaces_only_its_own(drive, tmp_path, monkeypatch):
    pytest.importorskip("mcap")
    out = tmp_path / "made" / "lap.mcap"
    line = ["replay", f"{drive}/exact.csv", "--vehicle", f"{drive}/vehicle.toml"]
    line += ["--front", "brush", "--rear", "brush", "--horizon", "0.5", "--out", str(tmp_path)]
    for _ in range(2):
        done = CliRunner().invoke(app, [*line, "--mcap", str(out)])
        assert done.exit_code == 0 and f"wrote {out}" in done.stdout
    assert "/exact/predicted_500_ms_ahead" in messages(out.read_bytes())
    other = tmp_path / "other.mcap"
    other.write_bytes(b"a recording")
    for file, code, said in ((other, 3, "did not write it"), (drive / "exact.csv", 2, ".mcap")):
        done = CliRunner().invoke(app, [*line, "--mcap", str(file)])
        assert done.exit_code == code and said in done.stderr
    assert other.read_bytes() == b"a recording"
    monkeypatch.setitem(sys.modules, "mcap", None)
    done = CliRunner().invoke(app, [*line, "--mcap", str(out)])
    assert done.exit_code == 2 and "pip install 'tirefit[logs]'" in done.stderr


def test_wrong_requests_are_refused(drive):
    log, toml = drive / "exact.csv", drive / "vehicle.toml"
    with pytest.raises(DataError, match="no stretch above 1 m/s is as long"):
        replay([log], toml, FRONT, REAR, horizons=(60.0,))
    with pytest.raises(UsageError, match="nosuch"):
        replay([log], toml, "nosuch", REAR)


def test_a_log_in_another_unit_is_refused_as_derive_does(drive, tmp_path):
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(TOML.replace("[filter]", '[units]\nyaw = "deg"\n[filter]'))
    with pytest.raises(DataError) as by_derive:
        tirefit.derive_files([drive / "exact.csv"], wrong, tmp_path / "axle.csv")
    with pytest.raises(DataError) as error:
        replay([drive / "exact.csv"], wrong, FRONT, REAR)
    found, known = (one.value.problems for one in (error, by_derive))
    assert [one.reason for one in found] == [one.reason for one in known]
    # The remedy of derive, less its option, which replay does not have.
    for one, other in zip(found, known, strict=True):
        assert "--" in other.remedy and "--" not in one.remedy
        assert one.remedy and other.remedy.startswith(one.remedy)


def test_a_tire_without_a_steady_lateral_force_is_refused(drive):
    given = [drive / "exact.csv"], drive / "vehicle.toml"
    with pytest.raises(UsageError, match="brush-relaxation has no lateral force in"):
        replay(*given, FRONT, "brush-relaxation")


def test_a_horizon_longer_than_every_stretch_gives_no_number(drive, tmp_path):
    log, toml = tmp_path / "short.csv", drive / "vehicle.toml"
    lines = (drive / "exact.csv").read_text().splitlines()
    log.write_text("\n".join(lines[:301]))  # 3 s
    found = replay([log], toml, FRONT, REAR, horizons=(0.5, 4.0))
    assert found.windows[1] == 0 and found.models["tire"].rms()["heading"][1] is None
    assert "0.5 s after a start, the predicted car" in replay_text(found)
    json.loads(found.to_json(), parse_constant=pytest.fail)  # no NaN


def test_a_long_log_has_fewer_starts_evenly_spread(drive, exact, monkeypatch):
    monkeypatch.setattr(module, "_MOST", 11)
    given = [drive / "exact.csv"], drive / "vehicle.toml", FRONT, REAR
    few = replay(*given, horizons=(0.25,)).fans["exact"].time[:, 0]
    (every,) = (fan.time[:, 0] for fan in exact.fans.values())
    assert len(few) == 11 and (few[0], few[-1]) == (every[0], every[-1]) and {*few} <= {*every}
    assert np.ptp(np.diff(few)) <= EVERY + 1e-9


def test_all_problems_of_a_replay_are_reported_at_once(drive):
    toml, missing = drive / "vehicle.toml", drive / "missing.csv"
    bare = drive / "bare.toml"
    bare.write_text(TOML.split("[steering]")[0].replace('steering = "steer"\n', ""))
    with pytest.raises(UsageError, match="(?s)needs the road wheel angle.*horizons 2, 1 do not"):
        replay([missing], bare, FRONT, REAR, horizons=(2, 1))
    with pytest.raises(UsageError, match="two logs are named 'exact'"):
        replay([drive / "exact.csv"] * 2, toml, FRONT, REAR)
    with pytest.raises(UsageError, match="no log given"):
        replay([], toml, FRONT, REAR)
    with pytest.raises(DataError) as error:
        replay([missing, drive / "other.csv"], toml, FRONT, REAR)
    assert len(error.value.problems) == 2


def test_a_car_without_slip_drives_a_circle():
    """The rear axle moves along its own heading, about a centre on its line."""
    time, v_x, angle, l_f, l_r = np.arange(101) / 100.0, 2.0, 0.2, 0.2, 0.15
    turn = v_x * np.tan(angle) / (l_f + l_r)
    heading, radius = 0.3 + turn * time, v_x / turn
    x = radius * np.sin(heading) + l_r * np.cos(heading)
    y = -radius * np.cos(heading) + l_r * np.sin(heading)
    even = {"v_y": l_r * turn, "yaw_rate": turn, "a_y": v_x * turn}
    series = {name: np.full((1, 101), value) for name, value in even.items()}
    series |= {"heading": heading[None], "x": x[None], "y": y[None]}
    windows = Measured(time[None], np.full((1, 101), v_x), np.full((1, 105), angle), series)
    car = SimpleNamespace(l_f=l_f, l_r=l_r, filter=SimpleNamespace(sample_rate=100.0))
    missed = errors_without_slip(car, windows, [50, 100])
    for values in missed.of.values():
        np.testing.assert_allclose(values, 0.0, atol=2e-4)
