"""The document of a diagnosis: its keys, and its next measurements."""

import json
from copy import copy
from dataclasses import fields, is_dataclass, replace
from itertools import combinations

import numpy as np
import pytest
from conftest_diagnosis import TRUTHS, brush, record

from tirefit.data.read import read_frame
from tirefit.diagnosis import diagnose as module
from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.engine.decide import Status
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.subject import fit_base
from tirefit.diagnosis.summary import forecast
from tirefit.diagnosis.summary.forecast import _MOMENT, _changed, _with_moment, next_measurements
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.models import Asymmetric, Brush, TireInputs, forces

GAP = ["rms", "resolvable", "closed", "closed_ci", "remaining_rms"]
KEYS = {
    "": [
        "schema", "data", "model", "simulator", "n", "n_effective", "noise", "gap",
        "budget", "where", "verdict", "ladder",
        "candidates", "untestable", "resolution", "next_measurement",
        "slip_check", "runs", "base_parameters", "extended_parameters", "extension",
        "settings", "seed", "version", "asked", "ladder_on",
    ],
    "data": [
        "name", "path", "sha256", "convention", "channels", "assumptions", "set_aside",
        "motion",
    ],
    "noise": [
        "fx", "sigma_x", "sigma_x_source", "source", "flags", "inflation", "outliers",
        "excess"
    ],
    "gap": [*GAP, "channels", "holdout"],
    "gap channels fx": GAP,
    "gap holdout": [*GAP, "on"],
    "where 0": ["covariate", "low", "high", "share", "p_value"],
    "budget 0": ["part", "rms", "share", "closed_ci"],
    "verdict": [
        "status", "effects", "acts_like", "probability", "each", "also_possible", "left",
        "sizes", "parameters",
    ],
    "verdict left": ["rms", "share", "unlisted", "looks_like"],
    "ladder 0": [
        "effects", "rms_left_out", "closed", "closed_std", "gain", "gain_std",
        "rms_held_out", "closed_held_out",
    ],
    "candidates 0": [
        "effects", "family", "probability", "parameters",
    ],
    "resolution": ["smallest unlisted remainder that would have been seen"],
    "candidates 0 parameters": ["slip_offset: amplitude"],
    "candidates 0 parameters slip_offset: amplitude": [
        "value", "std", "unit", "formula",
    ],
    "untestable 0": ["effect", "needs"],
    "settings": ["rig", "effects", "holdout", "forces"],
}  # fmt: skip
"""Path to a record of ``NAME.json`` -> its keys, in order."""


def at(document, path):
    """The value at a path, whose steps are separated by a space before the last."""
    steps = path.split(" ", 3) if path else []
    for step in steps:
        document = document[int(step) if step.isdigit() else step]
    return document


@pytest.mark.parametrize("path", KEYS)
def test_keys_of_the_document_are_unchanged(diagnosed, path):
    document = json.loads(diagnosed("slip_offset")[0].to_json())
    assert list(at(document, path)) == KEYS[path]


def test_every_record_survives_writing_and_reading(diagnosed):
    found, _ = diagnosed("slip_offset")
    document = json.loads(found.to_json())
    assert document["verdict"]["probability"] == found.verdict.probability
    assert document["gap"]["holdout"]["closed"] == found.gap.holdout.closed
    assert document["where"][2]["share"] == found.where[2].share
    assert [c["effects"] for c in document["candidates"]] == [
        list(c.effects) for c in found.candidates
    ]
    written = {f.name for f in fields(Diagnosis) if f.metadata.get("written", True)}
    assert written | {"schema", "ladder_on"} == set(document)
    # Keyed by what the file and the model have.
    free = ("parameters", "runs")
    assert all(
        not isinstance(getattr(found, name), dict) or name.endswith(free) for name in written
    )
    assert is_dataclass(found.gap)
    lost = replace(found, n_effective=np.float64("nan"), seed=np.int64(3))
    assert json.loads(lost.to_json())["n_effective"] is None


def sweep(loads, slips, seed=0, channel="fx", noise=0.01):
    """A brush with skewed forces in one sweep per load: a frame without time."""
    generator = np.random.default_rng(seed)
    slip, fz = np.tile(slips, len(loads)), np.repeat(loads, len(slips))
    force = brush(slip + 0.004, 5e4, 0.9, fz)
    force = force + noise * fz * generator.standard_normal(len(fz))
    column = {"alpha": np.arctan(slip)} if channel == "fy" else {"sigma_x": slip}
    return {**column, channel: force, "fz": fz}


def rich():
    return record(TRUTHS["slip_offset"], seed=3)[0]


DESIGNS = {
    "one load, one sign": lambda: sweep([4e3], np.linspace(0.004, 0.2, 240)),
    "two loads, both signs": lambda: sweep([2e3, 5e3], np.linspace(-0.2, 0.2, 120)),
    "lateral, no M_z": lambda: sweep([2e3, 5e3], np.linspace(-0.2, 0.2, 60), channel="fy"),
    "sweeps at three loads and two speeds": rich,
}
OFTEN = ("one load, one sign", "lateral, no M_z")


ALMOST_NO_NOISE = {"sigma_x": 1e-6, "alpha": 1e-6}
"""Of the slips: the compiled programs of other tests whose slips are noisy serve too."""


