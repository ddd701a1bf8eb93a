"""Recognise files of tires by their content: fits, ``.tir`` files, other tire models."""

import re
from typing import Literal

from tirefit.data.tir.tir_file import INFOFILE
from tirefit.data.tir.tir_keys import COEFFICIENTS
from tirefit.names import MODEL_NAMES
from tirefit.results import DataError, InputProblem

TireKind = Literal["fit", "tir", ""]

_HEAD = 2**18  # bytes that are searched; the key that names the model stands in the first lines

_NOT_READ = ("521", "FIALA", "FTIRE", "PAC89", "PAC94", "PACMC", "PACTIME", "TMEASY")
"""PROPERTY_FILE_FORMAT, letters and digits, of tire models that are not read."""

_FORMAT = re.compile(r"(?mi)^[ \t]*PROPERTY_FILE_FORMAT[ \t]*=[ \t]*['\"]?([^'\"\r\n$!]*)")
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
    model = stated[1].strip() if stated else ""
    name = re.sub("[^A-Z0-9]", "", model.upper())
    is_read = name.startswith(("MF", "PAC", "USER")) or _COEFFICIENT.search(text)
    if not stated or not name or (is_read and name not in _NOT_READ):
        return []
    row = text.count("\n", 0, stated.start()) + 1
    reason = f"this is a tire of the model {model} (PROPERTY_FILE_FORMAT), which is not read"
    return [InputProblem(reason, _REMEDY, file, row)]
