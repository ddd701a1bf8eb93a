"""A vehicle log: forces derived from the motion, rates, runs that differ."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from conftest_diagnosis import brush
from scipy.signal import lfilter
from scipy.stats import norm, t

from fits.withheld.car import FAULTS, Car, drive
from tirefit.data.read import read_frame
from tirefit.diagnosis.diagnose import diagnose
from tirefit.diagnosis.effects import EFFECTS, atoms_of, effects_by_id
from tirefit.diagnosis.effects.vehicle import lag
from tirefit.diagnosis.rows.covariates import derived_from
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig, load_rig
from tirefit.diagnosis.rows.runs import shrunk
from tirefit.diagnosis.rows.slips import AHEAD, slip_rate
from tirefit.diagnosis.rows.subject import fit_base
from tirefit.diagnosis.summary.closure import closure_of, of_so_few_runs, without_each
from tirefit.report.diagnosis.report import diagnosis_text
from tirefit.results import UsageError

KNOWN = effects_by_id(EFFECTS)
RIG = Rig(noise={"fy_relative": 0.005, "alpha": 5e-4})
MASS_REAR, ARM = 1400 * 1.2 / 2.6, 2300 / (1400 * 1.2)


@pytest.fixture(scope="module")
def driven():
    return drive(Car(), rows=240)


def prior(effect, frame, rig=RIG):
    """The prior with a vehicle file that states everything possible."""
    data, stated = read_frame(frame), ("tracked_point", "yaw_inertia", "clock")
    constants = dict.fromkeys(stated, 0.005)
    data = replace(data, source=replace(data.source, constants=constants))
    prepared = prepare(data, rig, ("fy",))
    return atoms_of([KNOWN[effect]])[0].prior(prepared, rig)


# --- a force that follows from the motion -----------------------------------------


def test_a_derived_force_is_recognised_by_its_channels(driven):
    found = derived_from(read_frame(driven), "fy")
    assert found.mass == pytest.approx(MASS_REAR) and not found.steered
    assert found.arm == pytest.approx(ARM)
    front = derived_from(read_frame(drive(Car(), "front")), "fy")
    assert front.steered and front.mass == pytest.approx(1400 * 1.4 / 2.6)
    # Even a good transducer has noise.
    noisy = driven["fy"] * (1 + 0.005 * np.sin(np.arange(240)))
    assert derived_from(read_frame(driven | {"fy": noisy}), "fy") is None
    without = {name: x for name, x in driven.items() if name != "a_y"}
    assert derived_from(read_frame(without), "fy") is None
    assert derived_from(read_frame(driven), "mz") is None


def test_priors_of_a_derived_force_follow_the_stated_vehicle(driven):
    measured = drive(Car(), measured=True, rows=240)
    assert prior("tracked_point", driven).scale == pytest.approx(0.03 * ARM)
    assert prior("tracked_point", measured).scale > 5 * 0.03 * ARM
    assert prior("channel_delay", driven).scale == pytest.approx(0.005)
    assert prior("channel_delay", measured).scale > 0.01
    inertia = prior("yaw_inertia", driven)
    assert inertia.scale == pytest.approx(0.3 * 2300 / 2.6)
    assert inertia.low == pytest.approx(-6 * inertia.scale)
    # What is stated counts, of a measured force as well.
    rig = Rig(vehicle={"position": 0.002, "clock": 0.001, "yaw_inertia": 0.05})
    for frame in (driven, measured):
        assert prior("tracked_point", frame, rig).scale == pytest.approx(0.002)
        assert prior("channel_delay", frame, rig).scale == pytest.approx(0.001)
    assert prior("yaw_inertia", driven, rig).scale == pytest.approx(0.05 * 2300 / 2.6)
    lifted = prior("load_transfer", driven)
    assert lifted.scale <= 0.4 * np.ptp(driven["a_x"]) / 9.8


def of_derive(frame, found, std=0.002, stated=0.115):
    """The data as a derived file states them, with the tracked point that derive found."""
    data = read_frame(frame)
    constants = {"tracked_point": stated, "found_point": found, "found_point_std": std}
    source = replace(data.source, constants={**data.source.constants, **constants})
    return replace(data, source=source)


def test_the_estimate_of_derive_is_the_prior_of_the_tracked_point(driven):
    prepared = prepare(of_derive(driven, 0.085), RIG, ("fy",))
    known = atoms_of([KNOWN["tracked_point"]])[0].prior(prepared, RIG)
    assert (known.center, known.scale) == pytest.approx((0.03, 0.002))
    assert known.low < 0 < 0.03 < known.high
    effect = KNOWN["tracked_point"]
    # Of a Gaussian estimate: 4 ± 2 mm against 0 is a log likelihood ratio of 2.
    assert effect.odds(prepare(of_derive(driven, 0.111), RIG, ("fy",))) == pytest.approx(2.0)
    assert effect.odds(prepared) == 30.0


@pytest.mark.parametrize(("found", "searched"), [(0.115, False), (0.120, False), (0.125, True)])
def test_a_point_that_derive_confirms_is_not_searched(driven, found, searched):
    prepared = prepare(of_derive(driven, found), RIG, ("fy",))
    assert (set(KNOWN["tracked_point"].needs) <= prepared.has) is searched


def test_stated_properties_of_a_vehicle_are_read_and_checked(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text("[vehicle]\nposition = 0.002\nclock = 1e-3\n")
    rig = load_rig(path)
    assert rig.vehicle == {"position": 0.002, "clock": 1e-3}
    path.write_text("[vehicle]\ncolour = 3\n")
    with pytest.raises(UsageError, match="vehicle.colour"):
        load_rig(path)
    path.write_text("[vehicle]\npositoin = 3\n")
    with pytest.raises(UsageError, match="did you mean 'position'"):
        load_rig(path)
    path.write_text("[vehicle]\nposition = -1\n")
    with pytest.raises(UsageError, match="vehicle.position"):
        load_rig(path)
    path.write_text("vehicle = 3\n")
    with pytest.raises(UsageError, match="must be a table"):
        load_rig(path)


def test_the_acceleration_of_a_derived_force_explains_nothing(driven):
    """An effect of the force uses the force of the model, not the measured one."""
    effects = [KNOWN["slip_offset"], KNOWN["toe"], KNOWN["yaw_inertia"]]
    found = diagnose(read_frame(driven), rig=RIG, effects=effects)
    said = " ".join(found.data.motion)
    assert "fy was derived from a_y (646.2 kg of it)" in said
    assert "does not state tracked_point, clock, yaw_inertia: measure them" in said
    whole = diagnosis_text(found, full=True)
    assert said.split(";")[0] in " ".join(whole.split())
    measured = drive(Car(), measured=True, rows=240)
    assert not diagnose(read_frame(measured), rig=RIG, effects=effects).data.motion
    assert found.verdict.status == "none"


def test_the_lean_of_a_derived_force_is_that_of_the_model(driven):
    """The lateral acceleration over g that its forces cause: that of the file, which has four
    wheels and a body that yaws, to a fifth."""
    base = fit_base(prepare(read_frame(driven), RIG, ("fy",)), "brush", [KNOWN["toe"]], RIG)
    force = base.forces(base.z, np.zeros(len(base.atoms)))["fy"]
    lean, measured = base.design.rows.lean[:240], driven["a_y"] / 9.80665
    np.testing.assert_allclose(lean, -force / driven["fz"], rtol=1e-9)
    assert 0 < np.std(lean - measured) < 0.3 * np.std(measured)


OFTEN, LATER = ("yaw_inertia",), ("tracked_point", "floor_slope")
"""Faults of ``make test`` and of ``make test-long``; the others are run on request."""


def _marks(effect: str) -> list:
    if effect in OFTEN:
        return []
    return [pytest.mark.long if effect in LATER else pytest.mark.statistics]


@pytest.mark.parametrize("effect", [pytest.param(e, marks=_marks(e)) for e in FAULTS])
def test_errors_of_a_vehicle_are_named(effect):
    """Four wheels, integrated, without any formula of the library."""
    # A path of some curvature at some speed has one road wheel angle: a yaw rate over
    # speed and a lateral acceleration together are that angle, but for its lead.
    without = ("toe",) if effect == "steering_gain" else ()
    data = read_frame(drive(*FAULTS[effect], rows=240 if effect in OFTEN else 700))
    found = diagnose(data, rig=RIG, without=without)
    # What a brush on two wheels lacks of a car may be there as well.
    assert effect in (*found.effects, *found.verdict.also_possible)


# --- rates ------------------------------------------------------------------------


def test_a_measured_rate_gives_the_slip_between_rows():
    """Rows 0.2 s apart with a slip at 1 Hz; the slip 20 ms earlier, by its formula."""
    time = np.arange(0.0, 20.0, 0.2)
    slip, rate = np.sin(2 * np.pi * time), 2 * np.pi * np.cos(2 * np.pi * time)
    run = np.zeros(len(time), int)
    found = slip_rate(slip, time, run, 0.0, rate)
    assert found.present and found.past.interval < 0.02
    np.testing.assert_array_equal(found.rate, rate)
    age = found.past.interval * np.arange(1, 4)
    inside = slice(3, -3)
    right = np.sin(2 * np.pi * (time[inside, None] - age))
    past = found.past.path[inside, AHEAD + 1 : AHEAD + 4]
    np.testing.assert_allclose(past, right, atol=0.01)
    blind = slip_rate(slip, time, run)
    assert not blind.present or blind.past.interval >= 0.2
    grows = np.sign(slip) * np.sign(rate)
    sure = np.abs(rate) > 2
    np.testing.assert_array_equal(np.sign(found.turning)[sure], grows[sure])


@pytest.mark.parametrize("interval", [0.0125, 0.005])
def test_without_noise_the_past_slip_is_the_measured_one(interval):
    """A chirp of 0.15 to 2 Hz: the slip behind a relaxation of 30 ms, against the
    equation itself, integrated finely."""
    time = np.arange(0.0, 16.0, interval)

    def slip(t):
        return 0.09 * np.sin(2 * np.pi * (0.15 * t + 1.85 * t**2 / 32))

    fine = np.arange(0.0, 16.0, interval / 50)
    ways = interval / 50 / 0.03
    share = 1 - np.exp(-ways)
    behind = np.append(0.0, lfilter([share / 2, share / 2], [1, share - 1], slip(fine))[1:])
    found = slip_rate(slip(time), time, np.zeros(len(time), int))
    steps = jnp.full(len(time), found.past.interval)
    late = lag(0.03, steps)(jnp.asarray(found.past.path))
    right = np.interp(time, fine, behind) - slip(time)
    # A slip of 0.09 comes late by up to 0.03; a force to 1 % needs it to 3e-4.
    assert np.abs(right).max() > 0.025
    assert np.sqrt(np.mean((np.asarray(late) - right) ** 2)) < 1e-4


@pytest.mark.long
@pytest.mark.parametrize(("rate", "each"), [(80, 3.0), (200, 10.0)])
def test_relaxation_in_fast_sweeps_is_the_only_named_effect(rate, each):
    """The equation itself, integrated between the rows, from 0.15 to 2 Hz, in two sweeps
    of ``each`` seconds."""
    time, length = np.arange(0.0, 2 * each, 1 / rate), 0.3
    v = np.where(time < each, 10.0, 20.0)
    swept = np.where(time < each, time, time - each)
    slip = 0.09 * np.sin(2 * np.pi * (0.15 * swept + 1.85 * swept**2 / 2 / each))
    late, behind = np.zeros(len(time)), 0.0
    for row in range(1, len(time)):
        rise = (slip[row] - slip[row - 1]) * rate * length / v[row]
        left = np.exp(-v[row] / length / rate)
        behind = slip[row] - rise + (behind - slip[row - 1] + rise) * left
        late[row] = behind
    noise = 80 * np.random.default_rng(4).standard_normal(len(time))
    frame = {
        "time": time,
        "alpha": np.arctan(slip),
        "fz": np.full(len(time), 4000.0),
        "fy": brush(late, 4e4, 0.9, 4000.0) + noise,
        "v": v,
    }
    found = diagnose(read_frame(frame), rig=Rig(noise={"fy": 80.0}))
    assert found.effects == ("relaxation_length",)
    (value,) = found.candidates[0].parameters.values()
    assert value.value == pytest.approx(length, rel=0.03)


def test_a_relaxation_of_10_ms_is_named_from_thinned_rows():
    time, slip, rate, late = np.arange(0.0, 50.0, 0.2), 0.0, 0.0, 0.0
    for size, turn, phase in ((0.05, 5.3, 0.0), (0.04, 13.1, 1.0)):
        angle, behind = turn * time + phase, turn * 0.01
        slip = slip + size * np.sin(angle)
        rate = rate + size * turn * np.cos(angle)
        # First order: behind by atan(omega tau), smaller by its cosine.
        lag = np.arctan(behind)
        late = late + size * np.cos(lag) * np.sin(angle - lag)
    generator, count = np.random.default_rng(0), len(time)
    frame = {
        "time": time,
        "alpha": np.arctan(slip),
        "alpha_rate": rate / (1 + slip**2),
        "fy": brush(late, 40.0, 0.9, 7.0) + 0.03 * generator.normal(size=count),
        "fz": np.full(count, 7.0),
        "v": np.full(count, 2.0),
    }
    kept = ("slip_offset", "relaxation_length", "pressure_asymmetry")
    found = diagnose(
        read_frame(frame),
        rig=Rig(noise={"fy": 0.03, "alpha": 1e-5}),
        effects=[KNOWN[name] for name in kept],
    )
    assert found.effects == ("relaxation_length",)
    (length,) = found.candidates[0].parameters.values()
    assert length.value == pytest.approx(0.02, rel=0.05)
    blind = {name: x for name, x in frame.items() if name != "alpha_rate"}
    needs = diagnose(read_frame(blind), rig=RIG, effects=[KNOWN[name] for name in kept]).untestable
    assert [lacking.effect for lacking in needs] == ["relaxation_length"]


# --- runs -------------------------------------------------------------------------


def test_values_per_run_shrink_to_a_common_value():
    """Two limits in closed form, and the mean of many cases in between."""
    values = np.array([1.0, 2.0, 6.0])
    sure = shrunk(values, 1e-12 * np.eye(3), "abc")
    np.testing.assert_allclose([value for value, _ in sure.values.values()], values, rtol=1e-3)
    assert sure.common == pytest.approx(3.0)
    # Restricted likelihood: the sample's standard deviation.
    assert sure.spread == pytest.approx(np.std(values, ddof=1), rel=0.01)
    assert sure.std == pytest.approx(sure.spread / np.sqrt(3), rel=0.01)
    assert sure.spread_ci[0] < sure.spread < sure.spread_ci[1]
    # Of R runs with error e: b e^2 + (1 - b)^2 (e^2 + s^2) / R, where b = s^2 / (e^2 + s^2).
    law = shrunk(values, np.eye(3), "abc")
    square, errors = law.spread**2, np.array([error for _, error in law.values.values()])
    far = square / (1 + square)
    np.testing.assert_allclose(errors**2, far + (1 - far) ** 2 * (1 + square) / 3)
    noise = shrunk(values, 100 * np.eye(3), "abc")
    own, errors = np.transpose([*noise.values.values()])
    assert noise.spread == 0.0 and noise.spread_ci[0] == 0.0
    np.testing.assert_allclose(own, 3.0)
    np.testing.assert_allclose(errors, 10 / np.sqrt(3), rtol=1e-6)
    assert noise.p_value == pytest.approx(0.93, abs=0.01)  # chi2 = 14 / 100 of 2


def test_shrunk_values_are_closer_with_right_errors():
    generator, off, raw, inside = np.random.default_rng(1), [], [], []
    for _ in range(300):
        truth = 2 + 0.5 * generator.standard_normal(8)
        seen = truth + 0.5 * generator.standard_normal(8)
        law = shrunk(seen, 0.25 * np.eye(8), "abcdefgh")
        values, errors = np.transpose([*law.values.values()])
        off.append(np.mean((values - truth) ** 2))
        raw.append(np.mean((seen - truth) ** 2))
        inside.append(np.abs(values - truth) < norm.ppf(0.95) * errors)
    assert np.mean(off) < 0.75 * np.mean(raw)
    assert 0.8 < np.mean(inside) < 0.95


def of_runs(offsets, seed=0):
    """Free driving on both sides in runs with different offsets of the slip angle."""
    generator, blocks = np.random.default_rng(seed), []
    for number, offset in enumerate(offsets):
        time = np.arange(50) * 0.24
        slip = 0.15 * np.sin(0.9 * time + number)
        force = brush(slip + offset, 5e4, 0.9, 4000.0)
        force = force + 20 * generator.standard_normal(50)
        blocks.append([time + 20 * number, np.arctan(slip), force, 0 * time + number])
    time, alpha, fy, run = np.concatenate(blocks, axis=1)
    run = np.array([f"r{k:.0f}" for k in run])
    return {"time": time, "alpha": alpha, "fy": fy, "fz": 0 * time + 4000, "run": run}


def test_different_offsets_of_runs_are_reported_with_their_spread():
    offsets = np.array([0.004, -0.003, 0.006, -0.002, -0.005])
    kept = ("slip_offset", "force_offset", "slip_offset_run", "load_stiffness")
    effects = [KNOWN[name] for name in kept]
    rig = Rig(noise={"fy": 20.0, "alpha": 1e-4})
    found = diagnose(read_frame(of_runs(offsets)), rig=rig, effects=effects)
    assert found.effects == ("slip_offset_run",)
    told = found.runs["slip_offset"]
    own = np.array([told.values[f"r{k}"] for k in range(5)])
    assert np.all(np.abs(own[:, 0] - offsets) < 4 * own[:, 1])
    assert told.spread == pytest.approx(np.std(offsets, ddof=1), rel=0.2)
    assert told.p_value < 1e-6
    # One zero for all is one, and no spread.
    same = diagnose(read_frame(of_runs([0.004] * 5)), rig=rig, effects=effects)
    assert same.effects == ("slip_offset",)
    assert same.runs["slip_offset"].p_value > 0.01
    assert same.runs["slip_offset"].common == pytest.approx(0.004, abs=5e-4)
    lone = {k: x for k, x in of_runs([0.0]).items() if k != "run"}
    alone = diagnose(read_frame(lone), rig=rig, effects=effects)
    assert not alone.runs
    assert "slip_offset_run" in {lacking.effect for lacking in alone.untestable}


def test_an_interval_of_closure_uses_the_number_of_logs():
    generator = np.random.default_rng(0)
    run = np.repeat([0, 1, 2], 400)
    before = generator.normal(size=1200) + 5.0
    left = np.repeat([0.2, 2.0, 4.0], 400)
    after = generator.normal(size=1200) + left

    def width(codes):
        found = closure_of(before, after, np.ones(1200), codes, 1.0, generator)
        return found.closed_ci[1] - found.closed_ci[0]

    assert width(run) > 5 * width(np.zeros(1200, int))
    # Alike, three logs tell as much as their rows.
    after = generator.normal(size=1200) + 1.0
    assert width(run) < 4 * width(np.zeros(1200, int))


def test_an_interval_from_few_runs_uses_students_t():
    terms = np.array([[1.0], [1.0], [2.0], [2.0], [6.0], [6.0]])
    run = np.array([0, 0, 1, 1, 2, 2])
    one_less = without_each(terms, run)
    np.testing.assert_allclose(one_less[:, 0], [4.0, 3.5, 1.5])
    low, high = of_so_few_runs(0.0, -0.01, 0.01, one_less[:, 0] / 100)
    # The jackknife of a mean is its standard error.
    error = np.std([1.0, 2.0, 6.0], ddof=1) / np.sqrt(3) / 100
    assert high == pytest.approx(t.ppf(0.95, 2) * error) and low == -high
    assert of_so_few_runs(0.0, -0.5, 0.5, one_less[:, 0] / 100) == (-0.5, 0.5)
    assert len(without_each(terms, np.zeros(6, int))) == 0


FRONT = pytest.mark.xfail(
    strict=True, reason="toe and force hysteresis take the shared error of the slips, at 0.88"
)

REAR = pytest.mark.xfail(
    strict=True,
    reason="carcass, relaxation and toe together draw what the motion knows of it:"
    " none is known to half its size, and the status is unknown at 0.5",
)


@pytest.mark.long
@pytest.mark.parametrize(
    ("axle", "seed"), [pytest.param("front", 2, marks=FRONT), pytest.param("rear", 3, marks=REAR)]
)
def test_exact_motion_channels_with_noisy_slip_give_no_effect(axle, seed):
    """The only error is a noise of the slip angle, 3 mrad, stated in the rig file; yaw
    rate and accelerations are exact and together nearly determine the slip."""
    frame = drive(Car(), axle, measured=True)
    noise = 0.003 * np.random.default_rng(seed).normal(size=len(frame["alpha"]))
    noisy = read_frame(frame | {"alpha": frame["alpha"] + noise})
    verdict = diagnose(noisy, rig=Rig(noise={"alpha": 0.003})).verdict
    assert verdict.status == "none"
