"""A diagnosis as one self-contained page, and as a fragment for notebooks."""

from collections.abc import Mapping, Sequence

from tirefit.diagnosis.summary.records import Status
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.report.diagnosis_details import details
from tirefit.report.diagnosis_draw import diagnosis_figure, panel_pictures, panels_of
from tirefit.report.diagnosis_sections import answer, first_screen, foot_line, head_lines, subject
from tirefit.report.html import GOOD, OPEN, Section, fragment, image_of, page

_ALTERNATIVES = {
    "sizes": "Size of each effect that helps, in groups of the rows",
    "ladder": "Rms on data left out, step by step, down to the noise",
    "which": "Probability that each effect is a cause, as bars",
    "where": "Map of measured minus fitted force over slip and another quantity",
    "before and after": "Force over slip and residuals, of the base fit and after it",
    "what is left": "Remainder: change of a parameter over the quantity that it depends on",
    "budget": "Waterfall from the simulator's error, part by part, to the noise",
}


def _alternative(name: str) -> str:
    """Description of a panel by name; for a panel of a channel, by the text before ``of``."""
    kind, of_channel, channel = name.partition(" of ")
    return _ALTERNATIVES[kind] + (f", of {channel}" if of_channel else "")


def _answer(result: Diagnosis) -> Mapping:
    is_closed = result.verdict.status in (Status.NONE, Status.NAMED)
    return {
        "sentence": answer(result),
        "lines": list(head_lines(result)),
        "color": GOOD if is_closed else OPEN,
    }


def _shown(sections: Sequence[Section], pictures: Mapping) -> list[Section]:
    """The sections with the pictures that their names stand for."""
    return [
        section._replace(
            pictures=[
                image_of(pictures[name], _alternative(name))
                for name in section.pictures
                if name in pictures
            ]
        )
        for section in sections
    ]


def diagnosis_page(result: Diagnosis) -> str:
    """The whole diagnosis as one HTML document, without script or external files."""
    sections = [
        *_shown(first_screen(result), panel_pictures(result)),
        *(section._replace(folded=True) for section in details(result)),
        Section("", [foot_line(result)]),
    ]
    return page(subject(result), sections, _answer(result), record=result.to_json())


def diagnosis_fragment(result: Diagnosis) -> str:
    """The answer, the first screen and the figure for a notebook."""
    picture = diagnosis_figure(result)
    picture.set_dpi(90)
    image = image_of(picture, "; ".join(map(_alternative, panels_of(result))))
    sections = [Section("", pictures=[image]), *_shown(first_screen(result), {})]
    return fragment(f"{subject(result)}, {result.n} rows", sections, _answer(result))
