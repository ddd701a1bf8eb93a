"""Errors of a simulator's parameters, over the sets of effects that data leave."""

import numpy as np
import pytest
from scipy.stats import norm

from tirefit.diagnosis.summary.budget import _of_mixture


def test_one_set_has_its_own_error():
    std = np.array([[2.0, 0.1]])
    found = _of_mixture(np.ones(1), np.zeros((1, 2)), std)
    np.testing.assert_allclose(found, std[0])


def test_nine_tenths_of_what_is_possible_are_held():
    shares, off = np.array([0.4, 0.4, 0.2]), np.array([[0.0], [4.0], [-2.0]])
    std = np.array([[1.0], [0.5], [1.0]])
    reach = norm.ppf(0.95) * _of_mixture(shares, off, std)
    held = shares @ np.diff(norm.cdf([-reach, reach], off.T, std.T), axis=0)[0]
    assert held == pytest.approx(0.9)


def test_what_is_hardly_possible_does_not_count():
    shares, off = np.array([0.99, 0.01]), np.array([[0.0], [50.0]])
    found = _of_mixture(shares, off, np.ones((2, 1)))
    assert found == pytest.approx(1.0, abs=0.06)
