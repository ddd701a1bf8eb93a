"""The library of effects: scale-free, in closed form, and found in their own truths."""

import numpy as np
import pytest
from conftest_diagnosis import RIG, brush, record

from tirefit.data.read import read_frame
from tirefit.diagnosis.diagnose import diagnose
from tirefit.diagnosis.effects import EFFECTS, atoms_of
from tirefit.diagnosis.effects.state import null_state
from tirefit.diagnosis.rows.covariates import half_force_slip
from tirefit.diagnosis.rows.prepared import on_scale_of, prepare
from tirefit.diagnosis.rows.rig import Rig, load_rig
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import parse_config
from tirefit.results import DataError

BY_ID = {effect.id: effect for effect in EFFECTS}
MODEL_CAR = {"force": 1e-3, "length": 0.1, "time": 0.3}
SECOND = {"force": 30.0, "length": 2.0, "time": 1.0}


def at_size(frame, force, length, time):
    """The same tire in other units, or scaled."""
    return frame | {
        "time": frame["time"] * time,
        "v": frame["v"] * length / time,
        **{name: frame[name] * force for name in ("fx", "fz")},
    }


def prepared_of(frame, rig=RIG):
    return prepare(read_frame(frame), rig, ("fx",))


def test_a_prior_scales_with_the_size_of_the_tire():
    """Relative to the file the expected change is the same: units cancel."""
    frame, _ = record(None, seed=1)
    units = {"s/m": -1.0, "m/s": 1.0, "s": 0.0, "m": 0.0}
    plain = prepared_of(frame)
    for size in (MODEL_CAR, SECOND):
        other = prepared_of(at_size(frame, **size))
        speed = size["length"] / size["time"]
        factor = {unit: speed**power for unit, power in units.items()}
        factor |= {"s": size["time"], "m": size["length"]}
        for atom in atoms_of(EFFECTS):
            if not set(atom.effect.needs) <= plain.has:
                continue
            expected = np.array(atom.prior(plain, RIG)) * factor.get(atom.effect.unit, 1.0)
            np.testing.assert_allclose(
                atom.prior(other, RIG), expected, rtol=1e-6, err_msg=atom.effect.id
            )


def _of_the_sliding_speed(slip, time, fz, v):
    return brush(slip, 5e4, 0.9 * (1 - 0.025 * np.abs(v * slip / (1 + slip))), fz)


def _with_an_offset(slip, time, fz, v):
    return brush(slip + 0.004, 5e4, 0.9, fz)


FORMULAS = {
    "with the speed of travel": (
        "friction_speed_linear", lambda s, t, fz, v: 1.15 - 0.01 * v, 0.01 / 1.15, 0.03,
    ),
    "with exponent e = 1, v_st = 1.": (
        "friction_speed_exponential",
        lambda s, t, fz, v: 0.7 + 0.3 * np.exp(-np.abs(v * s / (1 + s)) / 1.5),
        0.3, 0.1,
    ),
    "in proportion to log(F_z / F_z0)": (
        "load_friction", lambda s, t, fz, v: 1 - 0.15 * np.log(fz / 4000), -0.15, 0.1,
    ),
    "from 10": (
        "friction_step", lambda s, t, fz, v: np.where(t > 10, 0.8, 1), -0.22, 0.1,
    ),
    "quick at first, as exp(-t / ": (
        "friction_drift", lambda s, t, fz, v: 1 - 0.25 * np.exp(-t / 3), 0.25, 0.1,
    ),
}  # fmt: skip
"""What is said -> (effect, friction over its usual, amplitude, how nearly)."""

OFTEN = ("with the speed of travel", "in proportion to log(F_z / F_z0)")


def later(every, often):
    """All cases, of which only some run in ``make test``."""
    return [pytest.param(k, marks=[] if k in often else pytest.mark.long) for k in every]


@pytest.mark.parametrize("said", later(FORMULAS, OFTEN))
def test_a_named_effect_states_the_formula_of_its_amplitude(said):
    effect, friction, amplitude, rel = FORMULAS[said]
    frame, _ = record(lambda s, t, fz, v: brush(s, 5e4, 0.9 * friction(s, t, fz, v), fz), 5, 80)
    found = diagnose(read_frame(frame), rig=RIG)
    # Another law of the same kind may help beside it.
    assert effect in found.verdict.helping
    named = next(c for c in found.candidates if effect in c.effects)
    (size,) = (one for name, one in named.parameters.items() if name.startswith(f"{effect}: "))
    assert said in size.formula and said in " ".join(str(found).split())
    assert size.value == pytest.approx(amplitude, rel=rel)


