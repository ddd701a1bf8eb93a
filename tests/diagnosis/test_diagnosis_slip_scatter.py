"""The undeclared noise of a slip, from the scatter of the forces."""

import numpy as np
import pytest
from conftest_diagnosis import brush

from tirefit.data.read import read_frame
from tirefit.diagnosis.diagnose import diagnose
from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.rows.noise import between, noise_in_motion, slip_scatter
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.subject import shown_slip_noise
from tirefit.fitting.estimate import fit

ROWS, NOISE = 600, 0.002
LOADS = np.repeat([2000.0, 4000.0, 6000.0], ROWS // 3)
TIME = np.arange(ROWS)
FEW = [e for e in EFFECTS if e.id in ("slip_offset", "force_offset", "load_friction")]


def shown(seed, slip_noise, own=0.005 * LOADS, off=0.0):
    """Steady points in random order, fitted by the true curve."""
    generator = np.random.default_rng(seed)
    slip = generator.uniform(0, 0.15, ROWS)
    measured = slip + slip_noise * generator.normal(size=ROWS)
    curve = lambda x: brush(x, 5e4, 0.9, LOADS)  # noqa: E731
    force = curve(slip + off) + own * generator.normal(size=ROWS)
    steepness = ((curve(slip + 1e-5) - curve(slip - 1e-5)) / 2e-5) ** 2
    cells = [np.flatnonzero(load == LOADS) for load in np.unique(LOADS)]
    by_slip = [rows[np.argsort(measured[rows])] for rows in cells]
    return slip_scatter(force - curve(measured), steepness, LOADS, by_slip, [TIME])


def test_scatter_at_steep_slopes_gives_the_slip_noise():
    found = [shown(seed, NOISE) for seed in range(10)]
    assert np.mean(found) == pytest.approx(NOISE, rel=0.1)
    assert np.std(found) < 0.15 * NOISE


def test_the_noise_of_a_slip_that_moves_is_what_its_forces_do_not_follow():
    """Of 2 mrad beside a motion of 10 mrad from row to row. Its variance is known to 4 %."""
    generator, count = np.random.default_rng(0), 20_000
    noise, moved, force = generator.normal(size=(3, count)) * [[0.002], [0.01], [20.0]]
    slope = 5e4 * np.exp(0.5 * generator.normal(size=count))
    off = between(noise + moved, [np.arange(count)])
    found = noise_in_motion(force - slope * noise, slope, off, np.hypot(0.002, 0.01))
    assert found == pytest.approx(0.002, rel=0.08)


@pytest.mark.parametrize("growing", [0.0, 0.01])
def test_force_noise_alone_gives_no_slip_noise(growing):
    own = 20 + growing * LOADS
    found = [shown(seed, 0.0, own) for seed in range(40)]
    assert np.count_nonzero(found) <= 2
    assert max(found) < NOISE / 2


def test_a_drifting_slip_offset_is_not_taken_for_noise():
    """Neighbours in slip scatter by it, but neighbours in time have the same error."""
    drift = NOISE * np.sqrt(2) * np.sin(2 * np.pi * TIME / 300)
    found = [shown(seed, 0.0, off=drift) for seed in range(10)]
    assert np.mean(found) < 0.6 * NOISE


def steady(seed, slip_noise):
    generator = np.random.default_rng(seed)
    slip = generator.uniform(-0.12, 0.12, ROWS)
    fz = generator.permutation(LOADS)
    force = brush(slip, 5e4, 0.9, fz) + 0.01 * fz * generator.normal(size=ROWS)
    slip = slip + slip_noise * generator.normal(size=ROWS)
    return {"time": 0.5 * TIME, "sigma_x": slip, "fx": force, "fz": fz}


@pytest.mark.parametrize(
    ("seed", "effects"),
    [(1, FEW), *(pytest.param(k, EFFECTS, marks=pytest.mark.long) for k in (1, 2))],
    ids=["few effects", "all effects", "all effects, another seed"],
)
def test_undeclared_slip_noise_gives_no_gap(seed, effects):
    noise = 2 * NOISE
    found = diagnose(read_frame(steady(seed, noise)), effects=effects)
    assert found.verdict.status == "none"
    assert found.noise.slip == pytest.approx(noise, rel=0.15)
    assert found.noise.slip_source == "scatter where the force is steep"
    # What was stated stays as it was, or a resumed run would take it for another.
    assert found.settings.rig == Rig()


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_a_slip_offset_is_not_taken_for_slip_noise(seed):
    """With a kink at zero slip, a shifted curve scatters there from row to row."""
    generator = np.random.default_rng(seed)
    slip, fz = np.tile(np.linspace(-0.2, 0.2, 32), 3), np.repeat(LOADS[::200], 32)
    force = brush(slip + 0.006, 5e4, 0.9, fz) + 20 * generator.normal(size=96)
    rig = Rig(noise={"fx": 20.0})
    found = diagnose(read_frame({"sigma_x": slip, "fx": force, "fz": fz}), rig=rig, effects=FEW)
    assert found.effects == ("slip_offset",)
    assert found.noise.slip == 0


def test_stated_slip_noise_is_not_estimated():
    columns = steady(1, 2 * NOISE)
    stated = read_frame(columns | {"sigma_x_std": np.full(ROWS, 0.001)})
    prepared = prepare(stated, Rig(), ("fx",))
    assert shown_slip_noise(prepared, "brush", EFFECTS, Rig()) is None
    assert np.all(prepared.slip_std == 0.001)
    assert "sigma_x_std" in prepared.slip_source


def driven(seed, steps, noise=0.0, own=40.0, rows=ROWS, effect=0.0, period=np.inf):
    """A slip angle that goes up and down at 20 Hz with independent steps on it, measured
    with white ``noise``; a force that follows all of the slip, with noise ``own`` [N] and
    a friction of 0.9 that changes by 12 % with a ``period`` [s]."""
    generator = np.random.default_rng(seed)
    time, load = np.arange(rows) / 20, np.full(rows, 4000.0)
    alpha = 0.15 * np.sin(1.3 * time) + steps * generator.normal(size=rows)
    friction = 0.9 * (1 + 0.12 * np.sin(2 * np.pi * time / period))
    force = brush(np.tan(alpha + effect), 4e4, friction, load)
    force = force + own * generator.normal(size=rows)
    alpha = alpha + noise * generator.normal(size=rows)
    return {"time": time, "alpha": alpha, "fy": force, "fz": load, "v": np.full(rows, 20.0)}


def judged(seed, steps, noise, own=40.0):
    """Noise of the slip by the forces, None for all of its scatter about sweeps."""
    prepared = prepare(read_frame(driven(seed, steps, noise, own)), Rig(), ("fy",))
    assert prepared.slip_source == "scatter about smooth sweeps"
    return shown_slip_noise(prepared, "brush", FEW, Rig())


@pytest.mark.parametrize(("steps", "own"), [(0.02, 40.0), (0.02, 200.0), (0.005, 10.0)])
def test_steps_that_the_force_follows_are_no_noise(steps, own):
    assert [judged(seed, steps, 0.0, own) for seed in range(6)] == [0.0] * 6


@pytest.mark.parametrize(("noise", "own"), [(0.01, 40.0), (0.01, 200.0), (0.002, 10.0)])
def test_scatter_that_the_force_does_not_follow_is_noise(noise, own):
    """At four standard errors, one record in 30,000 is taken for motion."""
    assert [judged(seed, 0.0, noise, own) for seed in range(6)] == [None] * 6


def test_noise_beside_steps_is_found():
    found = [judged(seed, 0.02, 0.005) for seed in range(6)]
    assert np.mean(found) == pytest.approx(0.005, rel=0.15)


@pytest.mark.parametrize(
    ("seed", "effects"),
    [(1, FEW), *(pytest.param(k, EFFECTS, marks=pytest.mark.long) for k in range(10))],
)
def test_steps_of_the_slip_leave_the_noise_of_the_force(seed, effects):
    """The noise of 600 rows has a standard error of 3 %."""
    found = diagnose(read_frame(driven(seed, 0.02)), effects=effects)
    assert found.verdict.status == "none"
    assert found.noise.slip == 0
    assert found.noise.forces["fy"] == pytest.approx(40, rel=0.1)
    rms = [step.rms_left_out for step in found.ladder.steps]
    assert rms[-1] <= rms[0]


LONG = ((0.5, ROWS), (1.0, ROWS), (2.0, ROWS), (3.0, ROWS), (0.5, 2000))


@pytest.mark.parametrize(
    ("period", "rows"),
    [(0.3, ROWS), (8.0, ROWS), *(pytest.param(*one, marks=pytest.mark.long) for one in LONG)],
)
def test_a_ripple_of_the_friction_is_a_gap_and_no_noise(period, rows):
    """Its rms is 230 N, in forces whose sign the slip changes every 2.4 s. In records of 600
    rows whose noise has a standard error of 3 % the rest of the ripple adds up to 5 N."""
    found = diagnose(read_frame(driven(1, 0.02, rows=rows, period=period)), effects=FEW)
    assert found.verdict.status == "unknown"
    assert found.gap.resolvable
    assert found.noise.forces["fy"] == pytest.approx(40, rel=0.2)


def test_an_effect_beside_steps_of_the_slip_is_named():
    found = diagnose(read_frame(driven(2, 0.02, effect=0.01)), effects=FEW)
    assert found.effects == ("slip_offset",)
    assert found.noise.forces["fy"] == pytest.approx(40, rel=0.1)


def test_the_noise_floor_is_at_most_what_a_model_leaves():
    """Also where the stated noise is far above the scatter: it is flagged instead."""
    rig = Rig(noise={"fy": 4000.0})
    found = diagnose(read_frame(driven(3, 0.02)), rig=rig, effects=FEW)
    assert "noise_misstated" in found.noise.flags
    rms = [step.rms_left_out for step in found.ladder.steps]
    assert rms[-1] <= rms[0] < 50


def test_a_diagnosis_counts_rows_as_a_fit_does():
    """Both count the residuals of the brush, whose misfit is slow: the stiffness drifts."""
    columns = driven(4, 0.0, own=100.0)
    columns["fy"] *= 1 + 0.1 * np.sin(columns["time"])
    data = read_frame(columns)
    by_fit = fit(data, "brush", config={"solver": "gauss-newton"}).statistics
    found = diagnose(data, effects=FEW)
    assert by_fit.n_effective < 0.3 * ROWS
    assert found.n_effective == pytest.approx(by_fit.n_effective, rel=0.1)
