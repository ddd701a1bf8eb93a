"""Uninformative data, or data spoilt by one wrong cell, are reported, not diagnosed."""

import re
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import tirefit
from tirefit.data.read import read_frame
from tirefit.diagnosis.diagnose import a_model, a_rig, a_seed, names, the_effects
from tirefit.diagnosis.effects import EFFECTS, Effect
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.simulator import given_simulator
from tirefit.models import MODELS, Brush
from tirefit.report.diagnosis.report import diagnosis_text
from tirefit.results import DataError, TirefitError, UsageError

ACROSS = Path(__file__).parents[2] / "fits" / "cmu_wheel" / "grouser_wheel.csv"
FEW = [e for e in EFFECTS if e.id in ("slip_offset", "force_offset", "load_friction")]
"""Enough where a test is not about what is named."""


def rig_data(seed=1, noise=30.0):
    """A brush at three loads, with noise rounded to whole newtons."""
    generator = np.random.default_rng(seed)
    slip = np.tile(np.linspace(0.005, 0.25, 40), 3)
    fz = np.repeat([3000.0, 4000.0, 5000.0], 40)
    # S(12) of a brush of c_p a^2 = 50 kN and mu = 0.9.
    x = np.minimum(slip * 1e5 / (3 * 0.9 * fz), 1.0)
    fx = 0.9 * fz * (3 * x - 3 * x**2 + x**3)
    fx = fx + noise * generator.standard_normal(len(fx))
    return {"sigma_x": slip, "fx": fx, "fz": fz}


@pytest.mark.parametrize(
    ("column", "value", "has"), [("fz", 40000.0, "3000 to 5000 N"), ("fx", 3e9, "N")]
)
def test_one_mistyped_cell_is_excluded_and_reported(column, value, has):
    data = rig_data()
    as_typed = tirefit.diagnose(read_frame(data), effects=FEW)
    data[column] = data[column].copy()
    data[column][4] = value
    found = tirefit.diagnose(read_frame(data), effects=FEW)
    (said,) = found.data.set_aside
    assert f"column {column!r}" in said and has in said
    assert as_typed.data.set_aside == () and found.n == as_typed.n - 1
    assert found.verdict.effects == as_typed.verdict.effects == ()
    assert f"excluded: {said.split(':')[0]}" in diagnosis_text(found, full=True)
    # Of many rows the first are named.
    many = read_frame(data)
    again = replace(many, source=replace(many.source, masked=()))
    assert tirefit.diagnose(again, effects=FEW).data.set_aside == (said,)


@pytest.mark.parametrize("sim", [None, Brush(cpa2=5e4, mu=0.9), "forces"])
def test_exact_forces_have_no_gap(sim):
    data = rig_data(noise=0.0)
    given = {"fx": data["fx"]} if sim == "forces" else sim
    # The whole library has no gap to explain; an example is enough for the simulators.
    library = EFFECTS if sim is None else FEW
    found = tirefit.diagnose(read_frame(data), sim=given, effects=library)
    assert found.verdict.status == "none"
    assert found.verdict.effects == ()
    assert not found.gap.resolvable
    # 1e-5 of the load is the least that anybody resolves; a fit leaves half of it.
    assert found.gap.rms < 0.04
    if sim is not None:
        mu = found.verdict.parameters["mu"]
        assert abs(mu.measured - 0.9) < 1e-3 and not mu.differs


SIMULATED = {
    "zeros": (lambda fx: 0 * fx, "'fx_sim': zero in every row"),
    "no number": (lambda fx: np.nan * fx, "'fx_sim': no number in every row"),
    "kN": (lambda fx: 1e-3 * fx, "'fx_sim': .*times that of the measured force.*'fx_sim': 'kN'"),
    "mN": (lambda fx: 1e3 * fx, "'fx_sim': .*times that of the measured force"),
    "huge": (lambda fx: 1e300 * fx, "'fx_sim': .*times that of the measured force"),
    "twice": (lambda fx: {"fx": fx, "fx_sim": fx}, "fx and fx_sim are the same force"),
    "complex": (lambda fx: {"fx": 1j * fx}, "sim is of type ndarray"),
    "function": (lambda fx: lambda slip: slip, "sim is of type function"),
    "bytes": (lambda fx: b"abc", "sim is of type bytes"),
    "number as name": (lambda fx: {0: fx}, "sim: 0 of shape"),
}


