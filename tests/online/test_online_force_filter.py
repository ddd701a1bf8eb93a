"""Forces and friction hypotheses, S section 3.2, checked independently."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from drives import drive, estimated
from scipy.stats import multivariate_normal

from tirefit.data.table import WHEELS
from tirefit.online.base import Flag, code
from tirefit.online.force_filter import HYPOTHESES, ForceFilter

LONG = {"bend": 0.5, "brake": 0.3, "duration": 40.0}
modelled, rates_of, seen_of = map(
    jax.jit, (ForceFilter.modelled, ForceFilter.rates, ForceFilter.seen)
)


def true_state(truth, k):
    names = ["v", "v_y", "yaw_rate", "roll_rate", *(f"omega_{w}" for w in WHEELS)]
    names += [*(f"fx_{w}" for w in WHEELS), "fy_f", "fy_r"]
    inputs = [*(f"torque_{w}" for w in WHEELS), "steering"]
    return [np.array([truth[name][k] for name in group]) for group in (names, inputs)]


def test_the_filter_uses_the_equations_of_the_simulated_car():
    truth = drive(**LONG).truth
    k, dt = 620, 0.02
    x, inputs = true_state(truth, k)
    rates = np.array(rates_of(ForceFilter(), x, inputs))
    before, after = true_state(truth, k - 1)[0], true_state(truth, k + 1)[0]
    slopes = (after - before) / (2 * dt)
    # Yaw acceleration without what left and right tires of an axle differ in.
    np.testing.assert_allclose(rates[[0, 1]], slopes[[0, 1]], atol=0.1)
    assert abs(rates[2] - slopes[2]) < 0.05 + 0.1 * abs(slopes[2])
    np.testing.assert_allclose(rates[4:8], slopes[4:8], atol=2.0)
    seen = np.array(seen_of(ForceFilter(), x, inputs))
    measured = ["yaw_rate", *(f"omega_{w}" for w in WHEELS), "a_x", "a_y", "roll_rate"]
    expected = [truth[name][k] for name in [*measured, "v"]]
    np.testing.assert_allclose(seen, expected, atol=0.02)
    forces = modelled(ForceFilter(), x, inputs, 0.9)
    # Loads from the accelerations, not from roll and pitch.
    np.testing.assert_allclose(forces, x[8:], atol=0.05 * np.max(abs(x[8:])))


def test_a_brake_on_the_left_turns_the_car_to_the_left():
    """Accelerations of the forces summed wheel by wheel; a moment is x F_y - y F_x."""
    kind, steering = ForceFilter(), 0.3
    along, across = np.array([900.0, -400, 250, 600]), np.array([750.0, 750, -400, -400])
    turn = np.array([steering, steering, 0.0, 0.0])
    x, y = np.array([1.2, 1.2, -1.4, -1.4]), 0.75 * np.array([1, -1, 1, -1])
    fx = -along * np.cos(turn) - across * np.sin(turn)
    fy = across * np.cos(turn) - along * np.sin(turn)
    expected = np.sum(fx) / 1500, np.sum(fy) / 1500, np.sum(x * fy - y * fx) / 2500
    state = jnp.array(np.r_[np.zeros(8), along, 1500.0, -800.0])
    np.testing.assert_allclose(kind.pushed(state, steering), expected, rtol=1e-12)


def test_a_correction_agrees_with_gaussian_conditioning():
    kind, random = ForceFilter(), np.random.default_rng(0)
    x = np.r_[25, 0, 0.1, 0, [83] * 4, 100 * random.standard_normal(6)]
    root = random.standard_normal((14, 14)) * np.r_[[0.1] * 8, [100] * 6][:, None]
    covariance = root @ root.T
    inputs = np.r_[[10.0] * 4, 0.0]  # steered straight, the measurement is linear
    state = kind.init()._replace(
        x=jnp.array(x), covariance=jnp.array(covariance), inputs=jnp.array(inputs)
    )
    seen = np.array([0.12, 83.1, 83, 82.9, 83, 0.2, 2.0, 0.01, 25.1])
    rows = np.zeros((9, 14))
    rows[[0, 1, 2, 3, 4, 7, 8], [2, 4, 5, 6, 7, 3, 0]] = 1
    rows[5, 8:12], rows[6, 12:] = -1 / 1500, 1 / 1500
    noise = np.diag([0.002, *[0.05] * 4, 0.05, 0.05, 0.002, 0.03]) ** 2
    gain = covariance @ rows.T @ np.linalg.inv(rows @ covariance @ rows.T + noise)
    after, _ = jax.jit(kind.corrected)(state, jnp.array(seen))
    np.testing.assert_allclose(after.x, x + gain @ (seen - rows @ x), rtol=1e-6)
    expected = covariance - gain @ rows @ covariance
    np.testing.assert_allclose(after.covariance, expected, rtol=1e-4, atol=1e-4)


def test_the_hypotheses_are_weighted_by_bayes_rule():
    kind, truth = ForceFilter(), drive(**LONG).truth
    x, inputs = true_state(truth, 620)
    # Slips known exactly: the covariance of what is missed is that of the forces.
    covariance = np.diag([0.0] * 8 + [100.0**2] * 6)
    state = jax.tree.map(
        jnp.asarray, kind.init()._replace(x=x, covariance=covariance, inputs=inputs)
    )
    # The loads follow the forces; by differences.
    log_weight, surprise = jax.jit(kind._weighed)(state, 0.5)
    model = np.array([0.25] * 4 + [0.5] * 2) * 0.03 * 1500 * 9.81
    logs = []
    for mu in HYPOTHESES:
        slope = np.zeros((6, 6))
        for j in range(6):
            push = np.eye(14)[8 + j]
            one, other = (modelled(kind, x + s * push, inputs, mu) for s in (1, -1))
            slope[:, j] = np.eye(6)[j] - (np.array(one) - np.array(other)) / 2
        spread = slope @ slope.T * 100.0**2 + np.diag(model**2)
        missed = x[8:] - np.array(modelled(kind, x, inputs, mu))
        logs.append(multivariate_normal(np.zeros(6), spread).logpdf(missed))
        if abs(mu - np.mean(HYPOTHESES)) < 1e-9:  # as expected by equal weights
            steps = [modelled(kind, x, inputs, mu + s) for s in (1e-5, -1e-5)]
            along = np.linalg.solve(spread, (np.array(steps[1]) - np.array(steps[0])) / 2e-5)
            way = along @ spread @ along
            np.testing.assert_allclose(surprise, along @ missed / max(way**0.5, 1), rtol=1e-3)
    weights = np.exp(logs - np.max(logs))
    np.testing.assert_allclose(np.exp(log_weight), weights / weights.sum(), rtol=1e-3, atol=1e-9)


def test_the_truth_lies_within_the_stated_spread():
    log = drive(**LONG)
    truth, end = log.truth, estimated("force-filter", log.columns)
    late = slice(400, None)
    braked = sum(truth[f"fx_{w}"] for w in WHEELS)
    forces = np.stack([braked, truth["fy_f"], truth["fy_r"]], 1)[late]
    pulls = (end.value[late, 1:] - forces) / end.std[late, 1:]
    assert np.all(np.sqrt(np.mean(pulls**2, 0)) < 1.5)
    assert np.all(end.std[-1, 1:] < 500)
    mu = (end.value[late, 0] - 0.9) / end.own_std[late, 0]
    assert np.sqrt(np.mean(mu**2)) < 2 and end.own_std[-1, 0] < 0.2


@pytest.mark.long
def test_only_a_drop_of_friction_is_detected():
    how = {"bend": 0.45, "duration": 60.0}
    for after in (0.6, 0.55):
        log = drive(**how, drop=(40.0, after))
        end = estimated("force-filter", log.columns)
        alarms = log.columns["time"][end.flag == code(Flag.CHANGED)]
        assert len(alarms) and 40.0 < alarms[0] < 44.0
        assert abs(end.value[-1, 0] - after) < 2 * end.own_std[-1, 0] < 0.25
    for seed in range(2):
        end = estimated("force-filter", drive(**how, seed=seed).columns)
        assert not np.any(end.flag == code(Flag.CHANGED))


def test_missing_rows_are_flagged_and_bridged():
    columns = {k: v.copy() for k, v in drive(**LONG).columns.items()}
    columns["torque_fl"][400:410] = np.nan
    kept = np.r_[:600, 700:2000]
    end = estimated("force-filter", {k: v[kept] for k, v in columns.items()})
    assert np.all(end.flag[400:410] == code(Flag.MISSING))
    assert end.flag[600] == code(Flag.GAP)
    assert np.all(np.isfinite(end.value)) and np.all(end.std > 0)
    assert abs(end.value[-1, 0] - 0.9) < 2.5 * end.own_std[-1, 0]
