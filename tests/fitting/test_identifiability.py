"""Parameters that a file determines, compared with repeated fits and known answers."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from tirefit.data.read import read_frame
from tirefit.fitting.estimate import fit
from tirefit.fitting.verdict.identifiability import (
    MODELS_ASKED,
    identifiability,
    scatter_of,
    stretches,
)
from tirefit.results import UsageError
from tirefit.sim.simulate import simulate


def brush_by_hand(cpa2, mu, sigma, load):
    """Independent parabolic brush: S(20) in the share of the sliding slip."""
    x = np.minimum(cpa2 * np.abs(sigma) / (3 * mu * load) * 2, 1.0)
    return np.sign(sigma) * mu * load * (3 * x - 3 * x**2 + x**3)


def test_the_expected_scatter_agrees_with_repeated_fits():
    """200 sets of noise, fitted by another solver with an independent brush."""
    rng = np.random.default_rng(4)
    sigma = np.tile(np.linspace(0.005, 0.1, 60), 3)
    load = np.repeat([2000.0, 4000.0, 6000.0], 60)
    force, noise = brush_by_hand(5e4, 0.9, sigma, load), 0.02
    estimates = []
    for _ in range(200):
        seen = force + noise * load * rng.normal(size=len(load))
        end = least_squares(
            lambda p, seen=seen: (brush_by_hand(1e4 * p[0], p[1], sigma, load) - seen) / load,
            (6.0, 1.1),
        )
        estimates.append(end.x * (1e4, 1.0))
    scatter = np.std(estimates, axis=0)
    frame = {"sigma_x": sigma, "fx": seen, "fz": load, "v": np.full(len(load), 20.0)}
    (gate,) = identifiability(read_frame(frame), ["brush"]).gates
    told = {p.name: p for p in gate.parameters}
    assert told["cpa2"].std == pytest.approx(scatter[0], rel=0.2)
    assert told["mu"].std == pytest.approx(scatter[1], rel=0.2)
    assert {p.grade for p in gate.parameters} == {"well"}


def swept(largest, **more):
    made = simulate("rig", largest=largest, force_std=0.01, seed=3, **more)
    return read_frame(made.columns)


def answers(data, model):
    (gate,) = identifiability(data, [model]).gates
    return {p.name: p.grade for p in gate.parameters}


@pytest.mark.parametrize(
    ("model", "largest", "unknown"),
    [
        ("brush", 0.15, set()),
        ("brush", 0.004, {"mu"}),
        ("brush-load", 0.15, {"stiffness_power", "mu_load"}),
    ],
)
def test_undetermined_parameters_are_reported(model, largest, unknown):
    told = answers(swept(largest), model)
    assert {name for name, answer in told.items() if answer == "not"} == unknown


@pytest.mark.parametrize(("largest", "unknown"), [(0.15, set()), (0.012, {"mu", "d"})])
def test_undetermined_parameters_are_not_identified_by_a_fit(largest, unknown):
    data, model = swept(largest), "brush-d"
    told = answers(data, model)
    assert {name for name, answer in told.items() if answer == "not"} == unknown
    estimates = fit(data, model).least_squares
    assert {name for name, e in estimates.items() if not e.identified} == unknown


def test_rows_with_the_same_noise_count_once():
    """Each row four times with the same noise: a quarter of the information."""
    made = simulate("rig", largest=0.1, points=400, force_std=0.02, seed=5).columns
    rng = np.random.default_rng(6)
    noise = np.repeat(0.02 * 4000.0 * rng.normal(size=200), 8)[: len(made["fx"]) * 4]
    clean = simulate("rig", largest=0.1, points=1600, force_std=0.0).columns
    white = clean | {"fx": clean["fx"] + 80.0 * rng.normal(size=1600)}
    same = clean | {"fx": clean["fx"] + noise}
    one, other = (identifiability(read_frame(c), ["brush"]) for c in (white, same))
    assert one.effective_rows["fx"] > 1200
    assert other.effective_rows["fx"] == pytest.approx(200, rel=0.5)
    ratio = [
        b.std / a.std
        for a, b in zip(one.gates[0].parameters, other.gates[0].parameters, strict=True)
    ]
    np.testing.assert_allclose(ratio, np.sqrt(8), rtol=0.35)


def test_noise_of_short_curves_is_that_of_the_rows():
    """Of a parabola through 8 rows the residuals are too small by the root of 5/8."""
    rng = np.random.default_rng(7)
    speed, load, slip = (
        x.ravel()
        for x in np.meshgrid(
            np.arange(5.0, 17.0), 1e3 * np.arange(1.0, 13.0), np.linspace(0.01, 0.08, 8)
        )
    )
    force = load * (10 * slip - 40 * slip**2 + 0.02 * rng.standard_normal(slip.size))
    data = read_frame({"sigma_x": slip, "fx": force, "fz": load, "v": speed})
    found = scatter_of(data, "fx", stretches(data, "fx"))
    # 5 degrees of freedom of each of 144 curves: 2.6 %.
    assert found.share == pytest.approx(0.02, rel=0.08) and found.inflation == 1.0


def test_standard_errors_of_many_rows_use_their_number():
    """512 of 5,000 rows are used; the result is that of all."""
    few, many = (
        identifiability(
            read_frame(simulate("rig", largest=0.1, points=n, seed=2).columns), ["brush"]
        )
        for n in (500, 5000)
    )
    for a, b in zip(few.gates[0].parameters, many.gates[0].parameters, strict=True):
        assert a.std / b.std == pytest.approx(np.sqrt(10), rel=0.2)


def test_a_bound_does_not_determine_a_parameter():
    """Pure noise: no curve, and no answer from a bound that a parameter reaches."""
    rng = np.random.default_rng(8)
    slip = rng.uniform(-0.2, 0.2, 150)
    frame = {"sigma_x": slip, "fz": np.full(150, 4e3), "fx": 400 * rng.normal(size=150)}
    frame["v"] = np.full(150, 20.0)
    for model in ("brush-n", "brush-h"):
        (gate,) = identifiability(read_frame(frame), [model]).gates
        (last,) = gate.parameters[-1:]
        assert last.name in "nh" and last.grade != "well"
        # The ends of its interval are more than a factor of ten apart.
        assert (gate.parameters[0].name, gate.parameters[0].grade) == ("cpa2", "not")


def test_default_and_given_models_are_evaluated():
    gates = identifiability(swept(0.15)).gates
    assert tuple(gate.model for gate in gates) == MODELS_ASKED
    assert all(gate.parameters or gate.reason for gate in gates)
    curved = {p.name: p.grade for p in gates[-1].parameters}
    assert curved["D"] == "well" and curved.keys() == {"B", "C", "D", "E"}


def test_the_text_names_what_is_not_determined():
    data = swept(0.004)
    text = identifiability(data, ["brush", "brush-n"]).summary()
    assert "not mu" in text and "100 rows that count as" in text
    assert all(len(line) <= 110 for line in text.splitlines())
    frame = {name: data[name] for name in ("sigma_x", "fx", "fz")}
    (gate,) = identifiability(read_frame(frame), ["brush-n"]).gates
    assert "needs v" in gate.reason
    with pytest.raises(UsageError, match="unknown model"):
        identifiability(data, ["brusch"])
    still = {"alpha": np.zeros(30), "fy": np.ones(30), "fz": np.full(30, 1e3)}
    nothing = identifiability(read_frame(still, curve=False))
    assert nothing.gates == () and nothing.summary() == ""
