"""`vehicle.toml` agrees with VEHICLE.md: keys, defaults, units, the example."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from test_derive import rates_log
from test_motion import CAR, KEEP, L_F, L_R, POSE, RATES, pose_log, truth, write_log

from tirefit.data.vehicle.derive import derive
from tirefit.data.vehicle.vehicle import (
    QUANTITIES,
    Columns,
    Filter,
    Keep,
    Steering,
    Vehicle,
    load_vehicle,
    unit_of,
)
from tirefit.results import UsageError

TEXT = (Path(__file__).parents[2] / "VEHICLE.md").read_text(encoding="utf-8")
EXAMPLE = TEXT.partition("```toml\n")[2].partition("```")[0]


def loaded(tmp_path, text, units=None):
    path = tmp_path / "vehicle.toml"
    path.write_text(text)
    return load_vehicle(path, units)


def documented(section):
    """Keys of the table whose header begins with this text."""
    rows = TEXT.partition(f"| {section} |")[2].partition("\n\n")[0].splitlines()
    return [re.match(r"\| `(\w+)` \|", row).group(1) for row in rows[2:]]


@pytest.mark.parametrize(
    ("section", "kind"),
    [
        ("key | unit", Vehicle),
        ("key | dimension", Columns),
        ("`[filter]`", Filter),
        ("`[keep]`", Keep),
        ("`[steering]`", Steering),
    ],
)
def test_exactly_the_existing_keys_are_documented(section, kind):
    assert documented(section) == list(kind.model_fields)


def test_documented_dimensions_and_defaults_are_right():
    rows = re.findall(r"\| `(\w+)` \| (time|length|angle|speed|angular speed|accel\w+) ", TEXT)
    assert dict(rows) == QUANTITIES
    default = Filter()
    for name, value in (("cutoff", 5), ("order", 2), ("sample_rate", 100)):
        assert getattr(default, name) == value
        assert re.search(rf"\| `{name}` \| (Hz)? ?\| {value} \|", TEXT)


def test_the_documented_example_is_valid(tmp_path):
    vehicle = loaded(tmp_path, EXAMPLE)
    assert vehicle.columns.motion == ("v_x", "v_y", "yaw_rate", "a_y")
    assert vehicle.keep == Keep() and vehicle.filter == Filter()
    assert vehicle.v_min == pytest.approx(math.sqrt(9.80665 * 2.6) / 2)
    assert unit_of(vehicle.units["yaw_rate"], "yaw_rate").scale == -math.pi / 180


def test_keep_has_defaults(tmp_path):
    log = write_log(tmp_path / "a.csv", pose_log())
    result = derive(log, loaded(tmp_path, CAR + POSE))
    lowest = math.sqrt(9.80665 * (L_F + L_R)) / 2
    assert f"slower than {lowest:g} m/s" in result.dropped_samples
    assert len(result) == len(derive(log, loaded(tmp_path, CAR + POSE + KEEP)))


@pytest.mark.parametrize(
    ("text", "quantity", "scale"),
    [
        ("km/h", "v_x", 1 / 3.6),
        ("-km/h", "v_y", -1 / 3.6),
        ("deg", "yaw", math.pi / 180),
        ("us", "time", 1e-6),
        ("-s", "time", None),
        ("deg", "yaw_rate", None),
        ("-", "a_y", None),
        ("", "a_y", None),
        ("stone", "a_y", None),
    ],
)
def test_a_log_accepts_the_units_of_data_files(text, quantity, scale):
    unit = unit_of(text, quantity)
    assert unit is None if scale is None else unit.scale == pytest.approx(scale)


def test_units_of_the_command_line_override_those_of_the_file(tmp_path):
    text = CAR + RATES + KEEP + '[units]\nv_x = "mph"\na_y = "g"\n'
    vehicle = loaded(tmp_path, text, {"v_x": "km/h"})
    assert vehicle.units == {"v_x": "km/h", "a_y": "g"}
    for units, said in (
        ({"v_x": "N"}, "--unit v_x=N is not one of m/s, km/h"),
        ({"v_z": "km/h"}, "--unit v_z=km/h, but v_z is not one of time, x, y"),
    ):
        with pytest.raises(UsageError) as caught:
            loaded(tmp_path, text, units)
        (problem,) = caught.value.problems
        assert problem.reason.startswith(said) and not problem.file
    with pytest.raises(UsageError, match="units = "):
        loaded(tmp_path, "units = 3\n" + CAR + RATES, {"v_x": "km/h"})


def test_sideslip_offset_is_added_to_the_measured_sideslip(tmp_path):
    """A sensor of v_x and v_y rotated to the left by 12 mrad."""
    log = rates_log()
    cos, sin = np.cos(0.012), np.sin(0.012)
    turned = log | {
        "vx": cos * log["vx"] + sin * log["vy"],
        "vy": cos * log["vy"] - sin * log["vx"],
    }
    path = write_log(tmp_path / "a.csv", turned)
    raw = derive(path, loaded(tmp_path, CAR + RATES + KEEP))
    assert "sideslip offset: none assumed" in raw.heading
    advised = float(raw.heading.partition("sideslip_offset = ")[2].split()[0])
    assert advised == pytest.approx(0.012, abs=0.001)
    text = "sideslip_offset = 0.012\n" + CAR + RATES + KEEP
    right = derive(path, loaded(tmp_path, text))
    assert "0.012 rad were added to the logged sideslip" in right.heading
    true = truth(right.columns["time"] + log["t"][0])
    np.testing.assert_allclose(right.columns["alpha"], true.alpha_rear, atol=1e-4)
    shift = right.columns["alpha"].mean() - raw.columns["alpha"].mean()
    assert shift == pytest.approx(0.012, rel=0.05)
    with pytest.raises(UsageError, match="log of rates only"):
        loaded(tmp_path, "sideslip_offset = 0.1\n" + CAR + POSE + KEEP)


def test_a_measured_a_x_is_used_and_filtered(tmp_path):
    log = rates_log()
    time = log["t"]
    true = truth(time)
    ahead, left = 0.115 - L_R, -0.01
    log["ax"] = true.a_x - left * true.yaw_acceleration - ahead * true.yaw_rate**2
    # A hum of 20 Hz, which the filter takes out of every channel.
    hum = 0.5 * np.sin(2 * np.pi * 20 * time)
    log["ax"] = log["ax"] + hum
    text = CAR + RATES + 'a_x = "ax"\n' + KEEP
    result = derive(write_log(tmp_path / "a.csv", log), loaded(tmp_path, text))
    right = truth(result.columns["time"] + time[0]).a_x
    np.testing.assert_allclose(result.columns["a_x"], right, atol=0.02)
    found = [a.as_dict() for a in result.compared.pairs if a.channel == "a_x"]
    assert found[0]["gains"][0]["value"] == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize(
    ("key", "text"), [("l_f", "1e19"), ("l_r", "60.0"), ("tracked_point", "[0.0, -1e19]")]
)
def test_lengths_that_no_vehicle_has_are_refused(tmp_path, key, text):
    lines = [line for line in EXAMPLE.splitlines() if not re.match(rf"{key} *=", line)]
    with pytest.raises(UsageError, match=key) as caught:
        loaded(tmp_path, "\n".join([f"{key} = {text}", *lines]))
    assert caught.value.exit_code == 2
