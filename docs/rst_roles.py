"""Docstrings as Markdown: roles and literal blocks of reStructuredText become code."""

import re

from griffe import Extension

ROLE = re.compile(r":\w+:`~?([^`]+)`")
LITERAL = re.compile(r"::$", re.MULTILINE)
EXAMPLE = re.compile(r"^( *)Example:$", re.MULTILINE)
"""Only a section of this name in the plural is shown as code."""


class PlainRoles(Extension):
    """Rewrites the docstring of every object before it is parsed."""

    def on_object(self, *, obj, **_):
        """Called by griffe for each object that it has collected."""
        if obj.docstring:
            text = ROLE.sub(r"`\1`", obj.docstring.value)
            obj.docstring.value = EXAMPLE.sub(r"\1Examples:", LITERAL.sub(":", text))
