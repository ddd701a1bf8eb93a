"""Held-out data: the partition, predictions by refits, the ladder, the search."""

import numpy as np
import pytest
from conftest_diagnosis import brush, refitted
from scipy.optimize import least_squares

from fits.dart_rear_axle import logs_left_out
from tirefit.data.read import read_frame
from tirefit.diagnosis.diagnose import diagnose
from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.engine.left_out import predicted
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.runs import folds_of
from tirefit.diagnosis.rows.subject import fit_base

RIG, STD = Rig(noise={"fy": 20.0, "alpha": 1e-6}), 20.0
FEW = (
    "slip_offset",
    "force_offset",
    "friction_speed_linear",
    "friction_drift",
    "speed_zero",
    "load_friction",
)
LIBRARY = tuple(effect for effect in EFFECTS if effect.id in FEW)
OFFSET, RISE = 0.006, 0.05


def logs(count, rows=90, seed=2):
    """Runs of one car: a slip offset, friction that rises with the sliding speed."""
    blocks = []
    for number in range(count):
        generator = np.random.default_rng([seed, number])
        time = np.arange(rows) * 0.1
        slip = 0.16 * np.sin(0.9 * time + number)
        v = 8.0 + 3 * number % 14 + 2 * np.sin(0.4 * time)
        mu = 0.9 * (1 + RISE * v * np.abs(slip))
        force = brush(slip + OFFSET, 5e4, mu, 4000.0)
        force = force + STD * generator.standard_normal(rows)
        blocks.append([time + 20 * number, np.arctan(slip), force, v, 0 * v + number])
    time, alpha, fy, v, run = np.concatenate(blocks, axis=1)
    frame = {"time": time, "alpha": alpha, "fy": fy, "fz": 0 * v + 4000, "v": v}
    return frame | {"run": np.array([f"r{k:.0f}" for k in run])}


def prepared(frame):
    return prepare(read_frame(frame, "logs"), RIG, ("fy",))


def based(frame):
    return fit_base(prepared(frame), "brush", LIBRARY, RIG)


@pytest.fixture(scope="module")
def five():
    return based(logs(5))


@pytest.mark.parametrize("count", [4, 5])
def test_whole_runs_are_left_out_where_there_are_four(count):
    """Another run is too short to be informative: its rows are always fitted."""
    first = np.arange(90 * count + 4)
    rows = prepared({name: x[first] for name, x in logs(count + 1).items()})
    folds = folds_of(rows, 1.0)
    assert folds.number == count
    assert folds.on == f"{count} runs left out in turn"
    for fold in range(count):
        (run,) = set(rows.run[folds.code == fold])
        np.testing.assert_array_equal(folds.code == fold, rows.run == run)
    assert set(rows.run[folds.code == -1]) == {count}


@pytest.mark.parametrize(("count", "across_runs"), [(1, True), (3, True), (5, False)], ids=str)
def test_consecutive_rows_are_left_out_together(count, across_runs):
    """With fewer runs, or if an effect belongs to a single one."""
    rows = prepared(logs(count))
    folds = folds_of(rows, 1.0, across_runs)
    order = np.lexsort((rows.time, rows.run))
    assert "runs" not in folds.on and np.all(folds.code >= 0)
    assert np.all(np.diff(folds.code[order]) >= 0)
    assert np.ptp(np.bincount(folds.code)) <= 1 and folds.number >= 7
    assert folds.on == f"{folds.number} blocks of time left out in turn"
    # A block is several times as long as the noise remembers.
    for rows_each in (5.0, 20.0, 1e3):
        long = folds_of(rows, rows_each, across_runs)
        sizes = np.bincount(long.code)
        assert long.number == 2 or sizes.min() >= 4 * rows_each - 1


@pytest.mark.parametrize("loads", [(4e3,), (2e3, 4e3, 6e3)])
def test_without_time_settings_or_parts_of_the_slip_are_left_out(loads):
    slip = np.tile(np.linspace(-0.2, 0.2, 60), len(loads))
    fz = np.repeat(loads, 60)
    rows = prepared({"alpha": slip, "fy": brush(slip, 5e4, 0.9, fz), "fz": fz})
    folds = folds_of(rows, 1.0)
    assert np.all(folds.code >= 0) and np.bincount(folds.code).min() >= 12
    if len(loads) > 1:
        assert folds.on == "3 settings of load and speed left out in turn"
        assert all(np.ptp(fz[folds.code == k]) == 0 for k in range(3))
    else:
        assert folds.on == "5 parts of the slip range left out in turn"
        # No part is one end of the slip: each has rows on both sides of others.
        assert all(np.ptp(slip[folds.code == k]) > 0.15 for k in range(5))


