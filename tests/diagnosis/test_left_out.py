"""Held-out data: the partition, predictions by refits, the ladder, the search."""

import numpy as np
import pytest
from conftest_diagnosis import brush, refitted
from scipy.optimize import least_squares

from fits.dart_rear_axle import logs_left_out
from tirefit.data.read import read_frame
from tirefit.diagnosis.decide.verdict import POLICY
from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.engine import diagnose
from tirefit.diagnosis.evidence.base import fit_base
from tirefit.diagnosis.evidence.search import search
from tirefit.diagnosis.left_out import (
    NOISE,
    SMOOTH,
    Folds,
    Predicted,
    climbed,
    folds_of,
    gained,
    jackknife_error,
    ladder_of,
    predicted,
)
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig

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
    assert folds.across_runs and folds.number == count
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
    assert not folds.across_runs and np.all(folds.code >= 0)
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
    prior = float(base.design.prior_scale[names.index("slip_offset")])

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
    found = predicted(five, [none, offset], folds)
    assert found.effects == ((), ("slip_offset",))
    assert found.on == folds.on and found.across_runs
    for fold in range(folds.number):
        for k in (0, 1):
            loss, size = by_scipy(five, fold, folds.code, bool(k))
            assert found.loss[fold, k] == pytest.approx(loss, rel=1e-3)
        assert found.amplitude[1][fold, 0] == pytest.approx(size, rel=1e-3)
    # The noise is one number here, but for that of the slip.
    rows = found.rows[:, None]
    np.testing.assert_allclose(found.whitened, found.loss * rows / STD**2, rtol=1e-4)
    assert np.sum(found.rows) == np.sum(np.asarray(five.design.keep) > 0)


def test_a_smooth_remainder_is_predicted_down_to_the_noise(five):
    folds = folds_of(five.rows, 1.0)
    found = predicted(five, [refitted(five)], folds)
    assert np.mean(found.smooth) < 0.5 * np.mean(found.loss[:, 0])
    assert np.mean(found.smooth) > 0.8 * STD**2


def drawn(seed=0, parts=6):
    """Losses of four sets with the truth a + b: (Predicted, floor)."""
    generator = np.random.default_rng(seed)
    sets, truth = ((), ("a",), ("b",), ("a", "b")), np.array([900.0, 400, 700, 150])
    loss = truth * generator.uniform(0.7, 1.3, (parts, 4))
    rows = generator.integers(20, 90, parts)
    return Predicted(
        "6 parts",
        True,
        sets,
        loss,
        loss * rows[:, None] / 100,
        rows,
        tuple(np.ones((parts, len(s))) for s in sets),
        loss[:, 3] - 20,
    ), 100.0


def closed_by_hand(after, before, rows, floor):
    gap, left = (np.average(x, weights=rows) - floor for x in (before, after))
    return 1 - np.sqrt(left / gap)


@pytest.mark.parametrize("seed", range(3))
def test_a_gain_and_its_error_agree_with_a_loop_over_the_parts(seed):
    out, floor = drawn(seed)
    gain = gained(out, 1, 0, floor)
    each = [out.whitened[f, 0] - out.whitened[f, 1] for f in range(6)]
    assert gain.gain == pytest.approx(sum(each)) and gain.parts == 6
    # A sum of six independent parts.
    assert gain.std == pytest.approx(np.sqrt(6) * np.std(each, ddof=1))
    closed, one_less = closed_by_hand(*out.loss[:, [1, 0]].T, out.rows, floor), []
    for f in range(6):
        kept = [k for k in range(6) if k != f]
        of = out.loss[np.ix_(kept, [1, 0])].T
        one_less.append(closed_by_hand(*of, out.rows[kept], floor))
    assert gain.closed == pytest.approx(closed)
    jackknife = np.sqrt(5 / 6 * np.sum((one_less - np.mean(one_less)) ** 2))
    assert gain.closed_std == pytest.approx(jackknife)


