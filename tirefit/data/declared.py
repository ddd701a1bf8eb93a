"""What the user declares about a file."""

from collections.abc import Mapping
from typing import NamedTuple

from tirefit.data.table import CANONICAL, SIMULATED
from tirefit.data.units import base_column
from tirefit.results import InputProblem, UsageError, did_you_mean
from tirefit.slip import CONVENTIONS, SLIP_DEFINITIONS

__all__ = ["Options"]


class Options(NamedTuple):
    """What the user declares about a file; see :func:`tirefit.data.read.read`."""

    columns: Mapping[str, str]
    units: Mapping[str, str]
    convention: str | None
    slip: str | None
    constants: Mapping[str, float]
    rolling_radius: float | None
    mask_bad_rows: bool
    forces: bool
    curve: bool = True

    def check(self) -> None:
        """Raises UsageError with every option whose value is not a known one."""
        named = [*CANONICAL, *(key for key in SLIP_DEFINITIONS if key != "sigma_x")]
        readable = [*named, "run", *(f"{name}_std" for name in named), *SIMULATED]
        constant = [name for name in readable if base_column(name) in CANONICAL]
        problems = [
            *_unknown("--column", self.columns, readable),
            *_unknown("--unit", self.units, [n for n in readable if n != "run"]),
            *_unknown("--constant", self.constants, constant),
            *_unknown("--convention", [self.convention], CONVENTIONS),
            *_unknown("--slip", [self.slip], SLIP_DEFINITIONS),
        ]
        radius = self.rolling_radius
        if radius is not None and not 0 < radius < float("inf"):
            reason = f"--rolling-radius {radius} is not a positive length"
            remedy = "give the effective rolling radius in metres"
            problems.append(InputProblem(reason, remedy))
        for name, value in self.constants.items():
            is_size = name in ("fz", "v", "pressure") or name.endswith("_std")
            if not abs(value) < float("inf") or (is_size and value <= 0):
                kind = "a positive" if is_size else "a finite"
                reason = f"--constant {name}={value:g} is not {kind} number"
                problems.append(InputProblem(reason, "give it in SI units and signs"))
        if problems:
            raise UsageError(problems)


def _unknown(option: str, given, known) -> list[InputProblem]:
    problems = []
    for value in given:
        if value is None or value in known:
            continue
        remedy = f"{did_you_mean(str(value), known)}valid: {', '.join(known)}"
        problems.append(InputProblem(f"{option}: {value!r} is not known", remedy))
    return problems
