"""A base fit at a bound does not prevent an explanation."""

import pytest

import tirefit
from fits.withheld.injected import CHANGES, half
from tirefit.data.read import read_frame
from tirefit.models import Brush
from tirefit.params import specs


@pytest.mark.parametrize("zero", [-0.024, pytest.param(-0.03, marks=pytest.mark.long)])
def test_a_heading_offset_is_named_if_the_plain_fit_has_no_friction(zero):
    data = {name: values[::4] for name, values in half(0).items()}
    change, *_ = CHANGES["slip_offset"]
    result = tirefit.diagnose(read_frame(data | change(data, zero, None)))
    # Slips of one sign, shifted past zero: nothing slides, by the plain fit.
    assert result.base_parameters["mu"] > 0.99 * specs(Brush())["mu"].upper
    assert "slip_offset" in result.verdict.helping
    assert 0.6 < result.extended_parameters["mu"] < 1.1
