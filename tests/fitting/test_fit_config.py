"""``fit.toml``: valid content, and messages about invalid content."""

from dataclasses import replace

import numpy as np
import pytest
from recipes import STD, curve

from tirefit.data.table import Source
from tirefit.fitting.estimate import fit
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import FitConfig, load_config, parse_config
from tirefit.results import DataError, UsageError

# content, what the message must name, what the remedy must name
WRONG = {
    "unknown key": ({"modle": "brush"}, "unknown key 'modle'", "did you mean 'model'"),
    "unknown nested key": (
        {"noise": {"fx_relativ": 0.1}}, "'noise.fx_relativ'", "'fx_relative'",
    ),
    "missing key of a prior": (
        {"parameters": {"mu": {"prior": {"mean": 1.0}}}},
        "missing key 'parameters.mu.prior.std'", "add it",
    ),
    "word for a whole number": (
        {"starts": "many"}, 'starts = "many": must be a valid integer', "whole number",
    ),
    "fraction for a whole number": ({"seed": 3.0}, "seed = 3.0: ", "whole number"),
    "number in quotes": (
        {"parameters": {"mu": {"value": "0.9"}}},
        'parameters.mu.value = "0.9": must be a valid number', "without quotes",
    ),
    "number for a truth": (
        {"parameters": {"mu": {"free": 1}}}, "parameters.mu.free = 1: ", "true or f",
    ),
    "number for a word": ({"model": 3}, "model = 3: must be a valid string", "quotes"),
    "no number": ({"noise": {"fx": float("nan")}}, "be a finite number", "correct"),
    "number of no end": ({"noise": {"fx": 10**400}}, "noise.fx = 1000", "a number"),
    "parameter without a key": (
        {"parameters": {"mu": 0.9}}, "parameters.mu = 0.9: must be a table", "value,",
    ),
    "prior without spread": (
        {"parameters": {"mu": {"prior": {"mean": 1.0, "std": 0.0}}}},
        "parameters.mu.prior.std", "correct",
    ),
    "unknown force": ({"force": "fq"}, "force = \"fq\": must be 'fx', 'f", "correct"),
    "no force": ({"force": []}, "force = []: must have at least 1 item", "correct"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "said", "remedy"), WRONG.values(), ids=WRONG)
def test_wrong_content_is_refused(content, said, remedy):
    with pytest.raises(UsageError) as caught:
        parse_config(content, "my.toml")
    (problem,) = caught.value.problems
    assert said in problem.reason and len(problem.reason) < 120
    assert remedy in problem.remedy
    assert problem.file == "my.toml"


def test_every_problem_is_reported_at_once():
    content = {"modle": "brush", "starts": 0, "noise": {"fx": -1}}
    with pytest.raises(UsageError) as caught:
        parse_config(content)
    assert len(caught.value.problems) == 3


def test_whole_numbers_and_scalars_of_numpy_are_numbers():
    config = parse_config(
        {
            "seed": np.int64(3),
            "noise": {"fx": 40, "sigma_x": np.float64(0.01)},
            "force": ("fx", "fy"),
            "parameters": {"mu": {"free": np.bool_(True), "value": np.float32(0.5)}},
        }
    )
    assert (config.seed, config.noise.fx, config.force) == (3, 40.0, ["fx", "fy"])
    assert config.parameters["mu"].free is True
    assert parse_config({"force": "fy"}).force == ["fy"]


def of_mu(**settings):
    return {"parameters": {"mu": settings}}


PRIOR = {"mean": 1.0, "std": 0.1}
# content -> the start of every reason
CONTRADICTIONS = {
    "tied and free": (of_mu(tied="D", free=True), ["parameters.mu: free contradicts tied = 'D'"]),
    "tied and all else": (
        of_mu(tied="D", value=1, lower=0.1, upper=2, prior=PRIOR, per_run=True),
        [
            f"parameters.mu: {key} contradicts tied = 'D'"
            for key in ("value", "lower", "upper", "prior", "per_run")
        ],
    ),
    "factor without tied": (of_mu(factor=2), ["parameters.mu: factor without tied"]),
    "tied by nothing": (
        of_mu(tied="D", factor=0),
        ["parameters.mu: factor = 0 ties it to nothing"],
    ),
    "fixed and all else": (
        of_mu(free=False, value=1, lower=0.1, upper=2, prior=PRIOR, per_run=True),
        [
            f"parameters.mu: {key} contradicts free = false"
            for key in ("lower", "upper", "prior", "per_run")
        ],
    ),
    "bounds": (of_mu(lower=2, upper=1), ["parameters.mu: lower = 2 is not below upper = 1"]),
    "noise": (
        {"noise": {"fx": 40, "fx_relative": 0.01, "fy": 40, "fy_relative": 0.01}},
        ["noise: fx contradicts fx_relative", "noise: fy contradicts fy_relative"],
    ),
    "beside wrong keys": (
        {
            "noise": {"fx": 40, "fx_relative": 0.01, "loss": "l7"},
            "modle": "brush",
            **of_mu(free=False, lower=1, value="0.9"),
        },
        [
            "noise.loss = ",
            "parameters.mu.value = ",
            "unknown key 'modle'",
            "noise: fx contradicts",
            "parameters.mu: lower contradicts free",
        ],
    ),
}


