"""Every model, as a fit of all its parameters, for every target: a file, or one error."""

import warnings

import numpy as np
import pytest

import tirefit
from tests.targets.support import WHOLE
from tirefit.fitting.problem.layout import Layout
from tirefit.fitting.store import StoredFit
from tirefit.models import MODELS, modelled
from tirefit.params import parameter_values
from tirefit.results import UsageError
from tirefit.targets.export import TARGETS

MIDDLE = 4000.0
WHEEL = {
    "chrono": dict(
        mass=10.0, ixx=0.5, iyy=1.0, vertical_stiffness=2e5, vertical_damping=500.0,
        width=0.2, radius=0.3,
    ),
    "tir": {"radius": 0.3},
}  # fmt: skip
REFUSED = {"slipx": "SlipX is for 1:10 cars", "autoware": "describes a car's steering"}


def fit_of(name, load=MIDDLE, **ranges):
    """A stored fit of a model at its defaults, with an error of every parameter."""
    tire, forces = MODELS[name], list(modelled(MODELS[name]))
    content = {
        "data": {
            "file": "x.csv",
            "sha256": "0" * 64,
            "used": 99,
            "runs": ["x"],
            "convention": "braking",
            "range": {"sigma_x": [-0.2, 0.2], "alpha": [-0.2, 0.2], "fz": [3000.0, 5000.0]}
            | ranges,
        },
        "seed": 0,
        "forces": forces,
        "parameters": {k: {"std": 0.01, "fixed": False} for k in parameter_values(tire)},
        "reference": {"fz": load},
    }
    empty = Layout((), ())
    return StoredFit(name, tire, empty, np.zeros(0), np.zeros((0, 0)), {}, content)


def tried(name, target, folder, **how):
    chosen = TARGETS[target]
    stem = "rubber_lab" if target == "slipx" else "tire"
    how = {"force": True, "wheel": WHEEL.get(target)} | how
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return tirefit.export(fit_of(name), target, folder / f"{stem}{chosen.ending}", **how)
        except UsageError as error:
            (problem, *_) = error.problems
            assert problem.reason and problem.remedy and not list(folder.iterdir())
            return str(error)


def refusals(target, folder):
    """Model -> the error of its export to a target; without the models that are exported."""
    refused = {}
    for name in MODELS:
        (folder / name).mkdir()
        done = tried(name, target, folder / name)
        if isinstance(done, str):
            refused[name] = done
    return refused


@pytest.mark.parametrize("target", ["tir", "chrono"])
def test_every_model_is_a_tir_file_or_refused_with_a_reason(target, tmp_path):
    """With --force, a model with c_p a^2 and mu, or a Magic Formula, has a file."""
    refused = refusals(target, tmp_path)
    without = {n for n in MODELS if not {"cpa2", "mu"} <= parameter_values(MODELS[n]).keys()}
    assert set(refused) == without
    said = "describes a whole Magic Formula, or c_p a^2 and mu"
    assert all(said in text for text in refused.values())


@pytest.mark.long
@pytest.mark.parametrize("target", sorted(set(TARGETS) - {"tir", "chrono"}))
def test_every_model_is_exported_or_refused_with_a_reason(target, tmp_path):
    if target == "casadi":
        pytest.importorskip("casadi")
    refused = refusals(target, tmp_path)
    known = REFUSED.get(target)
    assert set(refused) == (set(MODELS) if known else set()) and all(
        known in text for text in refused.values()
    )


# --- the measured range ---------------------------------------------------------------


FAR = {
    # ranges of the fit, target, how, what the error says
    "the load of a car": (
        {"fz": [2.5, 2.5]},
        "commonroad",
        {"vehicle": True},
        "fz 8.581 N, measured fz 2.5 N",
    ),
    "a load of --over": (
        {"fz": [3000.0, 5000.0]},
        "gymkhana-stp",
        {"over": {"fz": (1000.0, 5000.0)}},
        "fz 1000 to 5000 N, measured fz 3000 to 5000 N",
    ),
    "an angle of --over": (
        {"alpha": [-0.05, 0.08]},
        "gymkhana-stp",
        {"over": {"alpha": (-0.2, 0.2)}},
        "alpha -0.2 to 0.2 rad, measured alpha -0.05 to 0.08 rad",
    ),
    "angles too small for a refit": (
        {"alpha": [-0.004, 0.004]},
        "gymkhana-stp",
        {},
        "alpha -0.2 to 0.2 rad, measured alpha -0.004 to 0.004 rad",
    ),
    "a slip of --over": (
        {"sigma_x": [0.0, 0.05]},
        "commonroad",
        {"over": {"kappa": (-0.3, 0.0)}},
        "kappa -0.3 to 0, measured kappa -0.04762 to 0",
    ),
}


@pytest.mark.parametrize("name", FAR)
def test_a_range_far_from_the_measured_one_is_refused_by_both_ranges(name, tmp_path):
    ranges, target, how, said = FAR[name]
    fit = fit_of("brush", load=np.mean(ranges.get("fz", MIDDLE)), **ranges)
    if how.get("vehicle"):
        how = {"vehicle": tmp_path / "vehicle.toml"}
        how["vehicle"].write_text(WHOLE)
    path = tmp_path / "car.yaml"
    with pytest.raises(UsageError) as caught:
        tirefit.export(fit, target, path, **how)
    text = str(caught.value)
    assert said in text, text
    assert "far from where it was measured" in text and "--force" in text
    assert not path.exists()
    forced = tirefit.export(fit, target, path, force=True, **how)
    assert any("far from where it was measured" in warning for warning in forced.warnings)
    assert "far from where it was measured" in path.read_text()


def test_a_load_near_the_measured_one_is_accepted(tmp_path):
    """A log has one load; a drive shifts a quarter of it."""
    vehicle = tmp_path / "vehicle.toml"
    vehicle.write_text(WHOLE)
    static = 3.5 * 9.80665 / 4
    for share, accepted in ((0.85, True), (1.25, True), (0.7, False), (1.5, False)):
        fit = fit_of("brush", load=static * share, fz=[static * share] * 2)
        path = tmp_path / f"{share}.yaml"
        how = dict(vehicle=vehicle, over={"alpha": (-0.2, 0.2)})
        if accepted:
            tirefit.export(fit, "commonroad", path, force=False, **how)
        else:
            with pytest.raises(UsageError, match="far from where"):
                tirefit.export(fit, "commonroad", path, **how)


def test_forces_are_compared_at_a_measured_speed():
    from tirefit.targets.tire import tire_of

    for ends, speed in (([1.0, 3.0], 3.0), ([20.0, 30.0], 20.0), ([5.0, 15.0], 10.0)):
        assert tire_of(fit_of("brush", v=ends)).speed == speed
    assert tire_of("brush").speed == 10.0


BAD = [("alpha", 0, 0), ("alpha", -0.001, 0.001), ("kappa", 0.1, -0.1), ("fz", 4000, 4000)]
BAD += [("fz", 0, 4000), ("fz", -1, 4000), ("alpha", 0, np.inf), ("mu", 0, 1), ("kappa", np.nan, 1)]


@pytest.mark.parametrize(("name", "low", "high"), BAD)
def test_a_range_without_width_is_refused(name, low, high, tmp_path):
    with pytest.raises(UsageError, match=rf"--over {name}=.* is not a range"):
        tirefit.export("brush", "commonroad", tmp_path / "x.yaml", over={name: (low, high)})
    assert not list(tmp_path.iterdir())
