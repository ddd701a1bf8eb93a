"""Files of every kind, damaged at random, are read or refused with place and remedy."""

import warnings

import numpy as np
import pytest
from rig_file import truth, ttc
from test_read_kinds import (
    SHEET,
    arrow_table,
    consortium,
    save_5,
    save_73,
    save_arrow,
    save_excel,
    save_parquet,
)

from tirefit.data.read import read
from tirefit.data.readers.extras import readable
from tirefit.results import DataError

MADE = {
    "MATLAB 5": lambda path: save_5(path, consortium()),
    "MATLAB 7.3": lambda path: save_73(path, consortium()),
    "Parquet": lambda path: save_parquet(path, arrow_table(ttc(truth(40)))),
    "Arrow": lambda path: save_arrow(path, arrow_table(ttc(truth(40)))),
    "Excel": lambda path: save_excel(path, {"one": SHEET, "two": [["a", 1]]}),
}


def damaged(content, rng):
    """The bytes with a few of them changed, removed, doubled or the end cut off."""
    content = bytearray(content)
    for _ in range(rng.integers(1, 6)):
        at, length = rng.integers(len(content)), int(rng.integers(1, 40))
        match rng.integers(4):
            case 0:
                content[at] = rng.integers(256)
            case 1:
                del content[at : at + length]
            case 2:
                content[at:at] = content[at : at + length]
            case 3:
                del content[max(at, 20) :]
        content = content or bytearray(b"x")
    return bytes(content)


@pytest.mark.parametrize("kind", MADE)
def test_damaged_files_are_read_or_refused(tmp_path, kind):
    rng = np.random.default_rng(list(MADE).index(kind))
    MADE[kind](tmp_path / "whole")
    content = (tmp_path / "whole").read_bytes()
    path = tmp_path / "damaged"
    outcomes = set()
    for _ in range(30):
        path.write_bytes(damaged(content, rng))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the libraries, on what they met
            try:
                read(path)
                outcomes.add("read")
            except DataError as error:
                assert all(p.file and p.reason for p in error.problems)
                outcomes.add("refused")
    assert "refused" in outcomes


@pytest.mark.parametrize("text", ['"', '"Format","AiM CSV File"\n"', '\n\n"'])
def test_an_unclosed_quotation_mark_is_reported(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(DataError, match="quotation mark is not closed"):
        read(tmp_path / "a.csv")


def test_an_error_of_a_reading_library_becomes_one_with_a_remedy():
    with pytest.raises(DataError) as caught:
        with readable("bag", "a.mcap", "record it again"):
            raise KeyError("topic")
    (problem,) = caught.value.problems
    assert problem.reason == "the bag cannot be read: KeyError: 'topic'"
    assert (problem.file, problem.remedy) == ("a.mcap", "record it again")
    with pytest.raises(DataError, match="too large") as caught:  # has a remedy of its own
        with readable("bag", "a.mcap", "record it again"):
            raise DataError("too large", "split it", "a.mcap")
    assert caught.value.problems[0].remedy == "split it"
