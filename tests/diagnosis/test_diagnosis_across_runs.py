"""Effects chosen by what carries over to a run that was left out."""

import numpy as np
import pytest
from conftest_diagnosis import brush
from scipy.stats import t
from tirefit.diagnosis.decide.across_runs import chosen_across_runs

from fits.dart_rear_axle import logs_left_out
from tirefit.data.read import read_frame
from tirefit.diagnosis.decide import across_runs
from tirefit.diagnosis.decide.verdict import Verdict, Weighed
from tirefit.diagnosis.effects import EFFECTS, effects_by_id
from tirefit.diagnosis.engine import diagnose
from tirefit.diagnosis.evidence.search import Hypothesis
from tirefit.diagnosis.rows.rig import Rig

KNOWN = effects_by_id(EFFECTS)
EMPTY = np.zeros(0)
NAMES = [(), ("a",), ("b",), ("a", "b")]


def test_the_smallest_set_that_is_as_good_as_the_best_carries_over():
    # b only helps on one of four runs; a on all of them.
    losses = np.array([
        [9.0, 1.0, 8.0, 0.2], [9.5, 1.2, 9.4, 1.3], [8.0, 0.9, 8.1, 1.0],
        [9.0, 1.1, 9.2, 1.2],
    ])  # fmt: skip
    found = chosen_across_runs(NAMES, losses, np.zeros(4))
    assert found.effects == ("a",) and found.also == ()
    gained = losses[:, 0] - losses[:, 1]
    score = gained.mean() / (gained.std(ddof=1) / 2)
    assert found.probability == pytest.approx(t.cdf(score, 3))
    # Twice as good on every run is better, however few there are.
    losses[:, 3] = losses[:, 1] / 2
    assert chosen_across_runs(NAMES, losses, np.zeros(4)).effects == ("a", "b")
    # One that gains on one run and loses on the next is none.
    losses[:, 1] = losses[:, 0] + np.array([-8.0, 9.0, -7.0, 7.0])
    losses[:, 2:] = losses[:, [1]] + 0.1
    assert chosen_across_runs(NAMES, losses, np.zeros(4)).effects == ()


def test_what_two_sets_do_alike_is_said():
    losses = np.array([[9.0, 1.0, 1.1, 2.0], [8.0, 1.1, 1.0, 2.0], [9.0, 1.0, 1.0, 2]])
    found = chosen_across_runs(NAMES, losses, np.zeros(4))
    assert {found.effects, *found.also} == {("a",), ("b",)}
    # Then the usual goes before the rare.
    rare = chosen_across_runs(NAMES, losses, np.array([0.0, -1.0, 0.0, 0.0]))
    assert rare.effects == ("b",) and rare.also == (("a",),)


def test_what_one_run_alone_shows_does_not_name_an_effect():
    """A zero off on all five runs, and on one of them a wave that friction imitates."""
    generator, blocks = np.random.default_rng(2), []
    for number in range(5):
        time = np.arange(150) * 0.1
        slip = 0.16 * np.sin(0.9 * time + number)
        v = np.full(150, 10.0 + 3 * number)
        force = brush(slip + 0.006, 5e4, 0.9 - 0.15 * (number == 4), 4000.0)
        force = force + 60 * np.sin(40 * slip + number)
        force = force + 20 * generator.standard_normal(150)
        blocks.append([time + 20 * number, np.arctan(slip), force, v, 0 * v + number])
    time, alpha, fy, v, run = np.concatenate(blocks, axis=1)
    frame = {"time": time, "alpha": alpha, "fy": fy, "fz": 0 * v + 4000, "v": v}
    frame["run"] = np.array([f"r{k:.0f}" for k in run])
    kept = ("slip_offset", "friction_speed_linear", "friction_drift", "speed_zero")
    found = diagnose(
        read_frame(frame), rig=Rig(noise={"fy": 20.0, "alpha": 1e-4}),
        effects=[KNOWN[name] for name in kept],
    )  # fmt: skip
    assert found.effects == ("slip_offset",)
    assert found.candidates[0].effects == ("slip_offset",)
    (zero,) = found.candidates[0].parameters.values()
    assert zero.value == pytest.approx(0.006, rel=0.25)
    held = found.gap.holdout
    assert held.on == "each of 5 runs, left out of both fits in turn"
    assert 0.1 < held.closed < 0.9
    assert held.closed_ci[0] < held.closed < held.closed_ci[1]


