"""predict takes a fit, its file, a .tir file, a tire or a model's name."""

from pathlib import Path

import numpy as np
import pytest

import tirefit
from tirefit.data.accept import as_data
from tirefit.data.tir.tir import read_tir
from tirefit.fitting.predict import outside_fit
from tirefit.fitting.store import load_fit
from tirefit.fitting.tir import tire_of
from tirefit.results import DataError, UsageError

TIR = Path(__file__).parents[1] / "data" / "tir" / "mfeval_julia" / "MagicFormula61_Parameters.tir"
SLIPS = np.linspace(-0.1, 0.1, 41)
ROWS = {"sigma_x": SLIPS, "fz": np.full(41, 4e3)}


@pytest.fixture(scope="module")
def fitted():
    rng = np.random.default_rng(3)
    force = tirefit.predict("brush", ROWS, {"mu": 0.9})["fx"] + rng.normal(0, 20, 41)
    return tirefit.fit(ROWS | {"fx": force}, "brush")


def test_values_together_with_a_fit_are_refused(fitted):
    with pytest.raises(UsageError, match="values together with a fit"):
        tirefit.predict(fitted, ROWS, {"mu": 0.5})


def test_rows_outside_the_fitted_ranges_are_counted(fitted, tmp_path):
    fitted.save(tmp_path)
    stored = load_fit(tmp_path / "fit.json")
    assert outside_fit(stored, as_data(ROWS, forces=False)) == []
    far = {"sigma_x": [-0.1, 0.0, 0.3], "fz": [4e3, 3e4, 3e4], "v": [9.0, 9.0, 9.0]}
    said = outside_fit(stored, as_data(far, forces=False))
    assert said == [
        "1 of 3 rows outside the fitted sigma_x = -0.1 to 0.1 -: extrapolated",
        "2 of 3 rows outside the fitted fz = 4000 to 4000 N: extrapolated",
    ]


def test_a_tir_file_predicts_as_its_tire(tmp_path):
    expected = tirefit.predict(tire_of(read_tir(TIR)), ROWS)["fx"]
    np.testing.assert_array_equal(tirefit.predict(TIR, ROWS)["fx"], expected)
    with pytest.raises(DataError, match="none.tir"):
        tirefit.predict(tmp_path / "none.tir", ROWS)


def test_a_file_without_signs_is_read_in_those_of_the_tir(tmp_path):
    path = tmp_path / "rows.csv"
    path.write_text("sigma_x [-],alpha [rad],fz [N]\n0.05,0.02,4000\n-0.05,-0.03,4000\n")
    found = tirefit.predict(TIR, path)
    for convention, same in (("iso-w", True), ("braking", False)):
        declared = tirefit.read(path, convention=convention, forces=False)
        expected = tirefit.predict(TIR, declared)
        assert np.array_equal(found["fx"], expected["fx"]) == same
