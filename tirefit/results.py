"""Outcomes of computations, and the errors that a user can cause.

An expected outcome (not converged, at a bound, not identified) is a value of
:class:`Outcome`, whose text is the message. Results hold it, and the command line turns
it into an exit code. Bad input raises an exception with *every* problem that was found,
each with its place, reason and remedy.
"""

import difflib
import enum
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


class ExitCode(enum.IntEnum):
    """Exit codes of the command line."""

    OK = 0
    USAGE = 2
    DATA = 3
    NOT_CONVERGED = 4
    NOT_IDENTIFIED = 5


class Outcome(enum.Enum):
    """The outcome of a computation; the value is the message for the user."""

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
        "the starts ended in different minima of equal cost: the estimate is not unique"
    )
    AT_BOUND = "a parameter ended at its bound"
    NOT_IDENTIFIED = "the data do not identify this parameter"
    CHAIN_TOO_SHORT = (
        "the posterior chain is too short for its autocorrelation time or its"
        " ensembles disagree: continue it with --resume"
    )
    INTERRUPTED = "interrupted: the samples drawn so far are kept; --resume continues"
    GUARD_FAILED = "within the loads and slips of the data the fitted curve is not that of a tire"
    WORSENED = "rows of combined slip worsened the curve of pure slip"
    SYSTEMATIC_MISFIT = "the residuals are mostly a systematic miss of the curve"
    POOR_FIT = (
        "the model does not describe these data: the residuals are larger or more"
        " structured than the noise allows"
    )


@dataclass(frozen=True)
class InputProblem:
    """One problem with an input: where, why, and what to do about it."""

    reason: str
    remedy: str = ""
    file: str = ""
    row: int | None = None  # line of the file as in an editor (the header is line 1)
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


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Beginning of the remedy for an unknown name: ``did you mean 'mu'? ``, with a
    trailing space; empty if no known name resembles it."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"did you mean {close[0]!r}? " if close else ""


_PAIRS = {"column": "columns", "unit": "units", "constant": "constants"}
_OPTION = re.compile(
    r"--(?P<pair>column|unit|constant) (?P<key>\w+)=(?P<given>[^\s,;)]*)"
    r"|--(?P<flag>mask-bad-rows|resume|beside)"
    r"|--(?P<name>convention|signs|slip|rolling-radius|side|model|sampler)"
    r" (?P<value>[\w.-]+)"
)


def in_python(text: str) -> str:
    """Replace command-line options in a text by the equivalent Python arguments."""

    def argument(found: re.Match) -> str:
        if found["pair"]:
            value = found["given"] or "..."
            quoted = value if _is_number(value) else f"'{value}'"
            return f"{_PAIRS[found['pair']]}={{'{found['key']}': {quoted}}}"
        if found["flag"]:
            return f"{found['flag'].replace('-', '_')}=True"
        name, value = found["name"].replace("-", "_"), found["value"]
        bare = name == "rolling_radius" or _is_number(value)
        return f"{name}={value}" if bare else f"{name}='{value}'"

    return _OPTION.sub(argument, text)


def _is_number(text: str) -> bool:
    return text.replace(".", "", 1).replace("-", "", 1).isdigit()


class TirefitError(Exception):
    """Base of the errors that a user can cause; holds all problems.

    The text of the exception is for callers of Python functions: it names arguments
    where the problems name options of the command line.

    Args:
        problems: all problems, or the reason of a single one.
        more: the other fields of that single :class:`InputProblem`.
    """

    exit_code = ExitCode.USAGE

    def __init__(self, problems: Sequence[InputProblem] | InputProblem | str, *more, **named):
        if isinstance(problems, str):
            problems = InputProblem(problems, *more, **named)
        if isinstance(problems, InputProblem):
            problems = [problems]
        self.problems = tuple(problems)
        super().__init__(in_python("\n".join(map(str, self.problems))))

    @classmethod
    def raise_for(cls, problems: Sequence[InputProblem]) -> None:
        """Raise this error with all the problems, if there are any."""
        if problems:
            raise cls(problems)


class DataError(TirefitError):
    """The measured data cannot be used as they are (exit code 3)."""

    exit_code = ExitCode.DATA


class UsageError(TirefitError):
    """The command, an option or a configuration file is wrong (exit code 2)."""

    exit_code = ExitCode.USAGE
