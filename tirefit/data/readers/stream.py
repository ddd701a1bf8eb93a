"""Read a CSV stream row by row as canonical numbers, without storing it.

Columns, units and signs are found from the header as for a file. A cell that is not a
number is a missing value and no error, as a driving vehicle cannot stop for it.
"""

import csv
import itertools
from collections.abc import Iterator
from typing import Any, TextIO

import numpy as np

from tirefit.data.columns import is_number, plan_columns
from tirefit.data.declared import declared, stated_convention
from tirefit.data.units import sign_of, slip_from_speeds, slip_to_sigma
from tirefit.results import DataError


class RowReader:
    """Read a CSV stream whose first line is the header.

    ``columns``: the canonical columns of every row; ``assumptions``: sentences on them;
    ``bad``: (line, reason) of the last row, None if it was complete.

    Raises:
        UsageError: an option has an unknown name or value.
        DataError: there is no header, or it cannot be understood; it lists all problems.
    """

    def __init__(self, lines: TextIO, name: str = "standard input", **how: Any) -> None:
        known = "columns", "units", "convention", "slip", "constants", "rolling_radius"
        self._options = declared(mask_bad_rows=True, **{key: how.get(key) for key in known})
        # Do not iterate over the file itself, which would read ahead.
        above: list[str] = []
        while (first := lines.readline()).startswith("#"):
            above.append(first)
        layout, doubts = stated_convention(above, name)
        following = itertools.chain([first], iter(lines.readline, ""))
        self._rows = csv.reader(following, skipinitialspace=True)
        try:
            header = [cell.strip() for cell in next(self._rows, [])]
        except csv.Error as error:
            reason = f"the first line is not a header: {error}"
            raise DataError(reason, "give CSV", name, 1) from None
        if not header or all(is_number(cell) for cell in header):
            remedy = "begin with a line such as time,sigma_x,fx,fz"
            raise DataError("the first line is not a header", remedy, name, 1)
        plan = plan_columns(header, None, self._options, name)
        signs = self._options.signs(layout, plan.columns, name)
        if problems := [*plan.problems, *signs.problems]:
            raise DataError(problems)
        self._plan, self._width, self._above = plan, len(header), len(above)
        self._convention = signs.convention
        self.assumptions = (*doubts, *plan.assumptions, str(signs))
        self.bad: tuple[int, str] | None = None
        self.columns = tuple(self._row([""] * self._width))
        self.bad = None

    def __iter__(self) -> Iterator[dict[str, float]]:
        while True:
            try:
                cells = next(self._rows, None)
            except csv.Error as error:
                # Treat it as a row without numbers and read on.
                row = self._row([""] * self._width)
                self.bad = self._above + self._rows.line_num, f"not CSV: {error}"
                yield row
                continue
            if cells is None:
                return
            if cells:
                yield self._row(cells)

    def _row(self, cells: list[str]) -> dict[str, float]:
        """Canonical values of one row; NaN for cells that are not numbers."""
        line, self.bad = self._above + self._rows.line_num, None
        row = dict(self._options.constants)
        for name, column in self._plan.columns.items():
            if name == "run" or column.unit is None:
                continue
            text = cells[column.index].strip() if column.index < len(cells) else ""
            value = float(text) if is_number(text) else np.nan
            if np.isnan(value):
                self.bad = line, f"column {column.header!r}: {text!r} is not a number"
            is_std = name.endswith("_std")
            row[name] = sign_of(self._convention, name) * column.unit.to_si(value, is_std)
        if len(cells) != self._width:
            self.bad = line, f"{len(cells)} fields where the header has {self._width}"
        definition, radius = self._plan.slip, self._options.rolling_radius
        if definition is not None:
            slip = np.asarray(row.pop(definition))
            alpha = np.asarray(row["alpha"]) if "alpha" in row else None
            with np.errstate(all="ignore"):
                row["sigma_x"] = float(slip_to_sigma(slip, definition, alpha))
        elif radius is not None and {"v", "omega"} <= row.keys():
            speeds = np.asarray(row["omega"]), np.asarray(row["v"])
            row["sigma_x"] = float(slip_from_speeds(*speeds, radius))
        return row
