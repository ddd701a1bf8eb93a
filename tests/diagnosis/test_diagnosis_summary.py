"""P-values of several tests are adjusted."""

import numpy as np
import pytest
from scipy.stats import false_discovery_control

from tirefit.diagnosis.summary.views import adjusted


@pytest.mark.parametrize("count", [1, 2, 7, 50])
def test_p_values_are_adjusted_as_by_scipy(count):
    chances = np.random.default_rng(count).uniform(0, 0.2, count)
    for dependent, method in ((False, "bh"), (True, "by")):
        expected = false_discovery_control(chances, method=method)
        np.testing.assert_allclose(adjusted(chances, dependent), expected, rtol=1e-12)
