"""Fits by trajectory of simulated drives whose tires and unknowns are known."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_car import TIRES, slopes
from test_replay import TOML

import tirefit
from tirefit.results import DataError, UsageError
from tirefit.vehicle.trajectory import fit_trajectory

DELAY, OFFSET = 0.06, 0.012  # s, rad
TRUE = {
    "front.cpa2": TIRES["front"][0], "front.mu": TIRES["front"][1],
    "rear.cpa2": TIRES["rear"][0], "rear.mu": TIRES["rear"][1],
    "steering_delay": DELAY, "steering_offset": OFFSET,
}  # fmt: skip


def steer(time):
    return 0.28 * np.sin(1.7 * time) + 0.12 * np.sin(6.1 * time + 1)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A vehicle file, a log of poses with noise, and brushes fitted to what derive
    makes of it, with the steering as logged."""
    folder = tmp_path_factory.mktemp("trajectory")
    (folder / "vehicle.toml").write_text(TOML)
    time, generator = np.arange(0, 24, 0.01), np.random.default_rng(3)
    true = solve_ivp(
        slopes, (0, time[-1]), np.zeros(5), t_eval=time, rtol=1e-8, atol=1e-8,
        max_step=0.01, args=[lambda t: 3.0, lambda t: steer(t - DELAY) + OFFSET],
    )  # fmt: skip
    _, _, yaw, x, y = true.y
    noisy = [
        values + std * generator.standard_normal(len(time))
        for values, std in ((x, 1e-3), (y, 1e-3), (yaw, 2e-3))
    ]
    rows = np.stack([time, *noisy, steer(time)], axis=1)
    path = folder / "drive.csv"
    np.savetxt(path, rows, "%.9g", ",", header="t,x,y,yaw,steer", comments="")
    fits = {}
    for axle in ("front", "rear"):
        out = folder / f"{axle}.csv"
        tirefit.derive_files([path], folder / "vehicle.toml", out, axle)
        fits[axle] = tirefit.fit(tirefit.read(out), "brush")
    return folder, fits


def test_the_tires_and_the_steering_come_back(drive):
    folder, fits = drive
    found = fit_trajectory(
        [folder / "drive.csv"], folder / "vehicle.toml", fits["front"], fits["rear"]
    )
    assert found.converged and found.windows > 40
    for name, true in TRUE.items():
        one = found.parameters[name]
        assert abs(one.value - true) < 3 * one.std, (name, one)
        assert one.std < 0.1 * true and one.ci95[0] < one.value < one.ci95[1]
    # The noise of each channel is that of the log.
    assert found.noise["heading"] == pytest.approx(2e-3, rel=0.15)
    assert found.noise["x"] == pytest.approx(1e-3, rel=0.15)


def test_what_cannot_be_fitted_is_refused(drive, tmp_path):
    folder, fits = drive
    given = [folder / "drive.csv"], folder / "vehicle.toml"
    with pytest.raises(UsageError, match="the front tire brush is no fit"):
        fit_trajectory(*given, "brush", fits["rear"])
    with pytest.raises(UsageError, match="(?s)no unknown of a car.*steering_delay"):
        fit_trajectory(*given, *fits.values(), unknowns=["steering_dela"])
    with pytest.raises(DataError, match="no stretch above 1 m/s is 60 s long"):
        fit_trajectory(*given, *fits.values(), window=60.0)