@pytest.mark.parametrize(
    ("truth", "effect", "size"),
    [
        (_of_the_sliding_speed, "friction_speed_linear", MODEL_CAR),
        pytest.param(_with_an_offset, "slip_offset", SECOND, marks=pytest.mark.long),
    ],
)
def test_the_verdict_does_not_depend_on_the_scale(truth, effect, size):
    frame, _ = record(truth, seed=3)
    first, found = (diagnose(read_frame(f), rig=RIG) for f in (frame, at_size(frame, **size)))
    assert first.effects == (effect,) and first.verdict.status == "named"
    assert found.verdict.status == first.verdict.status
    assert found.effects == first.effects
    # The usual change of the slip, in the unlisted effect, is the same for all tires.
    assert found.verdict.probability == pytest.approx(first.verdict.probability, abs=0.03)
    for one, other in zip(first.candidates[:2], found.candidates[:2], strict=True):
        assert one.effects == other.effects


@pytest.mark.long
def test_friction_may_rise_with_the_sliding_speed():
    """Rubber at the speeds of a model car, by the logarithm of the sliding speed."""

    def truth(slip, time, fz, v):
        sliding = np.abs(v * slip / (1 + slip))
        return brush(slip, 5e4, 0.8 * (1 + 0.08 * np.log1p(sliding / 0.5)), fz)

    frame, _ = record(truth, seed=5)
    found = diagnose(read_frame(at_size(frame, **MODEL_CAR)), rig=RIG)
    assert any(effect.startswith("friction_speed") for effect in found.verdict.helping)
    sizes = found.candidates[0].parameters.items()
    rise = next(size for name, size in sizes if name.startswith("friction_speed"))
    assert rise.value < -2 * rise.std


def test_slip_at_half_of_the_force():
    """1 - (1 - u)^3 = 1/2 of the brush, u of the slip of full sliding."""
    slip = np.linspace(-0.3, 0.3, 4001)
    full = 1.5 * 0.9 * 4000 / 5e4
    right = (1 - 0.5 ** (1 / 3)) * full
    noise = 0.02 * np.random.default_rng(0).standard_normal(len(slip))
    found = half_force_slip(slip, brush(slip, 5e4, 0.9, 4000.0) / 4000 + noise)
    assert found == pytest.approx(right, rel=0.1)
    # Too few rows on the way up: the middle of what was driven.
    assert half_force_slip([0.1, 0.2, 0.3], np.ones(3)) == pytest.approx(0.2)
    # An angle of 90 degrees is no unit of the error of a slip.
    assert half_force_slip(np.full(3, np.tan(np.pi / 2)), np.ones(3)) == 1.0


def _changed(effect, amplitude, rows, variant=0):
    return atoms_of([BY_ID[effect]])[variant].change(null_state(), amplitude, rows)


def _rows(**given):
    return prepared_of(record(None)[0]).covariates._replace(**given)


def test_a_load_offset_changes_the_load():
    """Friction at the load of reference stays: it is the base model's to fit."""
    found = _changed("load_offset", 60.0, _rows(fz=np.array([0.5, 1.0, 1.5]))).friction
    np.testing.assert_allclose(found, np.array([1.12, 1.06, 1.04]) / 1.06)


def test_the_lateral_force_uses_part_of_the_friction():
    across, fz = np.array([0.0, 1800.0, 1800.0, -3600.0]), np.array([1.0, 1.0, 2.0, 1.0])
    found = _changed("friction_ellipse", 1.0, _rows(across=across, peak=0.9, fz=fz, load=4000.0))
    # Shares of 0, 1/2, 1/4 and all of the friction; a twentieth of the square is kept.
    np.testing.assert_allclose(found.friction**2, [1.0, 3 / 4, 15 / 16, 0.05], rtol=1e-9)


