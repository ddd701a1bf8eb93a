"""Check the sizes in a MATLAB file of version 5 before SciPy reads it.

SciPy trusts the sizes and dimensions that a file states; a damaged file can crash the
process. The layout is that of MathWorks, *MAT-File Format*, chapter 1.
"""

import math
import struct
import zlib
from collections.abc import Sequence
from typing import NamedTuple

_MATRIX, _COMPRESSED = 14, 15
_SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
"""Type of the numbers of an element -> bytes of a number."""

_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_NUMBERS = range(6, 16)
_DEEPEST, _LARGEST = 32, 2**30


class _Element(NamedTuple):
    kind: int
    content: bytes


def _refuse(is_damaged: object, reason: str) -> None:
    if is_damaged:
        raise ValueError(reason)


def check_sound(content: bytes) -> None:
    """Checks all sizes of a file of version 5.

    Raises:
        ValueError: a size leaves the file, or does not fit its dimensions.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128], "")
    _refuse(not order, "its header is damaged")
    for kind, inside in _elements(content[128:], order):
        if kind == _COMPRESSED:
            unpack = zlib.decompressobj()
            inside = unpack.decompress(inside, _LARGEST)
            _refuse(not unpack.eof, "a compressed variable is cut short")
            (kind, inside), *_ = _elements(inside, order)
        _refuse(kind != _MATRIX, f"an element of kind {kind} where a variable is expected")
        _check_matrix(inside, order, _DEEPEST)


def _elements(content: bytes, order: str) -> list[_Element]:
    """The consecutive elements in a part of the file."""
    elements = []
    at = 0
    while at < len(content):
        _refuse(at + 8 > len(content), "it is cut short")
        kind, size = struct.unpack_from(f"{order}II", content, at)
        start = at + 8
        if kind >> 16:  # a small element: size and kind in four bytes
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
            at += 8
            _refuse(size > 4, "a small element is too large")
        else:
            at = start + (size if kind == _COMPRESSED else -(-size // 8) * 8)
        _refuse(start + size > len(content), "a size leaves the file")
        elements.append(_Element(kind, content[start : start + size]))
    return elements


def _check_matrix(content: bytes, order: str, deepest: int) -> None:
    if not content:
        return
    _refuse(not deepest, "structs are nested too deeply")
    flags, *parts = _elements(content, order)
    _refuse(len(flags.content) < 4 or flags.kind != 6, "a variable has no class")
    word = struct.unpack_from(f"{order}I", flags.content)[0]
    kind, is_complex = word & 0xFF, bool(word & 0x800)
    if kind in (_OPAQUE, _FUNCTION):
        for part in parts:
            if part.kind == _MATRIX:
                _check_matrix(part.content, order, deepest - 1)
        return
    named = len(parts) > 1 and parts[0].kind == 5 and parts[1].kind in (1, 2)
    _refuse(not named, "a variable has no dimensions or no name")
    dimensions = _numbers(parts[0], order)
    is_wrong = len(dimensions) < 2 or min(dimensions) < 0
    _refuse(is_wrong, f"a variable has the dimensions {dimensions}")
    count, parts = math.prod(dimensions), parts[2:]
    if kind in _NUMBERS or kind == _CHAR:
        _check_numbers(parts, count, is_complex, kind == _CHAR)
    elif kind in (_CELL, _STRUCT, _OBJECT):
        if kind != _CELL:
            count, parts = _fields(parts, count, kind == _OBJECT, order)
        is_wrong = len(parts) != count or any(part.kind != _MATRIX for part in parts)
        _refuse(is_wrong, f"{len(parts)} values where there should be {count}")
        for part in parts:
            _check_matrix(part.content, order, deepest - 1)
    elif kind == _SPARSE:
        _check_sparse(parts, dimensions, order)
    else:
        raise ValueError(f"a variable has the unknown class {kind}")


def _numbers(part: _Element, order: str) -> tuple[int, ...]:
    _refuse(len(part.content) % 4, "a list of whole numbers is cut short")
    return struct.unpack(f"{order}{len(part.content) // 4}i", part.content)


def _check_numbers(parts: Sequence[_Element], count: int, is_complex: bool, is_text: bool) -> None:
    """Check that the number of values fits the dimensions; UTF-8 may have more bytes."""
    _refuse(len(parts) != 1 + is_complex, "a variable has no values")
    for part in parts:
        _refuse(part.kind not in _SIZES, f"values of the unknown kind {part.kind}")
        there, rest = divmod(len(part.content), _SIZES[part.kind])
        is_wrong = rest or there < count or (there > count and not is_text)
        _refuse(is_wrong, f"{there} values where there should be {count}")


def _check_sparse(parts: Sequence[_Element], dimensions: tuple[int, ...], order: str) -> None:
    """Check the row indices of a sparse matrix, and the beginning of each column."""
    _refuse(len(parts) < 3, "a sparse matrix has no values")
    rows, starts = (_numbers(part, order) for part in parts[:2])
    inside = all(0 <= row < dimensions[0] for row in rows)
    in_order = len(starts) == dimensions[1] + 1 and list(starts) == sorted(starts)
    inside = inside and in_order and 0 <= starts[0] and starts[-1] <= len(rows)
    _refuse(not inside, "a sparse matrix has places outside of it")


def _fields(
    parts: list[_Element], count: int, is_object: bool, order: str
) -> tuple[int, list[_Element]]:
    """The number of values that the fields of a struct must have, and its values."""
    parts = parts[1:] if is_object else parts
    _refuse(len(parts) < 2, "a struct has no fields")
    (length,), names = _numbers(parts[0], order)[:1] or (0,), parts[1].content
    _refuse(length <= 0 or len(names) % length, "a struct has damaged names of fields")
    return count * (len(names) // length), parts[2:]
