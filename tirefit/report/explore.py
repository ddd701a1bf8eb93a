"""The page on which a reader moves sliders and sees the forces of tires."""

from pathlib import Path
from typing import Any, NoReturn

from markupsafe import Markup

from tirefit import __version__
from tirefit.data.readers.extras import extra
from tirefit.files import json_safe, write_texts
from tirefit.report.page import template
from tirefit.results import UsageError
from tirefit.slip import CONVENTIONS

PAGE = "explore.html"
"""Name of the page in a folder."""


def _facts(found: Any) -> list[str]:
    """What a reader has to know of the numbers: signs, loads, errors, version."""
    facts = [f"Signs {found.convention}: {CONVENTIONS[found.convention].description}"]
    for one in found.tires:
        ends = [f"{float(f'{x:.4g}'):g}" for x in dict.fromkeys(one.ranges.get("fz", ()))]
        known = f"{' to '.join(ends)} N" if ends else "not known"
        facts.append(f"{one.label}: loads of the data {known}")
        facts[-1] += ", no standard errors" * (not one.steps)
    return [*facts, f"tirefit {__version__}"]


def explore_text(found: Any) -> str:
    """The tires, the signs and the rows of a :class:`tirefit.targets.explore.Explored`."""
    lines = [f"{one.label}: {'; '.join(one.origin)}" for one in found.tires]
    return "\n".join([*lines, *_facts(found), f"measured rows: {found.data or 'none (--data)'}"])


def explore_figure(found: Any) -> NoReturn:
    """Raise UsageError: the curves depend on the sliders."""
    raise UsageError("these tires have no figure", "write the page: .save('tire.html')")


def explore_page(found: Any) -> str:
    """One HTML document with its scripts; it fetches nothing.

    Raises:
        DataError: Plotly is not installed.
    """
    offline = extra("plotly.offline", "a page with sliders", "", "explore", "writing")
    content = json_safe(found.to_dict())
    programs = [one.pop("program") for one in content["tires"]]
    return template("explore.html").render(
        content=content,
        # Made of numbers and names of operations only.
        programs=Markup(",\n".join(programs)),
        plotly=Markup(offline.get_plotlyjs()),
        title=" against ".join(one.label for one in found.tires),
        facts=_facts(found),
        bands=any(one.steps for one in found.tires),
    )


def save_page(found: Any, folder: Path, name: str = "") -> list[Path]:
    """Write the page into a folder."""
    path = folder / (f"{name}.html" if name else PAGE)
    write_texts({path: explore_page(found)})
    return [path]
