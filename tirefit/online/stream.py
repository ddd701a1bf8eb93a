"""Several methods on rows as they come: what ``tirefit estimate - --follow`` prints."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tirefit.data.table import CANONICAL
from tirefit.online.base import FLAGS, Estimate, Flag
from tirefit.online.methods import METHODS, estimator_of
from tirefit.online.run import Stream
from tirefit.results import DataError, InputProblem


class Streams:
    """Methods beside each other; ``header`` is that of ``estimates.csv``.

    The expected stiffness comes from the first load, so nothing starts before it.

    Args:
        names: methods.
        settings: of each method, by its name.
        columns: canonical columns that every row has.

    Raises:
        DataError: a column that a method needs is missing.
    """

    def __init__(
        self,
        names: Sequence[str],
        settings: Mapping[str, Mapping[str, float]],
        columns: Sequence[str],
    ):
        problems = [
            InputProblem(
                f"method {name!r} needs {column} ({CANONICAL[column][1]}), which the"
                " rows do not have",
                f"name its column with --column {column}=HEADER",
            )
            for name in names
            for column in ("time", *METHODS[name].method.inputs)
            if column not in columns
        ]
        if problems:
            raise DataError(problems)
        self._settings = {name: settings.get(name, {}) for name in names}
        self._streams: dict[str, Stream] = {}

    @property
    def header(self) -> list[str]:
        head = ["time"]
        for name in self._settings:
            for parameter in METHODS[name].method.parameters:
                head += [f"{name}_{parameter}", f"{name}_{parameter}_std"]
            head.append(f"{name}_flag")
        return head

    def push(self, row: Mapping[str, float]) -> list[str]:
        """The cells of one more row."""
        if not self._streams and row.get("fz", 1.0) > 0:
            load = row.get("fz", 1.0)
            self._streams = {
                name: Stream(estimator_of(name, load, settings))
                for name, settings in self._settings.items()
            }
        cells = [_cell(row["time"])]
        for name in self._settings:
            if self._streams:
                cells += _cells(self._streams[name].push(row))
            else:
                nothing = [""] * (2 * len(METHODS[name].method.parameters))
                cells += [*nothing, Flag.MISSING.value]
        return cells


def _cells(estimate: Estimate) -> list[str]:
    pairs = zip(np.asarray(estimate.value), np.asarray(estimate.std), strict=True)
    numbers = [_cell(float(number)) for pair in pairs for number in pair]
    return [*numbers, FLAGS[int(estimate.flag)].value]


def _cell(number: float) -> str:
    return "" if math.isnan(number) else repr(float(number))
