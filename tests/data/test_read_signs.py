"""Signs are compared with the data: a wrong declaration is reported."""

import numpy as np
import pytest

from tirefit.data.read import read_frame
from tirefit.data.signs import evidence_of
from tirefit.results import DataError
from tirefit.slip import CONVENTIONS

DEG, G = np.pi / 180, 9.81
N = 240


def canonical(**left_out):
    """Sweeps of slip and slip angle at two cambers, of a physically plausible tire."""
    rng = np.random.default_rng(11)
    row = np.arange(N)
    angle = row < N // 2
    alpha = np.where(angle, 6 * np.sin(row / 7), 0.0) * DEG
    sigma = np.where(angle, 0.0, 0.12 * np.sin(row / 9))
    gamma = np.where(row // 30 % 2, 4.0, 0.0) * DEG
    load, speed = 4000.0, 20.0
    lateral = 1.0 * np.sin(1.4 * np.arctan(12 * alpha)) + 0.7 * gamma
    fy = load * lateral + rng.normal(0, 30, N)
    fx = 1.1 * load * np.sin(1.5 * np.arctan(14 * sigma)) + rng.normal(0, 30, N)
    columns = {
        "sigma_x": sigma,
        "alpha": alpha,
        "gamma": gamma,
        "fx": fx,
        "fy": fy,
        "fz": np.full(N, load),
        "mz": -0.03 * fy * np.exp(-((alpha / 0.06) ** 2)),
        "v": np.full(N, speed),
        "omega": speed / (0.3 * (1 + sigma)),
    }
    return {name: values for name, values in columns.items() if name not in left_out}


def in_signs(columns, convention):
    """Canonical columns in the signs of a convention, as in a file."""
    signs = CONVENTIONS[convention]._asdict() | {"sigma_x": CONVENTIONS[convention].slip}
    return {name: signs.get(name, 1) * values for name, values in columns.items()}


def told(frame, **options):
    """The messages about signs: the errors or, without errors, the warnings."""
    try:
        return "\n".join(read_frame(frame, **options).source.warnings)
    except DataError as error:
        return "\n".join(map(str, error.problems))


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_correctly_declared_signs_are_not_doubted(convention):
    frame = in_signs(canonical(), convention)
    data = read_frame(frame, convention=convention)
    assert data.source.warnings == ()
    np.testing.assert_allclose(data["sigma_x"], canonical()["sigma_x"])
    for item in evidence_of(data.columns):
        assert item.trend == 1, item


@pytest.mark.parametrize("declared", CONVENTIONS)
@pytest.mark.parametrize("true", CONVENTIONS)
def test_a_wrong_declaration_is_reported_with_the_right_one(true, declared):
    if true == declared:
        return
    message = told(in_signs(canonical(), true), convention=declared)
    assert f"--convention {true}" in message or f"or {true}" in message
    lateral = {"braking", "adapted-sae"}
    if {true, declared} & {"iso-w"} and declared != "sae":  # its side force differs from theirs
        others = lateral - {true} if true == "iso-w" else {"iso-w"}
        for other in others:
            assert f"--convention {other}" not in message.replace(repr(other), "")


@pytest.mark.parametrize(
    ("column", "unit", "rule"),
    [
        ("gamma", "rad", "a tire pushes to the side that it leans to"),
        ("mz", "N m", "the aligning moment reduces a small slip angle"),
    ],
)
def test_a_reversed_column_is_reported_with_the_unit_that_corrects_it(column, unit, rule):
    frame = in_signs(canonical(), "adapted-sae")
    frame[column] = -frame[column]
    message = told(frame, convention="adapted-sae")
    assert rule in message
    assert f"if the sign of {column} alone differs: --unit {column}=-{unit}" in message
    assert told(frame, convention="adapted-sae", units={column: f"-{unit}"}) == ""


BRAKES = {
    "brake_pressure": (lambda c: np.clip(c["fx"], 0, None) * 1e3, "with the brake pressure"),
    "a_x": (lambda c: -c["fx"] / 400, "a force that brakes slows the vehicle"),
}


@pytest.mark.parametrize("column", BRAKES)
def test_vehicle_signals_distinguish_driving_from_braking(column):
    columns = canonical(omega=0, v=0)
    make, rule = BRAKES[column]
    measured = {column: make(columns)}
    right = in_signs(columns, "iso-w") | measured
    assert told(right, convention="iso-w") == ""
    wrong = columns | {"fy": -columns["fy"], "mz": -columns["mz"]} | measured
    message = told(wrong, convention="iso-w")
    assert rule in message and "with the signs of 'iso-w'" in message
    undeclared = in_signs(columns, "adapted-sae") | measured
    message = told(undeclared)
    assert rule in message and "which were assumed" in message
    assert "these signs fit --convention adapted-sae" in message


@pytest.mark.parametrize("bad", [0, 20])
@pytest.mark.parametrize(("true", "declared"), [("iso-w", "sae"), ("sae", "iso-w")])
def test_loads_of_the_other_sign_are_reported_with_the_convention_to_declare(bad, true, declared):
    frame = in_signs(canonical(), true)
    frame["fz"][:bad] *= -1.0  # a rig that unloads the tire
    message = told(frame, convention=declared)
    assert "is not a load" in message
    assert "if loads are negative in the file (z down): --convention sae" in message
    assert "positive: --convention braking or iso-w or adapted-sae" in message


def test_a_few_wrong_loads_do_not_question_the_signs():
    frame = in_signs(canonical(), "braking")
    frame["fz"][3] = 0.0
    message = told(frame)
    assert "is not a load" in message and "--convention" not in message


def test_noise_does_not_determine_signs():
    rng = np.random.default_rng(5)
    columns = {
        "alpha": rng.normal(0, 0.03, 400),
        "fy": rng.normal(0, 900, 400),
        "fz": np.full(400, 4e3),
        "mz": rng.normal(0, 30, 400),
        "gamma": rng.normal(0, 0.05, 400),
        "sigma_x": rng.normal(0, 0.01, 400),
        "fx": rng.normal(0, 900, 400),
        "a_x": rng.normal(0, 3, 400),
        "omega": rng.uniform(50, 60, 400),
        "v": np.full(400, 15.0),
    }
    assert [item.trend for item in evidence_of(columns)] == [0] * 6
