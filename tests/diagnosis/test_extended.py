"""Effects written into a tire give the forces of the diagnosis."""

import json

import jax
import numpy as np
import pytest
from conftest_diagnosis import bare, brush

from tirefit.data.read import read_frame
from tirefit.diagnosis.effects import EFFECTS, Atom
from tirefit.diagnosis.extended import Document, extend, extension_of, read_document
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.subject import fit_base
from tirefit.models import MODELS, TireInputs, forces, modelled
from tirefit.results import DataError, UsageError

RIG = Rig(noise={"fx_relative": 0.01, "fy_relative": 0.01})
"""The slip is exact: a force is that at the slip, not the mean over its noise."""

HELD = {
    "pressure_asymmetry", "pressure_flatness", "kinetic_friction",
    "pressure_shift_load", "carcass_flexibility", "friction_speed_linear",
    "friction_speed_exponential", "load_stiffness", "load_friction",
    "drive_brake_asymmetry", "friction_pressure", "stiffness_pressure",
    "stiffness_speed",
}  # fmt: skip
LATERAL = {"camber_thrust", "conicity"}
OF_SHAPE = {"pressure_asymmetry", "carcass_flexibility", "kinetic_friction", "load_friction"}
OF_SHAPE |= {"friction_speed_linear"}
"""Enough for another slip or base: effects of shape use the pressure law of the base, those of the
sliding speed the braking slip."""


def table(mode, rows=240):
    """Slips of one kind over loads, speeds, camber and pressure, in random order."""
    generator = np.random.default_rng(2)
    slip = generator.uniform(-0.2, 0.2, rows)
    fz = generator.choice([2000.0, 4000.0, 6000.0], rows)
    force = brush(slip, 5e4, 0.9, fz) + 30 * generator.standard_normal(rows)
    frame = {
        "fz": fz,
        "v": generator.choice([6.0, 24.0], rows),
        "time": np.arange(rows),
        "gamma": generator.uniform(-0.05, 0.05, rows),
        "pressure": generator.choice([1.8e5, 2.2e5], rows),
    }
    along = {"sigma_x": slip, "fx": force}
    across = {"alpha": np.arctan(slip), "fy": force}
    return read_frame(frame | (along if mode == "x" else across))


def document(base, atom, size, to, **known):
    """The part of a document that names one effect."""
    effect = atom.effect
    amplitude = {"value": size, "std": abs(size) / 10, "unit": effect.unit}
    values = {k: float(v) for k, v in base.tire.layout.natural(base.z).items()}
    return Document.model_validate({
        "data": {"name": "data", "sha256": "0" * 64}, "model": "brush",
        "simulator": None,
        "verdict": {
            "status": "named", "effects": [effect.id], "probability": 0.9,
            "acts_like": [], "also_possible": [],
        },
        "candidates": [{
            "effects": [effect.id],
            "parameters": {f"{effect.id}: amplitude": amplitude},
        }],
        "base_parameters": values, "extended_parameters": values,
        "extension": to._asdict(),
    } | known)  # fmt: skip


def force_of(tire, name, inputs):
    """Of each row, without the compilation of a program for one use."""
    sizes = TireInputs(*(np.broadcast_to(x, inputs.fz.shape) for x in inputs))
    return np.asarray(getattr(jax.vmap(tire)(sizes), name))


def based(mode, model):
    data = table(mode)
    return fit_base(prepare(data, RIG, modelled(MODELS[model])), model, EFFECTS, RIG).measured


def only(base, k):
    """The hypothesis of one atom, without its explained part."""
    return bare((base.atoms[k].effect.id,), atoms=(k,), z=base.z)


