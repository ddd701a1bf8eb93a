"""Changes that are irrelevant to the tire change no verdict: the order of rows, the
seed, last digits, another run that agrees. On synthetic runs and six measured logs."""

from pathlib import Path

import numpy as np
import pytest
from test_left_out import LIBRARY, RIG, logs

import tirefit
from tirefit.data.read import read_frame
from tirefit.diagnosis.diagnose import diagnose

MEASURED = Path(__file__).parents[2] / "fits" / "dart_rear_axle" / "six_logs.csv"
CLOSE = 0.02
"""Largest change of a closure that counts as none."""


def columns_of(name):
    if name == "synthetic":
        return logs(3, rows=80), RIG
    data = tirefit.read(MEASURED)
    runs = np.array(data.runs)[data.run]
    return {**data.columns, "run": runs}, None


def shuffled(columns):
    order = np.random.default_rng(0).permutation(len(columns["time"]))
    return {name: values[order] for name, values in columns.items()}


def moved(columns):
    """All numbers changed by a relative 1e-9."""
    generator = np.random.default_rng(0)
    return {
        name: values * (1 + 1e-9 * generator.standard_normal(len(values)))
        if values.dtype.kind == "f" and name != "time"
        else values
        for name, values in columns.items()
    }


def only(columns, count):
    """The first runs, in the order of the file."""
    kept = list(dict.fromkeys(columns["run"]))[:count]
    rows = np.isin(columns["run"], kept)
    return {name: values[rows] for name, values in columns.items()}


@pytest.fixture(scope="module")
def found():
    """Diagnosis of a data set with some change."""
    known = {}

    def find(name, change=None, seed=0, count=None):
        key = name, change, seed, count
        if key not in known:
            columns, rig = columns_of(name)
            columns = only(columns, count) if count else columns
            columns = change(columns) if change else columns
            library = LIBRARY if name == "synthetic" else None
            data = read_frame(columns, name)
            known[key] = diagnose(data, rig=rig, effects=library, seed=seed)
        return known[key]

    return find


def closures(found):
    """Closure on the fitted rows, on the held-out rows, and by effect."""
    held = found.gap.holdout.closed if found.gap.holdout else None
    each = [one.closed_left_out for one in found.verdict.each.values()]
    steps = [step.closed for step in found.ladder.steps]
    return np.array([found.gap.closed, held, *each, *steps], float)


CHANGES = {"order": (shuffled, 0), "digits": (moved, 0), "seed": (None, 5)}


@pytest.mark.parametrize(
    ("name", "change"),
    [
        *(("synthetic", change) for change in ("order", "seed")),
        pytest.param("synthetic", "digits", marks=pytest.mark.long),
        *(pytest.param("measured", change, marks=pytest.mark.long) for change in CHANGES),
    ],
)
def test_stored_verdicts_are_reproduced(found, name, change):
    plain, other = found(name), found(name, *CHANGES[change])
    assert other.verdict.status == plain.verdict.status
    assert other.effects == plain.effects
    assert other.verdict.also_possible == plain.verdict.also_possible
    np.testing.assert_allclose(closures(other), closures(plain), atol=CLOSE)


@pytest.mark.long
def test_six_measured_logs_name_the_slip_offset(found):
    """Fourteen standard errors by hand, the same in every run."""
    of = found("measured")
    assert "slip_offset" in of.effects
    (size,) = (
        amplitude.value
        for name, amplitude in of.candidates[0].parameters.items()
        if name.startswith("slip_offset:")
    )
    assert size == pytest.approx(-9.7e-3, abs=2e-3)
    assert of.ladder.on == "6 runs left out in turn"


@pytest.mark.long
@pytest.mark.parametrize("count", [4, 5])
def test_an_agreeing_log_removes_no_name(found, count):
    """For nested subsets of the measured logs."""
    fewer = found("measured", count=count)
    more = found("measured", count=count + 1 if count < 5 else None)
    assert ("slip_offset" in more.effects) or ("slip_offset" not in fewer.effects)
