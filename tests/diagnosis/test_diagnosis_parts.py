"""The parts of the diagnosis, each compared with an independent computation."""

import ast
import re
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest_diagnosis import RIG, bare, brush, record
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq
from scipy.stats import false_discovery_control

import tirefit
from tirefit.data.read import read_frame
from tirefit.data.table import Source
from tirefit.diagnosis.effects import EFFECTS, NOISE_EFFECTS, Prior, atoms_of
from tirefit.diagnosis.effects.state import _breakaway, force_of_state, null_state
from tirefit.diagnosis.engine.discrepancy import Cell, Component
from tirefit.diagnosis.engine.fit import Start
from tirefit.diagnosis.rows import slips
from tirefit.diagnosis.rows.covariates import work_of_sliding
from tirefit.diagnosis.rows.discrepancy import PLACE, discrepancy_of, waves_within
from tirefit.diagnosis.rows.noise import judge_noise
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig, load_rig
from tirefit.diagnosis.rows.slips import AGES, AHEAD, segments, slip_rate
from tirefit.diagnosis.rows.subject import fit_base
from tirefit.diagnosis.summary.forecast import _told_apart, decided, separability, size_apart
from tirefit.diagnosis.summary.views import _shape, adjusted, regions
from tirefit.models import MODELS, Brush, TireInputs
from tirefit.results import UsageError


def test_the_null_state_gives_the_base_model():
    tire = Brush()
    for slip in (-0.3, -0.02, 0.0, 1e-9, 0.05, 0.5):
        inputs = TireInputs(slip, 0.0, 4000.0, 10.0)
        ours = force_of_state(tire, None, null_state(), slip, 0.0, inputs)
        np.testing.assert_allclose(ours[0], tire(inputs).fx, rtol=1e-12, atol=1e-9)
    # Of another model at both slips: tan(alpha) is the lateral one over 1 + sigma_x.
    tire, inputs = MODELS["magic-formula-combined"], TireInputs(0.3, np.arctan(0.2 / 1.3), 4e3)
    ours = force_of_state(tire, (5e4, 0.9, 0.1), null_state(), 0.3, 0.2, inputs)
    np.testing.assert_allclose(ours[:2], tire(inputs)[:2], rtol=1e-9)


@pytest.mark.parametrize(("skew", "flat"), [(0.3, 0.0), (-0.2, 0.4), (0.5, 0.9)])
def test_the_pressure_shape_agrees_with_the_contact_patch(skew, flat):
    """Pressure between S(24) and S(25), static friction above kinetic."""

    def density(xi):
        skewed = 0.75 * (1 - xi**2) * (1 + skew * xi)
        return (1 - flat) * skewed + flat * 0.625 * (1 - xi**4)

    c, mu, fz, excess, slip = 5e4, 1.0, 4000.0, 0.25, 0.05
    edge = brentq(lambda x: c * slip * (1 - x) - mu * (1 + excess) * fz * density(x), -1, 0.999)
    sliding = quad(lambda x: mu * fz * density(x), -1, edge)[0]
    sticking = c * slip * (1 - edge) ** 2 / 2
    state = null_state()._replace(
        skew=jnp.array(skew), flat=jnp.array(flat), static=jnp.array(excess)
    )
    inputs = TireInputs(slip, 0.0, fz, 0.0)
    ours = force_of_state(Brush(), None, state, slip, 0.0, inputs)[0]
    np.testing.assert_allclose(ours, sliding + sticking, rtol=1e-9)


@pytest.mark.parametrize("demand", [0.3, 1.1, 9.0])
def test_the_breakaway_point_has_the_slopes_of_central_differences(demand):
    at = np.array([demand, 0.2, 0.3])
    slopes = jax.jacfwd(lambda x: _breakaway(*x))(jnp.asarray(at))
    for k, step in enumerate(1e-5 * np.eye(3)):
        ends = (float(_breakaway(*map(jnp.asarray, at + side * step))) for side in (1, -1))
        assert slopes[k] == pytest.approx(np.subtract(*ends) / 2e-5, abs=1e-5)
    assert demand < 2 or not np.any(slopes)


@pytest.fixture(scope="module")
def base():
    frame, _ = record(None, seed=2)
    return fit_base(prepare(read_frame(frame), RIG, ("fx",)), "brush", EFFECTS, RIG)


def test_the_base_fit_recovers_the_truth(base):
    values = base.tire.layout.natural(base.z)
    assert float(values["cpa2"]) == pytest.approx(5e4, rel=0.02)
    assert float(values["mu"]) == pytest.approx(0.9, rel=0.01)
    assert base.noise["fx"].flags == ()


