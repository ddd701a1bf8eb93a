"""Accept data in any form: a result of ``tirefit.read``, a file, a frame or arrays."""

import os
from typing import Any

from tirefit.data.read import Columns, read, read_frame
from tirefit.data.table import TireData

DataLike = TireData | Columns | str | os.PathLike[str]
"""What every function takes as data: read, columns by name, or a path."""


def as_data(data: DataLike, name: str = "data", **how: Any) -> TireData:
    """The data as ``TireData``; read them if necessary.

    Args:
        data: a result of ``tirefit.read``, a path, a frame (pandas, polars or any with
            ``columns``), a structured array, or a mapping of name to (n,) array.
        name: what reports call data that have no file.
        how: arguments of ``tirefit.read`` for data that are not read yet. ``otherwise``
            applies to files only; arrays without a convention are canonical.

    Raises:
        UsageError: data of another type.
        DataError: as ``tirefit.read``.
    """
    if isinstance(data, TireData):
        return data
    if isinstance(data, str | os.PathLike):
        return read(data, **how)
    how.pop("otherwise", None)
    return read_frame(data, name, **how)
