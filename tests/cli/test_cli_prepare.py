"""``tirefit prepare``: files are written, read back, and reproduced."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tirefit.data.read import read

sys.path.insert(0, str(Path(__file__).parents[1] / "data"))
from rig_file import METRIC_UNITS, ttc
from rig_script import cornering, measured
from test_cli_tutorials import undocumented


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A test as a Tire Test Consortium rig writes it, and its settings."""
    script, rng = cornering(7101, rate=50, loads=2, cambers=2, pressures=1)
    seen, clean = measured(script, rng)
    n = script.rows
    seen |= {"omega": seen["v"] / 0.26, "mz": -0.02 * seen["fy"], "fx": np.zeros(n)}
    file = ttc(seen)
    path = tmp_path_factory.mktemp("rig") / "run7.dat"
    with path.open("w") as out:
        out.write("\t".join(file) + "\n" + "\t".join(METRIC_UNITS) + "\n")
        table = np.column_stack(list(file.values()))
        np.savetxt(out, table, fmt="%.6g", delimiter="\t")
    return path, script, clean


def test_a_prepared_recording_can_be_fitted(run, recording, tmp_path):
    path, script, clean = recording
    said = run("prepare", path, "--out", "out").stdout
    assert "convention braking, SI units" in said and "zero-phase" in said
    out = tmp_path / "out"
    assert [p.name for p in out.glob("*.csv")] == ["run7.csv"]  # all tables to fit
    assert {p.name for p in out.iterdir()} == {
        "run7.csv",
        "run7.segments.tsv",
        "run7.prepare.json",
        "run7.png",
    }
    data = read(out / "run7.csv")
    assert data.source.convention == "braking" and not data.source.warnings
    assert data.runs == ("run7",)
    rows = np.round(data["time"] * script.rate).astype(int)
    # White noise of 1 % of the largest load, of which the filter leaves its share.
    record = json.loads((out / "run7.prepare.json").read_text())
    assert undocumented(out / "run7.prepare.json") == []
    left = np.sqrt(2 * record["filter"]["bandwidth"] / script.rate)
    miss = np.std(data["fy"] - clean["fy"][rows]) / clean["fz"].max()
    assert miss == pytest.approx(0.01 * left, rel=0.15)
    np.testing.assert_allclose(data["alpha"], clean["alpha"][rows], atol=2e-3)
    binned = read(out / "run7.csv", columns={"run": "bin"})
    loads = sorted({e.settings["fz"] for e in script.events})
    assert len(binned.runs) == 4
    for code, name in enumerate(binned.runs):
        load, unit, camber, _ = name.split()
        here = binned.run == code
        assert unit == "N" and float(load) == pytest.approx(np.median(binned["fz"][here]), rel=0.03)
        assert float(camber) == pytest.approx(
            np.degrees(np.median(binned["gamma"][here])), abs=0.05
        )
    assert len(loads) == 2
    each = read(out / "run7.csv", columns={"run": "segment"})
    kept = [s for s in record["segments"] if s["kept"]]
    assert [str(s["segment"]) for s in kept] == list(each.runs)
    assert {s["kind"] for s in kept} == {"sweep", "steady"}
    assert record["rows"]["kept"] == len(data)
    counts = [int(n) for n in re.findall(r"  (\d+) of \d+ rows kept$", said, re.M)]
    assert sum(counts) == len(data)


def test_workers_give_the_result_of_one_process(run, unrendered, recording, workers_here, tmp_path):
    path, _, _ = recording
    (tmp_path / "no.csv").write_text("a,b\n1,2\n")
    files = (path, "no.csv")
    alone = run("prepare", *files, "--out", "one", exit_code=3)
    shared = run("prepare", *files, "--out", "two", "--jobs", 2, exit_code=3)
    one, both = (
        {p.name: p.read_bytes() for p in (tmp_path / name).iterdir()} for name in ("one", "two")
    )
    assert {name: both.pop(name) for name in ("results.parquet", "fleet.html")}
    assert both == one and len(one) == 4
    said = shared.stdout.replace("wrote to two:", "wrote to one:").splitlines()
    assert said[:-1] == alone.stdout.splitlines() and "no.csv" in shared.stderr
    table = pd.read_parquet(tmp_path / "two" / "results.parquet")
    rows = table[table["name"] == "rows"]["value"].tolist()
    assert rows == [len(read(tmp_path / "two" / "run7.csv"))]


def test_settings_come_from_the_configuration(run, unrendered, recording, tmp_path):
    path, _, _ = recording
    (tmp_path / "fit.toml").write_text("[prepare]\nfilter = false\nkeep = ['warm-up']\n")
    run("prepare", path, "--config", "fit.toml", "--out", "out")
    record = json.loads((tmp_path / "out/run7.prepare.json").read_text())
    assert record["filter"] is None and record["config"]["keep"] == ["warm-up"]
    kinds = {s["kind"] for s in record["segments"] if s["kept"]}
    assert kinds == {"warm-up"}
    (tmp_path / "fit.toml").write_text("[prepare]\nbandwith = 5\n")
    said = run("prepare", path, "--config", "fit.toml", "--out", "o", exit_code=2)
    assert "did you mean 'bandwidth'?" in said.stderr


def test_one_bad_file_does_not_stop_the_others(run, unrendered, recording, tmp_path):
    path, _, _ = recording
    (tmp_path / "no.csv").write_text("time,fz\n0,1000\n1,1000\n2,1000\n")
    said = run("prepare", "no.csv", path, "--out", "out", exit_code=3)
    assert "no slip" in said.stderr and (tmp_path / "out/run7.csv").exists()
    run("prepare", "--out", "out", exit_code=2)
    said = run("prepare", "no.csv", "--out", ".", exit_code=3).stderr
    assert "an input file" in said and (tmp_path / "no.csv").exists()
    said = run("prepare", path, path, "--out", "out", exit_code=2).stderr
    assert "several input files are named run7" in said
