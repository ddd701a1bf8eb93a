"""Files are written completely or not at all; JSON holds only what it can express."""

import json
import os
import time

import numpy as np
import pytest

from tests.killed import steps_of
from tirefit.files import json_safe, json_text, remove_left, replacing, write_texts
from tirefit.results import Outcome


def test_json_contains_plain_finite_values():
    content = {
        "outcome": Outcome.AT_BOUND,
        1: (np.float32(0.5), np.int64(3), np.bool_(True), True, "text", None),
        "array": np.array([[1.0, np.nan], [np.inf, -2.0]]),
        "scalar": np.array(7),
        "infinite": [float("-inf"), {"deep": np.float64("nan")}],
    }
    plain = json.loads(json_text(content), parse_constant=pytest.fail)
    assert plain == {
        "outcome": "at_bound",
        "1": [0.5, 3, True, True, "text", None],
        "array": [[1.0, None], [None, -2.0]],
        "scalar": 7,
        "infinite": [None, {"deep": None}],
    }
    assert type(json_safe(np.bool_(True))) is bool and type(json_safe(True)) is bool


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_block_that_fails_keeps_the_old_file(tmp_path, error):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    with pytest.raises(error), replacing(path) as temporary:
        temporary.write_bytes(b"half")
        raise error
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
    with replacing(path) as temporary:
        temporary.write_bytes(b"new")
        assert path.read_bytes() == b"old" and temporary.parent == path.parent
    assert path.read_bytes() == b"new" and list(tmp_path.iterdir()) == [path]


def test_an_error_of_another_file_keeps_its_name(tmp_path):
    with pytest.raises(OSError) as caught, replacing(tmp_path / "a"):
        (tmp_path / "b" / "c").write_text("")
    assert caught.value.filename == str(tmp_path / "b" / "c")


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.csv"
    path.write_text("old")

    def fail(name, *_):
        raise OSError(28, "disk full", name)

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full") as caught:
        write_texts({path: "new"})
    assert caught.value.filename == str(path)  # not the temporary one
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_keeps_the_permissions(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    path.chmod(0o640)
    write_texts({path: "grün\n"})
    assert path.read_text(encoding="utf-8") == "grün\n"
    assert path.stat().st_mode & 0o777 == 0o640


def test_files_that_belong_together_are_written_together(tmp_path):
    one, two = tmp_path / "one", tmp_path / "none" / "two"
    one.write_text("old")
    with pytest.raises(FileNotFoundError) as caught:
        write_texts({one: "new", two: "new"})
    assert caught.value.filename == str(two)
    assert one.read_text() == "old" and list(tmp_path.iterdir()) == [one]
    two.parent.mkdir()
    write_texts({one: "new", two: "newer"})
    assert (one.read_text(), two.read_text()) == ("new", "newer")


def test_a_killed_process_leaves_no_mixture_of_files(tmp_path):
    """Where the last of several files is, all are of its result, and an earlier one is gone."""
    paths = [tmp_path / name for name in ("a.png", "b.csv", "c.json")]
    gone = tmp_path / "d.csv"

    def restore():
        for path in (*paths, gone):
            path.write_text("old")

    states = []
    for _ in steps_of(lambda: write_texts(dict.fromkeys(paths, "new"), [gone]), restore):
        texts = {p.name: p.read_text() for p in tmp_path.iterdir() if p.name[0] != "."}
        if paths[-1].exists():
            after = dict.fromkeys([path.name for path in paths], "new")
            assert texts in (after | {"d.csv": "old", **dict.fromkeys(after, "old")}, after)
        states.append(paths[-1].exists())
        for path in tmp_path.iterdir():
            path.unlink()
    assert states[0] and states[-1] and states.count(False) == 4


def test_old_temporary_files_are_removed_and_no_others(tmp_path):
    """One of a day ago is of a killed process; one of now may be of a living one."""
    old = tmp_path / ".a.x.tirefit-part"
    old.write_text("torn")
    os.utime(old, (0, time.time() - 90_000))
    with replacing(tmp_path / "b") as temporary:
        remove_left(tmp_path)
        assert list(tmp_path.iterdir()) == [temporary]
