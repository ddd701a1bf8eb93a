"""Many fits side by side find what each fit alone finds."""

import numpy as np
import pytest
from recipes import solved, table

from tirefit import fit_many, predict
from tirefit.params import log_jacobian
from tirefit.results import DataError

SLIP = np.linspace(-0.12, 0.12, 60)
MU = (0.7, 0.9)


def specs_of(alone):
    return [parameter.spec for _, parameter in alone.problem.layout.elements]


@pytest.mark.parametrize(("slip", "force"), [("sigma_x", "fx"), ("alpha", "fy")])
def test_many_fits_are_those_of_each_data_set(slip, force):
    rows = {slip: SLIP, "fz": np.full(60, 4000.0)}
    noise = np.random.default_rng(5).normal(0, 20, (2, 60))
    measured = [predict("brush", rows, {"cpa2": 4e4, "mu": mu})[force] for mu in MU] + noise
    many = fit_many({slip: np.tile(SLIP, (2, 1)), force: measured, "fz": 4000.0}, "brush")
    assert many.status == "ok" and many.warnings == ()
    for k in range(2):
        alone = solved(table(rows | {force: measured[k]}), {})
        values = alone.problem.layout.natural(alone.z)
        for name, value in zip(many.names, many.values[k], strict=True):
            assert value == pytest.approx(float(values[name]), rel=1e-3)
        slopes = [np.exp(log_jacobian(z, s)) for z, s in zip(alone.z, specs_of(alone), strict=True)]
        std = slopes * np.sqrt(np.diag(alone.covariance))
        np.testing.assert_allclose(many.std[k], std, rtol=0.01)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"sigma_x": np.zeros((2, 9)), "fz": 1.0}, "no fx"),
        ({"alpha": np.zeros((2, 9)), "fy": np.zeros((2, 9))}, "no fz"),
        ({"sigma_x": np.zeros(9), "fx": np.zeros(9), "fz": 1.0}, "must both be"),
        ({"sigma_x": np.zeros((2, 9)), "fx": np.zeros((2, 8)), "fz": 1.0}, "must both be"),
    ],
)
def test_data_that_cannot_be_fitted_are_refused(data, said):
    with pytest.raises(DataError, match=said):
        fit_many(data)
