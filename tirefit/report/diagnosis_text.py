"""A diagnosis as text: the short or the full report."""

import textwrap
from collections.abc import Iterator

from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.report.diagnosis_answer import answer
from tirefit.report.diagnosis_details import details
from tirefit.report.diagnosis_sections import first_screen, foot_line, head_lines, subject
from tirefit.report.page import WIDTH, Section, table


def _text_of(section: Section) -> Iterator[str]:
    if section.lines or section.table:
        title, bracket, rest = section.title.partition(" (")
        yield from _wrapped(title.upper() + bracket + rest)
    if section.table:
        yield from table([list(row) for row in section.table])
    for line in section.lines:
        yield from _wrapped(f"  {line}")


def _wrapped(line: str) -> list[str]:
    return textwrap.wrap(
        line, WIDTH, subsequent_indent=" " * 6, break_long_words=False, break_on_hyphens=False
    )


def diagnosis_text(result: Diagnosis, full: bool = False) -> str:
    """The report of one file: the answer first, then what to do.

    Args:
        full: with where the gap lies, all candidates, forecast, noise and settings.
    """
    sections = first_screen(result) + (details(result) if full else [])
    more = "" if full else "; details: --full, or the JSON document"
    first = Section("Answer", [answer(result), *head_lines(result)])
    lines = _wrapped(f"DIAGNOSIS of {subject(result)}")
    for section in (first, *sections):
        lines += _text_of(section)
    return "\n".join([*lines, *_wrapped(foot_line(result) + more)])
