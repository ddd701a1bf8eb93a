"""Options by which a user describes a file, and the precedence of sign conventions."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from tirefit.data.table import CANONICAL, SIMULATED, Layout
from tirefit.data.units import base_column, sign_of
from tirefit.results import DataError, InputProblem, UsageError, unknown_names
from tirefit.slip import CONVENTIONS, SLIP_DEFINITIONS

_STATED = re.compile(r"\bconvention\b\W*(?:is +)?([\w-]+(?: +sae\b)?)", re.IGNORECASE)


def stated_convention(above: Sequence[str], file: str) -> tuple[Layout, tuple[Any, ...]]:
    """The sign convention that the lines ``above`` a header state, and warnings.

    Files that this package writes state it there. An unknown name causes a warning.

    Raises:
        DataError: two lines state different conventions.
    """
    layout, doubts = Layout(), []
    for row, line in enumerate(above, 1):
        if not (stated := _STATED.search(line)):
            continue
        name = re.sub("[ _]+", "-", stated[1].lower())
        if name not in CONVENTIONS:
            known = f"declare one of {', '.join(CONVENTIONS)} with --convention"
            doubts.append(f"line {row} states the convention {stated[1]!r}: {known}")
        elif layout.convention not in (None, name):
            before = f"contradicts {layout.convention!r} in line {layout.stated_in}"
            reason = f"the convention {name!r} {before}"
            raise DataError(reason, "correct one of them", file, row)
        else:
            layout = Layout(convention=name, stated_in=layout.stated_in or row)
    return layout, tuple(doubts)


DECLARED_BY = {
    "columns": "--column or [data.columns]",
    "units": "--unit or [data.units]",
    "constants": "--constant or [data.constants]",
    "slip": "--slip or [data] slip",
}
"""Option of :func:`tirefit.data.read.read` -> where users declare it."""


class Signs(NamedTuple):
    """The sign convention in which a file is read."""

    convention: str
    whose: str  # source of the convention, in words
    is_declared: bool = True  # False if it was assumed
    problems: tuple[InputProblem, ...] = ()  # contradictory declarations

    def __str__(self) -> str:
        if self.is_declared:
            return f"signs read as {self.convention!r}, {self.whose}"
        meaning = CONVENTIONS[self.convention].description
        return f"no sign convention declared: {self.convention!r} {self.whose}: {meaning}"


class Options(NamedTuple):
    """The user's declarations on a file; see :func:`tirefit.data.read.read`."""

    columns: Mapping[str, str] = {}
    units: Mapping[str, str] = {}
    convention: str | None = None
    slip: str | None = None
    constants: Mapping[str, float] = {}
    rolling_radius: float | None = None
    mask_bad_rows: bool = False
    forces: bool = True
    curve: bool = True
    otherwise: tuple[str, str] | None = None

    def signs(self, layout: Layout, columns: Iterable[str], file: str) -> Signs:
        """The convention: the user's, the file's, a model's, or "braking".

        Args:
            layout: of the file. If a line of the file states a convention, it must agree
                with the user's in the sign of every column that is read.
            columns: those that are read.
            file: named in the problem.
        """
        stated, row = layout.convention, layout.stated_in
        by_file = f"stated in line {row}" if row else "by the layout of the file"
        model, whose = self.otherwise or ("braking", "")
        if self.convention is None:
            if stated is None:
                assumed = f"assumed, that of {whose}" if whose else "assumed"
                return Signs(model, assumed, is_declared=False)
            unused = f", not as {model!r} of {whose}" if whose and model != stated else ""
            return Signs(stated, by_file + unused)
        if stated in (None, self.convention):
            return Signs(self.convention, "as declared")
        declared = Signs(self.convention, f"as declared, not {stated!r} ({by_file})")
        turned = [n for n in columns if sign_of(stated, n) != sign_of(self.convention, n)]
        if not (row and turned):
            return declared
        reason = f"--convention {self.convention} contradicts the file, which states {stated!r}:"
        reason += f" {', '.join(turned)} would have the other sign"
        remedy = f"leave out --convention (or [data] convention), or correct line {row}"
        return declared._replace(problems=(InputProblem(reason, remedy, file, row),))

    def check(self) -> None:
        """Raises UsageError with every option that has an invalid value."""
        named = [*CANONICAL, *(key for key in SLIP_DEFINITIONS if key != "sigma_x")]
        readable = [*named, "run", *(f"{name}_std" for name in named), *SIMULATED]
        constant = [name for name in readable if base_column(name) in CANONICAL]
        problems = [
            *unknown_names(DECLARED_BY["columns"], self.columns, readable),
            *unknown_names(DECLARED_BY["units"], self.units, [n for n in readable if n != "run"]),
            *unknown_names(DECLARED_BY["constants"], self.constants, constant),
            *unknown_names("--convention", [self.convention], CONVENTIONS),
            *unknown_names("--slip", [self.slip], SLIP_DEFINITIONS),
        ]
        if self.rolling_radius is not None and not 0 < self.rolling_radius < float("inf"):
            reason = f"--rolling-radius {self.rolling_radius} is not a positive length"
            problems.append(InputProblem(reason, "give the effective rolling radius in metres"))
        for name, value in self.constants.items():
            is_size = name in ("fz", "v", "pressure") or name.endswith("_std")
            if not abs(value) < float("inf") or (is_size and value <= 0):
                kind = "a positive" if is_size else "a finite"
                reason = f"--constant {name}={value:g} is not {kind} number"
                problems.append(InputProblem(reason, "give it in SI units and signs"))
        UsageError.raise_for(problems)


def declared(**how: Any) -> Options:
    """The declarations of a user, checked; None counts as not given.

    Raises:
        UsageError: an option has an unknown name or value; it lists all of them.
    """
    options = Options(**{key: value for key, value in how.items() if value is not None})
    options.check()
    return options
