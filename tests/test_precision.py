"""Every function that estimates or predicts reports that it needs 64-bit floats."""

import jax
import numpy as np
import pytest

import tirefit
from tirefit.data.table import TireData
from tirefit.fitting.result import FitResult
from tirefit.precision import require_x64
from tirefit.results import UsageError

SLIP = np.linspace(0.0, 0.2, 30)
ROWS = TireData(
    "rows",
    {"sigma_x": SLIP, "fx": 1e5 * SLIP, "fz": np.full(30, 4000.0)},
    np.ones(30, bool),
    np.zeros(30, int),
    ("run",),
)
ENTRIES = {
    "fit": lambda: tirefit.fit(ROWS),
    "fit_many": lambda: tirefit.fit_many({"sigma_x": SLIP[None], "fx": SLIP[None], "fz": 4000.0}),
    "sample": lambda: tirefit.sample(object.__new__(FitResult)),
    "predict": lambda: tirefit.predict("brush", ROWS),
    "diagnose": lambda: tirefit.diagnose(ROWS),
}


@pytest.mark.parametrize("entry", list(ENTRIES))
def test_32_bit_floats_are_refused_with_the_remedy(entry):
    with jax.enable_x64(False), pytest.raises(UsageError) as caught:
        ENTRIES[entry]()
    (problem,) = caught.value.problems
    assert "64-bit floats" in problem.reason
    assert "jax.config.update('jax_enable_x64', True)" in problem.remedy
    assert "JAX_ENABLE_X64=1" in problem.remedy


def test_64_bit_floats_are_accepted():
    assert require_x64("anything") is None