@pytest.mark.parametrize(("content", "reasons"), CONTRADICTIONS.values(), ids=CONTRADICTIONS)
def test_contradictions_are_refused_with_both_keys(content, reasons):
    with pytest.raises(UsageError) as caught:
        parse_config(content, "my.toml")
    problems = caught.value.problems
    assert len(problems) == len(reasons)
    for problem, reason in zip(problems, reasons, strict=True):
        assert problem.reason.startswith(reason)
        assert problem.remedy and problem.file == "my.toml"


def test_compatible_settings_are_accepted():
    config = parse_config(
        {
            "parameters": {
                "mu": {"free": False, "value": 1, "per_run": False},
                "m": {"tied": "cpa2", "factor": -2},
                "cpa2": {"lower": 1, "upper": 2, "value": 3, "prior": PRIOR},
            },
            "noise": {"fx": 40, "fy_relative": 0.01},
        }
    )
    assert config.parameters["m"].factor == -2 and config.parameters["cpa2"].upper == 2


# model, parameters -> (the start of the reason, part of the remedy) of every problem
IMPOSSIBLE = {
    "no such parameter": (
        "brush", {"nu": {"value": 1.0}}, {"nu: the model has no such": "cpa2, mu"},
    ),
    "bounds outside": (
        "brush", {"mu": {"upper": 9.0}},
        {"mu: bounds [0.01, 9] are empty or outside the model's [0.01, 5]": "`tirefit"},
    ),
    "value outside": (
        "brush", {"mu": {"value": 1.5, "upper": 1.2}},
        {"mu: value 1.5 outside its bounds [0.01, 1.2]": "choose a value"},
    ),
    "prior outside": (
        "brush", {"mu": {"prior": {"mean": 7, "std": 1}}},
        {"mu: prior mean 7 outside its bounds [0.01, 5]": "choose a mean"},
    ),
    "prior without room": (
        "brush", {"mu": {"prior": {"mean": 0.9, "std": 1e-300}}},
        {"mu: prior std 1e-300 leaves it no room in [0.01, 5]": "value = 0.9 and free"},
    ),
    "nothing free": (
        "brush", {"mu": {"free": False}, "cpa2": {"free": False}},
        {"no free parameter": "[parameters]"},
    ),
    "tied to a fixed one": (
        "brush", {"mu": {"free": False}, "cpa2": {"tied": "mu"}},
        {"cpa2: tied to 'mu', which is not free": "free a parameter",
         "no free parameter": "[parameters]"},
    ),
    "tied to an unknown one": (
        "brush", {"cpa2": {"tied": "mu_"}},
        {"cpa2: tied to 'mu_': the model has no such": "did you mean 'mu'? it has cpa2, mu, h"},
    ),
    "tied to itself, and to a tied one": (
        "brush-d", {"mu": {"tied": "d"}, "d": {"tied": "d"}},
        {"mu: tied to 'd', which is not free": "tie it to one of cpa2",
         "d: tied to 'd', which is not free": "tie it to one of cpa2"},
    ),
    "settings of one that is not estimated": (
        "brush-h", {"v_st": {"lower": 2, "prior": {"mean": 3, "std": 1}}},
        {"v_st: lower has no effect: this fit does not estimate v_st": "v_st.free = t",
         "v_st: prior has no effect": "leave prior out"},
    ),
    "half-length without its moment": (
        "brush", {"half_length": {"per_run": True}},
        {"half_length: per_run has no effect": "fit mz too"},
    ),
    "all at once": (
        "brush-d",
        {"nu": {}, "mu": {"upper": 9, "value": 20},
         "cpa2": {"prior": {"mean": -1, "std": 1}}},
        {"nu: the model": "", "mu: bounds": "", "mu: value 20": "",
         "cpa2: prior mean -1": ""},
    ),
}  # fmt: skip


