"""The table of all results and its page, for a fleet with a known truth."""

import re

import numpy as np
import pytest

from tirefit.data.records import FileRecord, Row, dates_of, records_into
from tirefit.report.many_files import files_of, files_page, points_of, write_fleet_page

WILD = 17


def records(n, dated=True, seed=0):
    """mu drifts by -0.1 from the first to the last; file 17 has another one; every
    tenth file does not determine cpa2; the last one failed, with a malicious name."""
    generator = np.random.default_rng(seed)
    for k in range(n - 1):
        mu = 0.9 - 0.1 * k / n + 0.01 * generator.normal() + 0.3 * (k == WILD)
        std = 0.005
        rows = (
            Row("parameter", "mu", mu + std * generator.normal(), std, unit="-"),
            Row("parameter", "cpa2", 5e4, None if k % 10 == 0 else 50.0, unit="N"),
            Row("statistic", "rmse", 40.0 + generator.normal()),
        )
        day = f"2024-{1 + k // 28 % 12:02d}-{1 + k % 28:02d}T08{k % 60:02d}"
        name = f"data/{day}.csv" if dated else f"data/run{k}.csv"
        yield FileRecord(
            name, f"out/{k}", "brush", "ok", rows, convention="iso-w", seed=3, version="1.2"
        )
    evil = "data/<script>2024-12-31.csv"
    yield FileRecord(evil, "out/x", "", "failed", problem="<b>no column & fz</b>")


def test_the_table_has_a_row_per_number_and_file(tmp_path):
    import pyarrow.parquet

    given = list(records(30))
    with records_into(tmp_path / "results.parquet") as into:
        for record in given:
            into.add(record)
    rows = pyarrow.parquet.read_table(tmp_path / "results.parquet").to_pylist()
    assert len(rows) == 29 * 3 + 1
    assert [row["number"] for row in rows[:4]] == [1, 1, 1, 2]
    mu = next(row for row in given[4].rows if row.name == "mu")
    there = next(row for row in rows if row["number"] == 5 and row["name"] == "mu")
    assert there["value"] == mu.value and there["std"] == mu.std
    assert there["low"] is None and there["identified"] and there["seed"] == 3
    assert there["file"] == given[4].file and there["result"] == "out/4"
    assert rows[-1]["status"] == "failed" and rows[-1]["value"] is None
    assert rows[-1]["problem"] == "<b>no column & fz</b>"


def test_an_unfinished_table_leaves_no_file(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        with records_into(tmp_path / "results.parquet"):
            raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("dated", [True, False])
def test_drift_and_the_outlying_file_are_found(dated):
    fleet = files_of(list(records(200, dated=dated)))
    assert (fleet.dates is not None) == dated
    mu, stiffness, rmse = fleet.quantities
    assert mu.across.drifts and abs(mu.across.change + 0.1) < 4 * mu.across.change_std
    points = points_of(fleet, mu)
    assert np.flatnonzero(points.outlying).tolist() == [WILD]
    line = points.line[0][mu.known]
    assert line[-1] - line[0] == pytest.approx(mu.across.change)
    assert np.isfinite(stiffness.value).sum() == 199 and stiffness.known.sum() == 179
    assert not rmse.across.drifts


def test_the_page_is_small_complete_and_escaped(tmp_path):
    write_fleet_page(list(records(600)), tmp_path / "fleet.html", "fit")
    page = (tmp_path / "fleet.html").read_text("utf-8")
    assert len(page) < 400_000
    links = re.findall(r"""\b(?:src|href)=['"]?([^'" >]*)""", page)
    assert len(links) == 3 and all(k.startswith("data:image/png;base64,") for k in links)
    assert "<script" not in page and "<b>no column" not in page
    cells = " ".join(re.sub(r"<[^>]*>", " ", page).split())
    assert "cpa2 N 539 61 50000 " in cells  # one in ten, and the failed file
    assert "599 ok" in page and "1 failed" in page
    assert "no column &amp; fz" in page and "drifts" in page
    assert "iso-w" in page and "seed: 3" in page and "version: 1.2" in page


def test_a_page_is_written_if_all_files_failed():
    page = files_page(files_of(list(records(1))), "diagnose")
    assert "no quantity of three files or more" in page and "1 failed" in page


@pytest.mark.parametrize(
    ("names", "seconds"),
    [
        (["a_20240131.csv", "b_20240201.csv"], 86400),
        (["s3://x/2024-01-31T10:00:00.csv", "2024-01-31T10:01:30.csv"], 90),
        (["20240131_101500.tdx", "20240131_101600.tdx"], 60),
        (["2024-01-31.csv", "run2.csv"], None),
        (["2024-01-31/a.csv", "2024-02-01/b.csv"], None),
        (["2024-01-31a.csv", "2024-01-31b.csv"], None),
        (["2024-02-31.csv", "2024-02-01.csv"], None),
        (["1202401311.csv", "1202402011.csv"], None),
    ],
)
def test_dates_are_read_from_the_names(names, seconds):
    dates = dates_of(names)
    if seconds is None:
        assert dates is None
    else:
        assert np.diff(dates).astype(int).tolist() == [seconds]
