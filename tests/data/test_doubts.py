"""Warnings of `derive`: edges, noise removed by the filter, waves of the road."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from test_motion import CAR, KEEP, POSE, WHEELBASE, pose_log, vehicle, write_log

from tirefit.data.derive import derive
from tirefit.data.doubts import repeats_with_distance


def noise(seed, count=6000):
    """Slow wandering and white noise through the filter of a log at 100 Hz."""
    white = np.random.default_rng(seed).standard_normal((2, count))
    low_pass = butter(2, 5.0, fs=100.0, output="sos")
    return sosfiltfilt(low_pass, 1e-3 * np.cumsum(white[0]) + 1e-2 * white[1])


def drive(count=6000):
    """Distance [m] at 1.5 to 2.5 m/s."""
    return np.cumsum(2 + 0.5 * np.sin(0.006 * np.arange(count))) / 100


def test_a_wave_of_the_road_is_found_with_length_and_amplitude():
    way = drive()
    wave = repeats_with_distance(
        [noise(1) + 0.004 * np.sin(2 * np.pi * way / 0.8)], [way], 0.5, 1.4
    )
    assert wave.length == pytest.approx(0.8, rel=0.03)
    assert wave.size == pytest.approx(0.004, rel=0.25)
    assert wave.p_value < 1e-6


def test_noise_and_a_wave_in_time_give_no_wave_of_the_road():
    way, time = drive(), np.arange(6000) / 100
    assert not any(repeats_with_distance([noise(seed)], [way], 0.5, 1.4) for seed in range(20))
    # 2.5 Hz is spread over 0.6 to 1 m of the road.
    slalom = noise(1) + 0.004 * np.sin(2 * np.pi * 2.5 * time)
    assert repeats_with_distance([slalom], [way], 0.5, 1.4) is None
    assert repeats_with_distance([noise(1)], [way], 1.5, 1.4) is None
    assert repeats_with_distance([noise(1, 300)], [way[:300]], 0.5, 1.4) is None


def settings(tmp_path, after="", wide=""):
    return vehicle(tmp_path, CAR + POSE + KEEP + after + wide)


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


def test_an_out_of_round_wheel_is_reported(tmp_path):
    """The car sways once per turn of a wheel of 45 mm."""
    columns, turn = pose_log(noise=0.3), 2 * np.pi * 0.045
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(columns["x"]), np.diff(columns["y"])))])
    columns["psi"] = columns["psi"] + 0.006 * np.sin(2 * np.pi * way / turn)
    path = write_log(tmp_path / "a.csv", columns)
    config = settings(tmp_path, wide="[filter]\ncutoff = 15.0\n")
    assert turn < 2 * WHEELBASE
    said = [w for w in derive(path, config).warnings if w.startswith("alpha repeats")]
    assert len(said) == 1
    length = float(said[0].split()[3])
    assert length == pytest.approx(turn, rel=0.04)
    assert ", p < 1e-12)" in said[0]
    clean = write_log(tmp_path / "b.csv", pose_log(noise=0.3))
    assert not any("repeats" in w for w in derive(clean, config).warnings)
