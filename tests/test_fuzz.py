"""500 damaged inputs: each a result or a clean error. ``make fuzz`` tries more."""

import json
import re
import zlib

import numpy as np
import pytest

from fits.fuzz import COMMANDS, KINDS, damaged, failures
from tirefit.diagnosis.rows.rig import load_rig
from tirefit.door import (
    RECORD,
    content_of,
    control_character,
    outrageous,
    read_record,
    read_toml,
    sealed,
)
from tirefit.fitting.problem.config import load_config
from tirefit.results import DataError, TirefitError, UsageError


def test_damaged_inputs_give_results_or_clean_errors():
    found = list(failures(500, seed=7))
    assert [(f.kind, f.number, f.text) for f in found] == []


_QUICK = ("inspect", "predict", "predict of a .tir", "derive", "derive by")


def test_whole_commands_end_with_results_or_clean_errors():
    quick = tuple(name for name in COMMANDS if name.split(": ")[0] in _QUICK)
    assert len(quick) == len(_QUICK)
    found = list(failures(18, seed=7, kinds=quick))
    assert [(f.kind, f.number, f.text) for f in found] == []


def test_the_fuzzer_detects_an_escaped_exception(monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError

    monkeypatch.setattr("tirefit.data.inspect.inspect", broken)
    kinds = ("inspect: data.csv",)
    assert any("ZeroDivision" in f.text for f in failures(8, seed=1, kinds=kinds))


def test_the_fuzzer_detects_a_traceback(monkeypatch):
    """Its purpose: a reader from which the parser's error escapes."""
    kind = KINDS["rig.toml"]._replace(read=lambda path: json.loads(path.read_bytes()))
    monkeypatch.setitem(KINDS, "rig.toml", kind)
    found = list(failures(5, seed=1, kinds=("rig.toml",)))
    assert len(found) == 5 and "Traceback" in found[0].text


def test_the_same_seed_gives_the_same_damage():
    sound = KINDS["tire.tir"].sound()[0]
    both = [damaged(sound, np.random.default_rng([1, 2])) for _ in range(2)]
    assert both[0] == both[1] != sound


@pytest.mark.parametrize("kind", KINDS)
def test_sound_inputs_are_read(kind, tmp_path):
    for number, content in enumerate(KINDS[kind].sound()[:3]):
        path = tmp_path / f"{number}{KINDS[kind].suffix}"
        path.write_bytes(content)
        try:
            KINDS[kind].read(path)
        except TirefitError as error:  # a table without slip, or another car's log
            assert kind in ("data.csv", "vehicle.toml"), error


WRONG = {
    "deep": ("a = " + "[" * 2000 + "]" * 2000, "nested too deeply|nested more than"),
    "deep keys": ("a." * 2000 + "b = 1", "nested more than 16 deep"),
    "long number": ("starts = " + "9" * 400, "starts: a number above 1e.20"),
    "very long number": ("starts = " + "9" * 5000, "not valid TOML"),
    "large": ("[noise]\nfx = 1e308", "noise.fx: a number above"),
    "small": ("[noise]\nfx = 1e-308", "noise.fx: a number closer to 0 than 1e-20"),
    "not UTF-8": ("a = '\xff'", "not valid TOML"),
}


@pytest.mark.parametrize(("text", "said"), WRONG.values(), ids=WRONG)
def test_implausible_settings_are_refused(tmp_path, text, said):
    path = tmp_path / "s.toml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(UsageError, match=said) as caught:
        read_toml(path)
    (problem,) = caught.value.problems
    assert problem.file == str(path) and problem.remedy and len(problem.reason) < 300


@pytest.mark.parametrize("value", ["1e10", "1e-13", "0", "true"])
def test_implausible_sizes_of_a_rig_are_refused(tmp_path, value):
    path = tmp_path / "rig.toml"
    path.write_text(f"[noise]\nfx = {value}\n")
    with pytest.raises(UsageError, match="noise.fx = .*: must be "):
        load_rig(path)
    path.write_text("[noise]\nfx = 1e7\nsigma_x = 1e-12\n")
    assert load_rig(path).noise == {"fx": 1e7, "sigma_x": 1e-12}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("starts = 10000000000", "starts = 10000000000: must be less than or equal"),
        ("[posterior]\nwalkers = 100000", "posterior.walkers = 100000"),
        ("[posterior]\nmax_steps = 100000000", "posterior.max_steps = 100000000"),
    ],
)
def test_numbers_beyond_the_float_range_are_refused(tmp_path, text, said):
    path = tmp_path / "fit.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match=said):
        load_config(path)


def test_a_grid_too_large_for_memory_is_refused(tmp_path, monkeypatch):
    text = (KINDS["vehicle.toml"].sound()[0]).decode()
    path = tmp_path / "vehicle.toml"

    def refused(rate, said):
        path.write_text(re.sub(r"sample_rate = \S+", f"sample_rate = {rate}", text))
        with pytest.raises(TirefitError, match=said):
            KINDS["vehicle.toml"].read(path)

    refused("1e9", "filter.sample_rate = 1000000000.0: must be less")
    monkeypatch.setattr("tirefit.data.vehicle.motion._MOST_SAMPLES", 5000)
    refused("1000.0", "samples, more than 5,000")


def test_too_large_a_file_is_not_read(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text("# " + "x" * 2**20 + "\n")
    with pytest.raises(UsageError, match="more than 1 MiB"):
        read_toml(path)
    with pytest.raises(DataError, match="cannot read it: No such file"):
        content_of(tmp_path / "none", RECORD)
    with pytest.raises(DataError, match="cannot read it"):
        content_of("a\0b", RECORD)


def test_infinities_are_not_refused_in_general():
    assert outrageous({"a": [float("inf"), float("nan"), 0, True, "1e400"]}) is None
    assert outrageous({"a": {"b": [1.0, -1e30]}}) == ("a.b", "a number above 1e+20")


def test_control_characters_are_reported_with_their_place():
    assert control_character("a\tb\r\nc\n") is None
    assert control_character("a\r\nb\nc\x1bd") == (3, "U+001B")
    assert control_character("a\x85b") == (1, "U+0085")


def test_a_modified_record_is_refused(tmp_path):
    path = tmp_path / "r.json"
    record = sealed({"schema": "x/1", "values": [0.1, None, "µ"], "n": 3})
    path.write_text(json.dumps(record, indent=3))
    assert read_record(path, "x/1", "") == {"schema": "x/1", "values": [0.1, None, "µ"], "n": 3}
    with pytest.raises(DataError, match="its schema is not y/1"):
        read_record(path, "y/1", "")
    path.write_text(json.dumps(record | {"n": 4}))
    with pytest.raises(DataError, match="changed or damaged since"):
        read_record(path, "x/1", "")
    path.write_text(json.dumps({k: v for k, v in record.items() if k != "checksum"}))
    with pytest.raises(DataError, match="changed or damaged since"):
        read_record(path, "x/1", "")
    path.write_text('{"schema":' * 3000)
    with pytest.raises(DataError, match="nested too deeply|not JSON"):
        read_record(path, "x/1", "")


def test_a_gzip_bomb_does_not_fill_the_memory(tmp_path, monkeypatch):
    from tirefit.data.readers import text

    monkeypatch.setattr(text, "DATA", 2**20)
    packed = zlib.compressobj(9, zlib.DEFLATED, 31)
    path = tmp_path / "bomb.csv.gz"
    path.write_bytes(packed.compress(b"1,2,3\n" * 2**20) + packed.flush())
    assert path.stat().st_size < 2**16
    with pytest.raises(DataError, match="more than"):
        KINDS["data.csv"].read(path)
