"""The drive force of a derived file, and the stated properties of its vehicle."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from test_derive import rates_log
from test_motion import (
    CAR,
    INERTIA,
    KEEP,
    L_R,
    MASS,
    POSE,
    RATES,
    WHEELBASE,
    pose_log,
    pose_vehicle,
    steer,
    vehicle,
    write_log,
)

from tirefit.data.read import read
from tirefit.data.vehicle.derive import derive, derive_files
from tirefit.data.vehicle.findings import findings, found_in
from tirefit.results import UsageError

STEERED = "[steering]\ncommand = [-1, 1]\nangle = [-1, 1]\n"


def steered_car(tmp_path, before="", clock=0.0):
    """A vehicle whose log has the road wheel angle, logged early by ``clock`` [s]."""
    columns = rates_log()
    columns["command"] = steer(columns["t"] + clock)
    text = before + CAR + RATES + 'steering = "command"\n' + KEEP + STEERED
    return write_log(tmp_path / "a.csv", columns), vehicle(tmp_path, text)


@pytest.mark.parametrize(
    ("stated", "rear", "drag"),
    [
        ('driven = "rear"\n', 1.0, 0.0),
        ('driven = "front"\ndrag = 0.4\n', 0.0, 0.4),
        ('driven = "all"\nrear_share = 0.7\ndrag = 0.2\n', 0.7, 0.2),
        ('driven = "all"\n', 0.5, 0.0),
    ],
)
def test_forces_of_both_axles_balance_the_acceleration(tmp_path, stated, rear, drag):
    """Newton along and across the body, and the distribution over the axles."""
    path, car = steered_car(tmp_path, stated)
    back, front = (derive(path, car, axle).columns for axle in ("rear", "front"))
    time = np.intersect1d(back["time"], front["time"])
    back, front = (
        {name: x[np.isin(of["time"], time)] for name, x in of.items()} for of in (back, front)
    )
    none = np.zeros(len(time))
    # Canonical forces: fx > 0 brakes, fy > 0 acts to the right.
    push = {"rear": -back.get("fx", none), "front": -front.get("fx", none)}
    delta, v_x = back["steering"], back["v"]
    along = push["rear"] + push["front"] * np.cos(delta) + front["fy"] * np.sin(delta)
    needed = MASS * back["a_x"] + drag * v_x**2
    np.testing.assert_allclose(along, needed, atol=1e-9)
    left = push["front"] * np.sin(delta) - front["fy"] * np.cos(delta)
    across = (MASS * L_R * back["a_y"] + INERTIA * back["yaw_acceleration"]) / WHEELBASE
    np.testing.assert_allclose(left, across, atol=1e-9)
    total = push["rear"] + push["front"]
    np.testing.assert_allclose(push["rear"], rear * total, atol=1e-9)
    assert np.std(total) > 0.1


def test_an_undriven_axle_has_no_longitudinal_force(tmp_path):
    path, car = steered_car(tmp_path, 'driven = "rear"\n')
    assert "fx" in derive(path, car).columns
    front = derive(path, car, "front")
    assert not {"fx", "fx_std"} & set(front.columns)
    assert "the front axle neither drives nor brakes" in front.assumptions
    path, car = steered_car(tmp_path)
    assert "fx" not in derive(path, car).columns


def test_the_error_of_the_drive_force_states_its_assumption(tmp_path):
    """Rolling resistance and 30 % of the braking force, 5 % of the driving force."""
    for drag, rolling in (("", 0.02), ("drag = 0.1\n", 0.005)):
        path, car = steered_car(tmp_path, f'driven = "rear"\n{drag}')
        found = derive(path, car).columns
        known = rolling * MASS * 9.80665
        share = np.where(found["fx"] > 0, 0.3, 0.05)
        np.testing.assert_allclose(found["fx_std"], np.hypot(share * found["fx"], known))
    # Half of an unknown split is known to 0.15 of the whole.
    path, car = steered_car(tmp_path, 'driven = "all"\ndrag = 0.1\n')
    assumed = derive(path, car)
    np.testing.assert_allclose(
        assumed.columns["fx_std"], np.hypot(0.3 * assumed.columns["fx"], known)
    )
    assert any("no rear_share" in said for said in assumed.assumptions)


def test_a_drive_share_with_one_driven_axle_is_refused(tmp_path):
    with pytest.raises(UsageError, match="rear_share applies to driven"):
        steered_car(tmp_path, 'driven = "front"\nrear_share = 0.5\n')
    with pytest.raises(UsageError, match="driven"):
        steered_car(tmp_path, 'driven = "both"\n')


def test_derived_files_state_the_known_properties_of_the_vehicle(tmp_path):
    def constants(log, settings):
        done = derive_files([log], tmp_path / "vehicle.toml", tmp_path / "axle.csv")
        return read(done.data).source.constants

    log = write_log(tmp_path / "a.csv", pose_log())
    posed = constants(log, pose_vehicle(tmp_path, "wheel_radius = 0.03\n"))
    assert posed["tracked_point"] == 0.115 and posed["wheel_radius"] == 0.03
    assert posed["wheelbase"] == WHEELBASE and posed["yaw_inertia"] == INERTIA
    assert posed["clock"] == 0.005  # one instrument
    log = write_log(tmp_path / "a.csv", rates_log())
    bare = CAR.replace("tracked_point", "# tracked_point")
    rates = constants(log, vehicle(tmp_path, bare + RATES + KEEP))
    assert not {"tracked_point", "clock", "wheel_radius"} & set(rates)
    timed = constants(log, vehicle(tmp_path, "clock = 0.02\n" + bare + RATES + KEEP))
    assert timed["clock"] == 0.02


def test_derived_files_contain_the_estimates_of_their_logs(tmp_path):
    """A heading off by 10 mrad, a point off by 20 mm, steering logged early."""
    columns = pose_log()
    columns["psi"] = columns["psi"] - 0.01
    log = write_log(tmp_path / "a.csv", columns)
    text = CAR.replace(f"[{0.115}", "[0.095") + POSE + KEEP
    vehicle(tmp_path, text)
    done = derive_files([log], tmp_path / "vehicle.toml", tmp_path / "axle.csv")
    found = read(done.data).source.constants
    assert found["alpha_zero"] == pytest.approx(0.01, abs=1e-3)
    off = found["found_point"] - 0.115
    assert abs(off) < 4 * found["found_point_std"] < 0.04
    companion = json.loads(done.metadata.read_text())
    assert companion["found"]["alpha_zero"] == pytest.approx(found["alpha_zero"], 1e-3)
    assert companion["runs"][0]["alpha_zero"] == done.logs[0].zero
    log, _ = steered_car(tmp_path, clock=0.1)
    done = derive_files([log], tmp_path / "vehicle.toml", tmp_path / "axle.csv")
    late = read(done.data).source.constants
    # The curvature of the path follows the tires, which follow the steering.
    assert -0.2 < late["late_steering"] < -0.08
    assert 0 < late["late_steering_std"] < 0.05


def test_derive_and_the_reader_of_its_file_report_the_same_words(tmp_path):
    """Two logs that differ: means, with the scatter of the logs in the standard errors."""
    logs = []
    for name, turned in (("a", -0.01), ("b", -0.02)):
        columns = pose_log()
        logs.append(write_log(tmp_path / f"{name}.csv", columns | {"psi": columns["psi"] + turned}))
    pose_vehicle(tmp_path, "")
    done = derive_files(logs, tmp_path / "vehicle.toml", tmp_path / "axle.csv")
    (said,) = (text for text in read(done.data).source.assumptions if "found by" in text)
    assert said in " ".join(done.summary().split())
    assert "alpha is +0.0150 rad where fy = 0" in said and "the stated one" in said
    (lag,) = re.findall("the yaw rate changes .*? ± .*? s", said) or [""]
    for log in done.logs:
        assert bool(lag) == ("the yaw rate changes" in log.summary())


def test_the_scatter_of_logs_counts_in_their_mean():
    """By hand: 80 ± 3 and 30 ± 4 ms have the mean 62 ms, and scatter 10 times their errors."""
    logs = [
        SimpleNamespace(
            zero=None,
            point=SimpleNamespace(estimate=(0.1, 0.001)),
            compared=SimpleNamespace(pairs=[_pair("yaw", late, std), _pair("a_y", 0.3, 0.01)]),
        )
        for late, std in ((0.08, 0.003), (0.03, 0.004))
    ]
    found = found_in(logs)
    assert found["late_yaw"] == pytest.approx((0.08 / 9 + 0.03 / 16) / (1 / 9 + 1 / 16))
    assert found["late_yaw_std"] == pytest.approx(0.0024 * 0.05 / 0.005)
    assert found["found_point_std"] == pytest.approx(0.001 / 2**0.5)
    assert "late_a_y" not in found  # not exact: dynamics of the car may cause it
    (said,) = findings(found)
    assert "the yaw rate changes 0.062 ± 0.02 s after" in said


def _pair(channel, delay, std):
    return SimpleNamespace(channel=channel, is_exact=False, delay=delay, delay_std=std)


def test_the_steering_rate_is_computed_at_the_full_sample_rate(tmp_path):
    path, car = steered_car(tmp_path)
    found = derive(path, car).columns
    time = found["time"] + rates_log()["t"][0]
    right = (steer(time + 0.005) - steer(time - 0.005)) / 0.01
    assert np.abs(found["steering_rate"] - right).max() < 0.02 * np.ptp(right)