def test_the_work_of_sliding_agrees_with_its_integral():
    """At constant slip work is linear in time; a cooling tire ends evenly warm."""
    time = np.linspace(0.0, 40.0, 401)
    frame = {
        "time": time,
        "sigma_x": 0.2 + 0.01 * np.sin(9 * time),
        "fx": np.full(401, 3000.0),
        "fz": np.full(401, 4000.0),
        "v": np.full(401, 10.0),
    }
    work = prepared_of(frame).covariates.work
    np.testing.assert_allclose(np.ptp(work, axis=0), 1.0)
    np.testing.assert_allclose(work.mean(axis=0), 0.0, atol=1e-12)
    even = np.polyfit(time, work[:, 0], 1)
    assert np.std(work[:, 0] - np.polyval(even, time)) < 0.01
    # 1 - exp(-t / cooling), cooling a fifth of the record.
    warm = -np.expm1(-time / 8.0)
    assert np.corrcoef(warm, work[:, 1])[0, 1] > 0.999
    paused = frame | {"time": time + 100.0 * (time > 20)}
    cold = prepared_of(paused).covariates.work
    assert cold[202, 2] < 0.1 + cold[:, 2].min() < cold[200, 2]


def test_each_further_run_costs_half_the_logarithm_of_its_rows():
    frame, _ = record(None)
    rows = np.arange(240)
    few, many = (
        BY_ID["friction_run"].odds(prepared_of(frame | {"run": rows * runs // 240}))
        for runs in (2, 6)
    )
    assert few - many == pytest.approx(0.5 * (6 - 2) * np.log(40))


def test_constants_of_an_effect_come_from_the_fitted_rows():
    frame, _ = record(None, seed=1)
    fitted = prepared_of(frame)
    other = prepared_of(frame | {"fz": 2 * frame["fz"], "v": 3 * frame["v"]})
    here = on_scale_of(other, fitted).covariates
    np.testing.assert_allclose(here.fz, 2 * fitted.covariates.fz)
    np.testing.assert_allclose(here.load, fitted.covariates.load)
    np.testing.assert_allclose(here.brisk, fitted.covariates.brisk)
    again = on_scale_of(fitted, fitted).covariates
    for mine, same in zip(fitted.covariates, again, strict=True):
        np.testing.assert_allclose(mine, same)


def test_the_reduction_by_the_other_slip_is_a_cosine():
    rise = 1 - 0.5 ** (1 / 3)  # over the slip of full sliding
    alpha = np.array([0.0, 0.5, 2.0])
    rows = _rows(other=alpha, rise=rise, fz=1.0)
    change, state = BY_ID["combined_slip"].change, null_state()
    found = change(state, 1.0, (0.0, 1.0), rows)
    wanted = np.cos(np.arctan(3 * alpha))
    np.testing.assert_allclose(found.friction, wanted, rtol=5e-3)
    np.testing.assert_allclose(found.stiffness, wanted, rtol=5e-3)
    np.testing.assert_allclose(change(state, 1.0, (1.0, 0.0), rows).other, alpha)


def test_every_effect_has_an_explanation_and_a_remedy():
    for effect in EFFECTS:
        assert effect.means and effect.remedy and effect.formula
        assert effect.told_apart_by or effect.id == "relaxation_length"
        assert set(effect.looks_like) <= set(BY_ID), effect.id
        assert len(effect.per) in (1, len(effect.variants))
    assert len(EFFECTS) >= 25 + 12


def test_slip_noise_from_a_speed_falls_with_the_speed(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text("[noise]\nfx = 40\nsigma_x = 0.003\nsigma_x_speed = 0.01\n")
    rig = load_rig(path)
    assert rig.slip_noise("sigma_x", "_speed") == 0.01
    assert rig.slip_noise("alpha", "_speed") is None
    frame, _ = record(None)
    prepared = prepared_of(frame, rig)
    right = np.sqrt(0.003**2 + (0.01 / frame["v"]) ** 2)
    np.testing.assert_allclose(prepared.slip_std, right)
    only = prepared_of(frame, Rig(noise={"sigma_x_speed": 0.01}))
    np.testing.assert_allclose(only.slip_std, 0.01 / frame["v"])
    bare = {name: frame[name] for name in frame if name != "v"}
    with pytest.raises(DataError, match="no column v"):
        prepared_of(bare, rig)
    # The same words in fit.toml, the same noise.
    noise = {"sigma_x": 0.003, "sigma_x_speed": 0.01}
    problem = build(read_frame(frame), "brush", parse_config({"noise": noise})).problem
    np.testing.assert_allclose(problem.slip_noise["sigma_x"], right)