def test_the_ladder_descends_from_no_effect_to_the_noise():
    out, floor = drawn()
    ladder = ladder_of(out, ("a", "b"), floor)
    names = [step.effects for step in ladder.steps]
    assert names == [(), ("a",), ("a", "b"), SMOOTH, NOISE] and ladder.on == "6 parts"
    squares = [step.rms_left_out**2 for step in ladder.steps]
    assert squares == sorted(squares)[::-1] and squares[-1] == pytest.approx(floor)
    # Each step gains what the rms falls by; the last two against the last set.
    gains = [step.gain for step in ladder.steps]
    falls = [0, *(-np.diff(squares[:4])), squares[2] - squares[4]]
    np.testing.assert_allclose(gains, falls, atol=1e-9)
    assert ladder.steps[0].closed == 0 and ladder.steps[-1].closed == 1
    assert 0 < ladder.steps[1].closed < ladder.steps[2].closed < 1
    # Neither a set without a refit nor an unnamed one is a step.
    less = out._replace(effects=((), ("a",), ("c",), ("a", "b")))
    assert [s.effects for s in ladder_of(less, ("a", "b"), floor).steps] == names
    assert [s.effects for s in ladder_of(out, (), floor).steps] == [(), SMOOTH, NOISE]


@pytest.fixture(scope="module")
def ends():
    """The result of the search on the first runs of one set of logs."""
    known = {}

    def end(count):
        if count not in known:
            base = based(logs(count))
            found = search(base, range(len(base.atoms)))
            folds = folds_of(base.rows, 1.0)
            known[count] = base, found, climbed(base, found, folds, POLICY.gain)
        return known[count]

    return end


TRUE = {"slip_offset", "friction_speed_linear"}


@pytest.mark.parametrize("count", [3, 5])
def test_the_search_finds_the_effects_of_every_run(ends, count):
    """Another run that agrees removes no name."""
    base, found, end = ends(count)
    assert set(end.effects) == TRUE
    sizes = base.amplitudes(end.atoms, end.amplitude)
    (offset,) = (sizes[k] for k in end.atoms if base.atoms[k].effect.id[:4] == "slip")
    assert offset == pytest.approx(OFFSET, rel=0.15)
    # Every set on the way is among those of the search.
    assert end.atoms in found.tried and found.tried[end.atoms].refitted


def test_a_search_without_sufficient_gain_finds_no_effect(ends):
    base, found, _ = ends(5)
    folds = folds_of(base.rows, 1.0)
    assert climbed(base, found, folds, 1e3).effects == ()


def test_the_search_rejects_an_effect_of_one_run():
    """Friction is a third lower in one of five runs: it is not an effect of all runs, and
    the offset that all have is kept."""
    frame = logs(5)
    odd = frame["run"] == "r4"
    slip = np.tan(frame["alpha"])
    low = brush(slip + OFFSET, 5e4, 0.6 * (1 + RISE * frame["v"] * np.abs(slip)), 4e3)
    noise = frame["fy"] - brush(
        slip + OFFSET, 5e4, 0.9 * (1 + RISE * frame["v"] * np.abs(slip)), 4e3
    )
    base = based(frame | {"fy": np.where(odd, low + noise, frame["fy"])})
    found = search(base, range(len(base.atoms)))
    end = climbed(base, found, Folds(base.rows.run, "", True), POLICY.gain)
    assert set(end.effects) <= TRUE and "slip_offset" in end.effects


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


def test_jackknife_error_of_a_mean_is_its_standard_error():
    """For a mean the jackknife is exact: the sample deviation over the root of n."""
    sample = np.random.default_rng(4).normal([3.0, -1.0], [0.2, 5.0], (7, 2))
    means = [np.delete(sample, k, axis=0).mean(axis=0) for k in range(7)]
    np.testing.assert_allclose(jackknife_error(means), sample.std(axis=0, ddof=1) / np.sqrt(7))
