"""Read MATLAB files as tables: version 5 to 7 by SciPy, version 7.3 (HDF5) by h5py.

Columns are vectors of the same length: variables, fields of a struct (nested or not),
the columns of a matrix with a cell array of their names, or a struct with ``Time``,
``Value`` and ``Units`` for each channel, as data loggers export them. Units come from
those, from a struct ``channel`` with ``name`` and ``units`` (Tire Test Consortium), or
from a struct ``units`` with a text for each column.
"""

import io
import math
import struct as packing
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.readers.extras import readable
from tirefit.results import DataError

MAT = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"  # first bytes of a file

_HOW_TO_SAVE = (
    "save its columns as vectors: S = table2struct(T, 'ToScalar', true);"
    " save('file.mat', '-struct', 'S') (of a timetable: T = timetable2table(TT) first)"
)


class Channels(NamedTuple):
    """Columns of a file that has no lines."""

    columns: dict[str, Any]  # name -> (n,) numbers or n texts
    units: dict[str, str]  # stated units, by name
    notes: tuple[str, ...]  # assumptions, and what was left out
    epoch: float = 0.0  # the file's time [s] where its column ``time`` is 0


class _Opaque(NamedTuple):
    """An object of a MATLAB class, which no other program can read."""

    kind: str


def channels_of_mat(content: bytes, file: str, is_known: Callable[[str], bool]) -> Channels:
    """The columns of a MATLAB file.

    Args:
        content: bytes of the file.
        file: named in the problems.
        is_known: whether a name is that of a known column; the struct with most of them is read.

    Raises:
        DataError: the file is damaged, has no vectors, or has several structs with as
            many known columns.
    """
    is_hdf5 = content.startswith(MAT[1])
    contents: dict[str, Any] = {}
    remedy = "save it again, or as version 7: save('file.mat', ..., '-v7')"
    with readable("MATLAB file", file, remedy):
        if is_hdf5:
            import h5py  # 0.1 s

            with h5py.File(io.BytesIO(content), "r") as hdf5:
                named = [(key, item) for key, item in hdf5.items() if not key.startswith("#")]
                contents = {key: _of_item(item, hdf5) for key, item in named}
        else:
            contents = _of_v5(content)
    place, channels = _best(contents, file, is_known)
    units: dict[str, str] = {}  # of a struct ``channel`` or ``units``
    for name, struct in _structs(contents):
        folded = {key.casefold(): value for key, value in struct.items()}
        if name.split(".")[-1].casefold() == "units":
            units |= {n: text for n, text in struct.items() if isinstance(text, str)}
        names, texts = folded.get("name"), folded.get("units")
        if isinstance(names, list) and isinstance(texts, list):
            if len(names) == len(texts) and _are_texts(names + texts):
                units |= dict(zip(names, texts, strict=True))
    version = "7.3" if is_hdf5 else "5"
    where = f", struct {place!r}" if place else ""
    notes = (f"read as a MATLAB file of version {version}{where}", *channels.notes)
    return channels._replace(units=units | channels.units, notes=notes)


# --- the two formats, as plain values ----------------------------------------------


def _of_v5(content: bytes) -> dict[str, Any]:
    from scipy.io import loadmat

    _check_sound(content)
    with warnings.catch_warnings():  # of objects, which are refused by name below
        warnings.simplefilter("ignore")
        raw = loadmat(io.BytesIO(content), chars_as_strings=True)
    contents = {}
    for key, value in raw.items():
        if type(value).__name__ == "MatlabOpaque":  # the name of a variable with an object
            key = value.reshape(-1)[0]["s0"].decode()
        if key[:2] != "__":
            contents[key] = _plain(value)
    return contents


def _plain(value: Any) -> Any:
    """A value from SciPy as array, text, list (cell, struct array) or dict (struct)."""
    kind = type(value).__name__
    if kind in ("MatlabOpaque", "MatlabFunction"):
        inside = value.reshape(-1)[0]
        return _Opaque(inside["s2"].decode() if value.dtype.names else "function")
    if not isinstance(value, np.ndarray):
        return value
    if value.dtype.names:
        names = value.dtype.names
        items = [{name: _plain(item[name]) for name in names} for item in value.reshape(-1)]
        return items[0] if len(items) == 1 else items
    if value.dtype.kind == "O":
        return [_plain(element) for element in value.reshape(-1)]
    if value.dtype.kind == "U":
        texts = [str(text).rstrip() for text in value.reshape(-1)]
        return texts[0] if len(texts) == 1 else texts
    return value


def _of_item(item: Any, file: Any) -> Any:
    """A variable of version 7.3 in the form of :func:`_plain`; arrays are transposed."""
    kind = item.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    if hasattr(item, "items"):
        return {key: _of_item(part, file) for key, part in item.items()}
    if "MATLAB_object_decode" in item.attrs and kind not in ("char", "logical"):
        return _Opaque(kind)
    if "MATLAB_empty" in item.attrs:
        return np.empty(0)
    values = item[()]
    if values.dtype == object:  # of references
        return [_of_item(file[ref], file) for ref in values.T.reshape(-1)]
    if kind == "char":
        rows = ["".join(map(chr, row)).rstrip() for row in np.atleast_2d(values.T)]
        return rows[0] if len(rows) == 1 else rows
    return values.T


# --- find the columns -----------------------------------------------------------------


