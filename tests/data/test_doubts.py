"""Warnings of `derive`: edges, noise removed by the filter."""

from test_motion import CAR, KEEP, POSE, pose_log, vehicle, write_log

from tirefit.data.vehicle.derive import derive


def settings(tmp_path, after=""):
    return vehicle(tmp_path, CAR + POSE + KEEP + after)


def test_a_clean_log_raises_no_doubt(tmp_path):
    log = derive(write_log(tmp_path / "a.csv", pose_log()), settings(tmp_path))
    assert log.warnings == () and "warning" not in log.summary()


def test_rows_near_an_edge_are_reported(tmp_path):
    path = write_log(tmp_path / "a.csv", pose_log())
    log = derive(path, settings(tmp_path, "margin = 0.05\n"))
    (said,) = log.warnings
    # 0.3 s of settling less the margin, at both ends, at 100 Hz.
    assert said.startswith("50 samples are within 0.3 s of an edge")
    assert "warning: 50 samples" in log.summary()


def test_noise_removed_by_the_filter_is_reported(tmp_path):
    path = write_log(tmp_path / "a.csv", pose_log(noise=30.0))
    said = " ".join(derive(path, settings(tmp_path)).warnings)
    assert "of the variance of fy lies above 2.8 Hz" in said
