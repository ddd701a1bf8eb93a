"""Files are written completely or not at all; JSON holds only what it can express."""

import json
import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.killed import killed_at, steps_of
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


def written(path, text, days=0.0):
    """Write a file of some days ago."""
    path.write_text(text)
    os.utime(path, (0, time.time() - 86_400 * days))


@pytest.mark.parametrize("earlier", ["abcd", "acd", "abd", "d"])
@pytest.mark.parametrize("days", [0, 2])
def test_a_killed_process_leaves_no_mixture_of_files(tmp_path, earlier, days):
    """Where the last of several files is, all are of its result. The next command finds the
    earlier files, however old they are, or the new ones, wholly."""
    paths = [tmp_path / name for name in ("a.png", "b.csv", "c.json")]
    before = {name: "old" for name in ("a.png", "b.csv", "c.json", "d.txt") if name[0] in earlier}
    after = {**dict.fromkeys([path.name for path in paths], "new"), "d.txt": "old"}

    def restore():
        shutil.rmtree(tmp_path)
        tmp_path.mkdir()
        for name, text in before.items():
            written(tmp_path / name, text, days)

    def found():
        return {path.name: path.read_text() for path in tmp_path.iterdir() if path.is_file()}

    states = []
    for _ in steps_of(lambda: write_texts(dict.fromkeys(paths, "new")), restore):
        visible = {name: text for name, text in found().items() if name[0] != "."}
        if paths[-1].exists():
            assert visible in (before, after)
        remove_left(tmp_path)
        assert not list(tmp_path.glob(".*.earlier*"))
        states.append({name: text for name, text in found().items() if name[0] != "."})
        assert states[-1] in (before, after)
    assert before in states and after in states and len(states) >= 6
    restore()
    write_texts(dict.fromkeys(paths, "new"))
    assert found() == after and len([*tmp_path.iterdir()]) == 4


def test_a_recovery_that_is_killed_can_be_repeated(tmp_path):
    """And it keeps a file that was written after the kill."""
    paths = [tmp_path / name for name in ("a.png", "b.csv", "c.json")]
    for path in paths:
        written(path, "old", days=2)
    # It has made a folder, moved three earlier files there and put one new file in place.
    assert killed_at(5, lambda: write_texts(dict.fromkeys(paths, "new")))
    assert not paths[2].exists() and not paths[1].exists()
    written(paths[1], "mine", days=-0.01)
    for _ in steps_of(lambda: remove_left(tmp_path), lambda: None):
        assert paths[1].read_text() == "mine"
    remaining = {p.name: p.read_text() for p in tmp_path.iterdir() if p.name[0] != "."}
    assert remaining == {"a.png": "old", "b.csv": "mine", "c.json": "old"}


def test_old_temporary_files_are_removed_and_no_others(tmp_path):
    """One of a day ago is of a killed process; one of now may be of a living one."""
    old = tmp_path / ".a.x.tirefit-part"
    old.write_text("torn")
    os.utime(old, (0, time.time() - 90_000))
    with replacing(tmp_path / "b") as temporary:
        remove_left(tmp_path)
        assert list(tmp_path.iterdir()) == [temporary]


def test_the_next_replacement_restores_the_other_files_of_a_killed_one(tmp_path):
    paths = [tmp_path / name for name in ("a.png", "b.csv", "c.json")]
    write_texts(dict.fromkeys(paths, "old"))
    assert killed_at(5, lambda: write_texts(dict.fromkeys(paths, "new")))
    write_texts(dict.fromkeys([paths[0], paths[2]], "newer"))
    assert [path.read_text() for path in paths] == ["newer", "old", "newer"]


def test_a_replacement_of_a_living_process_is_not_undone(tmp_path, monkeypatch):
    """Another command that begins meanwhile leaves it alone."""
    paths = [tmp_path / name for name in ("a", "b")]
    write_texts(dict.fromkeys(paths, "old"))
    rename = os.replace

    def watched(one, other):
        remove_left(tmp_path)
        rename(one, other)

    monkeypatch.setattr(os, "replace", watched)
    write_texts(dict.fromkeys(paths, "new"))
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"a": "new", "b": "new"}


def test_commands_that_write_at_the_same_time_wait_for_each_other(tmp_path):
    """The files of the folder are then of one result, and none failed."""
    paths = [tmp_path / name for name in ("a", "b", "c")]

    def work(text):
        for _ in range(40):
            remove_left(tmp_path)
            write_texts(dict.fromkeys(paths, text))

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, ["one", "two", "three", "four"]))
    assert len({path.read_text() for path in paths}) == 1
    assert sorted(tmp_path.iterdir()) == paths


def test_an_interrupted_replacement_is_undone(tmp_path, monkeypatch):
    paths = [tmp_path / name for name in ("a", "b", "c")]
    write_texts(dict.fromkeys(paths[1:], "old"))
    rename, left = os.replace, [3]

    def interrupted(one, other):
        left[0] -= 1
        rename(one, other)
        if left[0] == 0:
            raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_texts(dict.fromkeys(paths, "new"))
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"b": "old", "c": "old"}


def test_a_renaming_that_fails_undoes_the_others(tmp_path, monkeypatch):
    paths = [tmp_path / name for name in ("a", "b", "c")]
    for path in paths[:2]:
        path.write_text("old")
    before = {path.name: path.read_text() for path in tmp_path.iterdir()}
    rename, failed = os.replace, 0
    for step in range(5):  # two are set aside, three put in place
        left = [step]

        def failing(one, other, left=left):
            left[0] -= 1
            if left[0] == -1:
                raise OSError(5, "fault", str(other))
            rename(one, other)

        monkeypatch.setattr(os, "replace", failing)
        with pytest.raises(OSError, match="fault"):
            write_texts(dict.fromkeys(paths, "new"))
        failed += 1
        assert {path.name: path.read_text() for path in tmp_path.iterdir()} == before
    assert failed == 5