@pytest.mark.parametrize(
    ("mode", "model", "expected", "variants"),
    [
        ("y", "brush", HELD | LATERAL, 1),
        ("x", "brush", OF_SHAPE, 1),
        pytest.param("y", "brush", HELD | LATERAL, 99, marks=pytest.mark.long),
    ],
)
def test_each_tire_effect_gives_the_forces_of_the_diagnosis(mode, model, expected, variants):
    base, held = based(mode, model), set()
    rows, name = base.rows, f"f{mode}"
    given = {"alpha": np.arctan(rows.slip)} if mode == "y" else {"sigma_x": rows.slip}
    inputs = rows.inputs._replace(**given)
    for k, atom in enumerate(base.atoms):
        effect, scale = atom.effect, float(base.priors.scale[k])
        if effect.channels and name not in effect.channels:
            continue
        if atom.variant >= variants or (expected is OF_SHAPE and effect.id not in expected):
            continue
        size = (-0.5 if max(high for _, high in effect.bounds) <= 0 else 0.5) * scale
        to = extension_of(base, only(base, k))
        found = extend(
            MODELS[model], model, document(base, atom, size, to, model=model), lambda tire: tire
        )
        if not found.names:
            assert found.tire is found.bare
            continue
        held.add(effect.id)
        if effect.id == "friction_pressure":  # an unknown pressure is the mean of the rows
            mean = np.full(len(rows.slip), np.mean(rows.column("pressure")))
            both = (inputs._replace(pressure=p) for p in (0 * mean, mean))
            np.testing.assert_array_equal(*(force_of(found.tire, name, x) for x in both))
        wanted = base.forces(base.z, base.amplitudes((k,), (size / scale,)))[name]
        ours = force_of(found.tire, name, inputs)
        assert np.max(np.abs(ours - wanted) / rows.inputs.fz) < 1e-9, effect.id
        without = force_of(found.bare, name, inputs)
        assert np.max(np.abs(ours - without) / rows.inputs.fz) > 1e-4, effect.id
    assert held == expected


def test_effects_of_measurement_vehicle_and_past_are_only_reported():
    base = based("x", "brush")
    every = {effect.id: effect for effect in EFFECTS}
    for id, words in (
        ("slip_offset", "of the measurement, not in the forces: slip_offset"),
        ("relaxation_length", "not in the forces: relaxation_length amplitude = 0.3 +-"),
        ("speed_drag", "not in the forces, of the vehicle: speed_drag"),
        ("friction_drift", "not in the forces: friction_drift"),
    ):
        k = [atom.effect.id for atom in base.atoms].index(id)
        to = extension_of(base, only(base, k))
        at = document(base, Atom(every[id]), 0.3, to)
        found = extend(MODELS["brush"], "brush", at, lambda tire: tire)
        assert found.names == () and words in found.sentences[1]


@pytest.mark.parametrize(
    ("status", "claim"),
    [
        ("none", "no effect"),
        ("unknown", "an unlisted effect"),
        ("incomplete", "exactly these effects and an unlisted one"),
        ("cannot_tell", "exactly these effects"),
    ],
)
def test_the_probability_of_a_verdict_is_stated_with_its_claim(status, claim):
    base = based("x", "brush")
    at = document(base, base.atoms[0], 0.1, extension_of(base, only(base, 0)))
    at.verdict.status = status
    sentence = extend(MODELS["brush"], "brush", at, lambda tire: tire).sentences[0]
    assert sentence.endswith(f": {status.replace('_', ' ')}, probability 0.90 of {claim}")


def test_a_tire_with_effects_is_finite_at_rest_and_without_load():
    base = based("y", "brush")
    k = [atom.effect.id for atom in base.atoms].index("load_friction")
    at = document(base, base.atoms[k], -0.3, extension_of(base, only(base, k)))
    found = extend(MODELS["brush"], "brush", at, lambda tire: tire)
    still = forces(found.tire, TireInputs(0.0, 0.0, np.array([0.0, 4000.0]), 0.0))
    assert np.all(np.asarray(still.fy) == 0)


def test_a_diagnosis_of_another_model_or_of_columns_is_refused(tmp_path):
    base, path = based("x", "brush"), tmp_path / "run.json"
    at = document(base, base.atoms[0], 0.1, extension_of(base, only(base, 0)))
    for changes in ({"model": "brush-d"}, {"simulator": {"kind": "columns"}}):
        path.write_text(json.dumps(at.model_dump() | changes | {"schema": "tirefit.diagnosis/4"}))
        with pytest.raises(UsageError, match="the tire is a brush"):
            extend(MODELS["brush"], "brush", read_document(path), lambda tire: tire)
    path.write_text(json.dumps({"schema": "tirefit.diagnosis/2"}))
    with pytest.raises(DataError, match="schema"):
        read_document(path)
