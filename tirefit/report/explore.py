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


def _facts(explored: Any) -> list[str]:
    """What a reader has to know of the numbers: signs, loads, errors, version."""
    facts = [f"Signs {explored.convention}: {CONVENTIONS[explored.convention].description}"]
    for tire in explored.tires:
        ends = [f"{float(f'{x:.4g}'):g}" for x in dict.fromkeys(tire.ranges.get("fz", ()))]
        known = f"{' to '.join(ends)} N" if ends else "not known"
        facts.append(f"{tire.label}: loads of the data {known}")
        facts[-1] += ", no standard errors" * (not tire.steps)
    return [*facts, f"tirefit {__version__}"]


def explore_text(explored: Any) -> str:
    """The tires, the signs and the rows of a :class:`tirefit.targets.explore.Explored`."""
    lines = [f"{tire.label}: {'; '.join(tire.origin)}" for tire in explored.tires]
    return "\n".join(
        [*lines, *_facts(explored), f"measured rows: {explored.data or 'none (--data)'}"]
    )


def explore_figure(explored: Any) -> NoReturn:
    """Raise UsageError: the curves depend on the sliders."""
    raise UsageError("these tires have no figure", "write the page: .save('tire.html')")


def explore_page(explored: Any) -> str:
    """One HTML document with its scripts; it fetches nothing.

    Raises:
        DataError: Plotly is not installed.
    """
    offline = extra("plotly.offline", "a page with sliders", "", "explore", "writing")
    content = json_safe(explored.to_dict())
    programs = [tire.pop("program") for tire in content["tires"]]
    return template("explore.html").render(
        content=content,
        # Made of numbers and names of operations only.
        programs=Markup(",\n".join(programs)),
        plotly=Markup(offline.get_plotlyjs()),
        title=" against ".join(tire.label for tire in explored.tires),
        facts=_facts(explored),
        bands=any(tire.steps for tire in explored.tires),
    )


def save_page(explored: Any, folder: Path, name: str = "") -> list[Path]:
    """Write the page into a folder."""
    path = folder / f"{name or 'explore'}.html"
    write_texts({path: explore_page(explored)})
    return [path]
