"""Notes on many files: each once, with a count of files and without loss of values."""

from dataclasses import replace

import numpy as np
import pytest

from tirefit.data.merged import merged
from tirefit.data.read import read_frame
from tirefit.data.table import join
from tirefit.results import DataError


def test_no_data_at_all_are_refused():
    with pytest.raises(DataError, match="no data given"):
        join([])


def test_a_note_names_few_files_or_covers_all():
    said = [(f"run{i:02d}", ["no column gamma"]) for i in range(72)]
    said[4] = ("run04", ["no column gamma", "row 3 read as units"])
    assert merged(said) == ["72 files: no column gamma", "run04: row 3 read as units"]
    half = [(name, texts if i % 2 else []) for i, (name, texts) in enumerate(said)]
    assert merged(half) == ["36 of 72 files: no column gamma"]


def test_different_values_are_given_as_a_range():
    said = [
        (f"r{i}", [f"FZW = {load} N in all rows", f"MEASID = A-{i}", "from a.csv"])
        for i, load in enumerate(("1000", "-20.5", "3000", "1000"))
    ]
    assert merged(said) == [
        "4 files: FZW = -20.5 to 3000 N in all rows",
        "4 files: MEASID = A-0 to A-3",
        "4 files: from a.csv",
    ]
    assert merged(said[:2])[1] == "2 files: MEASID = A-0, A-1"


def test_notes_of_one_file_are_unchanged():
    assert merged([("a", ["1 of 2", "3 of 4"])]) == ["1 of 2", "3 of 4"]


def test_joined_rows_keep_their_runs():
    columns = {"kappa": np.linspace(0, 0.1, 9), "fx": np.linspace(0, 900, 9), "fz": np.ones(9)}
    several = read_frame(columns | {"run": ["dry"] * 4 + ["wet"] * 5}, "a")
    joined = join([several, read_frame(columns, "b")])
    names = [joined.runs[k] for k in joined.run]
    assert names == ["a:dry"] * 4 + ["a:wet"] * 5 + ["b"] * 9


def test_joined_files_repeat_no_note():
    columns = {"kappa": np.linspace(0, 0.1, 9), "fx": np.linspace(0, 900, 9)}
    tables = [
        read_frame(columns, f"sweep_{load}", constants={"fz": load})
        for load in range(1000, 8200, 100)
    ]
    alone = {len(table.source.assumptions) for table in tables}
    said = join(tables).source.assumptions
    assert len(tables) == 72 and alone == {len(said)}
    assert "72 files: fz = 1000 to 8100 N in all rows, as declared" in said
    odd = replace(tables[0], source=replace(tables[0].source, warnings=("look",)))
    assert join([odd, *tables[1:]]).source.warnings == ("sweep_1000: look",)