@pytest.fixture(scope="module")
def studied():
    """The search on the rows of a design."""
    rig = Rig(noise=ALMOST_NO_NOISE)
    known = {}

    def study(design):
        if design not in known:
            data = read_frame(DESIGNS[design](), design)
            rows = prepare(data, rig, ("fx", "fy", "mz"))
            known[design] = module.studied(rows, "brush", rig, EFFECTS, ())
        return known[design]

    return study


@pytest.mark.parametrize(
    "design",
    [pytest.param(design, marks=[] if design in OFTEN else pytest.mark.long) for design in DESIGNS],
)
def test_undecidable_pairs_have_a_next_measurement(studied, design):
    """Pairs of effects, as if the verdict could not distinguish them."""
    case = studied(design)
    ids = dict.fromkeys(case.base.atoms[k].effect.id for k in case.base.testable)
    told = 0
    pairs = list(combinations(ids, 2))
    pairs = pairs[:: max(len(pairs) // 20, 1)]
    for one, other in pairs:
        verdict = replace(
            case.verdict, status=Status.CANNOT_TELL, key=(one,), also_possible=(other,)
        )
        steps = next_measurements(case.base, case.search, case.weighed, verdict)
        for step in steps:
            assert 0 <= step.p_now + 0.02 < step.p_after <= 1
            assert set(step.separates) <= {*ids, "unknown"}
        gains = [step.p_now - step.p_after for step in steps if "unknown" not in step.separates]
        assert gains == sorted(gains)
        told += bool(steps)
    assert told > 0


@pytest.mark.long
def test_one_load_and_one_sign_suggest_another_sign_or_load():
    data = read_frame(sweep([4e3], np.linspace(0.004, 0.2, 240)), "one sign")
    found = module.diagnose(data, rig=Rig(noise={"fx_relative": 0.01, **ALMOST_NO_NOISE}))
    assert found.verdict.status == "cannot_tell"
    assert {"slip_offset", "force_offset"} <= {*found.effects, *found.verdict.also_possible}
    first = found.next_measurement[0]
    assert set(first.separates) == {"slip_offset", "force_offset"}
    assert first.p_now < 0.6 and first.p_after > 0.9
    adds = {step.add for step in found.next_measurement}
    assert any("opposite sign" in add or "more loads" in add for add in adds)


def test_other_speeds_are_those_of_rows_measured_there():
    """Half and twice the speed in turn: every covariate that follows from it."""
    frame, rig, factors = rich(), Rig(noise=ALMOST_NO_NOISE), (0.5, 2.0)
    base = fit_base(prepare(read_frame(frame), rig, ("fx",)), "brush", EFFECTS[:2], rig)
    n, ours = len(frame["v"]), _changed(base, {"v": factors}).design.rows
    measured = read_frame(frame | {"v": np.resize(factors, n) * frame["v"]})
    right = prepare(measured, rig, ("fx",)).covariates
    for name in ("v", "pace", "sliding", "step"):
        found = getattr(ours, name)[:n]
        np.testing.assert_allclose(found, getattr(right, name), rtol=1e-9, err_msg=name)


def test_the_predicted_moment_agrees_with_the_model(studied):
    """Tangents of M_z by the pressure's skewness, against the model's own M_z."""
    base = studied("lateral, no M_z").base
    n = base.rows.n
    (k,) = (i for i, a in enumerate(base.atoms) if a.effect.id == "pressure_asymmetry")
    _, columns = _with_moment(base, base.z)
    values = base.tire.layout.natural(base.z)
    slips, loads = base.rows.slip, base.rows.inputs.fz

    def moment(d):
        tire = Brush(cpa2=float(values["cpa2"]), mu=float(values["mu"]), pressure=Asymmetric(d))
        return np.asarray(forces(tire, TireInputs(0.0, np.arctan(slips), loads, 10.0)).mz)

    slope = (moment(1e-4) - moment(-1e-4)) / 2e-4
    ours = columns[n : 2 * n, k]
    # Each load has another noise: the ratio is one number per load.
    for fz in (2e3, 5e3):
        rows = loads == fz
        ratio = ours[rows] @ slope[rows] / (slope[rows] @ slope[rows])
        assert ratio > 0
        np.testing.assert_allclose(ours[rows], ratio * slope[rows], atol=3e-3 * np.abs(ours).max())


def test_noisy_data_lower_the_use_of_measuring_the_moment(studied, monkeypatch):
    monkeypatch.setattr(forecast, "_FEW", 99)
    case = studied("lateral, no M_z")
    verdict = replace(
        case.verdict,
        status=Status.CANNOT_TELL,
        key=("pressure_asymmetry",),
        also_possible=("carcass_flexibility",),
    )

    def chances(base):
        search = copy(case.search)
        search.subject = base
        steps = next_measurements(base, search, case.weighed, verdict)
        return {step.separates[1]: step.p_after for step in steps if step.add == _MOMENT}

    sure = chances(case.base)["carcass_flexibility"]
    scale = {c: 4 * v for c, v in case.base.design.scale.items()}
    noisy = case.base.on(case.base.design._replace(scale=scale))
    unsure = chances(noisy).get("carcass_flexibility", 0.5)
    assert 0.5 <= unsure < sure <= 1
    assert sure != 0.99
