"""Every result is printed, displayed, drawn and saved by the same methods."""

import json
import re
from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest

import tirefit
from tirefit.data.vehicle.vehicle import Filter, Keep, Steering, Vehicle
from tirefit.diagnosis.engine.decide import Status
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.display import Record
from tirefit.fitting.mf.result import MagicFormulaFit
from tirefit.fitting.result import FitResult, Verdict
from tirefit.fitting.solve.batch import BatchFit
from tirefit.fitting.source import given_tire
from tirefit.models import Brush
from tirefit.online.result import Estimates
from tirefit.report.canvas import Picture
from tirefit.report.numbers import format_estimate
from tirefit.results import Outcome, exit_code
from tirefit.sim.brake_result import Braking
from tirefit.targets.export import Exported
from tirefit.vehicle.car import State, car_of, predicted
from tirefit.vehicle.replay import Replay
from tirefit.vehicle.trajectory import TrajectoryFit

RIG = {"largest": 0.15, "points": 120, "force_std": 0.01, "seed": 4}


@cache
def rig():
    log = tirefit.simulate("rig", values={"cpa2": 4e4, "mu": 0.9}, **RIG)
    return tirefit.read_frame(dict(log.columns), "rig")


def recording():
    """Three sweeps of the slip angle at one load, as a rig records them."""
    time = np.arange(0.0, 30.0, 0.02)
    alpha = 0.15 * np.sin(2 * np.pi * time / 10.0)
    fy = 4000.0 * np.tanh(12 * alpha)
    fy += np.random.default_rng(0).normal(0.0, 20.0, len(time))
    frame = {"time": time, "alpha": alpha, "fy": fy, "fz": np.full_like(time, 4000.0)}
    return tirefit.read_frame(frame, "drum", curve=False, mask_bad_rows=True)


def many():
    slip = np.stack([rig()["sigma_x"]] * 2)
    force = np.stack([rig()["fx"], 0.9 * rig()["fx"]])
    return tirefit.fit_many({"sigma_x": slip, "fx": force, "fz": 4000.0}, "brush")


def exported(folder):
    return tirefit.export("brush", "numpy", folder / "tire.py")


CAR = Vehicle(
    mass=5.1,
    l_f=0.17,
    l_r=0.16,
    yaw_inertia=0.12,
    columns={k: k for k in ("time", "x", "y", "yaw", "steering")},
    steering=Steering(command=[-1, 1], angle=[-1, 1]),
    filter=Filter(cutoff=15, sample_rate=100),
    keep=Keep(v_min=1),
)
AXLES = Brush(cpa2=40.0, mu=0.9), Brush(cpa2=120.0, mu=0.75)


def drive(folder):
    """A car's log with noise, as a file; as long as that of tests/vehicle, with which a
    fit by trajectory shares its programs."""
    step, generator = 0.01, np.random.default_rng(3)
    time = np.arange(0.0, 24.0, step)
    steering = 0.2 * np.sin(1.7 * time) + 0.1 * np.sin(6.1 * time)
    given = np.full_like(time, 3.0), steering
    path = predicted(car_of(CAR, *AXLES), State(0, 0, 0, 0, 0), *given, step, 2)[0]
    columns = {"time": time, "x": path.x, "y": path.y, "yaw": path.heading}
    noisy = {k: v + 1e-3 * generator.standard_normal(len(time)) for k, v in columns.items()}
    rows = noisy | {"time": time, "steering": steering}
    out = folder / "drive.csv"
    values = np.stack(list(rows.values()), axis=1)
    np.savetxt(out, values, "%.9g", ",", header=",".join(rows), comments="")
    return [out]


STOP = {"controller": "none", "speed": 3.0, "vehicle": "quarter"}
RECORDS = {
    "fit": (lambda _: tirefit.fit(rig(), "brush"), {"fit.json"}),
    "fit_many": (lambda _: many(), {"fits.csv"}),
    "diagnose": (lambda _: tirefit.diagnose(rig()), {"rig.json", "rig.rows.csv"}),
    "prepare": (
        lambda _: tirefit.prepare(recording()),
        {"drum.csv", "drum.segments.tsv", "drum.prepare.json"},
    ),
    "estimate": (
        lambda _: tirefit.estimate(tirefit.simulate(teeth=2).columns),
        {"estimates.csv", "summary.json"},
    ),
    "simulate": (lambda _: tirefit.simulate(teeth=2), {"log.csv", "log.truth.tsv"}),
    "brake": (lambda _: tirefit.brake("brush", **STOP), {"summary.json", "series.csv"}),
    "export": (exported, {"tire.py"}),
    "replay": (
        lambda folder: tirefit.replay(drive(folder), CAR, *AXLES, horizons=(0.5,)),
        {"replay.json"},
    ),
    "fit_trajectory": (
        lambda folder: tirefit.fit_trajectory(drive(folder), CAR),
        {"front.json", "rear.json", "vehicle.toml", "trajectory.json"},
    ),
}
"""Function -> a result of it, and the files that it saves."""


