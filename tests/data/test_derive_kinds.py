"""`derive` accepts a log of every readable kind, with the result of its text file."""

import numpy as np
from scipy.io import savemat
from test_motion import pose_log, pose_vehicle, write_log

from tirefit.data.derive import derive


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
