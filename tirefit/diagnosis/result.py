"""What a diagnosis found: :class:`Diagnosis`, as JSON, as rows, as text."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from tirefit.display import Displayed
from tirefit.files import json_text

__all__ = ["SCHEMA", "Diagnosis"]

SCHEMA = "tirefit.diagnosis/1"


@dataclass(frozen=True, repr=False)
class Diagnosis(Displayed):
    """One file diagnosed.

    ``content`` is the JSON document of the schema; ``rows`` holds (n,) arrays by
    channel of all rows of the file, canonical, NaN where masked: ``base``,
    ``extended``, ``gap``, ``gap_std``. ``table`` is the data, ``curves`` what the
    figures need beyond them.
    """

    text_by: ClassVar[str] = "tirefit.report.diagnosis_text:diagnosis_text"
    html_by: ClassVar[str] = "tirefit.report.diagnosis_html:diagnosis_fragment"

    content: Mapping[str, Any]
    rows: Mapping[str, Mapping[str, np.ndarray]]
    table: Any
    curves: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, key: str) -> Any:
        return self.content[key]

    @property
    def verdict(self) -> Mapping[str, Any]:
        return self.content["verdict"]

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the verdict: empty for none, ``("unknown",)`` for not listed."""
        return tuple(self.verdict["effects"])

    def to_json(self) -> str:
        """The document; not-a-number and infinite become null."""
        return json_text(self.content)