# Two of 5 s each, of which tests/vehicle prints, draws and saves one.
LONG = dict.fromkeys(("replay", "fit_trajectory"), pytest.mark.long)


@pytest.fixture(
    scope="module", params=[pytest.param(k, marks=LONG.get(k, ()), id=k) for k in RECORDS]
)
def made(request, tmp_path_factory):
    make, files = RECORDS[request.param]
    return make(tmp_path_factory.mktemp(request.param)), files


def test_a_record_prints_its_summary(made):
    record, _ = made
    assert isinstance(record, Record)
    assert str(record) == record.summary() and len(record.summary().splitlines()) > 2
    assert repr(record).lstrip("<").startswith(type(record).__name__)
    assert " object at 0x" not in repr(record)


def test_a_record_is_finite_json(made):
    record, _ = made
    content = record.to_dict()
    assert json.loads(json.dumps(content, allow_nan=False)) and content
    assert json.loads(record.to_json()).keys() >= content.keys()


def test_a_notebook_shows_a_figure_and_loads_nothing(made):
    record, _ = made
    assert record.plot().axes
    fragment = record._repr_html_()
    assert "data:image/png;base64," in fragment
    assert "http" not in fragment.replace("http-equiv", "")


def test_a_record_is_saved_as_files_and_as_a_page(made, tmp_path, monkeypatch):
    record, files = made
    monkeypatch.setattr(Picture, "_repr_png_", lambda self: b"")  # drawn above
    written = record.save(tmp_path / "out")
    assert {path.name for path in written} == files
    assert {path.name for path in (tmp_path / "out").iterdir()} == files
    (page,) = record.save(tmp_path / "page.html")
    text = page.read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>") and text.rstrip().endswith("</html>")


def test_status_and_warnings_are_read_the_same_way(made):
    record, _ = made
    assert isinstance(record.status, Outcome) and isinstance(record.outcomes, tuple)
    assert all(isinstance(text, str) and text for text in record.warnings)
    assert len(record.warnings) >= len(record.outcomes)
    assert (record.status == "ok") == (record.outcomes == ())


def changed(record):
    """The record as if its computation had failed."""
    if isinstance(record, FitResult):
        return replace(record, verdict=Verdict((Outcome.INTERRUPTED, Outcome.NOT_CONVERGED)))
    if isinstance(record, BatchFit):
        return replace(record, converged=np.array([True, False]))
    if isinstance(record, TrajectoryFit):
        return replace(record, converged=False)
    if isinstance(record, Diagnosis):
        return replace(record, verdict=replace(record.verdict, status=Status.CANNOT_TELL))
    if isinstance(record, Braking):
        ((name, stop),) = record.stops.items()
        spun = stop.summary._replace(stopped=0.0, heading=2.0)
        return replace(record, stops={name: replace(stop, summary=spun)})
    if isinstance(record, Exported):
        return replace(record, shape=record.shape._replace(failed=("combined slip",)))
    if isinstance(record, Replay):
        return replace(record, windows=(0,))
    if isinstance(record, Estimates):
        methods = {k: replace(m, flag=np.full_like(m.flag, 1)) for k, m in record.methods.items()}
        return replace(record, methods=methods)
    return record


STATUS = {
    "fit": ("not converged", 4),
    "fit_many": ("not converged", 4),
    "fit_trajectory": ("not converged", 4),
    "diagnose": ("not identified", 0),
    "estimate": ("not identified", 0),
    "brake": ("incomplete", 0),
    "replay": ("incomplete", 0),
    "export": ("unsound", 4),
    "prepare": ("ok", 0),
    "simulate": ("ok", 0),
}
"""Function -> status and exit code of a result of it that failed, if it can."""