def test_equal_runs_do_not_name_what_only_draws_a_dead_band():
    """Five equal sweeps of a slip that has a dead band: each predicts the next, with
    whatever set draws it best."""
    generator, blocks = np.random.default_rng(8), []
    for number in range(5):
        time = np.arange(160) * 0.05
        slip = 0.08 - 0.1 * np.cos(2 * np.pi * time / 8.0)
        dead = np.sign(slip) * np.maximum(np.abs(slip) - 0.003, 0.0)
        fz = 4000 + 150 * np.sin(0.7 * time + number)
        force = brush(dead, 5e4, 0.9, fz) + 40 * generator.standard_normal(160)
        blocks.append([time + 60 * number, slip, force, fz, 0 * time + number])
    time, slip, force, fz, run = np.concatenate(blocks, axis=1)
    frame = {"time": time, "sigma_x": slip, "fx": force, "fz": fz}
    frame["v"], frame["run"] = 0 * time + 15, np.array([f"r{k:.0f}" for k in run])
    found = diagnose(
        read_frame(frame, convention="braking"), rig=Rig(noise={"fx": 40.0})
    )
    # Carcass and pressure together leave nothing that a test sees.
    assert found.verdict.status in ("unknown", "incomplete")
    assert found.verdict.left.unlisted > 0.5 and len(found.effects) == 1


@pytest.mark.parametrize(
    ("carried", "status", "effects"),
    [
        (("a", "b", "c"), "incomplete", ("a", "b")),
        (("b", "c"), "incomplete", ("b",)),
        (("a", "c"), "unknown", ("unknown",)),  # alone it was not refitted
        (("c",), "unknown", ("unknown",)),
    ],
)
def test_runs_take_names_away_beside_something_unlisted(carried, status, effects):
    nothing, *_ = sets = [
        Hypothesis((), key, 0.0, 0.0, EMPTY, EMPTY, np.zeros((0, 0)), 0.0)
        for key in ((), ("b",), ("a", "b"))
    ]
    weighed = Weighed(
        sets={}, best_of={one.effects: one for one in sets}, unknown_alone=0.2,
        unknown_beside={}, other_form=frozenset(), evidence={}, log_weight={},
        log_beside={}, hidden=0.0, gains={},
    )  # fmt: skip
    verdict = Verdict("incomplete", ("a", "b"), 0.4, (), 0.0, sets[-1], unlisted=0.8)
    found = across_runs._carried_beside(verdict, weighed, carried)
    assert found.chosen is (
        nothing if status == "unknown" else weighed.best_of[effects]
    )
    assert (found.status, found.effects) == (status, effects)


def test_the_floor_under_the_axle_is_that_of_its_readme():
    """Repeats of one state on logs of one day and another, and the tracker's noise."""
    tire, turning = (
        logs_left_out.repeats(),
        logs_left_out.repeats(logs_left_out.TURNING),
    )
    assert tire["one log"] == pytest.approx(0.09, abs=0.005)
    assert tire["two logs"] == pytest.approx(0.20, abs=0.01)
    assert tire["pairs of two logs"] == 133
    assert turning["one log"] == pytest.approx(0.03, abs=0.005)
    noise = logs_left_out.tracker_noise()
    assert noise["alpha"] == pytest.approx(4e-5, rel=0.1)
    assert noise["fy"] == pytest.approx(8e-4, rel=0.1)
