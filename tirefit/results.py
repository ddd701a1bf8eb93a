"""Outcomes as values, and the errors that carry them to the border.

An expected outcome (not converged, at a bound, not identified) is a value of
:class:`Outcome` whose text is the message; it travels in the result and is turned
into an exit code once, at the border. Bad input is an exception that holds *every*
problem found, each with its place, reason and remedy.
"""

import enum
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = [
    "DataError",
    "ExitCode",
    "Outcome",
    "InputProblem",
    "TirefitError",
    "UsageError",
]


class ExitCode(enum.IntEnum):
    """Exit codes of the command line."""

    OK = 0
    USAGE = 2
    DATA = 3
    NOT_CONVERGED = 4
    NOT_IDENTIFIED = 5


class Outcome(enum.Enum):
    """What a computation ended in; the value is the message for the user."""

    CONVERGED = "converged"
    NOT_CONVERGED = (
        "the least-squares solver did not converge: no start reached the tolerance"
        " within the step limit; give starting values in fit.toml or fix a parameter"
    )
    SLIP_CONTRADICTED = (
        "the slip column contradicts the speeds and the rolling radius: one of them is"
        " wrong, and if it is the slip, every number of this fit is"
    )
    STARTS_DISAGREE = (
        "the starts ended in different minima of the same depth: the estimate is not"
        " unique"
    )
    AT_BOUND = "a parameter ended at its bound"
    NOT_IDENTIFIED = "the data do not identify this parameter"
    CHAIN_TOO_SHORT = (
        "the posterior chain is too short for its autocorrelation time or its"
        " ensembles disagree: continue it with --resume"
    )
    INTERRUPTED = "interrupted: the samples drawn so far are kept; --resume continues"
    SYSTEMATIC_MISFIT = "the residuals are mostly a systematic miss of the curve"
    POOR_FIT = (
        "the model does not describe these data: the residuals are larger or more"
        " structured than the noise allows"
    )


@dataclass(frozen=True)
class InputProblem:
    """One problem with an input: where, why, and what to do about it.

    ``row`` counts lines of the file as an editor does (the header is line 1).
    """

    reason: str
    remedy: str = ""
    file: str = ""
    row: int | None = None
    column: str | None = None

    def __str__(self) -> str:
        place = [self.file] if self.file else []
        if self.row is not None:
            place.append(f"row {self.row}")
        if self.column is not None:
            place.append(f"column {self.column!r}")
        where = ", ".join(place)
        text = f"{where}: {self.reason}" if where else self.reason
        return f"{text}\n    remedy: {self.remedy}" if self.remedy else text


class TirefitError(Exception):
    """Base of the errors a user can cause; holds all problems at once."""

    exit_code = ExitCode.USAGE

    def __init__(self, problems: Sequence[InputProblem] | InputProblem | str):
        if isinstance(problems, str):
            problems = InputProblem(problems)
        if isinstance(problems, InputProblem):
            problems = [problems]
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class DataError(TirefitError):
    """The measured data cannot be used as they are (exit code 3)."""

    exit_code = ExitCode.DATA


class UsageError(TirefitError):
    """The command, an option or a configuration file is wrong (exit code 2)."""

    exit_code = ExitCode.USAGE