def by_scipy(base, fold, codes, with_offset):
    """Loss of a fold and the offset [1], by SciPy's refit to the other rows."""
    slip, force = base.rows.slip, base.rows.observed["fy"]
    scale = np.asarray(base.design.scale["fy"])[: base.rows.n]
    keep = np.asarray(base.design.keep)[: base.rows.n] > 0
    names = [atom.effect.id for atom in base.atoms]
    prior = float(base.priors.scale[names.index("slip_offset")])

    def missed(x):
        shift = x[2] * prior * with_offset
        return force - brush(slip + shift, 5e4 * x[0], 0.9 * x[1], base.rows.inputs.fz)

    def residual(x):
        inside = keep & (codes != fold)
        return np.append((missed(x) / scale)[inside], x[2])

    found = least_squares(residual, [1.0, 1.0, 0.0], xtol=1e-12, ftol=1e-12).x
    left = missed(found)[keep & (codes == fold)]
    return np.mean(left**2), found[2]


def test_losses_agree_with_refits_without_the_fold(five):
    """With no effect, and with the offset and its prior of one prior scale."""
    folds = folds_of(five.rows, 1.0)
    none, offset = refitted(five), refitted(five, "slip_offset")
    found = predicted(five, [none, offset], none, folds)
    assert [*found.sets] == [(), ("slip_offset",)] and found.folds is folds
    plain, shifted = found.sets.values()
    for fold in range(folds.number):
        for has_offset, of in enumerate((plain, shifted)):
            loss, size = by_scipy(five, fold, folds.code, bool(has_offset))
            # By one linear step from the fit of all runs.
            assert of.loss[fold] == pytest.approx(loss, rel=0.01)
        assert shifted.amplitude[fold, 0] == pytest.approx(size, rel=0.01)
    # The noise is one number here, but for that of the slip.
    np.testing.assert_allclose(plain.whitened, plain.loss * found.rows / STD**2, rtol=1e-4)
    assert np.sum(found.rows) == np.sum(np.asarray(five.design.keep) > 0)


def test_a_smooth_remainder_is_predicted_down_to_the_noise(five):
    folds = folds_of(five.rows, 1.0)
    none = refitted(five)
    found = predicted(five, [none], none, folds)
    assert 0.8 * STD**2 < np.mean(found.smooth.loss) < 0.5 * np.mean(found.sets[()].loss)


TRUE = {"slip_offset", "friction_speed_linear"}


@pytest.mark.parametrize("count", [4, pytest.param(6, marks=pytest.mark.long)])
def test_a_diagnosis_names_the_effects_of_the_search(count):
    found = diagnose(read_frame(logs(count), "logs"), rig=RIG, effects=LIBRARY)
    assert set(found.effects) == TRUE
    assert found.ladder.on == f"{count} runs left out in turn"
    rms = [step.rms_left_out for step in found.ladder.steps]
    assert rms[0] > rms[1] > rms[2] and rms[2] == pytest.approx(STD, rel=0.1)
    assert rms[-1] == pytest.approx(STD, rel=0.1)
    assert found.gap.holdout.on == found.ladder.on
    assert found.gap.holdout.closed == found.ladder.steps[2].closed > 0.8
    for each in found.verdict.each.values():
        assert each.closed_left_out > 3 * each.closed_left_out_std


@pytest.mark.long
def test_the_repeatability_of_the_axle_agrees_with_its_readme():
    """Repeats of one state on the same day and on another, and the tracker's noise."""
    tire = logs_left_out.repeats()
    turning = logs_left_out.repeats(logs_left_out.TURNING)
    assert tire["one log"] == pytest.approx(0.09, abs=0.005)
    assert tire["two logs"] == pytest.approx(0.20, abs=0.01)
    assert tire["pairs of two logs"] == 133
    assert turning["one log"] == pytest.approx(0.03, abs=0.005)
    noise = logs_left_out.tracker_noise()
    assert noise["alpha"] == pytest.approx(4e-5, rel=0.1)
    assert noise["fy"] == pytest.approx(8e-4, rel=0.1)
