"""Changed JSON documents: every reader gives a result or an error of ours.

Each key of a document is dropped, nested, and replaced by values of other types; the
checksum is made right again, as a program or a patient user could.
"""

import copy
import json
import warnings
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import tirefit
from tirefit.door import sealed
from tirefit.fitting.source import axle_tire
from tirefit.results import DataError, TirefitError

SAMPLES = Path(str(files("tirefit") / "samples"))
DROP, NEST = object(), object()
VALUES = (
    DROP, NEST, None, True, "", "x", -1, 0, 1e308, 10**400, float("nan"), [], {}, {"a": 1},
    [None], ["fx"], [[1.0], [1.0, 2.0]],
)  # fmt: skip
_SOME = 7  # values of each key are tried in turn: every so many of all changes


def keys_of(content, at=()):
    """The path of every key; of a list, its first and last item."""
    if isinstance(content, dict):
        items = list(content.items())
    elif isinstance(content, list):
        items = [(k, content[k]) for k in sorted({0, len(content) - 1} & {*range(len(content))})]
    else:
        return
    for key, value in items:
        if at or key not in ("checksum", "schema"):
            yield (*at, key)
            yield from keys_of(value, (*at, key))


def changed(content, path, value):
    """The content with another value at the path."""
    found = copy.deepcopy(content)
    place = found
    for key in path[:-1]:
        place = place[key]
    if value is DROP:
        del place[path[-1]]
    else:
        place[path[-1]] = {"inner": [place[path[-1]]]} if value is NEST else value
    return sealed(found) if "checksum" in content else found


@cache
def fit_document():
    return json.loads(tirefit.fit(SAMPLES / "circles.csv", "brush").to_json())


@cache
def whole_document():
    """A whole Magic Formula in a ``fit.json``."""
    from tirefit.models import MODELS, TireInputs, forces

    slip, load = np.tile(np.linspace(-0.2, 0.2, 31), 2), np.repeat([2000.0, 4000.0], 31)
    fx, fy = (
        np.asarray(forces(MODELS["brush"], TireInputs(*slips, fz=load))[k])
        for k, slips in enumerate(((slip, 0.0), (0.0, slip)))
    )
    along, across = {"sigma_x": slip, "fz": load, "fx": fx}, {"alpha": slip, "fz": load, "fy": fy}
    return json.loads(tirefit.fit_magic_formula([along, across], "mf52").to_json())


@cache
def car_document():
    """As ``diagnose --vehicle`` writes it, with an effect of each kind."""
    from tirefit.diagnosis.extended import SCHEMA
    from tirefit.vehicle.effects import CAR_EFFECTS
    from tirefit.vehicle.model import PARAMETERS

    effects = [effect.id for effect in CAR_EFFECTS]
    size = {"value": 0.1, "std": 0.01, "unit": "-"}
    verdict = dict(status="named", effects=effects, acts_like=[], probability=0.9)
    return {
        "schema": SCHEMA,
        "data": {"name": "drive", "sha256": "0"},
        "model": "car",
        "simulator": {"kind": "car"},
        "verdict": verdict | {"also_possible": []},
        "candidates": [
            {"effects": effects, "parameters": {f"{one}: amplitude": size for one in effects}}
        ],
        "base_parameters": dict.fromkeys(PARAMETERS, 1.0),
        "extended_parameters": dict.fromkeys(PARAMETERS, 1.1),
        "extension": {"variants": dict.fromkeys(effects, 0), "speed": 9.5},
    }


def predicted(path):
    rows = {"alpha": np.linspace(-0.1, 0.1, 5), "fz": np.full(5, 7.0), "v": np.full(5, 2.0)}
    tirefit.predict(path, rows | {"sigma_x": np.zeros(5)})


def exported(path):
    from tirefit.targets.tire import tire_of

    tire_of(path)


def simulated(path):
    from tirefit.diagnosis.rows.simulator import simulator_at

    simulator_at(path)


def applied_to_a_car(path):
    from tirefit.vehicle.diagnose import applied

    applied(path)


OF_FIT = (predicted, exported, axle_tire, simulated)
READERS = {
    "fit.json": (fit_document, OF_FIT),
    "vehicle_diagnosis.json": (car_document, (applied_to_a_car,)),
}


def cases(content, every):
    each = [(path, value) for path in keys_of(content) for value in VALUES]
    return each[::every]


def check(document, readers, path, every):
    content = document()
    path.write_text(json.dumps(content))
    for reader in readers:
        reader(str(path))  # as it is, every reader takes it
    wrong, refused = [], 0
    for key, value in cases(content, every):
        path.write_text(json.dumps(changed(content, key, value)))
        for reader in readers:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    reader(str(path))
            except TirefitError as error:
                refused += 1
                one = error.problems[0]
                if not (one.reason and one.remedy and one.file):
                    wrong.append((reader.__name__, key, value, str(error)))
            except Exception as error:
                wrong.append((reader.__name__, key, value, repr(error)))
    assert not wrong, f"{len(wrong)} others: {wrong[:5]}"
    assert refused > len(readers)


@pytest.mark.parametrize("name", READERS)
def test_a_changed_document_is_read_or_refused_by_file_and_reason(name, tmp_path):
    check(*READERS[name], tmp_path / name, _SOME)


@pytest.mark.long
@pytest.mark.parametrize("name", READERS)
def test_every_change_of_a_document_is_read_or_refused(name, tmp_path):
    check(*READERS[name], tmp_path / name, 1)


@pytest.mark.long
def test_changes_of_a_whole_magic_formula_are_read_or_refused(tmp_path):
    """Each kind of key with each value: its 85 coefficients have the same keys."""
    check(whole_document, (exported, simulated), tmp_path / "fit.json", 29)


REASONS = {
    # path, value, what the error says beside the file
    ("data", "range"): ([], "data.range: must be a table"),
    ("data", "used"): (DROP, "data.used: Field required"),
    ("parameters", "cpa2"): (-1, "parameters.cpa2: must be a table"),
    ("parameters",): ({}, "no parameters"),
    ("reference", "fz"): (0, "reference.fz: must be greater than 0"),
    ("prediction", "z"): ("x", "prediction.z: must be a valid list"),
}


@pytest.mark.parametrize("path", REASONS, ids=".".join)
def test_the_error_names_file_key_and_reason(path, tmp_path):
    value, said = REASONS[path]
    file = tmp_path / "fit.json"
    file.write_text(json.dumps(changed(fit_document(), path, value)))
    with pytest.raises(DataError) as caught:
        exported(str(file))
    (problem,) = caught.value.problems
    assert problem.file == str(file) and said in problem.reason, problem.reason
    assert problem.remedy == "give a fit.json of `tirefit fit`"
