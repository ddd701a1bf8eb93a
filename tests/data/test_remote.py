"""Files at an address are read like the same bytes on the disk."""

import sys
from pathlib import Path

import fsspec
import pytest

from tirefit.data.read import read
from tirefit.data.readers.remote import RemoteFile, expanded, file_at
from tirefit.results import DataError

TEXT = "sigma_x,fx,fz\n" + "\n".join(f"0.0{k},{k}00,4000" for k in range(1, 9)) + "\n"


@pytest.fixture
def memory():
    system = fsspec.filesystem("memory")
    for name in ("b", "a"):
        system.pipe(f"/rig/{name}.csv", TEXT.encode())
    yield system
    system.rm("/rig", recursive=True)


def test_an_address_is_read_like_the_file(memory, tmp_path):
    (tmp_path / "a.csv").write_text(TEXT)
    local, remote = (
        read(place, convention="braking") for place in (tmp_path / "a.csv", "memory://rig/a.csv")
    )
    assert remote.name == local.name == "a"
    assert remote.source.sha256 == local.source.sha256
    assert remote.source.path == "memory://rig/a.csv"
    assert (remote.columns["fx"] == local.columns["fx"]).all()


def test_local_and_chained_addresses_are_read(tmp_path):
    import gzip

    packed = tmp_path / "a.csv.gz"
    packed.write_bytes(gzip.compress(TEXT.encode()))
    for place in (f"file://{packed}", f"simplecache::file://{packed}"):
        data = read(place, convention="braking")
        assert data.n == 8 and data.name == "a"


def test_missing_addresses_are_reported(memory):
    with pytest.raises(DataError, match="memory://rig/no.csv: the file does not exist"):
        read("memory://rig/no.csv")


@pytest.mark.parametrize("place", ["memory://rig/*.csv", "memory://no/*.csv"])
def test_patterns_of_addresses_are_expanded(memory, place):
    if "no" in place:
        with pytest.raises(DataError, match="no file matches"):
            expanded([file_at(place)])
    else:
        names = [str(file) for file in expanded([file_at(place)])]
        assert names == ["memory:///rig/a.csv", "memory:///rig/b.csv"]


def test_patterns_of_local_files_are_expanded(tmp_path):
    for name in ("b.csv", "a.csv", "[1].csv"):
        (tmp_path / name).touch()
    files = expanded([tmp_path / "?.csv", tmp_path / "[1].csv"])
    assert [file.name for file in files] == ["a.csv", "b.csv", "[1].csv"]
    with pytest.raises(DataError, match="no file matches"):
        expanded([tmp_path / "*.mat"])


@pytest.mark.parametrize("scheme", ["s3", "no"])
def test_an_unreadable_address_is_a_data_error(scheme, monkeypatch):
    monkeypatch.setitem(sys.modules, "s3fs", None)
    with pytest.raises(DataError, match=f"{scheme}://rig/a.csv") as error:
        read(f"{scheme}://rig/a.csv")
    assert scheme == "no" or "Install s3fs" in str(error.value)


def test_without_fsspec_the_install_command_is_given(monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(DataError, match=r"tirefit\[cluster\]"):
        read("memory://rig/a.csv")


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("s3://bucket/x/run.csv.gz", "run.csv.gz"),
        ("https://rig.example/get/run.csv?token=a/b", "run.csv"),
        ("zip://inside/run.csv::s3://bucket/all.zip", "run.csv"),
        ("simplecache::s3://bucket/run.csv", "run.csv"),
    ],
)
def test_addresses_have_the_name_of_their_file(text, name):
    assert isinstance(file_at(text), RemoteFile) and file_at(text).name == name


@pytest.mark.parametrize("text", ["run.csv", "C:/x/run.csv", "a:b.csv", "x//y.csv"])
def test_paths_are_not_taken_for_addresses(text):
    assert file_at(text) == Path(text) and not isinstance(file_at(text), RemoteFile)
