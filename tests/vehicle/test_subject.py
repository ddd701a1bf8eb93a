"""The windows of a car as a subject of the engine, by independent routes: SciPy least squares
with explicit start states, quadrature of the evidence, and simulations in plain NumPy
(fits/withheld_vehicle/drives.py)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from fits.formulas import brush
from fits.withheld_vehicle.drives import LISTED, Trial, drive, trial, written
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.diagnosis.engine.fit import Start
from tirefit.fitting.source import axle_tire
from tirefit.models import Brush
from tirefit.vehicle import subject
from tirefit.vehicle.diagnose import subject_of
from tirefit.vehicle.effects import CAR_EFFECTS
from tirefit.vehicle.model import TIRES, Model
from tirefit.vehicle.shooting import Data
from tirefit.vehicle.subject import Windows
from tirefit.vehicle.windows import JoinedWindows, _sliding, cut_in_windows

FEW = ("steering_delay", "yaw_inertia", "steering_offset", "relaxation_length")
"""The library of test_diagnose_vehicle.py, so that both use the same compiled programs."""


@pytest.fixture(scope="module", autouse=True)
def few_windows():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subject, "_LEAST_WINDOWS", 16)
        yield


def windows(logs, vehicle_file, tires, library):
    """The subject of some logs."""
    vehicle = load_vehicle(vehicle_file)
    found = cut_in_windows(logs, vehicle, 1.0)
    return subject_of(found, vehicle, [axle_tire(one) for one in tires], library)[0]


def of_trial(folder, number, effect="", size=0.0, library=CAR_EFFECTS, off=1.0, grip=None):
    car = trial(number, "none").car
    car |= {"grip": grip or car["grip"]}
    one = Trial(number, effect, size, car, seconds=16.0)
    log, vehicle = written(one, folder)
    tires = [Brush(cpa2=off * c, mu=mu) for c, mu in one.car["tires"]]
    made = windows([log], vehicle, tires, library)
    noise = (0.02, 0.004) if not one.car["small"] else (0.006, 0.004 / 0.3)
    return replace(made, noise=np.array(noise)), one


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    library = tuple(effect for effect in CAR_EFFECTS if effect.id in FEW)
    return of_trial(tmp_path_factory.mktemp("small"), 5, "yaw_inertia", 0.3, library, 1.1)[0]


@pytest.fixture(scope="module")
def inertia(small):
    """A fit of the factors on the tires and of the yaw inertia."""
    atom = [a.effect.id for a in small.atoms].index("yaw_inertia")
    start = small.start
    return small.refit([Start(start.z, np.array([0.1]), start.state)], [(atom,)])[0]


def test_a_refit_with_start_states_eliminated_is_a_least_squares_with_explicit_ones(small, inertia):
    count, (w, states) = 5, small.cut.data.start.shape

    def missed(x):
        now = small.linear(
            small.coefficients(x[:4], inertia.atoms, x[4:count]), x[count:].reshape(w, states)
        )
        return np.concatenate([(now.missed / small.noise).ravel(), x[:count]])

    def slopes(x):
        z, places = small.coefficients(x[:4], inertia.atoms, x[4:count]), [0, 1, 2, 3]
        places = [*places, 4 + inertia.atoms[0]]
        now = small.linear(z, x[count:].reshape(w, states), places)
        rows = now.missed.size
        full = np.zeros((rows + count, len(x)))
        full[:rows, :count] = (now.by / small.noise[:, None]).reshape(rows, count)
        each = (now.by_start / small.noise[:, None]).reshape(w, -1, states)
        for k in range(w):
            own = slice(k * each.shape[1], (k + 1) * each.shape[1])
            full[own, count + k * states : count + (k + 1) * states] = each[k]
        full[rows:, :count] = np.eye(count)
        return full

    found = np.concatenate([inertia.z, inertia.amplitude])
    begin = np.concatenate([0 * found, np.ravel(small.cut.data.start)])
    other = least_squares(missed, begin, slopes, x_scale="jac", xtol=1e-12, ftol=1e-12)
    std = np.sqrt(np.diag(inertia.covariance))
    # The refit ends at a gain in cost of 1e-5 of it, within a fraction of an error.
    assert np.all(np.abs(other.x[:count] - found) < 0.1 * std)
    errors = np.sqrt(np.diag(np.linalg.inv(other.jac.T @ other.jac))[:count])
    np.testing.assert_allclose(std, errors, rtol=0.02)
    assert np.sum(inertia.residual**2) + found @ found == pytest.approx(2 * other.cost, rel=1e-3)


def test_the_yaw_inertia_is_recovered(inertia):
    size = inertia.amplitude[0] * 0.3  # the scale of its prior
    assert abs(size - 0.3) < 4 * inertia.errors[0] * 0.3 + 0.01


def test_derivatives_from_sample_to_sample_are_differences_of_the_whole_motion(small):
    ids = [a.effect.id for a in small.atoms]
    at = [ids.index("relaxation_length"), ids.index("steering_delay")]
    z = small.coefficients([0.1, -0.1, 0.05, 0.1], at, [0.8, 0.5])
    start, step = np.asarray(small.cut.data.start), 1e-5
    now = small.linear(z, start, range(small.model.size))
    for k in range(small.model.size):
        move = step * np.eye(len(z))[k]
        ends = [small.linear(z + side * move, start).missed for side in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(now.by[..., k], slope, atol=1e-5 * np.abs(slope).max())
    for k in (0, 1):
        move = step * np.eye(2)[k]
        ends = [small.linear(z, start + side * move).missed for side in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * step)
        found = now.by_start[..., k]
        np.testing.assert_allclose(found, slope, atol=1e-5 * np.abs(slope).max())


def test_a_residual_without_a_refit_has_nothing_that_start_states_explain(small):
    z = small.coefficients()
    now, rest = small.linear(z, small.cut.data.start), small.residual_of(z)
    by = (now.by_start / small.noise[:, None]).reshape(len(small.cut.log), -1, 2)
    along = np.abs(np.einsum("wms,wm->ws", by, rest.reshape(len(by), -1)))
    assert np.max(along / np.linalg.norm(by, axis=1)) < 1e-9 * np.linalg.norm(rest)
    # The best start states, by a refit of these alone, leave hardly less.
    best = small.refit([small.start], [()])[0].state
    at_best = small.linear(z, best).missed / small.noise
    assert rest @ rest < 1.02 * np.sum(at_best**2)


def test_a_residual_of_a_car_that_spins_does_not_diverge(small):
    """On rear tires of little friction, whole steps of the start states lead far away; no
    window may end worse than from its measured start state."""
    z = small.coefficients(z=(0.0, 0.0, 0.0, np.log(0.3)))
    given = np.sum((small.linear(z, small.cut.data.start).missed / small.noise) ** 2, axis=(1, 2))
    left = np.sum(small.residual_of(z).reshape(len(given), -1) ** 2, axis=1)
    assert np.all(left <= given * (1 + 1e-9))


def test_the_noise_of_a_fit_is_that_of_a_ridge_with_explicit_start_states(small):
    """Of all effects and unlisted forces, of twice their usual size, with the degrees of
    freedom of its hat matrix."""
    fit = small.refit([small.start], [()])[0]
    small = small.following(fit)
    now = small.at(fit, range(small.model.size))
    w, _, c, q = now.by.shape
    weight = 1 / small.noise[:, None]
    starts = block_diag(*(now.by_start * weight).reshape(w, -1, 2))
    seen = np.concatenate([(now.by * weight).reshape(-1, q), small.discrepancy.additive], axis=1)
    root = np.append(np.ones(TIRES), np.full(seen.shape[1] - TIRES, 1 / 2))
    whole = np.block([[starts, seen], [np.zeros((len(root), 2 * w)), np.diag(root)]])
    target = np.concatenate([-(now.missed * weight[:, 0]).ravel(), -fit.z])
    target = np.pad(target, (0, len(root) - TIRES))
    unit, m = np.linalg.qr(whole)[0], len(starts)
    rest = (target - unit @ (unit.T @ target))[:m].reshape(-1, c)
    level = np.mean(rest**2, axis=0) * m / (m - np.sum(unit[:m] ** 2))
    found = small.with_noise_of(fit).noise
    np.testing.assert_allclose(found, small.noise * np.sqrt(level), rtol=1e-4)


def test_white_noise_has_its_size_in_samples_that_start_states_leave_free():
    """Whatever they are; with samples that count as a quarter of themselves."""
    generator, noise, (w, k, c) = np.random.default_rng(4), np.array([2.0, 0.5]), (500, 5, 2)
    logged = noise * generator.standard_normal((w, k, c))
    data = Data(np.ones((w, k)), np.ones((w, k)), logged, np.zeros((w, 3)), np.ones((w, 3)))
    cut = JoinedWindows(data, None, np.zeros(w, int))
    made = Windows(Model((), (), 2), None, cut, 0.02, (), noise, inflation=4.0)
    by_start = noise[:, None] * generator.standard_normal((w, k, c, 3))
    rest = made.projected(by_start, logged[..., None])[:, 0]
    assert np.mean(rest**2) == pytest.approx((k * c - 3) / (k * c) / 4.0, rel=0.05)
    np.testing.assert_allclose(np.mean(made.over_noise(rest) ** 2, axis=0), 1.0, atol=0.06)
    # Each of many logs is left out, or eight blocks of the time of few.
    for logs, parts, what in ((5, 5, "5 logs"), (2, 8, "8 blocks of time")):
        log = np.repeat(np.arange(logs), w // logs)
        code, on, is_covered = replace(made, cut=cut._replace(log=log)).folds(())
        assert (
            is_covered
            and on == f"{what} left out in turn"
            and {*np.bincount(code) // (k * c)} <= {62, 63, 100}
        )
        assert code.max() + 1 == parts and np.all(np.diff(code) >= 0)


def test_a_brush_slides_above_the_slip_of_its_closed_form():
    assert _sliding(Brush(cpa2=5e4, mu=0.9), 4000.0, 10.0) == pytest.approx(
        1.5 * 0.9 * 4000 / 5e4, rel=0.01
    )


def test_the_time_of_effects_runs_over_all_logs(tmp_path):
    """The same log twice."""
    one = Trial(5, "", 0.0, trial(5, "none").car, seconds=6.0)
    log, vehicle = written(one, tmp_path)
    again = tmp_path / f"again{Path(log).suffix}"
    again.write_bytes(Path(log).read_bytes())
    tires = [Brush(cpa2=c, mu=mu) for c, mu in one.car["tires"]]
    cut = windows([log, again], vehicle, tires, CAR_EFFECTS[:1]).cut
    first, second = (cut.rows.time[cut.log == k] for k in (0, 1))
    np.testing.assert_allclose(second, first + 0.5, atol=1e-9)
    assert -0.5 <= first.min() < first.max() <= 0.0


def test_an_unlisted_force_acts_as_the_side_force_of_a_bank(tmp_path):
    library = tuple(effect for effect in CAR_EFFECTS if effect.id == "bank")
    made, one = of_trial(tmp_path, 5, library=library)
    at = made.coefficients(), made.cut.data.start
    by, car = made.linear(*at, [4]).by, one.car
    weight, wheelbase = car["mass"] * 9.81, car["l_f"] + car["l_r"]
    # At small steering angles, the forces of both axles without a moment.
    forces = [weight * car[arm] / wheelbase for arm in ("l_r", "l_f")]
    forces = np.broadcast_to(np.reshape(forces, (2, 1)), (*by.shape[:2], 2, 1))
    found = -made.linear(*at, forces=forces).by
    np.testing.assert_allclose(found * 0.02, by, atol=0.02 * np.abs(by).max())


SIZES = {
    "steering_ratio": 0.15, "steering_offset": 0.02, "steering_delay": 0.08, "steering_lag": 0.1,
    "steering_play": 0.2, "compliance_steer": 0.02, "yaw_inertia": 0.4,
    "centre_of_gravity": 0.07, "lateral_load_transfer": 0.5, "longitudinal_load_transfer": 0.3,
    "aerodynamic_load": 0.25, "friction_speed": 0.4, "sliding_friction": 0.4,
    "friction_drift": 0.3, "relaxation_length": 0.3, "drive_force": 2.0, "yaw_resistance": 0.2,
    "bank": 0.04, "sideslip_zero": 0.03, "yaw_rate_zero": 0.03, "tracked_point": 0.25,
}  # fmt: skip
OTHER_LAW = {"sliding_friction": 0.5, "drive_force": 0.5}
"""Effect -> largest relative error, where the simulator has another law: friction that falls
by 1 - exp(-s^2), and the root of a friction ellipse (half of the size to first order)."""


def true_amplitude(one, effect, size):
    if effect == "steering_play":  # the simulator has it over the spread of the angle
        still = Trial(one.number, "", 0.0, one.car, one.seconds)
        return size * np.std(drive(still)[5])
    return size / 2 if effect == "drive_force" else size


SLIDES = {"sliding_friction": 1.3}
"""Effect -> grip that the driver asks for, over that of the tires, where these have to slide."""


@pytest.mark.long
@pytest.mark.parametrize("effect", LISTED)
def test_size_and_sign_of_an_effect_are_those_of_an_independent_simulation(effect, tmp_path):
    size = SIZES[effect]
    made, one = of_trial(tmp_path, 7, effect, size, grip=SLIDES.get(effect))
    fit = made.refit([made.start], [()])[0]
    made = made.following(fit)
    ids = [a.effect.id for a in made.atoms]
    atom = ids.index(effect)
    start = made.start
    sign = np.sign(made.priors.high[atom] + made.priors.low[atom] + 1e-9)
    begin = Start(start.z, np.array([0.1 * sign]), start.state)
    fit = made.refit([begin], [(atom,)])[0]
    made = made.following(replace(fit, atoms=fit.atoms))
    begin = Start(fit.z, fit.amplitude, fit.state)
    fit = made.refit([begin], [(atom,)])[0]
    scale = made.model.scales[atom]
    found, std = scale * fit.amplitude[0], scale * fit.errors[0]
    true = true_amplitude(one, effect, size)
    # The log's speed is noisy and the simulator integrates its own laws: 10 %.
    allowed = 4 * std + OTHER_LAW.get(effect, 0.1) * abs(true)
    assert found * true > 0 and std < 0.3 * abs(true)
    assert abs(found - true) < allowed, (found, true, std)


@pytest.mark.long
def test_a_floor_slope_and_a_zero_are_recovered_from_poses_of_another_point(tmp_path):
    ahead, left, zero = 0.4, 0.3, 0.01  # of the tracked point [m], and of the sideslip [rad]
    mass, inertia, arms, slope, downhill = 1400.0, 2300.0, (1.2, 1.4), 0.03, 0.6
    tires, g = ((9e4, 0.9), (1.2e5, 0.9)), 9.81

    def steer(t):
        return 0.03 + 0.03 * np.sin(0.9 * t)

    def rates(t, state):
        v_y, r, yaw, _, _ = state
        v_x, forces = 12.0, []
        for (c, mu), arm, delta, other in (
            (tires[0], arms[0], steer(t), arms[1]),
            (tires[1], -arms[1], 0.0, arms[0]),
        ):
            slip = np.arctan2(v_y + arm * r, v_x) - delta
            load = mass * g * other / sum(arms)
            forces.append(-np.sign(slip) * float(brush(np.tan(abs(slip)), load, v_x, c, mu)))
        front = forces[0] * np.cos(steer(t))
        pull = mass * g * slope * np.sin(downhill - yaw)
        return [
            (front + forces[1] + pull) / mass - v_x * r,
            (arms[0] * front - arms[1] * forces[1]) / inertia,
            r,
            v_x * np.cos(yaw) - v_y * np.sin(yaw),
            v_x * np.sin(yaw) + v_y * np.cos(yaw),
        ]

    time = np.arange(0, 30, 0.02)
    path = solve_ivp(rates, (0, 30), np.zeros(5), t_eval=time, rtol=1e-8, max_step=0.02).y
    noise = np.random.default_rng(3).standard_normal((3, len(time)))
    cos, sin = np.cos(path[2]), np.sin(path[2])
    x, y = path[3] + ahead * cos - left * sin, path[4] + ahead * sin + left * cos
    # A larger sideslip is logged as a smaller heading.
    yaw, x, y = path[2] - zero + 5e-4 * noise[0], x + 2e-3 * noise[1], y + 2e-3 * noise[2]
    log, file = tmp_path / "slope.csv", tmp_path / "vehicle.toml"
    np.savetxt(log, np.stack([time, x, y, yaw, steer(time)], axis=1), "%.9g", ",",
               header="time,x,y,yaw,steer", comments="")  # fmt: skip
    file.write_text(
        f"mass = {mass}\nl_f = {arms[0]}\nl_r = {arms[1]}\nyaw_inertia = {inertia}\n"
        f"tracked_point = [{arms[1] + ahead}, {left}]\n"
        f'gravity = {g}\n[columns]\ntime = "time"\nx = "x"\ny = "y"\nyaw = "yaw"\n'
        'steering = "steer"\n[steering]\ncommand = [-1.0, 1.0]\nangle = [-1.0, 1.0]\n'
        "[filter]\ncutoff = 4.0\nsample_rate = 50\n"
    )
    library = [effect for effect in CAR_EFFECTS if effect.id in ("floor_slope", "sideslip_zero")]
    made = windows([log], file, [Brush(cpa2=c, mu=mu) for c, mu in tires], library)
    made = replace(made, noise=np.array([5e-4, 2e-3, 2e-3]))
    start = made.start
    begin = Start(start.z, np.zeros(3), start.state)
    fit = made.refit([begin], [(0, 1, 4)])[0]
    # Force to the left slope (s cos(yaw) - c sin(yaw)) for downhill = atan2(s, c).
    found = 0.02 * fit.amplitude[[1, 0]]
    true = slope * np.array([np.sin(downhill), np.cos(downhill)])
    np.testing.assert_allclose(found, true, atol=0.003)
    assert 0.02 * fit.amplitude[2] == pytest.approx(zero, abs=0.002)
    # What is left is the noise: of no more than the samples that the start states leave free.
    assert np.mean(fit.residual**2) < 1.1
