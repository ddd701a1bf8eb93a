"""Write data, and convert canonical values back to the units and signs of a file."""

import csv
import io
import itertools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tirefit.data.table import CANONICAL, SIMULATED, TireData
from tirefit.data.units import base_column, resolve_unit, sigma_derivative, sign_of, slip_from_sigma
from tirefit.results import InputProblem

_PLOTTED = ("time", "sigma_x", "alpha", "gamma", "fz", "v", "pressure")


def output_problems(path: str | os.PathLike[str], ending: str = "") -> list[InputProblem]:
    """The problems that prevent writing a file at ``path``, to check before the work.

    Args:
        ending: that of the kind of file, such as ``.csv``.
    """
    path = Path(path)
    folder, other = path.parent, "choose another name with --out"
    checks = (
        (path.is_dir(), "is a folder, where a file is to be written", other),
        (not folder.is_dir(), f"there is no folder {folder}", "make it first"),
        (not os.access(folder, os.W_OK | os.X_OK),
         f"no permission to write into the folder {folder.resolve()}", other),
        (ending and path.suffix.lower() != ending,
         f"the output is a {ending.removeprefix('.').upper()}", f"end it in {ending}"),
    )  # fmt: skip
    problems = (InputProblem(reason, do, str(path)) for is_wrong, reason, do in checks if is_wrong)
    return list(itertools.islice(problems, 1))


def csv_text(columns: Mapping[str, object], delimiter: str = ",") -> str:
    """Columns as the text of a CSV file, or with another delimiter.

    Args:
        columns: header -> (n,) array or list of numbers or texts. Numbers are written
            in full precision, NaN as an empty cell.

    Raises:
        ValueError: the columns are not equally long.
    """

    def text_of(value: object) -> str:
        if isinstance(value, float):
            return "" if value != value else repr(value)
        return str(value)

    cells: list[Any] = [x.tolist() if hasattr(x, "tolist") else x for x in columns.values()]
    text = io.StringIO()
    writer = csv.writer(text, delimiter=delimiter, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(map(text_of, values) for values in cells), strict=True))
    return text.getvalue()


def to_convention(
    data: TireData, canonical_values: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Canonical values in the convention, units and slip definition of the file.

    Args:
        data: the data whose source declares them.
        canonical_values: (n,) arrays by canonical name, also of ``<column>_std``.
            Converting ``sigma_x_std`` needs sigma_x, and slip ``s`` uses alpha: both
            are taken from here, or else from ``data``.

    Returns:
        The values by the header of the file, or by canonical name (for sigma_x, the slip
        definition) if the file has no such column.
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


def prediction_table(data: TireData, forces: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Predicted forces and the columns needed to plot them, in the terms of the file.

    Args:
        data: the rows that were predicted.
        forces: (n,) canonical forces, also ``<force>_std``.

    Returns:
        By header of the file: run, time, slips, camber, load, speed and pressure as far
        as the data have them, then the forces.
    """
    named = [name for name in _PLOTTED if name in data]
    return _table(data, named, to_convention(data, forces))


def simulated_table(data: TireData, forces: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """All columns of the data that were read, and the forces of a simulator, in the terms
    of the file, for ``tirefit diagnose --sim``.

    Args:
        data: the rows that were predicted; forces of an earlier simulator are left out.
        forces: (n,) canonical forces; ``<force>_std`` is left out.
    """
    made: dict[str, np.ndarray] = {}
    for name, force in forces.items():
        if f"{name}_sim" in SIMULATED:
            (made[f"{name}_sim"],) = to_convention(data, {name: force}).values()
    return _table(data, [name for name in data.columns if name not in SIMULATED], made)


def _table(
    data: TireData, names: Sequence[str], beside: Mapping[str, np.ndarray]
) -> dict[str, Any]:
    """Columns of the data in the terms of the file, with the runs if there are several, and those
    ``beside``. Units that the file states elsewhere are added to the headers, so that the written
    file is read back with the same units."""
    source, inputs = data.source, to_convention(data, {name: data[name] for name in names})
    # 12 digits: 0.1 converted to sigma_x and back is 0.1 again, as in the file.
    table: dict[str, Any] = {k: [float(f"{v:.12g}") for v in x] for k, x in inputs.items()}
    table |= beside
    if len(data.runs) > 1:
        table = {"run": [data.runs[code] for code in data.run]} | table
    for name in source.units_beside:
        unit, header = source.units.get(name), source.columns[name]
        if unit and unit != CANONICAL[base_column(name)][0]:
            named = {header: f"{header} [{unit}]"}
            table = {named.get(key, key): values for key, values in table.items()}
    return table