def test_every_null_amplitude_changes_nothing(base):
    rows = base.design.rows
    for atom in base.atoms:
        changed = atom.change(null_state(), 0.0, rows)
        for before, after in zip(null_state(), changed, strict=True):
            after = np.broadcast_to(after, np.shape(after))
            np.testing.assert_allclose(after, np.zeros_like(after) + before, atol=1e-7)


def test_tangents_agree_with_central_differences(base):
    _, jacobian, tangent, _ = base.linearised(base.z, np.zeros(len(base.atoms)))
    scale = base.priors.scale
    n = base.rows.n
    spread = np.asarray(base.design.scale["fx"])[:n]

    def force(z, amplitudes):
        return base.forces(z, amplitudes)["fx"] / spread

    silent = np.zeros(len(base.atoms))
    for i in range(len(base.z)):
        step = np.eye(len(base.z))[i] * 1e-5
        slope = (force(base.z + step, silent) - force(base.z - step, silent)) / 2e-5
        np.testing.assert_allclose(jacobian[:, i], slope, atol=1e-5 * abs(slope).max())
    for k, atom in enumerate(base.atoms):
        if atom.effect.misleads:
            continue
        step = silent.copy()
        step[k] = 1e-4 * scale[k]
        if atom.effect.id in ("relaxation_length", "channel_delay"):
            continue  # one-sided at zero, tested by their own truths
        slope = (force(base.z, step) - force(base.z, -step)) / 2e-4
        size = max(np.abs(slope).max(), 1e-6)
        np.testing.assert_allclose(tangent[:, k], slope, atol=2e-3 * size, err_msg=atom.effect.id)


def test_fields_agree_with_central_differences(base):
    """The force per field of the state, compared with effects that change only that."""
    linear = base.linearised(base.z, np.zeros(len(base.atoms)))
    scale = base.priors.scale
    rows = base.rows.covariates
    for name, field, factor in (
        ("slip_offset", "shift", 1.0),
        ("drive_brake_asymmetry", "friction", 0.5 * rows.side),
        ("friction_speed_linear", "kinetic", -rows.sliding),
        ("pressure_asymmetry", "skew", 1.0),
    ):
        k = next(k for k, a in enumerate(base.atoms) if a.effect.id == name)
        np.testing.assert_allclose(
            linear.columns[:, k],
            scale[k] * factor * linear.fields[:, PLACE[field]],
            atol=1e-9 * np.abs(linear.columns[:, k]).max() + 1e-12,
        )


def _history(base, values, interval, step):
    """Covariates of 40 rows whose past is ``values(columns back)``."""
    back = np.arange(40)[:, None] - AGES
    past = jnp.asarray(values(back.astype(float)))
    return base.design.rows._replace(
        past=past,
        pull=1e3 * past,
        twist=10 * past,
        burden=(1 + past) / (1 + past[:, [AHEAD]]),
        interval=jnp.full(40, interval),
        step=jnp.full(40, step),
    )


def _change(base, effect, variant, amplitude, rows):
    atom = next(a for a in base.atoms if a.effect.id == effect and a.variant == variant)
    return atom.change(null_state(), amplitude, rows)


def test_relaxation_solves_its_equation(base):
    """A ramp from rest lags by length over its own slope, exactly."""
    rows = _history(base, lambda x: 0.01 * np.maximum(x, 0), 0.05, 0.5)
    way = 0.5 * np.arange(40)
    right = -0.4 * 0.01 / 0.5 * (1 - np.exp(-way / 0.4))
    shift = _change(base, "relaxation_length", 0, 0.4, rows).shift
    # It began to rise at one of the ages that a row knows, or between two.
    known = AGES[AGES >= 0]
    np.testing.assert_allclose(shift[known], right[known], atol=1e-12)
    np.testing.assert_allclose(shift, right, atol=2e-5)
    # A filter lags over time what a carcass lags over way.
    for effect, variant, size in (("relaxation_length", 1, 0.4), ("channel_delay", 2, 0.04)):
        found = _change(base, effect, variant, size, rows)
        np.testing.assert_allclose(found.force, 1e3 * shift, atol=1e-12)
        np.testing.assert_allclose(found.moment, 10 * shift, atol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.1225, -0.06])
