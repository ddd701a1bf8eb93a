"""Errors of a simulator's parameters, over the sets of effects that data leave."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from tirefit.diagnosis.budget import _spread
from tirefit.diagnosis.verdict import Weighed


def case(fits, verdict):
    """Sets: (probability, value, variance) of one parameter each."""
    best = {
        key: SimpleNamespace(z=np.array([value]), covariance=np.array([[variance]]))
        for key, (_, value, variance) in fits.items()
    }
    weighed = Weighed(
        sets={key: share for key, (share, *_) in fits.items()}, best_of=best,
        unknown_alone=0.0, unknown_beside={}, other_form=frozenset(), evidence={},
        hidden=0.0, gains={},
    )  # fmt: skip
    chosen = SimpleNamespace(chosen=best[verdict])
    return SimpleNamespace(verdict=chosen, weighed=weighed)


def test_one_set_has_its_own_error():
    alone = case({("a",): (0.7, 3.0, 4.0)}, ("a",))
    assert _spread(alone, 1.0)[0] == pytest.approx(2.0)
    assert _spread(alone, 2.25)[0] == pytest.approx(3.0)


def test_nine_tenths_of_what_is_possible_are_held():
    fits = {("a",): (0.4, 0.0, 1.0), ("b",): (0.4, 4.0, 0.25), (): (0.2, -2.0, 1.0)}
    reach = norm.ppf(0.95) * _spread(case(fits, ("a",)), 1.0)[0]
    held = sum(
        share * np.diff(norm.cdf([-reach, reach], value, np.sqrt(variance)))[0]
        for share, value, variance in fits.values()
    )
    assert held == pytest.approx(0.9)


def test_what_is_hardly_possible_does_not_count():
    fits = {("a",): (0.99, 0.0, 1.0), ("b",): (0.01, 50.0, 1.0)}
    assert _spread(case(fits, ("a",)), 1.0)[0] == pytest.approx(1.0, abs=0.06)
