"""Recognise files of tires by their content: fits, ``.tir`` files, other tire models.

A tire of a model that is not read gets an error that names the model, instead of the
errors of the reader that would fail on it.
"""

import re
from typing import Literal

from tirefit.data.tir.tir_file import INFOFILE
from tirefit.data.tir.tir_keys import COEFFICIENTS
from tirefit.names import MODEL_NAMES
from tirefit.results import DataError, InputProblem

TireKind = Literal["fit", "tir", ""]

_HEAD = 2**18  # bytes that are searched; the key that names the model stands in the first lines

_FORMATS = {
    "FIALA": "Fiala",
    "521": "5.2.1",
    "PAC89": "Pacejka '89",
    "PAC94": "Pacejka '94",
    "PACMC": "PAC_MC (motorcycle)",
    "PACTIME": "PAC-TIME",
    "FTIRE": "FTire",
    "TMEASY": "TMeasy",
}
"""PROPERTY_FILE_FORMAT of tire models that are not read, letters and digits -> the model."""

_FORMAT = re.compile(r"(?mi)^[ \t]*PROPERTY_FILE_FORMAT[ \t]*=[ \t]*['\"]?([^'\"\r\n$!]*)")
_FTIRE = re.compile(r"(?mi)^[ \t]*\[FTIRE_\w+\]")
_ASSETTO = re.compile(r"(?m)^[ \t]*\[(FRONT|REAR)(_\d+)?\](?=[\s\S]*^[ \t]*(DY0|DY_REF)[ \t]*=)")
_CHRONO = re.compile(r"\"Type\"\s*:\s*\"Tire\"")
_TEMPLATE = re.compile(r"\"Template\"\s*:\s*\"(\w+)\"")
_COEFFICIENT = re.compile(
    rf"(?mi)^[ \t]*(\w+\.)*({'|'.join(k for k in COEFFICIENTS if k[0] in 'PQR')})[ \t]*="
)
_SECTION = re.compile(r"(?mi)^[ \t]*\[(MDI_HEADER|\w+_COEFFICIENTS)\]")

_REMEDY = (
    "give a Magic Formula 5.2, 6.1 or 6.2 (.tir), or compute a table of slip, load and force"
    " with the program of this tire and fit that"
)


def tire_kind(source: str) -> TireKind:
    """The kind of tire file that a text names: ``fit`` (JSON), ``tir``, or "" for neither.

    Args:
        source: path of a file, or the name of a model.

    Returns:
        The kind by the content, or by the ending of the name if the file does not exist; "" for
        the name of a model, and for a file of another kind.

    Raises:
        DataError: the file describes a tire of a model that is not read.
    """
    ending = source.lower().rpartition(".")[2]
    named: TireKind = "fit" if ending == "json" else "tir" if ending == "tir" else ""
    if source in MODEL_NAMES:
        return ""
    try:
        with open(source, "rb") as file:
            head = file.read(_HEAD)
    except (OSError, ValueError):  # ValueError: a NUL in the path
        return named
    # UTF-16 without its NULs has the same ASCII words.
    text = head.decode("latin-1").replace("\0", "")
    DataError.raise_for(other_tire(text, source))
    if named or not text.strip():
        return named
    if text.lstrip("\ufeff\u00ef\u00bb\u00bf \t\r\n").startswith("{"):
        return "fit"
    return "tir" if describes_tir(text) else ""


def describes_tir(text: str) -> bool:
    """Whether a text is a ``.tir`` file, or an infofile of CarMaker with its coefficients."""
    return any(mark.search(text) for mark in (_SECTION, INFOFILE, _COEFFICIENT))


def other_tire(text: str, file: str) -> list[InputProblem]:
    """The problem that a text describes a tire of a model that is not read; else empty."""
    stated = _FORMAT.search(text)
    name = re.sub("[^A-Z0-9]", "", stated[1].upper()) if stated else "MF"  # one that is read
    other = not name.startswith(("MF", "PAC", "USER")) and not _COEFFICIENT.search(text)
    if (mark := stated) and (name in _FORMATS or (other and mark[1].strip())):
        model = _FORMATS.get(name, mark[1].strip())
        reason = f"a tire of the model {model} (PROPERTY_FILE_FORMAT = {mark[1].strip()!r})"
    elif mark := _FTIRE.search(text):
        reason = f"a tire of the model FTire (section {mark[0].strip()})"
    elif mark := _ASSETTO.search(text):
        reason = "a tyres.ini of Assetto Corsa"
    elif mark := _CHRONO.search(text):
        template = _TEMPLATE.search(text)
        reason = f"a tire of Chrono ({template[1] if template else 'without template'})"
    elif (mark := INFOFILE.search(text)) and not _COEFFICIENT.search(text):
        reason = f"a CarMaker infofile of the model {mark[1]}, without Magic Formula"
    else:
        return []
    row = text.count("\n", 0, mark.start()) + 1
    remedy = "give the .tir file that it names in place of it" if "Pac02" in reason else _REMEDY
    return [InputProblem(f"this is {reason}, which tirefit does not read", remedy, file, row)]