def test_a_delay_uses_the_earlier_slip(base, delay):
    rows = _history(base, lambda x: np.abs(x - 20) / 100, 0.05, 0.5)
    row = np.arange(40)
    grid = np.arange(-20, 60)
    then = np.interp(row - delay / 0.05, grid, np.abs(grid - 20) / 100)
    right = then - np.abs(row - 20) / 100
    found = _change(base, "channel_delay", 0, delay, rows)
    np.testing.assert_allclose(found.shift, right, atol=1e-12)
    assert np.all(found.friction == 1)
    # Delayed forces belong to the earlier slip and load.
    found = _change(base, "channel_delay", 1, delay, rows)
    np.testing.assert_allclose(found.shift, right, atol=1e-12)
    now = 1 + np.abs(row - 20) / 100
    np.testing.assert_allclose(found.friction, 1 + right / now, atol=1e-12)


def test_the_example_effect_of_the_manual_is_found(tmp_path, monkeypatch, capsys):
    """Its lines find an existing ripple."""
    page = Path(__file__).parents[2] / "docs" / "how-to" / "effect.md"
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (printed,) = (block for block in blocks if "mine = Effect(" in block)
    span = record(None)[0]["time"]
    middle, whole = span.mean(), np.ptp(span)

    def truth(slip, time, fz, v):
        return brush(slip, 5e4, 0.9 * (1 + 0.1 * np.sin(25 * (time - middle) / whole)), fz)

    frame, _ = record(truth, seed=4)
    known = "".join(f"{name} = {value}\n" for name, value in RIG.noise.items())
    names, columns = zip(*frame.items(), strict=True)
    lines = [",".join(map(repr, map(float, row))) for row in zip(*columns, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join([",".join(names), *lines]))
    (tmp_path / "rig.toml").write_text(f"[noise]\n{known}", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    # A library of a few, which compiles in a fraction of the time.
    families = {"friction x time", "slip x time", "force x time", "friction x load"}
    beside = tuple(effect for effect in EFFECTS if effect.family in families)
    monkeypatch.setattr("tirefit.diagnosis.effects.EFFECTS", beside)
    assert load_rig("rig.toml").noise == RIG.noise
    # The page takes a sample that ships, which has no ripple.
    printed = printed.replace(
        '"tirefit/samples/free_driving.csv"', '"run.csv", convention="braking"'
    )
    exec(printed.replace("(data, ", '(data, rig=tirefit.load_rig("rig.toml"), '), {})
    text = re.sub(r"\s+", " ", capsys.readouterr().out)
    # That of something unlisted beside it is about even.
    assert re.search("The gap comes (in part )?from road ripple", text)
    assert "the road has waves; to do: measure on another road" in text


@pytest.mark.parametrize("piece", [41, 100, 256, 399])
def test_a_long_sweep_in_pieces_gives_the_same_result(monkeypatch, piece):
    time = np.cumsum(np.random.default_rng(6).uniform(0.008, 0.012, 400))
    noise = np.random.default_rng(7).normal(0, 0.002, 400)
    slip, run = 0.05 * np.sin(2.0 * time) + noise, np.zeros(400, int)
    whole = slip_rate(slip, time, run)
    monkeypatch.setattr(slips, "_PIECE", piece)
    pieces = slip_rate(slip, time, run)
    assert whole.present
    assert whole.noise > 0
    for of_whole, of_pieces in zip(whole, pieces, strict=True):
        if of_whole is not whole.past:
            np.testing.assert_array_equal(of_pieces, of_whole)
    for of_whole, of_pieces in zip(whole.past, pieces.past, strict=True):
        np.testing.assert_array_equal(of_pieces, of_whole)


def test_the_slip_rate_of_a_noisy_sweep_is_found():
    time = np.arange(400) * 0.01
    truth = 0.2 * np.sin(2 * time)
    noisy = truth + 0.002 * np.random.default_rng(0).standard_normal(400)
    found = slip_rate(noisy, time, np.zeros(400, int))
    assert found.present
    assert found.noise == pytest.approx(0.002, rel=0.1)
    inner = slice(25, -25)
    assert np.std(found.rate[inner] - 0.4 * np.cos(2 * time)[inner]) < 0.06
    assert np.std(found.past.path[:, AHEAD] - truth) < 0.0012
    clear = np.abs(0.4 * np.cos(2 * time)) > 0.15
    side = np.sign(truth * np.cos(2 * time))
    assert np.mean(np.sign(found.turning[clear]) == side[clear]) > 0.97
    shuffled = np.random.default_rng(1).permutation(noisy)
    assert not slip_rate(shuffled, time, np.zeros(400, int)).present


def test_hardly_a_row_is_certain_of_the_wrong_direction():
    """Near its ends a slow sweep is within the error of its slope, which the noise causes."""
    time, wrong = np.arange(400) * 0.01, 0
    for seed in range(10):
        noise = 0.002 * np.random.default_rng(seed).standard_normal(400)
        found = slip_rate(0.1 + 0.02 * np.sin(2 * time) + noise, time, np.zeros(400, int), 0.002)
        wrong += np.count_nonzero(found.turning * np.sign(np.cos(2 * time)) <= -1)
    assert wrong <= 2


def test_turning_points_of_a_saw_tooth_stay_sharp():
    """One-sided windows: no parabola extends across a turning point of the slip."""
    time = np.arange(240) * 0.01
    truth = 0.1 * np.abs((time / 0.6) % 1 - 0.5) * 2
    noisy = truth + 0.001 * np.random.default_rng(3).standard_normal(240)
    found = slip_rate(noisy, time, np.zeros(240, int), noise=0.001)
    slope = np.gradient(truth, time)
    away = np.abs((time / 0.3) % 1 - 0.5) < 0.42
    assert np.std(found.rate[away] - slope[away]) < 0.15 * np.abs(slope).max()
    assert np.sqrt(np.mean((found.past.path[:, AHEAD] - truth) ** 2)) < 0.001


def test_the_past_slip_is_independent_of_the_noise_of_its_row():
    """Otherwise a delay and a lag that cancel would remove the noise of the slip."""
    time = np.arange(600) * 0.01
    truth = 0.1 * np.sin(3 * time)
    own = np.zeros(17)
    for seed in range(8):
        noise = 0.002 * np.random.default_rng(seed).standard_normal(600)
        found = slip_rate(truth + noise, time, np.zeros(600, int), noise=0.002)
        past = found.past
        # Of sin(3 t) the standard deviation over that of its slope is 1/3 s.
        assert past.interval == pytest.approx(0.45 / 3 / 12, rel=0.05)
        error = past.path - past.of(truth)
        assert np.sqrt(np.mean(error[30:-30] ** 2)) < 0.0015
        own += noise @ error / (600 * 0.002**2) / 8
    # What is left comes from the choice of the windows.
    assert np.abs(np.delete(own, AHEAD)).max() < 0.04
    assert own[AHEAD] < 0.15
    # Before the record begins it rests.
    np.testing.assert_allclose(past.of(time)[0, AHEAD:], 0.0)
    np.testing.assert_allclose(past.of(time)[100, AHEAD + 4], 1 - 4 * past.interval)


def test_segments_break_at_pauses_and_runs():
    time = np.array([0.0, 0.1, 0.2, 5.0, 5.1, 0.0, 0.1])
    run = np.array([0, 0, 0, 0, 0, 1, 1])
    parts = segments(time, run)
    assert [part.tolist() for part in parts] == [[0, 1, 2], [3, 4], [5, 6]]


def test_the_work_of_sliding_solves_its_equation():
    """dw/dt = power - w / constant; constants of 20 % and 5 % of the time, or no cooling."""
    time = np.linspace(0.0, 10.0, 4001)
    found = work_of_sliding(100 * (1 + np.sin(time)), time, np.zeros(len(time), int))
    for work, constant in zip(found.T, (np.inf, 2.0, 0.5), strict=True):
        right = solve_ivp(
            lambda t, w, cooling=constant: 100 * (1 + np.sin(t)) - w / cooling,
            (0.0, 10.0), [0.0], t_eval=time, rtol=1e-8,
        )  # fmt: skip
        np.testing.assert_allclose(work, right.y[0], atol=0.005 * right.y.max())


def test_one_wave_among_many_is_found():
    generator = np.random.default_rng(0)
    x = np.linspace(0, 1, 400)
    angle = 2 * np.pi * x[:, None] * np.arange(1, 13)
    waves = np.stack([np.sin(angle), np.cos(angle)], 2).reshape(400, -1) / np.sqrt(200)
    residual = generator.standard_normal(400) + 0.5 * np.sin(2 * np.pi * 7 * x + 1)
    chi2 = waves_within(waves, np.ones((400, 1)), residual)
    assert int(np.argmax(chi2)) == 6
    assert chi2[6] > 30 and np.median(chi2) < 4
    # At uneven places sine and cosine are correlated: the decrease by least squares.
    few, one = x[:60] ** 2, np.ones((60, 1))
    pair = np.stack([np.sin(4 * few), np.cos(4 * few)], axis=1)
    left = [np.linalg.lstsq(a, residual[:60])[1][0] for a in (one, np.hstack([one, pair]))]
    assert waves_within(pair, one, residual[:60])[0] == pytest.approx(left[0] - left[1], rel=1e-4)


def test_separability_is_right_for_known_directions():
    first, second = 4 * np.eye(4)[:2]
    assert separability(first, second) == pytest.approx(0.99766, abs=1e-4)
    # The weaker of two effects decides.
    assert separability(first, 9 * second) == separability(9 * first, second)
    assert separability(first, 9 * second) == pytest.approx(0.99766, abs=1e-4)
    for size in (1, -1):  # an amplitude has either sign
        assert separability(first, size * first) == pytest.approx(0.5)
    # By amplitudes of four prior scales, beside a parameter that neither resembles.
    block = np.eye(4)[:, 2:3], np.eye(4)[:, :2]
    assert _told_apart([block], (0, 4.0), (1, 4.0)) == pytest.approx(0.99766, abs=1e-4)


@pytest.mark.parametrize(("chance", "distance"), [(0.3, 2.0), (0.7, 2.0), (0.6, 0.5), (0.25, 4.0)])
def test_the_forecast_of_a_decision_agrees_with_draws(chance, distance):
    """Of the more probable answer, given a result with unit error."""
    generator = np.random.default_rng(3)
    cause = generator.uniform(size=10**6) < chance
    result = generator.standard_normal(10**6) + distance * ~cause
    log = np.log(chance / (1 - chance)) + 0.5 * ((result - distance) ** 2 - result**2)
    right = np.mean((log > 0) == cause)
    assert decided(chance, distance) == pytest.approx(right, abs=2.5e-3)  # 5 errors of the mean
    assert decided(chance, 0.0) == pytest.approx(max(chance, 1 - chance))


def test_the_change_of_a_size_has_the_error_of_a_joint_fit():
    """By the inverse of the normal equations of both measurements."""
    generator = np.random.default_rng(4)
    blocks = [
        (generator.standard_normal((n, 2)), generator.standard_normal((n, 3))) for n in (30, 20)
    ]
    fit = bare(("a", "b"), atoms=(0, 2), amplitude=np.array([9.0, 1.5]), residual=np.ones(30),
               columns=np.zeros((30, 4)), pull=np.ones(4), off=np.zeros(4))  # fmt: skip
    columns = np.zeros((50, 5))
    columns[:, :2] = np.concatenate([jacobian for jacobian, _ in blocks])
    columns[:, 2] = np.concatenate([own[:, 0] for _, own in blocks])
    columns[:30, 3], columns[30:, 4] = blocks[0][1][:, 2], blocks[1][1][:, 2]
    covariance = np.linalg.inv(columns.T @ columns)
    error = np.sqrt(np.array([1, -1]) @ covariance[3:, 3:] @ np.array([1, -1]))
    expected = 0.5 / np.hypot(error / 1.5, 0.15)
    assert size_apart(blocks, fit, 1) == pytest.approx(expected)
    blocks[1][1][:, 2] = 0.0
    assert size_apart(blocks, fit, 1) == 0.0


def test_the_noise_is_estimated_despite_a_gap():
    generator = np.random.default_rng(0)
    x = np.linspace(-1, 1, 1500)
    fz = np.where(np.arange(1500) % 2, 2000.0, 6000.0)
    basis = np.stack([x**k for k in range(6)], axis=1)
    level = 0.01 * fz
    residual = 300 * x**3 + level * generator.standard_normal(1500)
    zero = np.zeros(1500)
    waves = np.stack([f(k * x) for k in (20, 33) for f in (np.sin, np.cos)], axis=1)
    groups = [np.arange(0, 1500, 2), np.arange(1, 1500, 2)]
    order = (np.arange(1500.0), zero.astype(int))

    def judged(residual, given, force=zero + 1.0):
        return judge_noise(residual, zero, fz, force, given, basis, lambda _: waves, groups, *order)

    found = judged(residual, None)
    np.testing.assert_allclose(found.std, level, rtol=0.1)
    assert found.inflation == 1.0 and not found.outlier.any()
    wrong = judged(residual, level / 2)
    assert "noise_misstated" in wrong.flags
    np.testing.assert_allclose(wrong.std, level, rtol=0.1)
    # A ripple finer than the smooth functions is a gap, not noise.
    ripple = judged(residual + 80 * np.sin(33 * x), level)
    assert ripple.flags == ()
    np.testing.assert_allclose(ripple.std, level)
    slow = np.empty(1500)
    slow[0] = 0
    for i in range(1, 1500):
        slow[i] = 0.6 * slow[i - 1] + generator.standard_normal()
    assert judged(slow, None).inflation == pytest.approx(4.0, rel=0.3)
    spoiled = residual.copy()
    spoiled[::30] += 12 * level[::30] * generator.choice([-1, 1], 50)
    outliers = judged(spoiled, level)
    assert "outliers" in outliers.flags
    assert set(range(0, 1500, 30)) <= set(np.flatnonzero(outliers.outlier))
    assert outliers.outlier.sum() < 65


def test_regions_contain_all_the_energy(base):
    n = base.rows.n
    gap = np.where(base.rows.inputs.fz == 6000, 100.0, 1.0)
    residual, *_ = base.at_null
    found = regions(base, residual[:n], gap)
    loads = [r for r in found if r.covariate == "fz"]
    assert sum(r.share for r in loads) == pytest.approx(1.0)
    of_6000 = 1e4 * np.sum(base.rows.inputs.fz == 6000)
    largest = max(loads, key=lambda r: r.share)
    assert largest.low == 6000
    assert largest.share == pytest.approx(of_6000 / (of_6000 + np.sum(gap == 1.0)))
    assert all(r.p_value > 0.01 for r in found)  # there is no gap in these data
    for name in {r.covariate for r in found}:
        shares = sum(r.share for r in found if r.covariate == name)
        assert shares == pytest.approx(1.0), name


def test_a_rig_file_is_read_and_checked(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text("rolling_radius = 0.3\n[noise]\nfx_relative = 0.02\nsigma_x = 1e-3\n")
    rig = load_rig(path)
    assert rig.rolling_radius == 0.3
    assert rig.slip_noise("sigma_x") == 0.001 and rig.slip_noise("alpha") is None
    np.testing.assert_allclose(rig.force_noise("fx", np.array([1e3, 2e3])), [20, 40])
    assert rig.force_noise("mz", np.array([1e3])) is None
    path.write_text(
        'rolling_radius = -1\nrun_order = "odd"\nwheel_inertai = 1\n'
        '[noise]\nfx = "a"\nfy = 1e19\nsigma = 0.01\n'
    )
    with pytest.raises(UsageError) as caught:
        load_rig(path)
    assert len(caught.value.problems) == 6
    assert "did you mean 'wheel_inertia'?" in str(caught.value)
    assert "did you mean 'sigma_x'?" in str(caught.value)
    assert all(str(path) in str(problem) for problem in caught.value.problems)
    with pytest.raises(UsageError, match="check the path"):
        load_rig(tmp_path / "none.toml")
    assert load_rig(None) == Rig()


@pytest.mark.parametrize("amount", [-3.0, -0.4e-3, -1e-300, 0.0, 1e-300, 0.02, 1e3])
def test_a_filter_stays_within_the_range_of_the_past(base, amount):
    """It may follow or stand still, but never leaves the range of its past."""
    rows = _history(base, lambda x: np.abs(x - 20) / 100, 0.05, 0.5)
    span = np.ptp(rows.past)
    for effect, variants in (("channel_delay", 3), ("relaxation_length", 2)):
        for variant in range(variants):
            state = _change(base, effect, variant, amount, rows)
            assert np.all(np.abs(state.shift) <= span * (1 + 1e-9))
            assert np.all(np.abs(state.force) <= 1e3 * span * (1 + 1e-9))


def test_every_effect_stays_within_its_bounds(base):
    """For any start, a refit gives physically possible amplitudes."""
    scale, low, high = (getattr(base.priors, n) for n in ("scale", "low", "high"))
    sets = [(k,) for k in range(len(base.atoms))]
    for far in (-50.0, 50.0):
        some = sets[:64] if far < 0 else sets[-64:]
        for fit in base.refit([Start(base.z, np.array([far]))] * len(some), some):
            (k,) = fit.atoms
            assert low[k] <= fit.amplitude[0] <= high[k], base.atoms[k].effect.id
    for k, atom in enumerate(base.atoms):
        prior = atom.prior(base.rows, RIG)
        assert prior.low == pytest.approx(low[k] * scale[k])
        assert prior.low < prior.high == pytest.approx(high[k] * scale[k])
    filtered = next(
        k for k, a in enumerate(base.atoms) if a.effect.id == "channel_delay" and a.variant == 2
    )
    assert low[filtered] == 0


def _wheel(seed=0, radius=0.32):
    """A record with a wheel speed, and its rig."""
    frame, _ = record(None, seed=seed)
    omega = frame["v"] / (radius * (1 + frame["sigma_x"]))
    return frame | {"omega": omega}, replace(RIG, rolling_radius=radius)


def test_the_wheel_speed_shows_another_slip_definition():
    frame, rig = _wheel()
    right = prepare(read_frame(frame), rig, ("fx",)).slip_check
    assert right.agrees and right.told_apart and right.rms < 1e-12
    wrong = frame | {"sigma_x": frame["sigma_x"] / (1 + frame["sigma_x"])}
    found = prepare(read_frame(wrong), rig, ("fx",)).slip_check
    assert (found.read_as, found.fits) == ("sigma_x", "kappa")
    assert not found.agrees and found.rms > 0.01 > 100 * found.scatter
    odds = next(e for e in EFFECTS if e.id == "slip_definition").odds
    files = [(wrong, rig), (frame, RIG), (frame, rig)]
    seen, unknown, denied = (odds(prepare(read_frame(f), r, ("fx",))) for f, r in files)
    assert seen > unknown == 0 > denied
    assert prepare(read_frame(frame), RIG, ("fx",)).slip_check is None


def test_a_wrong_radius_gives_an_offset():
    """1 + sigma is proportional to 1 / R: 1 % of it is 0.0099 at zero slip."""
    frame, rig = _wheel()
    data = read_frame(frame)
    wrong = replace(rig, rolling_radius=1.01 * rig.rolling_radius)
    found = prepare(data, wrong, ("fx",)).slip_check
    # column = offset + gain computed, computed = (1 + column) / 1.01 - 1
    assert found.offset == pytest.approx(0.01, abs=1e-9)
    assert found.gain == pytest.approx(1.01, abs=1e-9)
    assert found.fits == "sigma_x" and found.shifted and not found.agrees
    noisy = frame | {"omega": frame["omega"] + np.random.default_rng(1).normal(0, 0.02, len(data))}
    found = prepare(read_frame(noisy), wrong, ("fx",)).slip_check
    assert found.offset == pytest.approx(0.01, abs=5 * found.offset_std)
    # The prior of an offset follows what is seen, its odds say that it may be there.
    effect = next(e for e in EFFECTS if e.id == "slip_offset")
    prepared = prepare(data, wrong, ("fx",))
    prior = atoms_of([effect])[0].prior(prepared, wrong)
    assert prior.scale == pytest.approx(0.01, abs=1e-6)
    assert effect.odds(prepared) > 0 > effect.odds(prepare(data, rig, ("fx",)))


def test_a_radius_is_estimated_only_from_the_speeds():
    frame, rig = _wheel()
    data = read_frame(frame)
    assert RIG.radius_for(data) == pytest.approx(0.32, rel=1e-9)
    assert "rolling_radius" in prepare(data, RIG, ("fx",)).has
    bare = read_frame({k: v for k, v in frame.items() if k != "v"})
    assert RIG.radius_for(bare) is None
    assert "rolling_radius" not in prepare(bare, RIG, ("fx",)).has
    assert rig.radius_for(bare) == 0.32


def test_no_other_module_uses_the_id_of_an_effect():
    """Everything specific to an effect is in its record."""
    package = Path(tirefit.__file__).parent
    # Some are words of the input or a flag of the noise as well.
    other = {field.name for kind in (Rig, Source) for field in fields(kind)}
    other |= {effect.flag for effect in NOISE_EFFECTS}
    other |= {"position", "clock", "yaw_inertia", "tracked_point"}
    ids = {effect.id for effect in (*EFFECTS, *NOISE_EFFECTS)} - other
    assert len(ids) > 25
    for path in sorted(package.rglob("*.py")):
        # Estimators and cars have parameters of their own, of the same name; the names
        # to complete are compared with the records by a test of their own.
        of_others = {"effects", "online", "vehicle", "names.py", "autoware.py"}
        if not of_others & set(path.relative_to(package).parts):
            parts = ast.walk(ast.parse(path.read_text()))
            texts = {one.value for one in parts if isinstance(one, ast.Constant)}
            assert not texts & ids, path


def _prior(effect, frame, rig, variant=0):
    record_of = next(e for e in EFFECTS if e.id == effect)
    prepared = prepare(frame, rig, ("fx",))
    return atoms_of([record_of])[variant].prior(prepared, rig)


def test_data_and_rig_narrow_the_prior_of_an_amplitude():
    frame, _ = record(None)
    data = read_frame(frame)
    # A wheel weighs a few hundredths of what it carries, at its radius.
    small = replace(RIG, rolling_radius=0.3)
    carried = np.mean(frame["fz"]) / 9.80665 * 0.3**2
    usual = _prior("wheel_inertia", data, small)
    assert usual == pytest.approx(carried * np.array([0.03, 0.0, -0.06, 0.3]))
    # A force worked out from the torque lacks all of a known inertia.
    known = _prior("wheel_inertia", data, replace(small, wheel_inertia=30.0))
    assert known == pytest.approx((9.0, 30.0, -0.06 * carried, 60.0))
    # sigma_x may be a kappa: x / (1 - x); a kappa may be a sigma_x: x / (1 + x).
    assert _prior("slip_definition", data, RIG).center == 1.0
    logged = {k: v for k, v in frame.items() if k != "sigma_x"}
    other = read_frame(logged | {"kappa": frame["sigma_x"]})
    assert _prior("slip_definition", other, RIG).center == -1.0
    # No delay beyond the past that the rows know; no filter that foresees.
    prepared = prepare(data, RIG, ("fx",))
    interval = prepared.covariates.interval[0]
    late = _prior("channel_delay", data, RIG)
    longest = 3 * prepared.sizes["period"]
    assert longest < AGES[-1] * interval
    assert (late.low, late.high) == pytest.approx((-4 * interval, longest))
    assert _prior("channel_delay", data, RIG, variant=2).low == 0.0
    # A stated error narrows a prior, and never widens it.
    for stated, scale in ((late.scale / 3, late.scale / 3), (9 * late.scale, late.scale)):
        known = _prior("channel_delay", data, replace(RIG, vehicle={"clock": stated}))
        assert known.scale == pytest.approx(scale)
    # The offset from the slip of the wheel speed is a scale, and twice that is possible.
    seen = SimpleNamespace(slip_check=SimpleNamespace(shifted=True, offset=-0.02))
    offset = next(effect for effect in EFFECTS if effect.id == "slip_offset")
    wider = offset.prior(Prior(0.01, 0.0, -0.01, 0.1), seen, RIG)
    assert wider == Prior(0.02, 0.0, -0.04, 0.1)


def test_cells_of_the_discrepancy_hold_the_forces_of_changed_parameters(base):
    """Usual changes of each parameter, by the closed brush: 3 % of friction, 6 % of
    stiffness, .002 of slip, 1 % of the load; per setting of the load, and over the slip."""
    values = base.tire.layout.natural(base.z)
    c, mu = float(values["cpa2"]), float(values["mu"])
    slip, fz = base.rows.slip, np.asarray(base.rows.inputs.fz)
    unit = np.asarray(base.design.scale["fx"])[: base.rows.n]
    changed = {
        "friction": brush(slip, c, 1.01 * mu, fz) - brush(slip, c, 0.99 * mu, fz),
        "stiffness": brush(slip, 1.01 * c, mu, fz) - brush(slip, 0.99 * c, mu, fz),
        "slip": brush(slip + 5e-4, c, mu, fz) - brush(slip - 5e-4, c, mu, fz),
        "force": 0.02 * fz,
    }
    usual = {"friction": 1.5, "stiffness": 3.0, "slip": 2.0, "force": 0.5}
    found = discrepancy_of(base)
    cells = {(cell.quantity, cell.covariate): cell for cell in found.cells}
    columns = dict(zip(cells, (found.columns[:, part] for part in found.slices), strict=True))
    for name, right in changed.items():
        cell = cells[name, "fz"]
        assert cell.settings and list(cell.places) == [2000.0, 4000.0, 6000.0]
        for k, load in enumerate(cell.places):
            own = usual[name] * np.where(fz == load, right, 0.0) / unit
            # The noise of the slip blurs the curve.
            size = np.abs(own).max()
            off = columns[name, "fz"][:, k] - own
            assert np.sqrt(np.mean(off**2)) < 0.03 * size
        # Over the size of the slip, an offset has its sign.
        side = np.sign(slip) if name in ("slip", "force") else 1.0
        whole, of_loads = (columns[name, x].sum(axis=1) for x in ("slip_fraction", "fz"))
        np.testing.assert_allclose(whole, side * of_loads, atol=1e-9)


def test_a_function_of_the_remainder_is_shown_in_the_units_of_its_parameter():
    cell = Cell("slip", "slip_fraction", np.array([0.0, 0.5, 1.0]), False)
    found = Component(cell, 5.0, 0.8, 0.3, np.array([1.0, -4.0, 2.0]))
    shape = _shape(found)
    assert (shape.at, shape.size, shape.probability, shape.explains) == (0.5, -0.008, 0.8, 0.3)


@pytest.mark.parametrize("count", [1, 2, 7, 50])
def test_p_values_are_adjusted_as_by_scipy(count):
    chances = np.random.default_rng(count).uniform(0, 0.2, count)
    expected = false_discovery_control(chances, method="by")
    np.testing.assert_allclose(adjusted(chances), expected, rtol=1e-12)
