"""A diagnosis as text, as one self-contained page, and as a fragment for notebooks."""

from typing import Any

from tirefit.diagnosis.engine.decide import Status
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.report.diagnosis_answer import answer
from tirefit.report.diagnosis_details import details
from tirefit.report.diagnosis_sections import first_screen, foot_line, head_lines, subject
from tirefit.report.page import Section, fragment, image_of, page, report_text, verdict_of, wrapped


def diagnosis_text(result: Diagnosis, full: bool = False) -> str:
    """The report of one file: the answer first, then what to do.

    Args:
        full: with where the gap lies, all candidates, forecast, noise and settings.
    """
    sections = first_screen(result) + (details(result) if full else [])
    more = "" if full else "; details: --full, or the JSON document"
    first = Section("Answer", [answer(result), *head_lines(result)])
    head = wrapped(f"DIAGNOSIS of {subject(result)}", "", " " * 6)
    foot = wrapped(foot_line(result) + more, "", " " * 6)
    return "\n".join([*head, report_text([first, *sections]), *foot])


def _verdict(result: Diagnosis) -> dict[str, Any]:
    is_closed = result.verdict.status in (Status.NONE, Status.NAMED)
    return verdict_of(answer(result), list(head_lines(result)), is_closed)


def diagnosis_page(result: Diagnosis) -> str:
    """The whole diagnosis as one HTML document, without script or external files: the answer,
    the figures, the tables, the settings."""
    from tirefit.report.canvas import images_of  # Matplotlib
    from tirefit.report.diagnosis_figures import panels_of

    # The tables have the budget.
    panels = [one for name, one in panels_of(result).items() if not name.startswith("budget")]
    sections = [
        Section("", pictures=images_of(panels)),
        *first_screen(result),
        *(section._replace(folded=True) for section in details(result)),
        Section("", [foot_line(result)]),
    ]
    return page(subject(result), sections, _verdict(result), record=result.to_json())


def diagnosis_fragment(result: Diagnosis) -> str:
    """The answer, the first screen and the figure for a notebook."""
    from tirefit.report.diagnosis_figures import diagnosis_figure, panels_of  # Matplotlib

    picture = diagnosis_figure(result)
    picture.set_dpi(90)
    image = image_of(picture, "; ".join(panel.alternative for panel in panels_of(result).values()))
    sections = [Section("", pictures=[image]), *first_screen(result)]
    return fragment(f"{subject(result)}, {result.n} rows", sections, _verdict(result))
