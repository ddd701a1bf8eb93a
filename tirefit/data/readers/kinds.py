"""Detect the kind of a file from its content and read it: :func:`read_table`."""

import hashlib
import re
from collections.abc import Collection
from pathlib import Path

import numpy as np

from tirefit.data.columns import IsKnown, guess
from tirefit.data.readers import logs, tables, tydex
from tirefit.data.readers.loggers import VBO, is_vbo
from tirefit.data.readers.mat import MAT, Channels, channels_of_mat
from tirefit.data.readers.remote import Place
from tirefit.data.readers.text import (
    Table,
    decoded,
    gunzipped,
    read_bytes,
    stem_of,
    table_of_rows,
    table_of_text,
    table_of_vbo,
)
from tirefit.data.table import Layout
from tirefit.data.tir.tire_file import describes_tir, other_tire
from tirefit.door import COLUMNS
from tirefit.results import DataError

_AS_TEXT = "export it as CSV, or save it as Parquet or as a MATLAB file"
_IN_PYTHON = "load it in Python and give its columns to tirefit.read_frame, or write them as CSV"
_UNREADABLE = {
    rb"TDSm": ("a measurement file of LabVIEW (.tdms)", _AS_TEXT),
    rb"\x89HDF\r\n": ("an HDF5 file that is not MATLAB's", _AS_TEXT),
    rb"(?s)PK\x03\x04.{26}[^\0]{1,200}\.npy": ("a file of NumPy arrays (.npz)", _IN_PYTHON),
    rb"\x93NUMPY": ("a NumPy array (.npy)", _IN_PYTHON),
    rb"\x80[\x02-\x05]|\((dp|lp)\d+\n": ("a pickle, which could run code", _IN_PYTHON),
}
"""Pattern of the first bytes of a file that is not read -> its kind and the remedy."""
_OF_TIRE = 2**17  # characters in which a file of a tire shows its kind


def read_table(path: Place, declared: Collection[str]) -> Table:
    """Read a file of any kind into cells; ``declared`` headers help to find columns.

    Raises:
        DataError: the file does not exist, is damaged, of unknown kind, or has no table,
            or more columns than :data:`~tirefit.door.COLUMNS`.
    """
    folded = {header.strip().casefold() for header in declared}

    def is_known(name: str) -> bool:
        return name.strip().casefold() in folded or guess(name) is not None

    table = _read(path, is_known)
    if len(table.headers) > COLUMNS:
        reason = f"it has {len(table.headers)} columns, more than {COLUMNS}"
        raise DataError(reason, "keep the columns of slips, load and forces", str(path))
    return table


def _read(path: Place, is_known: IsKnown) -> Table:
    # The folder of a ROS 2 bag, whose files may be too large to be held together.
    if isinstance(path, Path) and (path / "metadata.yaml").is_file():
        every = hashlib.sha256()
        for inside in sorted(path.iterdir()):
            every.update(read_bytes(inside))
        channels = logs.channels_of_bag(path, b"", is_known)
        return _of_channels(channels, path, every.hexdigest())
    raw = read_bytes(path)
    content, file = gunzipped(raw, path), str(path)
    for start, (kind, remedy) in _UNREADABLE.items():
        if re.match(start, content):
            raise DataError(f"this is {kind}, which is not read", remedy, file)
    is_json = re.match(rb"(\xef\xbb\xbf)?\s*(\{|\[\s*\{)", content) is not None
    if is_json or file.lower().endswith((".json", ".toml")):
        reason = "this is JSON or a file of settings, and no table of measurements"
        remedy = "write its columns as CSV; in Python, read_frame takes a dict of columns; give a"
        raise DataError(reason, f"{remedy} fit as the tire (--model), settings as --config", file)
    digest = hashlib.sha256(raw).hexdigest()
    if content.startswith(MAT):
        return _of_channels(channels_of_mat(content, file, is_known), path, digest)
    if content.startswith(logs.MDF):
        return _of_channels(logs.channels_of_mdf(path, content, is_known), path, digest)
    if logs.bag_suffix(content):
        return _of_channels(logs.channels_of_bag(path, content, is_known), path, digest)
    if content.startswith(tables.ARROW):
        channels = tables.channels_of_arrow(content, file)
        return _of_channels(channels, path, digest, "metadata of the column")
    if tables.is_excel(content):
        rows, notes = tables.sheet_of_excel(content, file, is_known)
        return table_of_rows(rows, path, digest, notes)
    text, notes = decoded(content, path)
    if VBO.search(content) and is_vbo(text):
        return table_of_vbo(text, path, digest, notes)
    above = text[:_OF_TIRE]
    DataError.raise_for(other_tire(above, file))
    if describes_tir(above):
        reason = "this is a file of Magic Formula coefficients, which describes a tire"
        remedy = "give the measurements here, and this file as the tire: --model"
        raise DataError(reason, f"{remedy} {file} of diagnose, or `tirefit predict`", file)
    if tydex.is_tydex(text):
        return tydex.table_of_tydex(text, path, digest, notes)
    return table_of_text(text, path, digest, is_known, notes)


def _of_channels(
    channels: Channels, path: Place, digest: str, units_from: str = "stated in the file"
) -> Table:
    """A table of columns without lines; rows are counted from 1."""
    headers = list(channels.columns)
    cells = list(channels.columns.values())
    n = len(cells[0]) if cells else 0
    if not n:
        reason = "the file has no columns" if not cells else "there are no data rows"
        raise DataError(reason, "give at least as many rows as parameters", str(path))
    units = [channels.units.get(header, "") for header in headers]
    return Table(
        str(path), stem_of(path), headers, cells, np.arange(1, n + 1), np.zeros(n, bool),
        units_row=units if any(units) else None, sha256=digest, notes=channels.notes,
        layout=Layout(units_from=units_from), epoch=channels.epoch,
    )  # fmt: skip
