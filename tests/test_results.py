"""Messages about wrong input, in every part of the package."""

import pytest

from tirefit.data.declared import Options
from tirefit.params import check_names
from tirefit.results import UsageError, did_you_mean
from tirefit.settings import Section, parse_settings


def test_an_unknown_name_suggests_the_closest():
    assert did_you_mean("frction", {"friction", "stiffness"}) == ("did you mean 'friction'? ")
    assert did_you_mean("qqq", ("friction", "stiffness")) == ""


class _File(Section):
    friction: float = 1.0


def _options():
    Options({"kapa": "x"}, {}, None, None, {}, None, False, True).check()


SAID = {
    "name": (lambda: check_names("method", "rsl", ("rls", "ekf")), "rsl", "rls"),
    "option": (_options, "kapa", "kappa"),
    "key": (lambda: parse_settings(_File, {"frction": 1.0}, "a.toml"), "frction", "friction"),
}


@pytest.mark.parametrize(("use", "given", "meant"), SAID.values(), ids=SAID)
def test_every_function_suggests_the_closest_name_and_lists_all(use, given, meant):
    with pytest.raises(UsageError) as caught:
        use()
    problem = caught.value.problems[0]
    assert repr(given) in problem.reason
    assert problem.remedy.startswith(f"did you mean {meant!r}? ")
    assert meant in problem.remedy.split("? ")[1]