@pytest.mark.parametrize(("sim", "said"), SIMULATED.values(), ids=SIMULATED)
def test_what_is_no_simulated_force_is_refused(sim, said):
    data = read_frame(rig_data())
    with pytest.raises(TirefitError, match=f"(?s){said}") as caught:
        given_simulator(sim(data["fx"]), data).beside(data)
    assert ("kN" in str(caught.value)) == ("kN" in said)


def test_times_that_differ_in_the_last_digit_are_accepted():
    data = rig_data()
    time = np.arange(120) * 0.1
    time[17] = np.nextafter(time[16], 1.0)
    found = tirefit.diagnose(read_frame(data | {"time": time}), effects=FEW)
    assert found.n == 120


def test_the_fitted_data_may_not_be_held_out():
    data = read_frame(rig_data())
    with pytest.raises(DataError, match="the held-out data are those"):
        tirefit.diagnose(data, holdout=[data])
    with pytest.raises(DataError, match="the held-out data are those"):
        tirefit.diagnose(data, holdout=[data.where(np.arange(120) > 80)])


def test_other_rows_of_the_same_file_may_be_held_out():
    data, early = read_frame(rig_data()), np.arange(120) < 80
    found = tirefit.diagnose(data.where(early), holdout=[data.where(~early)], effects=FEW)
    assert found.verdict.status == "none"
    assert len(found.rows["fx"]["base"]) == 120


def test_without_effects_the_base_model_is_still_tested():
    null = read_frame(rig_data())
    without = [effect.id for effect in EFFECTS]
    assert tirefit.diagnose(null, without=without).verdict.status == "none"
    wrong = rig_data()
    wrong["fx"] = wrong["fx"] * np.where(wrong["sigma_x"] > 0.12, 0.8, 1.0)
    found = tirefit.diagnose(read_frame(wrong), without=without)
    assert found.verdict.status == "unknown"


def test_an_impossible_force_is_refused():
    data = rig_data()
    data["fx"] = data["fx"] * 1e10
    with pytest.raises(DataError, match="times the largest load") as caught:
        tirefit.diagnose(read_frame(data))
    assert "--unit fx=" in caught.value.problems[0].remedy


@pytest.mark.parametrize(
    ("noise", "reason"),
    [({"sigma_x": 10.0}, "is unknown"), ({"fx": 1e7}, "beyond the largest load")],
)
def test_noise_larger_than_the_spread_is_refused(noise, reason):
    with pytest.raises(DataError, match=reason):
        tirefit.diagnose(read_frame(rig_data()), rig=Rig(noise=noise))


WRONG = {
    "sim no file": ({"sim": Path("no.json")}, "no.json"),
    "no effects": ({"effects": ()}, "effects: none to search"),
    "model empty": ({"model": ""}, "unknown model ''"),
    "seed below zero": ({"seed": -1}, "seed = -1"),
    "misspelt": ({"without": "friction_stp"}, "--without: 'friction_stp' is not known"),
    "force": ({"forces": "fz"}, "gives no fz"),
    "no such file": ({"holdout": "no.csv"}, "no.csv: the file does not exist"),
}


@pytest.mark.parametrize(("arguments", "said"), WRONG.values(), ids=WRONG)
def test_wrong_arguments_are_refused(arguments, said):
    with pytest.raises(TirefitError, match=re.escape(said)):
        tirefit.diagnose(read_frame(rig_data()), **arguments)