@pytest.mark.parametrize(("model", "parameters", "expected"), IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_impossible_parameters_are_refused(model, parameters, expected):
    config = parse_config({"parameters": parameters}, "my.toml")
    with pytest.raises(UsageError) as caught:
        build(curve(n=20, extra={"v": np.full(20, 20.0)}), model, config)
    problems = caught.value.problems
    assert len(problems) == len(expected)
    for reason, remedy in expected.items():
        (problem,) = (
            p for p in problems if p.reason.removeprefix("parameters.").startswith(reason)
        )
        assert remedy in problem.remedy and problem.file == "my.toml"


# [noise] -> key of each that is refused
NO_NOISE = {
    "fx": ({"fx": 1e-300}, ["fx"]),
    "fx without end": ({"fx": 1e300}, ["fx"]),
    "both": ({"fx": 1e-300, "sigma_x": 1e-150}, ["fx", "sigma_x"]),
}


@pytest.mark.parametrize(("noise", "keys"), NO_NOISE.values(), ids=NO_NOISE)
def test_impossible_noise_is_refused_with_other_problems(noise, keys):
    config = parse_config({"noise": noise, "parameters": {"nu": {}}}, "my.toml")
    with pytest.raises(UsageError) as caught:
        build(curve(n=20), "brush", config)
    first, *others = caught.value.problems
    assert first.reason.startswith("parameters.nu")
    for problem, key in zip(others, keys, strict=True):
        assert problem.reason.startswith(f"noise.{key} = {noise[key]:g} is not a noise")
        assert f"leave noise.{key} out" in problem.remedy and problem.file == "my.toml"


def test_impossible_noise_columns_are_refused_with_row_and_column():
    std = np.where(np.arange(20) % 7 == 3, 1e-300, STD)
    data = curve(n=20, extra={"fx_std": std, "sigma_x_std": np.full(20, 1e-200)})
    used = np.ones(20, bool)
    used[3] = False
    source = Source("run.csv", columns={"fx_std": "Fx std"}, line=np.arange(20) + 2)
    with pytest.raises(DataError) as caught:
        build(replace(data, used=used, source=source), "brush", FitConfig())
    force, slip = caught.value.problems
    assert (force.file, force.row, force.column) == ("run.csv", 12, "Fx std")
    assert force.reason.startswith("1e-300 is not a noise level beside fx up to")
    assert force.reason.endswith("(2 such rows)") and force.remedy
    assert (slip.row, slip.column) == (2, "sigma_x_std")


@pytest.mark.parametrize(
    ("noise", "said"),
    [
        ({"fx": 7.5}, "noise of fx: column fx_std; noise.fx = 7.5 not used beside it"),
        (
            {"sigma_x": 0.125},
            "noise of sigma_x: column sigma_x_std; noise.sigma_x = 0.125 not used beside it",
        ),
        ({"fy": 7.5}, "noise of fx: column fx_std"),
    ],
    ids=["force", "slip", "another force"],
)
def test_a_noise_column_overrides_the_settings_and_is_reported(noise, said):
    stds = {"fx_std": np.full(20, STD), "sigma_x_std": np.full(20, 5e-4)}
    task = build(curve(n=20, extra=stds), "brush", parse_config({"noise": noise}))
    problem = task.problem
    assert said in task.notes
    np.testing.assert_array_equal(problem.used(problem.rows.scale["fx"]), STD)
    np.testing.assert_array_equal(problem.slip_noise["sigma_x"], 5e-4)


def test_a_locked_wheel_does_not_change_the_limit_of_slip_noise():
    data = curve(n=20)
    slip = data["sigma_x"].copy()
    slip[:2] = 1e6
    std = np.where(slip > 1, 1e10, 5e-4)
    data = replace(data, columns={**data.columns, "sigma_x": slip, "sigma_x_std": std})
    problem = build(data, "brush", FitConfig()).problem
    np.testing.assert_array_equal(problem.slip_noise["sigma_x"], std)


@pytest.mark.parametrize(
    ("name", "hint"), [("brsh-d", "did you mean brush-d"), ("qqq", "`tirefit models`")]
)
def test_unknown_model_is_refused_with_the_closest(name, hint):
    with pytest.raises(UsageError, match=f"unknown model '{name}'") as caught:
        build(curve(n=20), name, FitConfig())
    assert hint in str(caught.value)


def test_a_file_with_a_mark_of_its_encoding_is_read(tmp_path):
    path = tmp_path / "fit.toml"
    path.write_text("\ufeffmodel = 'brush-d'\n[parameters.mu]\nprior = {mean = 1.0, std = 0.1}\n")
    config = load_config(path)
    assert config.model == "brush-d" and config.parameters["mu"].prior.std == 0.1


def test_errors_name_the_file_of_a_setting(tmp_path):
    path = tmp_path / "fit.toml"
    path.write_text("seed = 3\n[parameters.nu]\nvalue = 1\n")
    config = load_config(path)
    assert config.source == str(path)
    for given, file in ((config, str(path)), (config.model_dump(), "config")):
        with pytest.raises(UsageError) as caught:
            fit(curve(n=20), "brush", config=given, seed=4)
        assert caught.value.problems[0].file == file
    assert "source" not in FitConfig.model_fields
    with pytest.raises(UsageError, match=r"fit\(\): seed = -1"):
        fit(curve(n=20), config=config, seed=-1)
