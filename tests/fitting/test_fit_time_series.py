"""Fits of a transient model, and of one with a reference load."""

from dataclasses import replace

import numpy as np
import pytest
from recipes import brush_force, solved, table

import tirefit
from tirefit.data.table import Source
from tirefit.fitting.predict import predict
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.solve.batch import fit_many
from tirefit.fitting.solve.far_rows import settle
from tirefit.fitting.uncertainty.bands import fitted_force
from tirefit.models import TireInputs
from tirefit.results import DataError, UsageError

LENGTH, V, FZ, NOISE = 0.5, 10.0, 4000.0, 20.0
TRUTH = {"cpa2": 6e4, "mu": 0.9}
CONFIG = {"noise": {"fx": NOISE}, "solver": "gauss-newton"}


def lagging(slip, time):
    """Slip after one relaxation length, by Heun's rule in steps of 20 microseconds."""
    step = 2e-5
    fine = np.arange(time[0], time[-1] + step, step)
    inputs = np.interp(fine, time, slip)
    felt = np.empty_like(fine)
    felt[0] = slip[0]
    rate = V / LENGTH
    for i in range(1, len(fine)):
        slope = rate * (inputs[i - 1] - felt[i - 1])
        ahead = felt[i - 1] + step * slope
        felt[i] = felt[i - 1] + step * (slope + rate * (inputs[i] - ahead)) / 2
    return np.interp(time, fine, felt)


def transient(n=150):
    """Two runs with a slip that oscillates faster than the patch follows."""
    rng = np.random.default_rng(4)
    columns = []
    for start, rate in ((0.0, 9.0), (7.0, 15.0)):
        time = start + np.cumsum(rng.uniform(0.004, 0.016, n))
        slip = 0.12 * np.sin(rate * time) + 0.04 * np.sin(3.1 * rate * time)
        force = brush_force(lagging(slip, time), **TRUTH, fz=FZ)
        columns.append([slip, force + NOISE * rng.standard_normal(n), time])
    slip, force, time = np.concatenate(columns, axis=1)
    even = np.ones(2 * n)
    names = {"sigma_x": slip, "fx": force, "time": time, "v": V * even, "fz": FZ * even}
    return table(names, "swing", np.repeat([0, 1], n), ("slow", "fast"))


DATA = transient()


@pytest.fixture(scope="module")
def lagged():
    return tirefit.fit(DATA, "brush-relaxation", config=CONFIG)


def test_fit_recovers_the_relaxation_length(lagged):
    assert lagged.status == "ok"
    for name, truth in {**TRUTH, "relaxation_length": LENGTH}.items():
        estimate = lagged.parameters[name]
        assert abs(estimate.value - truth) < 3 * estimate.std < 0.02 * truth, name
    assert 0.8 < lagged.statistics.chi2_dof < 1.2
    # The padded rows are copies of the first one and end up in no result.
    assert lagged.problem.n == 300 < len(lagged.problem.rows.weight)


def test_a_steady_brush_does_not_fit_lagging_data(lagged):
    steady = solved(DATA, CONFIG)
    assert steady.chi2_dof > 100 * lagged.statistics.chi2_dof


def test_masked_rows_are_skipped():
    """Between two used rows the slip is linear, whatever a masked row contained."""
    used = np.arange(len(DATA)) % 7 != 3
    columns = dict(DATA.columns)
    columns["sigma_x"] = np.where(used, columns["sigma_x"], np.nan)
    gaps = replace(DATA, columns=columns).where(used)
    found = solved(gaps, CONFIG, "brush-relaxation")
    value = found.problem.layout.vector(found.z)[-1]
    np.testing.assert_allclose(value, LENGTH, rtol=0.02)


def test_only_the_row_of_an_absurd_slip_is_excluded(lagged):
    """The lagged slip of the following rows does not include the wrong one."""
    slip = DATA["sigma_x"].copy()
    slip[[40, 200]] = 3.0
    spoilt = replace(DATA, columns={**DATA.columns, "sigma_x": slip})
    end = settle(spoilt, "brush-relaxation", parse_config(CONFIG))
    assert [far.row for far in end.outliers if far.set_aside] == [40, 200]
    off = np.abs(end.solved.z - lagged.z) / np.sqrt(np.diag(lagged.covariance))
    assert np.all(off < 0.5)


def test_prediction_follows_the_rows_in_time(lagged):
    found = predict(lagged, DATA)
    residual = found["fx"] - DATA["fx"]
    np.testing.assert_allclose(np.std(residual), NOISE, rtol=0.15)
    used = np.ones(len(DATA), bool)
    used[40:43] = False
    spoilt = DATA["sigma_x"].copy()
    spoilt[40:43] = np.nan
    masked = replace(DATA, columns={**DATA.columns, "sigma_x": spoilt}).where(used)
    again = predict(lagged, masked)
    assert np.isnan(again["fx"][40:43]).all()
    np.testing.assert_allclose(again["fx"][used], found["fx"][used], atol=0.1 * FZ)
    np.testing.assert_allclose(again["fx"][:40], found["fx"][:40], rtol=1e-12)
    # By name, with separate runs: the second starts in steady state.
    values = {name: e.value for name, e in lagged.least_squares.items()}
    by_name = predict("brush-relaxation", DATA, values)
    np.testing.assert_allclose(by_name["fx"], found["fx"], rtol=1e-9, atol=1e-6)


