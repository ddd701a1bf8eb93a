"""Base classes of results: text, numbers, figures, files and notebook display.

Results are defined in low layers, their text and figures in the report layer. A result
class therefore names these functions as text; they are imported when they are called.
"""

import importlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, NoReturn, Protocol, runtime_checkable

from tirefit.files import json_text, write_texts
from tirefit.results import Outcome, did_you_mean


def _made_by(place: str, *given: Any, **named: Any) -> Any:
    module, _, function = place.partition(":")
    return getattr(importlib.import_module(module), function)(*given, **named)


@runtime_checkable
class Figure(Protocol):
    """A figure of matplotlib, as the methods ``plot`` return it."""

    def savefig(self, fname: str | os.PathLike[str], **how: Any) -> None: ...


class ByName(dict[str, Any]):
    """Records by name; the error for an unknown name suggests a known one."""

    def __missing__(self, name: object) -> NoReturn:
        raise KeyError(f"{name}: {did_you_mean(str(name), self)}known: {', '.join(self)}")


class Displayed:
    """A record that notebooks display as HTML."""

    html_by: ClassVar[str] = "tirefit.report.page:record_fragment"

    def _repr_html_(self) -> str:
        return _made_by(self.html_by, self)


class Record(Displayed):
    """Base of all results, with the same methods for text, numbers, files and figures.

    Example:
        >>> result = fit(samples / "circles.csv", "brush")
        >>> print(result.status)
        systematic misfit
        >>> result.warnings[0].partition(":")[0]
        'residuals of neighbouring slips agree (correlation 0.51)'
        >>> [path.name for path in result.save(folder / "fit")]
        ['fit.json']
        >>> result.to_dict()["model"], len(result.plot().axes)
        ('brush', 1)
    """

    text_by: ClassVar[str]
    plot_by: ClassVar[str]
    page_by: ClassVar[str] = "tirefit.report.page:record_page"
    save_by: ClassVar[str] = "tirefit.display:save_files"
    internal: ClassVar[tuple[str, ...]] = ()
    """Attributes that completion does not offer."""

    def __dir__(self) -> list[str]:
        hidden = {*self.internal, "internal"}
        return [n for n in super().__dir__() if not n.endswith("_by") and n not in hidden]

    @property
    def limits(self) -> Mapping[Outcome, str]:
        """Outcome -> the sentence that says it, empty where it does not hold."""
        return {}

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """What limits the use of the result; empty where nothing does."""
        return tuple(outcome for outcome, text in self.limits.items() if text)

    @property
    def status(self) -> Outcome:
        """The gravest of ``outcomes``, a text such as "not converged"; "ok" of none.

        The command's exit code follows from ``outcomes`` by
        :func:`tirefit.results.exit_code`.
        """
        return Outcome.gravest(self.outcomes)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know before the result is used, a sentence each."""
        return tuple(filter(None, self.limits.values()))

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.summary().partition(chr(10))[0]}>"

    def summary(self, **how: Any) -> str:
        """Return the report as text, as the command prints it.

        Args:
            how: ``full=True`` for all details, of results that have more.
        """
        return _made_by(self.text_by, self, **how)

    def plot(self, what: str = "", **how: Any) -> Figure:
        """The matplotlib figure.

        Args:
            what: the name of one figure, of results that have several.
            how: keywords of that figure.
        """
        figure: Figure = _made_by(self.plot_by, self, *((what,) if what else ()), **how)
        return figure

    def to_dict(self) -> dict[str, Any]:
        """All numbers, as in the JSON file."""
        raise NotImplementedError

    def to_json(self) -> str:
        """The text of the JSON file; numbers that are not finite become null."""
        return json_text(self.to_dict())

    def files(self, name: str) -> Mapping[str, str]:
        """File name -> content of every file that :meth:`save` writes into a folder.

        Args:
            name: beginning of the names of files that are named after the data.
        """
        raise NotImplementedError

    def save(self, path: str | os.PathLike[str], name: str = "") -> list[Path]:
        """Write the files that the command writes, or one page; each completely or not at all.

        Args:
            path: a folder, created if needed; or a page, a name that ends in ``.html``.
            name: beginning of the names of files that are named after the data; the
                name of the data by default.

        Returns:
            The files written.

        Raises:
            OSError: a file cannot be written.
        """
        path = Path(path)
        if path.suffix == ".html":
            write_texts({path: _made_by(self.page_by, self)})
            return [path]
        path.mkdir(parents=True, exist_ok=True)
        return _made_by(self.save_by, self, path, *([name] if name else []))


def save_files(record: Record, folder: Path, name: str = "") -> list[Path]:
    """Write :meth:`Record.files` into a folder."""
    texts = {folder / file: text for file, text in record.files(name).items()}
    write_texts(texts)
    return list(texts)
