"""Data out: whole files or none, and canonical values back in a file's own terms."""

import csv
import io
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tirefit.data.table import TireData
from tirefit.data.units import (
    base_column,
    resolve_unit,
    sigma_derivative,
    sign_of,
    slip_from_sigma,
)

__all__ = ["to_convention", "write_csv", "write_text_atomic"]


def write_text_atomic(path, text: str) -> None:
    """Writes text as UTF-8 so that ``path`` holds all of it or what it held before."""
    path = Path(path)
    # In the same directory, so that the replacement is one step of the file system.
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
            file.write(text)
        os.chmod(temporary, _mode(path))
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


def _mode(path: Path) -> int:
    """Permissions of the file to replace, or those that open() would give."""
    if path.exists():
        return path.stat().st_mode & 0o777
    umask = os.umask(0)
    os.umask(umask)
    return 0o666 & ~umask


def write_csv(path, columns: Mapping[str, object]) -> None:
    """Writes columns as CSV, whole or not at all.

    Args:
        path: the file.
        columns: header to (n,) array or list of numbers or texts. Numbers are written
            in full precision, NaN as an empty cell.

    Raises:
        ValueError: the columns are not equally long.
    """
    cells = [_cells(values) for values in columns.values()]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*cells, strict=True))
    write_text_atomic(path, text.getvalue())


def _cells(values) -> list[str]:
    plain = values.tolist() if hasattr(values, "tolist") else list(values)
    return [
        ("" if value != value else repr(value))
        if isinstance(value, float)
        else str(value)
        for value in plain
    ]


def to_convention(
    data: TireData, canonical_values: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Canonical values in the convention, units and slip definition of data's file.

    Args:
        data: the data whose source declares them.
        canonical_values: (n,) arrays by canonical name, ``<column>_std`` included.
            Converting ``sigma_x_std`` needs sigma_x, and slip ``s`` uses alpha: both
            are taken from here, or else from ``data``.

    Returns:
        The values under the file's own header, or where the file has no such column
        under the canonical name (the slip definition's name for sigma_x).
    """
    source = data.source
    beside = {**data.columns, **canonical_values}
    out = {}
    for name, values in canonical_values.items():
        base, is_std = base_column(name), name.endswith("_std")
        values = np.asarray(values, float)
        key = name
        if base == "sigma_x":
            definition, alpha = source.slip_definition, beside.get("alpha")
            key = name.replace("sigma_x", definition, 1)
            if is_std:
                values = values / sigma_derivative(beside["sigma_x"], definition, alpha)
            else:
                values = slip_from_sigma(values, definition, alpha)
        text = source.units.get(name, source.units.get(base))
        values = sign_of(source.convention, name) * values
        if text is not None:
            values = resolve_unit(text, name).from_si(values, is_std)
        out[source.columns.get(name, key)] = values
    return out
