"""Fits, tires and diagnoses side by side: what differs beyond its error."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2
from typer.testing import CliRunner

import tirefit
from tirefit.cli.commands import app
from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.summary import forces
from tirefit.diagnosis.summary.compare import Apart, Comparison, Number, Source, _apart, standing_of
from tirefit.results import DataError, UsageError

TIR = Path(__file__).parents[1] / "data/tir/mfeval_julia/MagicFormula61_Parameters.tir"


def day(mu, seed, model="brush"):
    return tirefit.fit(tirefit.simulate("rig", values={"mu": mu}, seed=seed).columns, model)


@pytest.fixture(scope="module")
def days():
    return [day(0.9, 1), day(0.8, 2), day(0.9, 3)]


@pytest.fixture(scope="module")
def saved(days, tmp_path_factory):
    folder = tmp_path_factory.mktemp("days")
    for k, one in enumerate(days):
        one.save(folder / f"day{k}")
    return [folder / f"day{k}" / "fit.json" for k in range(len(days))]


def test_the_difference_of_two_days_is_found_with_its_error(days):
    found = tirefit.compare(days[:2], ["Monday", "Tuesday"])
    cpa2, mu = found.numbers
    assert (mu.name, mu.differs, mu.farthest, cpa2.differs) == ("mu", True, "Tuesday", False)
    first, second = (one.parameters["mu"] for one in days[:2])
    assert mu.difference == pytest.approx(second.value - first.value)
    assert mu.std == pytest.approx(np.hypot(first.std, second.std))
    assert abs(mu.difference + 0.1) < 2 * mu.std
    assert mu.p == pytest.approx(chi2.sf((mu.difference / mu.std) ** 2, 1), abs=1e-12)
    text = str(found)
    assert text.splitlines()[2].startswith("  mu differs: 0.8991 ± 0.0013 in Monday, 0.7993")
    assert "cpa2 (0.7 errors) does not differ" in text


def test_numbers_that_are_tested_together_share_the_level():
    """A difference of 2.7 errors has a probability of .007: below .01, not below .005."""
    apart = {name: {"a": Number(x, 0.5**0.5, "")} for name, x in (("one", 0.0), ("two", 2.7))}
    assert [number.differs for number in _apart(apart, ())] == [True]
    twice = {name: x | {"b": x["a"]} for name, x in apart.items()}
    assert [number.differs for number in _apart(twice, ())] == [False, False]
    assert _apart(apart, ("one",))[0].p is None


def test_of_three_days_the_one_apart_is_named(days):
    found = tirefit.compare(days, "ABC")
    mu = found.numbers[1]
    value = np.array([one.parameters["mu"].value for one in days])
    weight = np.array([one.parameters["mu"].std for one in days]) ** -2.0
    others = np.average(value[[0, 2]], weights=weight[[0, 2]])
    assert mu.farthest == "B" and mu.difference == pytest.approx(value[1] - others)
    assert mu.std == pytest.approx(np.sqrt(1 / weight[1] + 1 / (weight[0] + weight[2])))
    middle = np.average(value, weights=weight)
    assert mu.p == pytest.approx(chi2.sf(weight @ (value - middle) ** 2, 2), abs=1e-12)
    assert [one.differs for one in found.forces[0].curves.values()] == [False, True, False]


def test_forces_over_the_common_range_have_the_band_of_the_fit(days):
    curve = tirefit.compare(days[:2]).forces[0]
    first, second = curve.curves.values()
    assert curve.loads == (4000.0,) and curve.slips[[0, -1]] == pytest.approx([0.002, 0.2])
    # On the plateau the force is mu F_z; the band, by 100 draws, is known within 7 % (std).
    assert second.force[0, -1] == pytest.approx(4000 * days[1].parameters["mu"].value)
    assert second.std[0, -1] == pytest.approx(4000 * days[1].parameters["mu"].std, rel=0.25)
    assert abs(second.difference + 400) < 30 and second.differs
    away = second.force - first.force
    share = np.linalg.norm(away) / np.sqrt(away.size) / first.force.max()
    assert second.rms_share == pytest.approx(share)


def test_a_fit_beside_a_tir_is_compared_over_the_forces(saved):
    found = tirefit.compare([saved[0], TIR])
    (curve,) = found.forces
    own, other = curve.curves.values()
    assert not found.numbers and curve.force == "fx" and own.std is not None and other.std is None
    rows = {"sigma_x": [other.slip], "fz": [other.load], "v": [curve.speed]}
    here, there = (tirefit.predict(one, rows)["fx"][0] for one in (saved[0], TIR))
    assert other.difference == pytest.approx(there - here)
    assert other.differs and found.plot().axes
    with pytest.raises(UsageError, match="two or more"):
        tirefit.compare([TIR])


def test_the_band_of_forces_counts_the_free_parameters(days, monkeypatch):
    """Two of the brush, of two fits of it alike; together with the three of another model five."""
    counts = []

    def isf(count, level):
        counts.append(count)
        return chi2.isf(level, count)

    monkeypatch.setattr(forces, "chdtri", isf)
    for other in (days[1], day(0.9, 4, "brush-m")):
        tirefit.compare([days[0], other])
    assert counts == [2, 5]


def test_fits_of_the_same_rows_are_not_tested(days):
    other = tirefit.fit(tirefit.simulate("rig", values={"mu": 0.9}, seed=1).columns, "quartic")
    found = tirefit.compare([days[0], other, TIR])
    assert found.shared == ("data (1)", "data (2)") and "same rows" in found.notes[-1]
    assert not any(one.differs for one in found.numbers)
    assert "errors)" not in str(found)
    again = tirefit.fit(tirefit.simulate("rig", values={"mu": 0.8}, seed=2).columns, "quartic")
    pairs = tirefit.compare([days[0], other, days[1], again])
    assert pairs.models == () and len(pairs.shared) == 4  # each pair has other rows: no ranking
    apart = tirefit.compare([days[1], other])  # of other rows: by what both models have
    assert {one.name for one in apart.numbers} >= {"C_x", "F_max_over_fz"}
    assert "mu" not in {one.name for one in apart.numbers}


@pytest.fixture(scope="module")
def gaps():
    few = [e for e in EFFECTS if e.id in ("slip_offset", "load_friction")]
    slip, load = np.tile(np.linspace(-0.15, 0.15, 60), 3), np.repeat([2000.0, 3000, 4000], 60)
    found = []
    for k, offset in enumerate((0.006, 0.009, 0.0)):
        rows = {"sigma_x": slip + offset, "fz": load}
        force = tirefit.predict("brush", rows, {"mu": 0.9})["fx"]
        force = force + np.random.default_rng(k).normal(0, 20, len(slip))
        rows = {"sigma_x": slip, "fz": load, "fx": force}
        found.append(tirefit.diagnose(rows, rig=Rig(noise={"fx": 20.0}), effects=few))
    return found


def test_effects_on_which_diagnoses_agree(gaps, tmp_path):
    found = tirefit.compare(gaps, "ABC")
    (size,) = found.effects
    assert abs(size.difference - 0.003) < 2 * size.std and size.differs
    assert "slip offset is named in A, B only; its size differs: 0.00" in str(found)
    alone = tirefit.compare([gaps[0], gaps[0]], "AB")
    assert "slip offset is named in all" in str(alone)
    paths = [one.save(tmp_path / name)[0].parent for one, name in zip(gaps, "abc", strict=True)]
    again = tirefit.compare([path / "data.json" for path in paths])
    assert [one.name for one in again.sources] == ["a", "b", "c"]
    assert again.effects[0].difference == size.difference


def test_two_diagnoses_of_the_same_rows_are_compared(gaps, tmp_path):
    columns = {"sigma_x": np.linspace(-0.15, 0.15, 40), "fz": np.full(40, 3000.0)}
    columns["fx"] = tirefit.predict("brush", columns, {"mu": 0.9})["fx"]
    table = np.stack(list(columns.values()), axis=1)
    file = tmp_path / "rows.csv"
    np.savetxt(file, table, "%.9g", ",", header=",".join(columns), comments="")
    data = tirefit.read(file, convention="braking")
    few = [e for e in EFFECTS if e.id == "slip_offset"]
    rig = Rig(noise={"fx": 20.0})
    found = [tirefit.diagnose(data, model, rig=rig, effects=few) for model in ("brush", "brush-d")]
    both = tirefit.compare(found, ["one", "other"])
    assert both.shared == ("one", "other") and both.models == ()
    assert "are of the same rows: their errors are not independent" in " ".join(str(both).split())


def test_two_fits_to_the_same_logs_of_a_car_are_not_tested(tmp_path):
    """Their difference of 4 standard errors, were they independent."""
    for name, logs, value in (("a", "lap", 0.8), ("b", "lap", 0.96), ("c", "other", 0.96)):
        mu = {"value": value, "std": 0.02, "unit": "-"}
        content = {"schema": "tirefit.trajectory/1", "logs": [logs], "parameters": {"front.mu": mu}}
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    one, same, other = (tmp_path / f"{name}.json" for name in "abc")
    assert tirefit.compare([one, other]).numbers[0].differs
    both = tirefit.compare([one, same])
    assert both.shared == ("a", "b") and not both.numbers[0].differs


def test_the_command_writes_its_files_and_lists_all_faults(saved, tmp_path):
    run = CliRunner().invoke
    done = run(app, ["compare", *map(str, saved[:2]), "--out", str(tmp_path / "o"), "--html"])
    assert done.exit_code == 0 and done.output.startswith("COMPARISON of day0, day1\nANSWER\n  mu")
    content = json.loads((tmp_path / "o/comparison.json").read_text())
    assert content["schema"] == "tirefit.comparison/1" and content["numbers"][1]["differs"]
    assert {one.name for one in (tmp_path / "o").iterdir()} == {
        "comparison.json", "comparison.png", "comparison.html",
    }  # fmt: skip
    text = saved[0].read_text()
    (tmp_path / "cut.json").write_text(text[: len(text) // 2])
    (tmp_path / "table.csv").write_text("sigma_x,fx,fz\n0,0,1\n")
    (tmp_path / "t.json").write_text('{"schema": "tirefit.trajectory/1", "logs": [], "a": 1}')
    (tmp_path / "replay.json").write_text('{"schema": "tirefit.replay/1"}')
    names = "no.json", "cut.json", "table.csv", "t.json", "replay.json"
    wrong = [str(tmp_path / name) for name in names]
    with pytest.raises(DataError) as error:
        tirefit.compare([saved[0], *wrong])
    assert [one.file for one in error.value.problems] == wrong
    assert all(one.remedy for one in error.value.problems)
    assert "its schema is tirefit.replay/1; tirefit.fit/1, " in str(error.value)
    failed = run(app, ["compare", str(saved[0]), *wrong, "--out", str(tmp_path / "p")])
    assert failed.exit_code == 3 and "5 problems" in failed.output


@pytest.mark.long
def test_equal_days_hardly_ever_differ():
    """Of 40 pairs of equal days at most two claim a difference: each does in 1 % of pairs by
    a parameter and in at most 1 % by a force, so three or more have a chance below 5 %."""
    claims = 0
    for k in range(40):
        found = tirefit.compare([day(0.9, 1000 + 2 * k), day(0.9, 1001 + 2 * k)], "AB")
        claims += any(one.differs for one in found.numbers)
        claims += found.forces[0].curves["B"].differs
    assert claims <= 2


def test_an_unlisted_effect_is_not_named():
    verdict = SimpleNamespace(effects=("unknown",), acts_like=("slip_offset",), also_possible=())
    assert standing_of(verdict, ()) == {"slip_offset": "acts like one"}


def test_sizes_of_effects_have_the_units_of_a_diagnosis():
    """An offset of -29.8 thousandths of the load is one of -2.98 %."""
    unit = "1e-3 mean F_z"
    sizes = {name: Number(-29.8 - 90 * k, 6.7, unit) for k, name in enumerate("AB")}
    apart = Apart("force_offset: amplitude", unit, sizes, "B", -90.0, 9.5, 0.0, True)
    standing = {"force_offset": "acts like one"}
    sources = (Source(x, "diagnosis", "", "brush", "", {}, standing=standing) for x in "AB")
    text = " ".join(str(Comparison(sources=tuple(sources), effects=(apart,))).split())
    assert "force offset [% of the mean F_z] -2.98 ± 0.67 -11.98 ± 0.67" in text
    assert "the gap acts like force offset in all; its size differs: -2.98 ± 0.67 in A" in text
    assert "difference -9.00 ± 0.95 % of the mean F_z (9.5 errors)" in text
