"""Limits of columns and of unpacked sizes; work that grows with the rows and not faster."""

import zipfile

import numpy as np
import pytest

from tirefit.data import columns
from tirefit.data.columns import guess
from tirefit.data.read import read
from tirefit.data.readers import tables
from tirefit.data.vehicle.track import _in_runs
from tirefit.door import COLUMNS, MIB
from tirefit.results import DataError

ROWS = [(-0.1 + 0.02 * k, 3000 * (-0.1 + 0.02 * k), 3000.0) for k in range(11)]


def wide(path, count):
    """A table of three known columns and ``count`` others."""
    names = ["alpha", "fy", "fz", *(f"c{k}" for k in range(count))]
    lines = [",".join(names)]
    lines += [",".join([*(f"{x:.4g}" for x in row), *["1"] * count]) for row in ROWS]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("count", [COLUMNS - 2, 60_000])
def test_too_many_columns_are_refused_and_counted(tmp_path, count):
    with pytest.raises(DataError) as caught:
        read(wide(tmp_path / "a.csv", count))
    (problem,) = caught.value.problems
    assert problem.reason == f"it has {count + 3} columns, more than {COLUMNS}"
    assert problem.file.endswith("a.csv") and problem.remedy.startswith("keep the columns")


def test_the_work_on_headers_grows_with_their_number(tmp_path, monkeypatch):
    """Joined words of all headers: a line that is not split was joined at every length."""
    lengths = []
    known = columns._ALIASES

    class Counted(dict):
        def get(self, name, *other):
            lengths.append(len(name))
            return known.get(name, *other)

    monkeypatch.setattr(columns, "_ALIASES", Counted(known))
    work = []
    for count in (500, 2000):
        lengths.clear()
        assert len(read(wide(tmp_path / f"{count}.csv", count))) == len(ROWS)
        work.append(sum(lengths))
    # Longer names by one digit of five characters: 4.4 times, where squared is 16 times.
    assert work[1] < 6 * work[0]


def test_a_long_text_is_no_header():
    assert guess("Fx [N]" + " " * 10) is not None
    assert guess(",".join(["fx"] * 100)) is None


def workbook(path, rows, padding=0):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in [("alpha", "fy", "fz"), *rows]:
        book.active.append(row)
    book.save(path)
    if padding:
        with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
            with archive.open("xl/media/image.png", "w", force_zip64=True) as file:
                for _ in range(padding // MIB):
                    file.write(bytes(MIB))
    return path


def test_a_workbook_that_is_large_when_unpacked_is_refused_before_it_is_read(tmp_path, monkeypatch):
    path = workbook(tmp_path / "a.xlsx", ROWS)
    assert len(read(path)) == len(ROWS)
    workbook(tmp_path / "b.xlsx", ROWS, 200 * MIB)
    assert (tmp_path / "b.xlsx").stat().st_size < MIB
    monkeypatch.setattr(tables, "_rows", None)  # no cell is read
    with pytest.raises(DataError, match="unpacked, the workbook has 200 MiB, more than 128") as e:
        read(tmp_path / "b.xlsx")
    assert "as CSV" in e.value.problems[0].remedy


def test_a_sheet_of_too_many_cells_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "_CELLS", 30)
    with pytest.raises(DataError, match="a sheet has more than 30 cells"):
        read(workbook(tmp_path / "a.xlsx", ROWS))


def test_a_parquet_file_that_is_large_when_unpacked_is_refused(tmp_path, monkeypatch):
    """A repeated value takes no room in the file."""
    pyarrow = pytest.importorskip("pyarrow")
    import pyarrow.parquet as parquet

    path = tmp_path / "a.parquet"
    names = ("alpha", "fy", "fz")
    table = pyarrow.table({name: np.full(2_000_000, 1.0) for name in names})
    parquet.write_table(table, path, compression="zstd")
    assert path.stat().st_size < MIB
    monkeypatch.setattr(tables, "DATA", 40 * MIB)
    with pytest.raises(DataError, match="it holds more than 40 MiB"):
        read(path)


def slowly_in_runs(time, period, max_gap, lasting):
    """The time continued where it restarts, row by row as its definition says."""
    time = time.copy()
    for k in np.flatnonzero(np.diff(time) < -max_gap) + 1:
        if k + lasting <= len(time) and np.all(time[k : k + lasting] < time[k - 1]):
            time[k:] += np.max(time[:k]) - time[k] + 2 * max_gap
    return time


@pytest.mark.parametrize("seed", range(20))
def test_restarting_time_is_continued_as_its_definition_says(seed):
    from tirefit.data.vehicle.track import _LASTING

    random = np.random.default_rng(seed)
    period, max_gap = 0.02, 0.07
    runs = []
    for _ in range(int(random.integers(1, 12))):
        start, count = random.uniform(0, 5), int(random.integers(1, 400))
        time = start + period * np.arange(count)
        late = random.random(count) < 0.01  # single stamps that go back
        runs.append(np.where(late, time - 0.5, time))
    time = np.concatenate(runs)
    found, _, _ = _in_runs(time, np.full(len(time), ""), period, max_gap, [])
    expected = slowly_in_runs(time, period, max_gap, round(_LASTING / period))
    np.testing.assert_allclose(found, expected, atol=1e-9)  # sums of 12 runs, rounded
