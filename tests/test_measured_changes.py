"""The measured changes: data, split, values by hand, and how a line is judged."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from fits.measured_changes import by_hand, run
from fits.measured_changes.cases import CASES, CHOOSING, JUDGING, Case
from fits.measured_changes.logs import Logs, data, table

FOR_CHOOSING = {"circles", "free", "a"}
HAND = json.loads(by_hand.FILE.read_text())
BY_NAME = {case.name: case for case in CASES}


def test_cases_use_the_logs_of_their_split():
    """Cases for choosing use only the logs for choosing; names are unique."""
    assert len(BY_NAME) == len(CASES)
    for case in CASES:
        fitted = case.fitted_on.of if case.fitted_on else ()
        seen = {*case.logs.of, *fitted}
        assert (seen <= FOR_CHOOSING) == (case.use == CHOOSING), case.name
        assert case.named or case.never or case.change, case.name
    assert {case.use for case in CASES} == {CHOOSING, JUDGING}


def test_the_values_by_hand_cover_every_case():
    assert list(HAND) == [case.name for case in CASES]
    for case in CASES:
        hand = HAND[case.name]
        assert hand["rms"][hand["best"]] <= hand["rms"][""]
        assert ("plain" in hand) == (case.fitted_on is not None)


@pytest.fixture(scope="module")
def six():
    return table(BY_NAME["dart_six"].logs)


def test_six_logs_agree_with_hand_calculation(six):
    """SciPy on held-out runs: nothing, the slip offset, and rising friction with it."""
    on, parts = by_hand.folds(six)
    assert (on, len(six["fy"])) == (HAND["dart_six"]["on"], 2389)
    assert sum(part.sum() for part in parts) == len(six["fy"])
    for names in ((), ("slip_offset",), ("slip_offset", "friction_speed_linear")):
        found = by_hand.rms_left_out(names, six, parts)
        assert found == pytest.approx(HAND["dart_six"]["rms"]["+".join(names)], rel=1e-3)
    assert by_hand.fitted(("slip_offset",), six)[2] == pytest.approx(-9.7e-3, abs=2e-4)
    assert data(six, "six").n == 2389


def _zero(logs):
    return by_hand.fitted(("slip_offset",), table(logs))[2]


def _delay(logs):
    return by_hand.fitted(("steering_delay",), table(logs))[2]


@pytest.mark.parametrize(
    "change, measure, moved",
    [
        ({"vehicle": {"sideslip_offset": 0.02}}, _zero, -0.02),
        ({"axle": "front", "late": {"delta": 0.05}}, _delay, -0.05),
    ],
)
def test_inserted_changes_are_found(change, measure, moved):
    """A change of one log of set A changes SciPy's estimate by its own size."""
    plain = {key: change[key] for key in ("axle",) if key in change}
    logs = {"of": ("a",), "only": ("a_0",), "every": 10}
    found = measure(Logs(**logs, **change)) - measure(Logs(**logs, **plain))
    assert found == pytest.approx(moved, rel=0.1)


def test_a_delayed_force_and_a_wrong_load_are_found():
    logs = {"of": ("a",), "only": ("a_1",), "every": 10}
    plain = table(Logs(**logs))
    changed = table(Logs(**logs, late={"fy": 0.05}, scaled={"fz": 0.8}))
    np.testing.assert_allclose(changed.columns["fz"], 0.8 * plain.columns["fz"])
    rows = np.flatnonzero(changed.kept)
    np.testing.assert_allclose(changed["fy"], plain.columns["fy"][rows - 5])
    parts = [table(Logs(**logs, part=part)) for part in ("odd", "even")]
    assert sum(len(part["fy"]) for part in parts) == len(plain["fy"])


TRUTH = {"plain": [90.0, 0.5], "values": [80.0, 0.48, 0.1], "best": "parameters+x"}


def _mu(measured, differs=True):
    said = {"simulated": 0.8, "measured": measured, "std": 0.02, "differs": differs}
    return {"mu": said}


@pytest.mark.parametrize(
    "known, said, right",
    [
        ({"named": ("x.*",)}, {"named": ["x_one"]}, "right"),
        ({"named": ("x.*",)}, {"said": ["x_one"]}, "said"),
        ({"named": ("x", "z")}, {"named": ["x"], "said": ["y"]}, "wrong"),
        ({"never": "x|z"}, {"named": ["y", "z"]}, "wrong"),
        ({"never": "x|z"}, {"named": ["unknown"]}, "right"),
        ({"change": {"mu": True}}, {"parameters": _mu(0.53)}, "right"),
        ({"change": {"mu": True}}, {"parameters": _mu(0.55)}, "wrong"),
        ({"change": {"mu": True}}, {"parameters": _mu(0.53, False)}, "wrong"),
        ({"change": {"mu": False}}, {"parameters": _mu(0.55)}, "wrong"),
        ({"change": {"mu": False}}, {"parameters": _mu(0.79, False)}, "right"),
    ],
)
def test_lines_are_judged_by_the_stated_rules(known, said, right):
    case = Case("case", "a", CHOOSING, Logs(("a",)), "", **known)
    line = {"named": [], "said": [], "parameters": {}} | said
    assert run.judged(line, case, TRUTH)[0] == right


def test_halves_of_a_log_share_no_rows_and_miss_none():
    """The diagnosed rows of the two halves, against those of the whole."""
    case = next(c for c in CASES if c.name == "dart_later")
    even, odd, whole = (
        set(np.flatnonzero(table(c.logs).kept)) for c in (*run.halves_of(case), case)
    )
    assert not even & odd and even | odd == whole


def test_rms_of_the_ladder_is_right():
    """The longest step within the names; None if the tool has no ladder."""
    rms = {(): 0.6, ("x",): 0.3, ("x", "y"): 0.2, ("anything smooth",): 0.15, ("n",): 0}
    steps = [SimpleNamespace(effects=k, rms_left_out=v) for k, v in rms.items()]
    for named, expected in ((("x", "y"), 0.2), (("x", "z"), 0.3), ((), 0.6)):
        found = SimpleNamespace(
            verdict=SimpleNamespace(helping=named), ladder=SimpleNamespace(steps=steps)
        )
        assert run.of_ladder(found) == (0.6, expected)
    found.ladder.steps = []
    assert run.of_ladder(found) is None
