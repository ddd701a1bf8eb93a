"""Vehicle logs: columns, units and signs; no slip, force or load is required."""

import numpy as np
import pytest

from tirefit.data.read import read_frame, require
from tirefit.results import DataError

LOG = {
    "time": [0.0, 0.1, 0.2],
    "yaw rate [deg/s]": [0.0, 90.0, -90.0],
    "offset [cm]": [10.0, 20.0, 30.0],
    "a_y [g]": [0.1, 0.2, 0.3],
    "omega_fl": [80.0, 80.0, 80.0],
    "torque_rr [kNm]": [0.5, 0.5, 0.5],
    "heading": [0.0, 0.1, 0.2],
    "y": [1.0, 2.0, 3.0],
}


def frame(**changes):
    return {k: np.array(v) for k, v in (LOG | changes).items()}


def test_a_vehicle_log_is_converted_to_si_and_iso_axes():
    data = read_frame(frame(), curve=False, convention="sae")
    expected = {
        "yaw_rate": [0, np.pi / 2, -np.pi / 2],
        "offset": [0.1, 0.2, 0.3],
        "a_y": np.array([0.1, 0.2, 0.3]) * 9.80665,
        "omega_fl": [80] * 3,
        "torque_rr": [500] * 3,
        "y": [1, 2, 3],
    }
    for name, values in expected.items():
        np.testing.assert_allclose(data[name], values, rtol=1e-12)
    with pytest.raises(DataError, match="needs steering .*road wheel angle"):
        require(data, ["yaw_rate", "steering"], "method 'position'")
    with pytest.raises(DataError, match="no slip"):
        read_frame(frame())


def test_x_and_y_are_positions_only_with_a_heading():
    columns = frame(sigma_x=[0.01, 0.02, 0.03])
    del columns["heading"]
    assert "y" not in read_frame(columns, curve=False)
