"""The study of measured cars: the reference by hand, thinning, and one case of the command."""

import json
from pathlib import Path

import numpy as np
import pytest

from fits.measured_cars import by_hand, run
from fits.measured_cars.cars import CARS

CAR = {"mass": 5.1, "yaw_inertia": 0.12, "l_f": 0.165, "l_r": 0.165}
TRUE = by_hand.STARTS | {"c_front": 45.0, "c_rear": 90.0, "mu_front": 0.9, "mu_rear": 0.8}
TRUE |= {"delay": 0.083, "offset": 0.01}


def slalom(values, kind, seconds=24.0):
    """Windows of a car that the reference itself drives from rest, without noise."""
    time = np.arange(0, seconds, 1 / by_hand.RATE)
    delta = 0.6 * np.sin(2.2 * time) * np.sin(0.5 * time)
    v_x, none = 2.5 + 0.4 * np.sin(0.7 * time), np.full(len(time), 0.0)
    stretch = {k: none for k in ("v_y", "r", "heading", "x", "y")} | {"v_x": v_x, "delta": delta}
    whole = by_hand.windows([by_hand.Log((stretch,))], seconds - 0.5, 1e3, seconds - 0.5)
    states = by_hand.predicted(values, kind, CAR, whole)
    lead = by_hand.LEAD
    driven = {k: x[0] for k, x in states.items()} | {"v_x": v_x[lead:-9], "delta": delta[lead:-9]}
    return by_hand.Log(({k: x[: len(driven["r"])] for k, x in driven.items()},))


def test_the_reference_finds_the_car_that_it_drove():
    log = slalom(TRUE, "brush")
    cut = by_hand.windows([log], by_hand.WINDOW, by_hand.WINDOW, by_hand.WINDOW)
    found = by_hand.fitted("brush", CAR, cut)
    for name in ("c_front", "c_rear", "mu_front", "delay"):
        assert found[name] == pytest.approx(TRUE[name], rel=0.02), name
    linear = by_hand.fitted("linear", CAR, cut)
    ahead = by_hand.windows([log], 5.0, 0.25, 0.25)
    own, straight = (
        by_hand.errors(by_hand.predicted(values, kind, CAR, ahead), ahead)
        for values, kind in ((found, "brush"), (linear, "linear"))
    )
    assert max(own["yaw_rate"]) < 0.02 < 0.1 < max(straight["yaw_rate"])


def test_every_third_row_of_each_run_is_kept(tmp_path):
    table = tmp_path / "axle.csv"
    rows = [f"{k},{'a' if k < 7 else 'b'}" for k in range(12)]
    table.write_text("\n".join(["# constants", "time,run", *rows]) + "\n")
    out = run.thinned(table, 3, tmp_path / "third.csv").read_text().split()
    assert out[2:] == ["time,run", "0,a", "3,a", "6,a", "7,b", "10,b"]


@pytest.mark.long
def test_the_effects_of_a_front_axle_do_not_depend_on_how_many_rows_are_given(
    tmp_path, monkeypatch
):
    """Every 6th, 10th and 15th row of the front axle of tires D: the same effects, the first one
    with a size that agrees within two errors of the difference."""
    monkeypatch.setattr(run, "THINNED", (6, 10, 15))
    (car,) = (car for car in CARS if car.name == "d")
    found = run.thinning_of(car, tmp_path)
    assert len({frozenset(one["each"]) for one in found.values()}) == 1
    name = next(iter(found["6"]["each"]))
    sizes = np.array([one["each"][name][2][:2] for one in found.values()], float)
    apart = np.abs(sizes[1:, 0] - sizes[0, 0]) / np.hypot(sizes[1:, 1], sizes[0, 1])
    assert np.max(apart) < 2.0


def test_no_log_is_both_fitted_and_left_out():
    for car in CARS:
        assert not {*car.fitted} & {*car.left_out}, car.name
    assert len({car.name for car in CARS}) == len(CARS)


@pytest.mark.long
def test_the_command_computes_a_case_once(tmp_path, monkeypatch, capsys):
    """Free driving of the encoder car, by hand: brushes of rising friction predict the log left
    out better than linear tires after a second; the second run only writes the table."""
    words = ["x", "--car", "free", "--step", "hand", "--out", str(tmp_path)]
    monkeypatch.setattr("sys.argv", words)
    run.main()
    found = json.loads(Path(tmp_path, "free.hand.json").read_text())
    assert min(found["starts"]) > 0
    assert found["rising"]["lateral"][2] < found["linear"]["lateral"][2]
    assert "| free | hand, brush |" in capsys.readouterr().out
    monkeypatch.setitem(run.STEPS, "hand", None)
    run.main()
    assert "1/1" not in capsys.readouterr().out
