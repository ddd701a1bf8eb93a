"""Outcomes of computations, and the errors that a user can cause.

An expected outcome (not converged, at a bound, not identified) is a value of
:class:`Outcome` with its message. A result holds its outcomes, and :func:`exit_code` turns
them into the exit code of the command. Bad input raises an exception with *every* problem
that was found, each with its place, reason and remedy.
"""

import difflib
import enum
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Self


class ExitCode(enum.IntEnum):
    """Exit codes of the command line."""

    OK = 0
    USAGE = 2
    DATA = 3
    NOT_CONVERGED = 4
    NOT_IDENTIFIED = 5
    SHAPE_DEPENDENT = 6


class Outcome(enum.StrEnum):
    """The status of a result, the gravest first; ``message`` explains it, if a text fits all."""

    NOT_CONVERGED = (
        "not converged",
        "the least-squares solver did not converge: no start reached the tolerance"
        " within the step limit; give starting values in fit.toml or fix a parameter",
    )
    SLIP_CONTRADICTED = (
        "doubtful slip",
        "the slip column contradicts the speeds and the rolling radius: one of them is"
        " wrong; if it is the slip, all results of this fit are wrong",
    )
    GUARD_FAILED = (
        "not a tire's curve",
        "within the loads and slips of the data the fitted curve is not that of a tire",
    )
    POOR_FIT = "poor fit"
    NOISE_OVERSTATED = "overstated noise"
    STARTS_DISAGREE = (
        "not unique",
        "the starts ended in different minima of equal cost: the estimate is not unique",
    )
    SYSTEMATIC_MISFIT = "systematic misfit"
    SHAPE_DEPENDENT = (
        "friction rests on the shape of the model",
        "models of other shapes describe the rows as well, or better, and have another peak",
    )
    UNSOUND = "unsound", "the tire fails a check of its forces"
    NOT_IDENTIFIED = "not identified", "the data do not identify this parameter"
    INCOMPLETE = "incomplete"
    INTERRUPTED = ("interrupted", "the samples drawn so far are kept")
    CHAIN_TOO_SHORT = (
        "chain too short",
        "the posterior chain is too short for its autocorrelation time or its"
        " ensembles disagree: raise max_steps under [posterior]",
    )
    AT_BOUND = "at a bound"
    CONVERGED = "converged"
    OK = "ok"

    message: str

    def __new__(cls, status: str, message: str = "") -> "Outcome":
        self = str.__new__(cls, status)
        self._value_, self.message = status, message
        return self

    @classmethod
    def gravest(cls, outcomes: Collection["Outcome"]) -> "Outcome":
        """The gravest of the outcomes; ``OK`` where there is none."""
        return next((outcome for outcome in cls if outcome in outcomes), cls.OK)


_UNFINISHED = {
    Outcome.NOT_CONVERGED,
    Outcome.GUARD_FAILED,
    Outcome.UNSOUND,
    Outcome.CHAIN_TOO_SHORT,
    Outcome.INTERRUPTED,
}


def exit_code(outcomes: Collection[Outcome], strict: bool = False) -> ExitCode:
    """The exit code of a command whose result has these outcomes.

    Args:
        strict: whether a parameter that is not identified is a failure.
    """
    if _UNFINISHED & {*outcomes}:
        return ExitCode.NOT_CONVERGED
    if strict and Outcome.NOT_IDENTIFIED in outcomes:
        return ExitCode.NOT_IDENTIFIED
    if Outcome.SHAPE_DEPENDENT in outcomes:
        return ExitCode.SHAPE_DEPENDENT
    return ExitCode.OK


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


def unknown_names(
    noun: str, names: Iterable[str | None], known: Iterable[str]
) -> list["InputProblem"]:
    """A problem for each name that is not known, with the valid names; None is no name."""
    there = list(known)
    return [
        InputProblem(
            f"{noun}: {name!r} is not known",
            f"{did_you_mean(name, there)}valid: {', '.join(there)}",
        )
        for name in names
        if name is not None and name not in there
    ]


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

    def argument(match: re.Match[str]) -> str:
        if match["pair"]:
            value = match["given"] or "..."
            quoted = value if _is_number(value) else f"'{value}'"
            return f"{_PAIRS[match['pair']]}={{'{match['key']}': {quoted}}}"
        if match["flag"]:
            return f"{match['flag'].replace('-', '_')}=True"
        name, value = match["name"].replace("-", "_"), match["value"]
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

    def __init__(
        self, problems: Sequence[InputProblem] | InputProblem | str, *more: Any, **named: Any
    ):
        if isinstance(problems, str):
            problems = InputProblem(problems, *more, **named)
        if isinstance(problems, InputProblem):
            problems = [problems]
        self.problems = tuple(problems)
        super().__init__(in_python("\n".join(map(str, self.problems))))

    def __reduce__(self) -> tuple[type[Self], tuple[tuple[InputProblem, ...]]]:
        return type(self), (self.problems,)

    @classmethod
    def raise_for(cls, problems: Sequence[InputProblem]) -> None:
        """Raise this error with all the problems, if there are any."""
        if problems:
            raise cls(problems)


class DataError(TirefitError):
    """The measured data cannot be used as they are (exit code 3).

    ``problems`` holds each problem with reason, remedy and, where known, file, row and column.

    Example:
        >>> try:
        ...     fit({"sigma_x": np.linspace(0, 0.1, 30), "fx": np.linspace(0, 3e3, 30)})
        ... except DataError as error:
        ...     print(error.problems[0].reason)
        no load: fz is needed
    """

    exit_code = ExitCode.DATA


class UsageError(TirefitError):
    """The command, an option or a configuration file is wrong (exit code 2).

    ``problems`` is as in :class:`DataError`.

    Example:
        >>> try:
        ...     fit(samples / "circles.csv", "brsh")
        ... except UsageError as error:
        ...     print(error.problems[0].reason)
        unknown model 'brsh'
    """

    exit_code = ExitCode.USAGE
