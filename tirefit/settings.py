"""Check settings files (``fit.toml``, ``vehicle.toml``).

The sections of a file are subclasses of :class:`Section`. Neither ``"0.9"`` nor
``true`` is a number. The error lists all problems of a file, each with the file and key.
"""

import copy
import itertools
import json
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Self, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator, model_validator

from tirefit.results import InputProblem, UsageError, did_you_mean


class Contradiction(ValueError):
    """Keys of one section that contradict each other."""

    def __init__(self, problems: Iterable[InputProblem]):
        self.problems = tuple(problems)
        super().__init__("; ".join(problem.reason for problem in self.problems))


class Section(BaseModel):
    """One table of a settings file: known keys, exact types, finite numbers.

    The ``description`` of a required field is the remedy if it is missing.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    def contradictions(self) -> Iterable[InputProblem]:
        """Problems of keys that are valid but contradict each other; subclasses override."""
        return ()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        problems = tuple(self.contradictions())
        if problems:
            raise Contradiction(problems)
        return self

    @field_validator("*", mode="before")
    @classmethod
    def _plain(cls, value: object) -> object:
        """Accept NumPy scalars, which settings from Python may contain."""
        return value.item() if isinstance(value, np.generic) else value


S = TypeVar("S", bound=Section)


def parse_settings(kind: type[S], content: dict[str, Any], source: str) -> S:
    """Check the content of a settings file.

    Args:
        kind: the section that describes the whole file.
        content: the result of :func:`tirefit.door.read_toml`, or a dict of that form.
        source: name of the file, for messages.

    Raises:
        UsageError: unknown or missing keys, wrong types or values, contradictions; it
            lists all of them.
    """
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        details = error.errors()
    # Contradictions are checked only if all keys of a section are right: remove the wrong
    # keys and check again.
    seen = [detail["loc"] for detail in details if detail["type"] == "value_error"]
    content = copy.deepcopy(content)
    for detail in details:
        # A list is removed as a whole.
        path = [*itertools.takewhile(lambda part: isinstance(part, str), detail["loc"])]
        place: Any = content
        for part in path[:-1]:
            place = place.get(part) if isinstance(place, dict) else None
        if path and isinstance(place, dict) and detail["type"] != "value_error":
            place.pop(path[-1], None)
    try:
        kind.model_validate(content)
    except ValidationError as error:
        details += [
            detail
            for detail in error.errors()
            if detail["type"] == "value_error" and detail["loc"] not in seen
        ]
    raise UsageError(
        [replace(problem, file=source) for detail in details for problem in _problems(kind, detail)]
    )


def _section_at(kind: type[Section], path: tuple[str, ...]) -> type[Section]:
    """The section at ``path``; names in a table of sections are skipped."""
    for part in path:
        field = kind.model_fields.get(part)
        if field is None:
            continue
        kinds = (field.annotation, *get_args(field.annotation))
        kind = next(k for k in kinds if isinstance(k, type) and issubclass(k, Section))
    return kind


_REMEDIES = {
    "bool_type": "write true or false, without quotes",
    "dict_type": "give it keys of its own",
    "float_type": "write a number, without quotes",
    "int_type": "write a whole number, without quotes",
    "string_type": "write a text in quotes",
}
"""Type of pydantic's error -> remedy."""


def _problems(kind: type[Section], detail: Any) -> list[InputProblem]:
    """Convert an error of pydantic to problems with a remedy."""
    path = tuple(part for part in detail["loc"] if isinstance(part, str))
    key, error = ".".join(path), detail["type"]
    if error == "value_error":
        prefix = f"{key}: " if key else ""
        problems = detail["ctx"]["error"].problems
        return [replace(p, reason=prefix + p.reason) for p in problems]
    if error == "missing":
        field = _section_at(kind, path[:-1]).model_fields[path[-1]]
        return [InputProblem(f"missing key {key!r}", field.description or "add it")]
    if error == "extra_forbidden":
        valid = list(_section_at(kind, path[:-1]).model_fields)
        hint = did_you_mean(path[-1], valid)
        remedy = f"{hint}valid keys here: {', '.join(valid)}"
        return [InputProblem(f"unknown key {key!r}", remedy)]
    reason, remedy = _in_words(detail), _REMEDIES.get(error, "correct it")
    ends = detail.get("ctx", {}).values()
    if error.endswith("_equal") and any(isinstance(end, float) for end in ends):
        remedy = "give it in SI units"
    if error == "model_type":
        remedy = f"its keys: {', '.join(_section_at(kind, path).model_fields)}"
    return [InputProblem(f"{key} = {_shown(detail['input'])}: {reason}", remedy)]


def _in_words(detail: Any) -> str:
    if detail["type"] in ("dict_type", "model_type"):
        return "must be a table"
    text = detail["msg"].replace(" after validation", "").removeprefix("Value error, ")
    return re.sub("^(Input|List) should", "must", text)


_MOST = 3  # faults of a document in one sentence


def faults_in(error: Exception) -> str:
    """Key and reason of the first faults that reading a document found, in a line."""
    if not isinstance(error, ValidationError):
        text = f"the key {error}" if isinstance(error, KeyError) else str(error)
        return (text.splitlines() or ["it is nested too deeply"])[0][:200]
    details = error.errors(include_url=False)
    each = [
        f"{'.'.join(map(str, detail['loc']))[:80]}: {_in_words(detail)}".removeprefix(": ")
        for detail in details[:_MOST]
    ]
    more = f"; and {len(details) - _MOST} more" if len(details) > _MOST else ""
    return "; ".join(each) + more


def _shown(value: Any) -> str:
    """A value as in the file, shortened."""
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}..."
