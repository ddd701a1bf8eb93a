"""A single name in place of a list of names counts as a list of one."""

from pathlib import Path

import pytest

import tirefit
from tirefit.results import DataError, UsageError

VEHICLE = Path(tirefit.__file__).parent / "samples" / "vehicle.toml"
TIRES = {"front": "brush", "rear": "brush"}
CALLS = {
    "derive_files": lambda log, out: tirefit.derive_files(log, VEHICLE, out / "derived.csv"),
    "replay": lambda log, _: tirefit.replay(log, VEHICLE, **TIRES),
    "fit_trajectory": lambda log, _: tirefit.fit_trajectory(log, VEHICLE),
    "diagnose_vehicle": lambda log, _: tirefit.diagnose_vehicle(log, VEHICLE, **TIRES),
}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("kind", [str, Path])
def test_a_single_log_is_named_as_a_whole(tmp_path, name, kind):
    with pytest.raises((DataError, UsageError), match=r"absent\.csv: the file does not exist"):
        CALLS[name](kind(tmp_path / "absent.csv"), tmp_path)


def test_a_single_model_and_effect_are_named_as_a_whole():
    columns = {"alpha": [0.01, 0.05, 0.1], "fy": [500.0, 2000.0, 3000.0], "fz": [4000.0] * 3}
    with pytest.raises(UsageError, match="unknown model 'nope'"):
        tirefit.identifiability(columns, "nope")
    with pytest.raises(UsageError, match="no effect 'nope' of a vehicle"):
        tirefit.diagnose_vehicle(["absent.csv"], VEHICLE, **TIRES, without="nope")