def test_the_exit_code_follows_from_the_outcomes(made, request):
    record = changed(made[0])
    status, code = STATUS[request.node.callspec.params["made"]]
    assert (record.status, exit_code(record.outcomes)) == (status, code)
    strict = 5 if status == "not identified" else code
    assert exit_code(record.outcomes, strict=True) == strict


def test_no_record_has_a_status_of_its_own():
    """Every class derives it from what limits its use; its warnings are in it, too."""
    classes = {MagicFormulaFit, *Record.__subclasses__()}
    assert len(classes) > len(RECORDS)
    for cls in classes:
        assert cls.status is Record.status
        assert isinstance(cls.outcomes, property) and isinstance(cls.warnings, property)


def test_every_public_function_is_tested_here():
    assert jax.config.read("jax_enable_x64")
    family = "fit fit_many diagnose prepare estimate simulate brake export"
    family += " replay fit_trajectory"
    assert set(RECORDS) == set(family.split()) <= set(tirefit.__all__)


def test_python_and_command_simulate_the_same_file(tmp_path):
    from typer.testing import CliRunner

    from tirefit.cli.commands import app

    out = tmp_path / "d.csv"
    words = "simulate braking --teeth 2 --slip-variance 1e-5 --drop 1=0.4".split()
    assert CliRunner().invoke(app, [*words, "--out", str(out)]).exit_code == 0
    log = tirefit.simulate("braking", teeth=2, slip_variance=1e-5, drop=(1.0, 0.4))
    assert out.read_text() == log.files()["log.csv"]


def test_a_fitted_tire_brakes_like_its_model():
    fit = tirefit.fit(rig(), "brush")
    values = {k: fit.parameters[k].value for k in ("cpa2", "mu")}
    one, other = tirefit.brake(fit, **STOP), tirefit.brake("brush", values=values, **STOP)
    distance = [float(x.stops["none"].summary.stopping_distance) for x in (one, other)]
    assert distance[0] == pytest.approx(distance[1], rel=1e-6)
    with pytest.raises(tirefit.UsageError, match="leave them out, or name a model"):
        tirefit.brake(fit, values={"mu": 1.0}, **STOP)
    with pytest.raises(tirefit.UsageError, match="leave them out, or name a model"):
        given_tire(given_tire(fit), values={"mu": 1.0})


def test_the_figure_of_many_fits_has_their_values_and_standard_deviations():
    fits = many()
    for axes, value, std in zip(fits.plot().axes, fits.values.T, fits.std.T, strict=True):
        points, _, (bars,) = axes.containers[0]
        np.testing.assert_array_equal(points.get_ydata(), value)
        ends = [segment[:, 1] for segment in bars.get_segments()]
        np.testing.assert_allclose(ends, np.stack([value - std, value + std], axis=1))


def test_every_row_of_estimates_in_parts_has_its_method_and_parameter():
    result = tirefit.estimate(tirefit.simulate(teeth=2).columns)
    ((name, method),) = result.methods.items()
    long = f"{name}, whose name fills half a line"
    text = replace(result, methods={long: method}).summary()
    assert text.count("flagged rows") == 1 and "\n\n" in text
    for parameter in method.parameters:
        last = format_estimate(method[parameter][-1], method.std_of(parameter)[-1])
        assert len(re.findall(rf"^  {long} +{parameter} ", text, re.M)) == 2
        assert re.search(rf"^  {long} +{parameter} +{re.escape(last)} ", text, re.M)


def test_estimates_below_zero_lie_within_their_axis():
    result = tirefit.estimate(tirefit.simulate(teeth=2).columns)
    methods = {k: replace(m, value=-m.value) for k, m in result.methods.items()}
    (name, method), *_ = methods.items()
    panel, *_ = replace(result, methods=methods).plot().axes
    shown = method[method.parameters[0]][method.flag == 0]
    lowest, highest = panel.get_ylim()
    assert lowest < np.percentile(shown, 5) < np.percentile(shown, 95) < highest, name
    # The band is one standard deviation.
    band = panel.collections[0].get_paths()[0].vertices
    ends = np.unique(band[band[:, 0] == result.time[-1], 1])
    std = method.std_of(method.parameters[0])[-1]
    np.testing.assert_allclose(ends, method[method.parameters[0]][-1] + std * np.array([-1, 1]))
