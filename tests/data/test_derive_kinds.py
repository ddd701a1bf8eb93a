"""`derive` accepts a log of every readable kind, with the result of its text file."""

import numpy as np
import pytest
from scipy.io import savemat
from test_motion import CAR, KEEP, POSE, pose_log, pose_vehicle, vehicle, write_log

from tirefit.data.vehicle.derive import derive
from tirefit.results import DataError, UsageError


def test_a_matlab_log_gives_the_result_of_its_text_file(tmp_path):
    columns = pose_log()
    settings = pose_vehicle(tmp_path)
    from_text = derive(write_log(tmp_path / "log.csv", columns), settings)
    units = {"t": "s", "x": "m", "y": "m", "psi": "rad"}
    log = {name: np.asarray(values)[:, None] for name, values in columns.items()}
    savemat(tmp_path / "log.mat", {"log": log | {"units": units}})
    from_matlab = derive(tmp_path / "log.mat", settings)
    for name, values in from_text.columns.items():
        np.testing.assert_allclose(from_matlab.columns[name], values, rtol=1e-9)


def test_columns_without_any_value_are_named(tmp_path):
    """Not the time, which has all of its values."""
    columns = pose_log()
    for gone, wrong in ((["x"], ["x"]), (["x", "psi"], ["x", "psi"]), ([], [])):
        log = {k: np.full(len(v), np.nan) if k in gone else v.copy() for k, v in columns.items()}
        if not gone:  # values in turn
            log["x"][::2], log["y"][1::2] = np.nan, np.nan
        path = write_log(tmp_path / "a.csv", log)
        with pytest.raises(DataError) as caught:
            derive(path, pose_vehicle(tmp_path))
        problems = caught.value.problems
        assert [p.column for p in problems] == (wrong or [None])
        reason = "has no value in any row" if gone else "no row has a value in all of"
        assert all(reason in p.reason for p in problems)


def test_two_quantities_in_one_column_are_refused(tmp_path):
    with pytest.raises(UsageError, match="columns.x and columns.y are the same column 'y'"):
        vehicle(tmp_path, CAR + POSE.replace('x = "x"', 'x = "y"') + KEEP)
