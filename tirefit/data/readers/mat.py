"""Read MATLAB files as tables: version 5 to 7 by SciPy, version 7.3 (HDF5) by h5py.

Columns are vectors of the same length: variables, fields of a struct (nested or not),
the columns of a matrix with a cell array of their names, or a struct with ``Time``,
``Value`` and ``Units`` for each channel, as data loggers export them. Units come from
those, from a struct ``channel`` with ``name`` and ``units`` (Tire Test Consortium), or
from a struct ``units`` with a text for each column.
"""

import io
import struct as packing
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.columns import IsKnown
from tirefit.data.readers.extras import readable
from tirefit.door import DATA
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


def channels_of_mat(content: bytes, file: str, is_known: IsKnown) -> Channels:
    """The columns of the struct of a MATLAB file with the most known ones.

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

    _check_sizes(content[128:], {b"IM": "<", b"MI": ">"}.get(content[126:128], ""))
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


def _best(contents: Mapping[str, Any], file: str, is_known: IsKnown) -> tuple[str, Channels]:
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
        raise DataError(reason, _HOW_TO_SAVE, file)
    if len(best) > 1 and scores[best[0]] and best[0]:
        listed = ", ".join(map(repr, best))
        reason = f"several structs hold columns that are known: {listed}"
        remedy = "save each to a file of its own: save('one.mat', '-struct', 'one')"
        raise DataError(reason, remedy, file)
    others = [*best[1:], *(place for place in read if place not in best)]
    listed = ", ".join(repr(place) for place in others if place not in ("", "channel"))
    notes = (f"structs not read: {listed}",) if listed else ()
    return best[0], read[best[0]]._replace(notes=(*read[best[0]].notes, *notes))


def _structs(
    contents: Mapping[str, Any], place: str = ""
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    yield place, contents
    for name, value in contents.items():
        if isinstance(value, dict):
            yield from _structs(value, f"{place}.{name}" if place else name)


def _channels(struct: Mapping[str, Any], is_known: IsKnown) -> Channels:
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
    others = {n: x for n, x in struct.items() if n not in kept and not isinstance(x, dict)}
    listed = ", ".join(f"{name!r} ({_described(value)})" for name, value in others.items())
    notes = (f"variables not read: {listed}",) if listed else ()
    return Channels(kept if numbers else {}, {}, notes)


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


def _described(value: Any) -> str:
    if isinstance(value, _Opaque):
        return f"MATLAB {value.kind}"
    if hasattr(value, "shape"):
        return " x ".join(map(str, value.shape))
    return repr(value) if isinstance(value, str) else f"{type(value).__name__} of {len(value)}"


# --- the sizes in a file of version 5 ------------------------------------------------

_MATRIX, _COMPRESSED = 14, 15
_OF_NUMBERS = (1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18)  # other types of elements
_DEEPEST = 32  # structs in structs


def _check_sizes(content: bytes, order: str, deepest: int = _DEEPEST) -> None:
    """Raises ValueError if an element of a file of version 5 leaves the part that holds it: SciPy
    trusts the sizes, and a damaged file can crash the process. The layout is that of MathWorks,
    *MAT-File Format*, chapter 1.

    Args:
        order: of the bytes, ``<`` or ``>``.
    """
    at, is_sound = 0, bool(order and deepest)
    while is_sound and at + 8 <= len(content):
        kind, size = packing.unpack_from(f"{order}II", content, at)
        start, length = at + 8, size if kind == _COMPRESSED else -(-size // 8) * 8
        if kind >> 16:  # a small element: size and kind in four bytes
            kind, size, start, length = kind & 0xFFFF, kind >> 16, at + 4, 0
        at += 8 + length
        is_sound = start + size <= min(at, len(content))
        inside = content[start : start + size]
        if kind == _COMPRESSED:
            unpack = zlib.decompressobj()
            inside = unpack.decompress(inside, DATA)
            is_sound &= unpack.eof
        if kind in (_MATRIX, _COMPRESSED):
            _check_sizes(inside, order, deepest - 1)
        else:
            is_sound &= kind in _OF_NUMBERS
    if not is_sound or at < len(content):
        raise ValueError("it is cut short or damaged")
