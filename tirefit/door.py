"""Read every file within limits of size, nesting and numbers; checksums of own files.

Content read here is safe to parse and check further. Files that this package writes
itself contain a checksum, which detects a single flipped bit.
"""

import hashlib
import json
import math
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from tirefit.results import DataError, InputProblem, TirefitError, UsageError

MIB = 2**20
SETTINGS, TIRE, RECORD, DATA = (1 * MIB, 8 * MIB, 256 * MIB, 1024 * MIB)
"""Largest sizes: settings, ``.tir``, JSON, data (also when unpacked)."""

COLUMNS = 20_000
"""Most columns of a table; recordings of whole cars have some thousands."""

JSON_GAP = rb"(?:\xef\xbb\xbf)?+(?:\s++|//[^\r\n]*+|#[^\r\n]*+|/\*(?s:.*?)\*/)*+"
"""Space and comments before a part of a JSON text; JSON that tirefit wrote has no comments."""

_DEEPEST = 16  # most levels of nested tables and lists; valid files have up to 6

_LARGEST, _SMALLEST = 1e20, 1e-20
"""Limits of numbers in settings; beyond them, squares and products could overflow."""

_SEAL = "checksum"


def too_large(
    path: str | os.PathLike[str], most: int, error: type[TirefitError] = DataError
) -> TirefitError:
    """The error for a file of more than ``most`` bytes."""
    reason = f"it holds more than {most // MIB} MiB"
    return error(InputProblem(reason, "split or thin it", str(path)))


def content_of(
    path: str | Path, most: int, error: type[TirefitError] = DataError, remedy: str = ""
) -> bytes:
    """The content of a file of at most ``most`` bytes.

    Raises:
        ``error``: the file cannot be read, or is larger.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError) as fault:  # ValueError: a NUL in the path
        cause = getattr(fault, "strerror", None) or fault
        problem = InputProblem(f"cannot read it: {cause}", remedy, str(path))
        raise error(problem) from None
    if len(content) > most:
        raise too_large(path, most, error)
    return content


def replaced_inputs(
    made: Iterable[str | Path], read: Mapping[str, Iterable[object]]
) -> list[InputProblem]:
    """A problem for each file to write that is an input, also by a link or another name.

    Args:
        made: the files to write.
        read: option or argument -> the files that it names, among other things.
    """
    known: dict[tuple[int, int] | None, str] = {}
    for option, given in read.items():
        for file in given:
            if isinstance(file, str | Path) and (there := _identity(file)):
                known.setdefault(there, option)
    problems = []
    for path in made:
        there = _identity(path)
        if there in known:
            of = f" ({known[there]})" if known[there] else ""
            reason = f"it is an input file{of}, which would be replaced"
            problems.append(InputProblem(reason, "choose another --out", str(path)))
    return problems


def _identity(path: str | Path) -> tuple[int, int] | None:
    """Device and inode of a file, the same for all of its names; None if it does not exist."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):  # ValueError: a NUL in the path
        return None
    return status.st_dev, status.st_ino


def control_character(text: str) -> tuple[int, str] | None:
    """Row and name of the first control character that is invalid in text, or None."""
    match = re.search(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029]", text)
    if match is None:
        return None
    row = len(re.findall(r"\r\n?|\n", text[: match.start()])) + 1
    return row, f"U+{ord(match.group()):04X}"


def outrageous(
    content: Any, smallest: float = _SMALLEST, largest: float = _LARGEST
) -> tuple[str, str] | None:
    """Key and reason of the first value of parsed settings beyond the limits, or None.

    Args:
        content: nested tables and lists.
        smallest, largest: limits of the size of numbers; 0 and infinity are not checked.
    """
    waiting: list[tuple[str, Any, int]] = [("", content, 0)]
    while waiting:
        key, value, depth = waiting.pop()
        if depth > _DEEPEST:
            return key[:40], f"tables and lists are nested more than {_DEEPEST} deep"
        if isinstance(value, dict):
            start = f"{key}." if key else ""
            waiting += [(f"{start}{k}"[:80], v, depth + 1) for k, v in value.items()]
        elif isinstance(value, list):
            waiting += [(key, item, depth + 1) for item in value]
        elif isinstance(value, int | float):
            size = abs(value)
            if largest < size < math.inf:
                return key, f"a number above {largest:g}"
            if 0 < size < smallest:
                return key, f"a number closer to 0 than {smallest:g}"
    return None


def read_toml(path: str | Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        UsageError: no such file, too large, not TOML, nested too deeply, or with
            numbers out of the limits.
    """
    raw = content_of(path, SETTINGS, UsageError, "check the path")
    try:
        # Editors on Windows may write a byte-order mark before the first key.
        content = tomllib.loads(raw.decode("utf-8-sig"))
    except RecursionError:
        reason = "not valid TOML: brackets are nested too deeply"
    except ValueError as error:  # of TOML, of UTF-8, of a number of 5,000 digits
        reason = f"not valid TOML: {str(error)[:200]}"
    else:
        odd = outrageous(content)
        if odd is None:
            return content
        reason = f"{odd[0]}: {odd[1]}"
    is_other = Path(path).suffix.lower() not in (".toml", "")
    remedy = "give a TOML file of settings here" if is_other else "correct the file"
    raise UsageError(reason, remedy, str(path))


# --- our own files --------------------------------------------------------------


def _digest(content: dict[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def sealed(content: dict[str, Any]) -> dict[str, Any]:
    """A JSON-able record with its checksum added."""
    bare = {key: value for key, value in content.items() if key != _SEAL}
    return bare | {_SEAL: _digest(bare)}


def read_record(path: str | Path, schema: str, remedy: str) -> dict[str, Any]:
    """The content of a JSON file with a checksum by :func:`sealed`.

    Raises:
        DataError: no such file, not JSON, another schema, or a wrong checksum.
    """

    def refused(reason: str) -> DataError:
        return DataError(reason, remedy, str(path))

    raw = content_of(path, RECORD, DataError, remedy)
    try:
        content = json.loads(raw.decode("utf-8"))
    except RecursionError:
        raise refused("not JSON that tirefit wrote: it is nested too deeply") from None
    except ValueError as error:
        is_json = re.match(JSON_GAP + rb"[{\[]", raw) is not None
        what = "JSON with comments or a fault" if is_json else "not JSON"
        raise refused(f"{what}, which tirefit did not write: {str(error)[:200]}") from None
    if not isinstance(content, dict) or content.get("schema") != schema:
        raise refused(f"its schema is not {schema}")
    if outrageous(content, 0.0, math.inf):
        raise refused("it was changed or damaged since it was written")
    seal = content.pop(_SEAL, None)
    if seal != _digest(content):
        raise refused("its checksum is wrong: it was changed or damaged since it was written")
    return content


UNSEALED = "checksum 0000000000000000"
"""Placeholder of the checksum in a text, see :func:`sealed_text`."""


def sealed_text(text: str) -> str:
    """The text with its checksum at every :data:`UNSEALED`."""
    return text.replace(UNSEALED, f"checksum {hashlib.sha256(text.encode()).hexdigest()[:16]}")


def unsealed(path: Path, remedy: str) -> list[InputProblem]:
    """A problem if there is a file that :func:`sealed_text` did not make, or that was
    changed since."""
    if not path.exists():
        return []
    with suppress(DataError, UnicodeError):
        text = content_of(path, RECORD).decode()
        bare = re.sub("checksum [0-9a-f]{16}", UNSEALED, text)
        if bare != text and sealed_text(bare) == text:
            return []
    reason = "the file exists and is not an export, or was changed since"
    return [InputProblem(reason, remedy, str(path))]