def test_wrong_types_of_rig_and_seed_are_refused():
    with pytest.raises(UsageError, match="rig is of type dict"):
        a_rig({"noise": {"fx": 30.0}})
    with pytest.raises(UsageError, match=r"seed = 1\.5"):
        a_seed(1.5)
    assert a_seed(np.uint32(7)) == 7


def test_wrong_types_of_names_and_effects_are_refused():
    with pytest.raises(UsageError, match="without = 3"):
        names(3, "without")
    with pytest.raises(UsageError, match=r"forces = \[1\]"):
        names([1], "forces")
    assert names("fx", "forces") == names(["fx"], "forces") == ("fx",)
    for wrong in (3, ["friction_step"], ()):
        with pytest.raises(UsageError, match="give Effect records"):
            the_effects(wrong)
    assert the_effects(iter(EFFECTS)) == EFFECTS
    with pytest.raises(UsageError, match=r"is a simulator: sim=\.\.\."):
        a_model(MODELS["brush"])


BROKEN = {
    "raises": (lambda state, a, constants, rows: state.nothing, "AttributeError"),
    "shape": (
        lambda state, a, constants, rows: state._replace(friction=rows.fz[:3] * a),
        "effect 'mine': ValueError",
    ),
    "no slope at zero": (
        lambda state, a, constants, rows: state._replace(
            friction=jnp.sqrt(1 + 0 * a) + jnp.sqrt(jnp.abs(a))
        ),
        "effect 'mine': its change at amplitude 0 is not finite",
    ),
}


@pytest.mark.parametrize(("change", "said"), BROKEN.values(), ids=BROKEN)
def test_an_effect_that_fails_is_reported(change, said):
    mine = Effect(
        id="mine", family="friction x time", change=change, scale=0.1, unit="-", formula="none"
    )
    with pytest.raises(UsageError, match=re.escape(said)):
        tirefit.diagnose(read_frame(rig_data()), effects=(*FEW, mine))


def test_an_effect_without_end_at_a_slip_angle_of_90_degrees_is_left_out():
    """Friction that falls with the sliding speed, of a wheel that moves across its plane."""
    falls = [effect for effect in EFFECTS if effect.id == "friction_speed_linear"]
    found = tirefit.diagnose(ACROSS, effects=(*FEW, *falls))
    assert "finite slips" in {n for x in found.untestable for n in x.needs}


def test_two_noise_levels_of_one_force_are_refused(tmp_path):
    with pytest.raises(UsageError, match="fx and fx_relative are both stated"):
        Rig(noise={"fx": 30.0, "fx_relative": 0.01})
    path = tmp_path / "rig.toml"
    path.write_text("[noise]\nfx = 30\nfx_relative = 0.01\n")
    with pytest.raises(UsageError, match=re.escape(f"{path}: noise: fx and")):
        a_rig(path)


@pytest.mark.parametrize("value", [np.nan, -1.0, 0.0, np.inf])
def test_a_noise_must_be_a_positive_number(value):
    with pytest.raises(UsageError, match="give a positive number"):
        Rig(noise={"fx": value})


def test_a_single_value_is_accepted_for_a_list(tmp_path):
    data, other = read_frame(rig_data()), read_frame(rig_data(seed=2))
    few = [*FEW, *(effect for effect in EFFECTS if effect.id == "friction_step")]
    (tmp_path / "rig.toml").write_text("[noise]\nfx = 30\n")
    one = tirefit.diagnose(
        data,
        rig=tmp_path / "rig.toml",
        forces="fx",
        effects=few,
        without="friction_step",
        holdout=other,
    )
    several = tirefit.diagnose(
        data,
        rig=Rig(noise={"fx": 30.0}),
        forces=["fx"],
        effects=few,
        without=["friction_step"],
        holdout=[other],
    )
    assert one.verdict == several.verdict
    assert one.settings == several.settings
    assert "friction_step" not in one.settings.effects
    assert one.settings.holdout == (other.source.sha256,)
    assert tirefit.diagnose(data, effects=few, holdout=None).settings.holdout == ()
