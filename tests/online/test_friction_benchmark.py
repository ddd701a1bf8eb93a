"""The benchmark's metrics on series made by hand; a small run without peers."""

import csv

import numpy as np
import pytest

from fits.friction_benchmark.__main__ import main
from fits.friction_benchmark.estimators import matched_lugre
from fits.friction_benchmark.metrics import Trace, accuracy, crossings, detection
from fits.friction_benchmark.page import page_test
from fits.friction_benchmark.scenarios import KINDS, Scenario, make
from fits.friction_benchmark.scoring import closest_brush
from fits.friction_while_braking.reference import reference
from tirefit.models import Brush, LuGre, TireInputs, forces
from tirefit.sim.braking import LOAD, STIFFNESS, source_tire


def trace(mu, std=0.1, supported=True):
    n = len(mu)
    time = np.arange(n, dtype=float)
    full = np.full(n, std), np.full(n, supported)
    return Trace(time, np.asarray(mu, float), *full, np.zeros(n, bool))


def test_accuracy_is_right_for_a_known_error():
    # Errors of 0.3 and -0.1 by turns: mean 0.1, standard deviation 0.2; of the two only
    # the smaller lies within 1.96 times 0.1.
    mu = 0.5 + np.where(np.arange(40) % 2, 0.3, -0.1)
    error = accuracy(trace(mu), 0.5, begin=10)
    np.testing.assert_allclose(error, [0.1, 0.2, 0.5, 1.0])


def test_unsupported_rows_are_counted_but_not_scored():
    one = trace([9.0] * 10 + [0.6] * 30)
    one = one._replace(supported=np.r_[np.zeros(25, bool), np.ones(15, bool)])
    error = accuracy(one, 0.5, begin=0)
    np.testing.assert_allclose(error, [0.1, 0.0, 1.0, 15 / 40], atol=1e-12)
    assert accuracy(trace([np.nan] * 20), 0.5).supported == 0


def test_delay_and_false_alarms_are_right_for_known_alarms():
    # Two before the drop and one long after it are false; the second in the window not.
    found = detection([3, 18, 21.5, 24, 35], drop=20, duration=40)
    assert found == (1.5, 3, 30)
    missed = detection([5], drop=20, duration=40)
    assert np.isnan(missed.delay) and missed.false == 1
    assert detection([1, 2], np.nan, 60)[1:] == (2, 60)
    assert detection([], drop=35, duration=40).seconds == 35


def test_crossings_ignore_unsupported_rows():
    one = trace([0.9, 0.7, 0.7, 0.9, 0.5, 0.9, 0.7])
    supported = np.array([1, 1, 1, 1, 0, 1, 1], bool)
    crossed = crossings(one._replace(supported=supported), 0.8)
    np.testing.assert_array_equal(crossed, [1, 6])


def test_page_detects_a_shift_at_the_calculated_row():
    # From 0 to 2 with drift 0.5 the sum grows by 1.5: beyond 12 at the ninth sample.
    assert page_test([0.0] * 50 + [2.0] * 12, 12.0) == [58]


@pytest.mark.parametrize("use", [0.6, 0.75])
def test_the_closest_brush_agrees_with_another_method(use):
    # There from rows that are even in force, here from those of the log.
    log = make(Scenario("one", "braking", use, 0, 10.0))
    assert abs(closest_brush(log) - reference()[f"{100 * use:.0f} %: mu"]) < 0.005
    assert np.isnan(closest_brush(make(Scenario("one", "cornering", use, 0, 10.0))))


def test_a_cornering_log_follows_the_brush():
    log = make(Scenario("one", "cornering", 0.75, 3, 4.0, 2.0, 0.6))
    truth = log.truth
    assert set(np.unique(truth["mu"])) == {0.98, 0.6}
    noise = log.columns["fy"] / LOAD
    tire = Brush(STIFFNESS / 2, truth["mu"])
    at = TireInputs(alpha=log.columns["alpha"], fz=LOAD, v=20.0)
    force = np.asarray(tire(at).fy) / LOAD
    assert abs(np.std(noise - force) / 0.0447 - 1) < 0.15
    assert abs(force[truth["mu"] > 0.9].max() / 0.98 - 0.75) < 0.01


def test_the_matched_lugre_tire_lies_on_the_curve():
    kappa = np.linspace(0.005, 0.3, 100)
    at = TireInputs(sigma_x=kappa / (1 - kappa), fz=1.0, v=20.0)
    share = np.asarray(forces(LuGre(**matched_lugre()), at).fx)
    curve = np.asarray(source_tire().pure(kappa, LOAD)) / LOAD
    assert np.max(np.abs(share - curve)) < 0.05


@pytest.fixture(scope="module")
def benchmark(tmp_path_factory):
    out = tmp_path_factory.mktemp("benchmark")
    small = ["--hours", "0.02", "--drops", "1", "--out", str(out)]
    main(["logs", *small])
    # A foreign estimator that knows the truth.
    for path in (out / "logs").glob("*.truth.csv"):
        rows = np.genfromtxt(path, delimiter=",", names=True)
        columns = [rows["time"], rows["mu"], 0.01 + 0 * rows["mu"]]
        columns += [np.ones(len(rows)), np.r_[0, np.diff(rows["mu"]) < 0]]
        name = path.name.replace(".truth", "")
        (out / "others" / "truth").mkdir(parents=True, exist_ok=True)
        np.savetxt(
            out / "others" / "truth" / name,
            np.stack(columns, 1),
            delimiter=",",
            header="time,mu,mu_std,supported,alarm",
            comments="",
        )
    others = ["--traces", str(out / "others"), "--no-peers", "--method", "ekf,cubic,path"]
    main(["run", *small, *others])
    main(["table", *small])
    return out


def lines(out):
    with open(out / "table.csv", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.long
def test_the_truth_has_a_perfect_score(benchmark):
    scored = [line for line in lines(benchmark) if line["estimator"] == "truth"]
    assert [(line["log"], float(line["use"])) for line in scored] == [
        (kind, use) for kind, (_, uses, _) in KINDS.items() for use in uses
    ]
    for line in scored:
        assert float(line["bias"]) == float(line["std"]) == 0
        assert float(line["covered"]) == float(line["supported"]) == 1
        assert float(line["found_60"]) == float(line["found_80"]) == 1
        assert 0 <= float(line["delay_60"]) <= 0.02  # one row of a drive
        assert float(line["false_per_hour"]) == 0


@pytest.mark.long
def test_a_small_benchmark_has_a_line_for_every_method_and_use(benchmark):
    names = [line["estimator"] for line in lines(benchmark)]
    expected = [*["tirefit ekf"] * 3, *["tirefit cubic"] * 3, *["tirefit path"] * 3]
    assert names == [*expected, *["truth"] * 9]
    text = (benchmark / "table.md").read_text()
    assert "skipped: no time" in text  # sand
    assert (benchmark / "trade_off.png").stat().st_size > 1000