def _best(
    contents: Mapping[str, Any], file: str, is_known: Callable[[str], bool]
) -> tuple[str, Channels]:
    """The struct ("" for the variables) with the most known columns, and its columns."""
    read = {
        place: channels
        for place, struct in _structs(contents)
        if (channels := _channels(struct, is_known)).columns
    }
    scores = {place: sum(map(is_known, read[place].columns)) for place in read}
    best = [place for place in scores if scores[place] == max(scores.values())]
    if not best:
        listed = ", ".join(f"{name!r} ({_described(value)})" for name, value in contents.items())
        reason = f"no columns in this MATLAB file: {listed or 'it is empty'}"
        objects = [(n, value.kind) for n, value in contents.items() if isinstance(value, _Opaque)]
        if objects:
            kinds = ", ".join(f"{name!r} is a {kind}" for name, kind in objects)
            reason = f"{kinds}, which only MATLAB can read"
        raise DataError(reason, _HOW_TO_SAVE, file)
    if len(best) > 1 and scores[best[0]] and best[0]:
        listed = ", ".join(map(repr, best))
        reason = f"several structs hold columns that are known: {listed}"
        remedy = "save each to a file of its own: save('one.mat', '-struct', 'one')"
        raise DataError(reason, remedy, file)
    others = [*best[1:], *(place for place in read if place not in best)]
    listed = ", ".join(repr(place) for place in others if place not in ("", "channel"))
    notes = [f"structs not read: {listed}"] if listed else []
    channels = read[best[0]]
    return best[0], channels._replace(notes=(*channels.notes, *notes))


def _structs(
    contents: Mapping[str, Any], place: str = ""
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    yield place, contents
    for name, value in contents.items():
        if isinstance(value, dict):
            yield from _structs(value, f"{place}.{name}" if place else name)


def _channels(struct: Mapping[str, Any], is_known: Callable[[str], bool]) -> Channels:
    """Columns of one struct, of the length that most of the known columns have."""
    logged = _logged(struct)
    if logged is not None:
        return logged
    columns: dict[str, Any] = {}
    for name, value in struct.items():
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            flat = value.reshape(-1)
            if value.size == max(value.shape, default=0) and value.size > 1:
                columns[name] = flat.astype(float) if flat.dtype.kind == "b" else flat
        elif isinstance(value, list) and len(value) > 1 and _are_texts(value):
            columns[name] = value
    numbers = [k for k in columns if isinstance(columns[k], np.ndarray)]
    if not numbers:
        numbers = list(columns := _of_matrix(struct))
    weights = Counter[int]()
    for name in numbers:
        weights[len(columns[name])] += 1 + 1000 * is_known(name)
    length = max(weights, key=weights.__getitem__, default=0)
    kept = {name: values for name, values in columns.items() if len(values) == length}
    return Channels(kept if numbers else {}, {}, tuple(_left_out(struct, kept)))


def _are_texts(values: list[object]) -> bool:
    return all(isinstance(value, str) for value in values)


def _of_matrix(struct: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of the only matrix with a list of as many names."""
    names = [v for v in struct.values() if isinstance(v, list) and _are_texts(v)]
    inner = struct.get("channel")
    if isinstance(inner, dict) and isinstance(inner.get("name"), list):
        names.append(inner["name"])
    for value in struct.values():
        if isinstance(value, np.ndarray) and value.ndim == 2 and value.shape[0] > 1:
            for headers in names:
                if len(set(headers)) == len(headers) == value.shape[1] > 1:
                    return dict(zip(headers, value.T, strict=True))
    return {}


def _logged(struct: Mapping[str, Any]) -> Channels | None:
    """Channels that are structs with Time, Value and Units; None if they are not."""
    parts: dict[str, dict[str, Any]] = {}
    for name, value in struct.items():
        if isinstance(value, dict):
            folded = {key.casefold(): part for key, part in value.items()}
            if {"time", "value"} <= folded.keys():
                parts[name] = folded
    if len(parts) < 2:
        return None
    times = {name: np.ravel(part["time"]) for name, part in parts.items()}
    clock = Counter(time.tobytes() for time in times.values()).most_common(1)[0][0]
    kept = [name for name in parts if times[name].tobytes() == clock]
    columns = {"Time": times[kept[0]]}
    columns |= {name: np.ravel(parts[name]["value"]) for name in kept}
    units = {name: parts[name].get("units", "") for name in kept}
    texts = {name: unit for name, unit in units.items() if isinstance(unit, str)}
    notes = ["each channel a struct with Time and Value"]
    if others := ", ".join(repr(name) for name in parts if name not in kept):
        notes.append(f"channels not read, sampled at other times: {others}")
    return Channels(columns, {"Time": "s"} | texts, tuple(notes))


def _left_out(struct: Mapping[str, Any], kept: Collection[str]) -> list[str]:
    """Notes on the other content of a struct; texts in full."""
    others = {n: value for n, value in struct.items() if n not in kept}
    texts = [f"{n} = {value!r}" for n, value in others.items() if isinstance(value, str)]
    left = (f"{n!r} ({_described(x)})" for n, x in others.items() if not isinstance(x, dict | str))
    listed = ", ".join(left)
    return [*texts, *([f"variables not read: {listed}"] if listed else [])]


def _described(value: Any) -> str:
    if isinstance(value, _Opaque):
        return f"MATLAB {value.kind}"
    if isinstance(value, np.ndarray):
        return " x ".join(map(str, value.shape))
    if hasattr(value, "nnz"):
        return "sparse matrix"
    return "text" if isinstance(value, str) else f"{type(value).__name__} of {len(value)}"


# --- the sizes in a file of version 5 ------------------------------------------------

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


def _check_sound(content: bytes) -> None:
    """Raises ValueError if a size of a file of version 5 leaves the file, or does not fit its
    dimensions: SciPy trusts them, and a damaged file can crash the process. The layout is that of
    MathWorks, *MAT-File Format*, chapter 1."""
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
        kind, size = packing.unpack_from(f"{order}II", content, at)
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
    word = packing.unpack_from(f"{order}I", flags.content)[0]
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
    return packing.unpack(f"{order}{len(part.content) // 4}i", part.content)


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
