"""Tire property files in common variants: read as other programs do, force by force."""

import re
from functools import cache
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

from tirefit.data.tir.tir import notes_on, parse_tir, read_tir
from tirefit.fitting.tir import own_tire
from tirefit.models import modelled
from tirefit.results import DataError

FOLDER = Path(__file__).parent / "tir"
FILES = sorted(FOLDER.glob("*/*.tir"))
MF52, MF61 = (FOLDER / f"mfeval_julia/MagicFormula{number}_Parameters.tir" for number in (52, 61))
VALUE = re.compile(r"(?m)^(\w+[ \t]*=[ \t]*)([-+]?[\d.]+(?:[eEdD][-+]?\d+)?)(?=[ \t\r$]|$)")


def text_of(path):
    return path.read_text(encoding="latin-1")


def tire(tir):
    """The tire of a file; 6.2 has the forces of 6.1."""
    return own_tire(tir.with_values({"FITTYP": 61}) if tir.version == "6.2" else tir)


published = cache(lambda path: tire(read_tir(path)))


def same(tir, path):
    """Whether a file has exactly the coefficients of a published one."""
    return bool(eqx.tree_equal(tire(tir), published(path)))


def shuffled(text, random):
    """Sections in another order, and the keys within each."""
    head, *sections = re.split(r"(?m)^(?=\[\w+\])", text)
    parts = []
    for k in random.permutation(len(sections)):
        header, *lines = sections[k].splitlines(keepends=True)
        if not re.match(r"\[(SHAPE|UNITS)", header):
            lines = [lines[i] for i in random.permutation(len(lines))]
        parts.append("".join([header, *(x if x.endswith("\n") else x + "\n" for x in lines)]))
    return head + "".join(parts)


def dropped(text, random):
    """The file without a third of the keys that no force uses."""
    unused = re.compile(r"(Q[TR]|PT|PECP|PDXP|PHYP|VERTICAL|BOTTOM|MASS|[A-Z]XLOW)")
    return "".join(
        line
        for line in text.splitlines(keepends=True)
        if not (unused.match(line) and random.random() < 0.3)
    )


def numbers_as(change):
    return lambda text, random: VALUE.sub(lambda m: m[1] + change(m[2]), text)