def test_a_longer_series_than_the_fitted_one_is_predicted_completely(lagged):
    """The rows three times: time decreases twice, and each part starts anew."""
    inputs, run = lagged.problem.rows.inputs, lagged.problem.rows.run
    thrice = [np.tile(lagged.problem.used(column), 3) for column in (*inputs, run)]
    force = fitted_force(lagged, "fx", TireInputs(*thrice[:-1]), thrice[-1])
    assert len(force) > 2 * len(run)
    expected = np.tile(predict(lagged, DATA)["fx"], 3)
    np.testing.assert_allclose(force, expected, rtol=1e-9, atol=1e-6)


def line_numbers(data):
    return replace(data, source=Source("swing.csv", line=np.arange(len(data)) + 2))


def test_constant_time_is_refused_with_the_row():
    time = DATA["time"].copy()
    time[20], time[200] = time[19], time[199] - 1
    data = line_numbers(table({**DATA.columns, "time": time}, run=DATA.run, runs=DATA.runs))
    for use in (
        lambda: build(data, "brush-relaxation", parse_config(CONFIG)),
        lambda: predict("brush-relaxation", data),
    ):
        with pytest.raises(DataError, match="is not after") as error:
            use()
        (problem,) = error.value.problems
        assert (problem.file, problem.row, problem.column) == ("swing.csv", 22, "time")
        assert "2 such rows" in problem.reason and "sort the rows" in problem.remedy


def test_runs_that_alternate_are_refused():
    run = (np.arange(len(DATA)) // 100) % 2
    data = line_numbers(table(DATA.columns, run=run, runs=DATA.runs))
    with pytest.raises(DataError, match="'slow' are not contiguous") as error:
        build(data, "brush-relaxation", parse_config(CONFIG))
    assert error.value.problems[0].row == 202


def test_settings_that_remove_history_are_refused():
    config = {"noise": {"sigma_x": 0.01}}
    with pytest.raises(UsageError) as error:
        build(DATA, "brush-relaxation", parse_config(config))
    reasons = [problem.reason for problem in error.value.problems]
    assert [reason.split()[0] for reason in reasons] == ["noise.sigma_x:"]
    noisy = table({**DATA.columns, "sigma_x_std": 0.01 + 0 * DATA["v"]})
    with pytest.raises(UsageError, match="column 'sigma_x_std'.*must have no noise"):
        build(noisy, "brush-relaxation", parse_config({}))
    with pytest.raises(UsageError, match="fit_many"):
        fit_many({"alpha": np.zeros((1, 9)), "fy": np.zeros((1, 9)), "fz": FZ}, "brush-relaxation")


# Reference load


def loads(n=120):
    """Three loads; c_p a^2 grows as load^0.8, friction falls with it."""
    rng = np.random.default_rng(5)
    fz = np.tile([2000.0, 3900.0, 6000.0], n // 3)
    slip = rng.uniform(0, 0.2, n)
    force = [
        brush_force(s, 6e4 * (f / 3900) ** 0.8, 0.9 - 0.12 * (f / 3900 - 1), fz=f)
        for s, f in zip(slip[:, None], fz, strict=True)
    ]
    noise = NOISE * rng.standard_normal(n)
    return table({"sigma_x": slip, "fx": np.concatenate(force) + noise, "fz": fz})


def test_the_reference_load_defaults_to_the_median():
    data = loads()
    task = build(data, "brush-load", parse_config(CONFIG))
    assert task.problem.model.fz0 == 3900.0
    assert any("fz0: 3900 N, the median" in note for note in task.notes)
    given = CONFIG | {"parameters": {"fz0": {"value": 5000.0}}}
    task = build(data, "brush-load", parse_config(given))
    assert task.problem.model.fz0 == 5000.0
    assert not any("fz0" in note for note in task.notes)


def test_fit_recovers_the_load_dependence_of_parameters():
    found = solved(loads(), CONFIG, "brush-load")
    layout = found.problem.layout
    values = dict(zip(layout.labels, layout.vector(found.z), strict=True))
    truth = {"cpa2": 6e4, "mu": 0.9, "stiffness_power": 0.8, "mu_load": -0.12}
    assert list(values) == list(truth)
    np.testing.assert_allclose(list(values.values()), list(truth.values()), rtol=0.05)
    np.testing.assert_allclose(found.chi2_dof, 1.0, atol=0.3)
