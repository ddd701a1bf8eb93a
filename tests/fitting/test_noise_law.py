"""Stated bands contain 95 % of the rows of every setting, not only of all together."""

import numpy as np
import pytest
from recipes import TRUTH, brush_force, curve, table
from scipy.optimize import nnls

from tirefit.fitting.estimate import fit
from tirefit.fitting.predict import predict
from tirefit.fitting.problem.noise import noise_std, non_negative
from tirefit.fitting.store import load_fit

N = 600


def rig(seed, std):
    """Free rolling and braking at three loads, each a run; noise ``std`` of
    (force, fz, run)."""
    generator = np.random.default_rng(seed)
    run = np.repeat(np.arange(3), N)
    fz = np.array([2000.0, 4000.0, 7000.0])[run]
    free = np.arange(3 * N) % 2 == 0
    slip = np.where(free, 0.002, 0.3) * generator.uniform(-1, 1, 3 * N)
    size = brush_force(np.abs(slip), TRUTH["cpa2"] * fz / 4000, TRUTH["mu"], fz=fz)
    force = np.sign(slip) * size
    noise = std(np.abs(force), fz, run) * generator.standard_normal(3 * N)
    columns = {"sigma_x": slip, "fx": force + noise, "fz": fz}
    runs = ("low", "middle", "high")
    return table(columns, run=run, runs=runs), 2 * run + free


LAWS = {
    "free rolling": lambda force, fz, run: 10 + 0.04 * force,
    "load": lambda force, fz, run: 0.02 * fz,
    "run": lambda force, fz, run: np.array([20.0, 160.0, 40.0])[run],
}
CONFIG = {"parameters": {"cpa2": {"per_run": True}}}


@pytest.mark.parametrize("name", LAWS)
def test_bands_contain_95_percent_of_the_rows_of_every_setting(name, tmp_path):
    data, setting = rig(1, LAWS[name])
    result = fit(data, "brush", config=CONFIG)
    path = tmp_path / "fit.json"
    path.write_text(result.to_json())
    for seed, source in ((1, result), (2, load_fit(path))):
        other, _ = rig(seed, LAWS[name])
        stated = predict(source, other)
        inside = np.abs(other["fx"] - stated["fx"]) < 1.96 * stated["fx_std"]
        share = np.bincount(setting, inside) / np.bincount(setting)
        # Of 300 rows: 0.95 +- 0.013.
        assert np.all((share > 0.90) & (share < 0.985)), share


def test_uniform_noise_is_one_number():
    seeds = range(10)
    laws = [fit(curve(seed=seed), "brush").noise["fx"].keys() for seed in seeds]
    assert not any({"constant", "by_run"} & set(law) for law in laws)


def test_noise_of_a_record_agrees_with_hand_calculation():
    record = {
        "median_std": 9.0,
        "constant": 3.0,
        "share_of_load": 0.001,
        "share_of_force": 0.012,
        "by_run": {"a": 2.0},
    }
    fz, force = np.array([4000.0, 4000.0]), np.array([1000.0, -1000.0])
    # 3, 4 and 12 in square are 13.
    std = noise_std(record, fz, force, ["a", "other"])
    np.testing.assert_allclose(std, [26.0, 13.0])
    np.testing.assert_allclose(noise_std({"median_std": 9.0}, fz, force), 9.0)


def test_non_negative_least_squares_is_that_of_scipy():
    generator = np.random.default_rng(0)
    for k in (2, 3):
        for _ in range(100):
            rows, wanted = generator.normal(size=(6, k)), generator.normal(size=6)
            found = non_negative(rows.T @ rows, rows.T @ wanted)
            np.testing.assert_allclose(found, nnls(rows, wanted)[0], atol=1e-9)