FORMS = {
    "no header": lambda text, random: text[text.index("[UNITS]") :],
    "shuffled": shuffled,
    "dropped": dropped,
    "D exponents": numbers_as(lambda x: f"{float(x):.17E}".replace("E", "D")),
    "lower-case keys": lambda text, random: re.sub(
        r"(?m)^(\w+)(?=\s*=)", lambda m: m[1].lower(), text
    ),
    "tabs": lambda text, random: re.sub(r"(?m) *= *", "\t=\t", text),
    "no marks": lambda text, random: re.sub(r"(?m)(?<=\d)(\s*)\$", r"\1  ", text),
    "other marks": lambda text, random: text.replace("$", "!"),
}
ENCODINGS = ("utf-8", "cp1252", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_form_of_a_published_file_gives_the_same_tire(path, tmp_path):
    """Each variant alone and up to four together, in any encoding and line end."""
    random = np.random.default_rng(2024)
    chosen = [(name,) for name in FORMS]
    chosen += [tuple(random.choice(list(FORMS), 4, replace=False)) for _ in range(12)]
    for names in chosen:
        text = text_of(path).replace("\r\n", "\n")
        for name in sorted(names, key=list(FORMS).index):
            text = FORMS[name](text, random)
        text = text.replace("[UNITS]", "! \N{EN DASH} \N{DEGREE SIGN}C\n[UNITS]")
        encoding = str(random.choice(ENCODINGS))
        end = str(random.choice(["\n", "\r\n", "\r"]))
        (tmp_path / "x.tir").write_bytes(text.replace("\n", end).encode(encoding))
        tir = read_tir(tmp_path / "x.tir")
        assert same(tir, path), (names, encoding, end)


FORCE_KEYS = {"fx": "PCX1 PDX1 PKX1", "fy": "PCY1 PDY1 PKY1", "mz": "QBZ1 QCZ1 QDZ1"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_missing_key_removes_only_its_force(path):
    for force, keys in FORCE_KEYS.items():
        for k, key in enumerate(keys.split()):
            # Without its line, or with an empty one.
            instead = f"{key} = $empty\n" if k == 1 else ""
            tir = parse_tir(re.sub(rf"(?m)^{key} .*\n", instead, text_of(path)))
            lost = {"fy": ("fy", "mz")}.get(force, (force,))
            assert own_tire(tir).lacks == lost
            assert f"{key} is missing" in " ".join(notes_on(tir))
            assert same(tir.with_values({key: read_tir(path).numbers[key]}), path)


@pytest.mark.parametrize(
    ("lost", "given", "mode"),
    [
        ("LONGITUDINAL ALIGNING", ("fy",), 2),
        ("LATERAL ALIGNING", ("fx",), 1),
        ("ALIGNING", ("fx", "fy"), 4),
        ("LONGITUDINAL", ("fy", "mz"), 12),
    ],
)
def test_whole_blocks_may_be_missing(lost, given, mode):
    text = re.sub(r"(?m)^USE_MODE.*", f"USE_MODE = {mode}", text_of(MF52))
    for name in lost.split():
        text = re.sub(rf"(?ms)^\[{name}_COEFF.*?(?=^\[|\Z)", "", text)
    tir = parse_tir(text)
    assert tuple(f for f in modelled(own_tire(tir)) if f in FORCE_KEYS) == given
    said = " ".join(notes_on(tir))
    assert said.count("its coefficients are missing") == len(lost.split())
    assert "USE_MODE" not in said
    with pytest.raises(DataError, match="no force is described"):
        parse_tir(re.sub(r"(?ms)^\[\w+_COEFF.*?(?=^\[|\Z)", "", text))


@pytest.mark.parametrize(
    ("edits", "version", "because"),
    [
        (["FITTYP = 'MF52'"], "5.2", "FITTYP = 'MF52'"),
        (["FITTYP = 6.1"], "6.1", "FITTYP = 6.1"),
        (["PROPERTY_FILE_FORMAT = 'PAC2002'"], "5.2", "FORMAT = 'PAC2002'"),
        (["PROPERTY_FILE_FORMAT = 'MF_05'"], "5.2", "FORMAT = 'MF_05'"),
        (["PROPERTY_FILE_FORMAT = 'MF-Tyre 6.2'"], "6.2", "FORMAT = 'MF-Tyre 6.2'"),
        (["PROPERTY_FILE_FORMAT = 'MF61'", "PKY6 = -2"], "6.1", "'MF61'"),
    ],
)
def test_the_version_is_found_from_the_file(edits, version, because):
    text = re.sub(r"(?m)^(FITTYP|PROPERTY_FILE_FORMAT|PHY3|LGA[XYZ]) .*\n", "", text_of(MF52))
    tir = parse_tir(text.replace("[MODEL]\n", "\n".join(["[MODEL]", *edits, ""])))
    assert tir.version == version
    (said,) = [note for note in notes_on(tir) if "taken as Magic Formula" in note]
    assert f"Formula {version}: " in said and because in said
    if not any("FITTYP = " in edit for edit in edits):
        assert "no FITTYP" in said


@pytest.mark.parametrize("edits", [[], ["FITTYP ="], ["PROPERTY_FILE_FORMAT = 'MF-TYRE'"]])
def test_a_file_without_a_version_is_refused(edits):
    text = re.sub(r"(?m)^(FITTYP|PROPERTY_FILE_FORMAT) .*\n", "", text_of(MF61))
    with pytest.raises(DataError, match="neither FITTYP nor PROPERTY.*\n.*write FITTYP to .MODEL"):
        parse_tir(text.replace("[MODEL]\n", "\n".join(["[MODEL]", *edits, ""])))


def test_keys_of_another_version_are_reported_once_and_ignored():
    text = re.sub(r"(?m)^FITTYP.*\n", "FITTYP = 6\n", text_of(MF61))
    tir = parse_tir(text)
    (said,) = [note for note in notes_on(tir) if "MF 5.2 has no" in note]
    assert re.search(r"and \d+ more", said) and "changes the tire" in said
    lost = read_tir(MF61).numbers.keys() - tir.numbers.keys()
    assert {"PPX1", "PKY6", "RBY4"} <= lost and "PHY1" not in lost
    # A factor of one or a zero has no effect, and no note.
    quiet = parse_tir(re.sub(r"(?m)^LGAX .*", "LGAX = 1\nLKYC = 1\nPPX1 = 0", text_of(MF52)))
    assert not any("has no" in note for note in notes_on(quiet))


def test_alternative_keys_and_limits_in_degrees_are_read():
    text = text_of(MF52).replace("LFZO ", "LFZ0 ")
    text = re.sub(r"(?m)^(LFZ0 +=).*", r"\1 0.8", text)
    assert parse_tir(text).numbers["LFZO"] == 0.8
    text = re.sub(r"(?m)^ANGLE .*", "ANGLE = 'degrees'", text_of(MF61))
    tir = parse_tir(re.sub(r"(?m)^ALPMAX .*", "ALPMAX = 18", text))
    np.testing.assert_allclose(tir.numbers["ALPMAX"], np.pi / 10)
    assert tir.numbers["PKY1"] == read_tir(MF61).numbers["PKY1"]  # per radian in every file
