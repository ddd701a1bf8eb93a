"""How a record finds its picture without its room knowing the report room.

Records live on low floors, their text and HTML are made on the report floor. A record
names the functions; they are looked up when a notebook or ``print`` asks.
"""

import importlib
from typing import Any, ClassVar


def _made_by(place: str, record: Any) -> str:
    module, _, function = place.partition(":")
    return getattr(importlib.import_module(module), function)(record)


class Displayed:
    """A record with a rich notebook form, and a text form where one is named."""

    html_by: ClassVar[str]
    text_by: ClassVar[str | None] = None

    def _repr_html_(self) -> str:
        return _made_by(self.html_by, self)

    def __str__(self) -> str:
        return _made_by(self.text_by, self) if self.text_by else repr(self)
