"""``fit.toml``: what it may say, and what is said of everything else."""

import pytest
from recipes import curve

from tirefit.fitting.config import FitConfig, load_config, parse_config
from tirefit.fitting.problem import build
from tirefit.results import UsageError

# content, what the message must name, what the remedy must name
WRONG = {
    "unknown key": ({"modle": "brush"}, "unknown key 'modle'", "did you mean 'model'"),
    "unknown nested key": (
        {"noise": {"fx_relativ": 0.1}}, "'noise.fx_relativ'", "'fx_relative'",
    ),
    "unknown key of a parameter": (
        {"parameters": {"mu": {"fre": True}}}, "'parameters.mu.fre'", "'free'",
    ),
    "unknown key of a prior": (
        {"parameters": {"mu": {"prior": {"mean": 1.0, "std": 1.0, "sdt": 2.0}}}},
        "'parameters.mu.prior.sdt'", "valid keys here: mean, std",
    ),
    "wrong type": ({"starts": "many"}, "starts: ", "correct the value"),
    "wrong type of a value": (
        {"parameters": {"mu": {"value": "high"}}}, "parameters.mu.value: ", "correct",
    ),
    "prior without spread": (
        {"parameters": {"mu": {"prior": {"mean": 1.0, "std": 0.0}}}},
        "parameters.mu.prior.std", "correct",
    ),
    "negative noise": ({"noise": {"fx": -1.0}}, "noise.fx", "correct"),
    "unknown loss": ({"noise": {"loss": "l7"}}, "noise.loss", "correct"),
    "unknown solver": ({"solver": "newton"}, "solver", "correct"),
    "unknown force": ({"force": "fq"}, "force", "correct"),
    "unknown sampler": ({"posterior": {"sampler": "nuts"}}, "sampler", "correct"),
    "too few ensembles": ({"posterior": {"ensembles": 3}}, "ensembles", "correct"),
    "negative seed": ({"seed": -1}, "seed", "correct"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "said", "remedy"), WRONG.values(), ids=WRONG)
def test_wrong_content_is_refused(content, said, remedy):
    with pytest.raises(UsageError) as caught:
        parse_config(content, "my.toml")
    text = str(caught.value)
    assert said in text and remedy in text and "my.toml" in text


def test_every_problem_is_reported_at_once():
    content = {"modle": "brush", "starts": 0, "noise": {"fx": -1}}
    with pytest.raises(UsageError) as caught:
        parse_config(content)
    assert len(caught.value.problems) == 3


IMPOSSIBLE = {
    "no such parameter": ({"nu": {"value": 1.0}}, "nu: the model has no such", "cpa2"),
    "bounds outside": ({"mu": {"upper": 9.0}}, "outside the model's [0.01, 5]", ""),
    "bounds empty": ({"mu": {"lower": 2.0, "upper": 1.0}}, "are empty", ""),
    "value outside": (
        {"mu": {"value": 1.5, "upper": 1.2}}, "value 1.5 outside its bounds", "",
    ),
    "tied to a fixed one": (
        {"mu": {"free": False}, "cpa2": {"tied": "mu"}}, "'mu', which is not free", "",
    ),
    "tied to itself": ({"mu": {"tied": "mu"}}, "'mu', which is not free", "cpa2"),
    "tied to nothing": ({"mu": {"tied": "nu"}}, "'nu', which is not free", "cpa2"),
    "nothing free": (
        {"mu": {"free": False}, "cpa2": {"free": False}}, "no free parameter", "",
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("parameters", "said", "remedy"), IMPOSSIBLE.values(), ids=IMPOSSIBLE
)
def test_impossible_parameters_are_refused(parameters, said, remedy):
    config = parse_config({"parameters": parameters})
    with pytest.raises(UsageError) as caught:
        build(curve(n=20), "brush", config)
    assert said in str(caught.value) and remedy in str(caught.value)


@pytest.mark.parametrize(
    ("name", "hint"), [("brsh-d", "did you mean brush-d"), ("qqq", "`tirefit models`")]
)
def test_unknown_model_is_refused_with_the_closest(name, hint):
    with pytest.raises(UsageError, match=f"unknown model '{name}'") as caught:
        build(curve(n=20), name, FitConfig())
    assert hint in str(caught.value)


def test_files(tmp_path):
    path = tmp_path / "fit.toml"
    with pytest.raises(UsageError, match="cannot read it"):
        load_config(path)
    path.write_text("model = \n")
    with pytest.raises(UsageError, match="not valid TOML"):
        load_config(path)
    path.write_bytes(b"model = '\xff'\n")
    with pytest.raises(UsageError, match="not valid TOML"):
        load_config(path)
    path.write_text(
        "model = 'brush-d'\nseed = 3\n[noise]\nfx = 40\n"
        "[parameters.mu]\nprior = {mean = 1.0, std = 0.1}\nper_run = true\n"
    )
    config = load_config(path)
    assert (config.model, config.seed, config.noise.fx) == ("brush-d", 3, 40.0)
    assert config.parameters["mu"].prior.std == 0.1


def test_empty_file_is_the_default(tmp_path):
    path = tmp_path / "fit.toml"
    path.write_text("")
    assert load_config(path) == FitConfig()
