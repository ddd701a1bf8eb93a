"""A diagnosis as one self-contained page, and as a fragment for notebooks."""

from collections.abc import Mapping, Sequence

from tirefit.diagnosis.summary.result import Diagnosis, Status
from tirefit.report.canvas import Panel, images_of
from tirefit.report.diagnosis_answer import answer
from tirefit.report.diagnosis_details import details
from tirefit.report.diagnosis_draw import diagnosis_figure, panels_of
from tirefit.report.diagnosis_sections import first_screen, foot_line, head_lines, subject
from tirefit.report.page import GOOD, OPEN, Section, fragment, image_of, page


def _answer(result: Diagnosis) -> Mapping:
    is_closed = result.verdict.status in (Status.NONE, Status.NAMED)
    return {
        "sentence": answer(result),
        "lines": list(head_lines(result)),
        "color": GOOD if is_closed else OPEN,
    }


def _shown(sections: Sequence[Section], panels: Mapping[str, Panel]) -> list[Section]:
    """The sections with the pictures of the panels that they name."""
    return [
        one._replace(pictures=images_of([panels[name] for name in one.pictures if name in panels]))
        for one in sections
    ]


def diagnosis_page(result: Diagnosis) -> str:
    """The whole diagnosis as one HTML document, without script or external files."""
    sections = [
        *_shown(first_screen(result), panels_of(result)),
        *(section._replace(folded=True) for section in details(result)),
        Section("", [foot_line(result)]),
    ]
    return page(subject(result), sections, _answer(result), record=result.to_json())


def diagnosis_fragment(result: Diagnosis) -> str:
    """The answer, the first screen and the figure for a notebook."""
    picture = diagnosis_figure(result)
    picture.set_dpi(90)
    image = image_of(picture, "; ".join(panel.alternative for panel in panels_of(result).values()))
    sections = [Section("", pictures=[image]), *_shown(first_screen(result), {})]
    return fragment(f"{subject(result)}, {result.n} rows", sections, _answer(result))
