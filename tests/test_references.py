"""Every equation and every paper that the package cites is listed."""

import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

import tirefit

ROOT = Path(__file__).parents[1]
PACKAGE = sorted((ROOT / "tirefit").rglob("*.py"))
TESTS = [*ROOT.glob("tests/**/*.py"), *ROOT.glob("fits/**/*.py")]
TEXTS = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("fits/**/*.md")]

CITED = re.compile(r"(?<![A-Za-z0-9_\\{])([SO])\((\d+)([a-z]?|\.\d+)\)(?:-\((\d+)\))?")
# "S(10), (24)" and "S(45) and (46)": the letter stands once.
MORE = re.compile(r"((?:, | and )\((\d+)([a-z]?)\))(?:-\((\d+)\))?")
# "Hall & Hausman 1974)", "Neal (2011)", "(Applied Statistics 37, 1988)".
PAPER = re.compile(r"(?<=[ (])((?:19|20)\d\d)\)")
NEAR = 150
"""Letters before the year among which the names stand, none of another citation."""


def equations(text):
    """(source, number, letter) of every equation in a text, ranges expanded."""
    # A reference may go on in the next line, as of a comment.
    text = re.sub(r"\s*\n\s*#?\s*", " ", text)
    for start in CITED.finditer(text):
        source, at = start[1], start.end()
        parts = [(start[2], start[3], start[4])]
        while more := MORE.match(text, at):
            parts.append((more[2], more[3], more[4]))
            at = more.end()
        for number, letter, last in parts:
            for n in range(int(number), int(last or number) + 1):
                yield source, n, letter


def listed():
    """The equations of EQUATIONS.md; S(17) represents S(17a) to S(17c) together."""
    lines = (ROOT / "EQUATIONS.md").read_text(encoding="utf-8").splitlines()
    rows = [line for line in lines if re.match(r"\| [SO]\(", line)]
    there = [each for row in rows for each in equations(row.split("|")[1])]
    assert len(there) == len(set(there)), "an equation has two lines"
    return {*there, ("S", 17, "")}


LISTED = listed()


def unknown(text):
    return [f"{s}({n}{letter})" for s, n, letter in equations(text) if (s, n, letter) not in LISTED]


@pytest.mark.parametrize("files", [PACKAGE, TESTS, TEXTS], ids=["package", "tests", "texts"])
def test_every_cited_equation_has_a_line(files):
    here = Path(__file__).resolve()
    cited = {
        str(path.relative_to(ROOT)): unknown(path.read_text(encoding="utf-8"))
        for path in files
        if path.resolve() != here
    }
    assert {path: wrong for path, wrong in cited.items() if wrong} == {}


def test_the_sources_are_listed_completely():
    assert {n for source, n, _ in LISTED if source == "S"} == set(range(1, 53))
    assert {n for source, n, _ in LISTED if source == "O"} == set(range(1, 23))


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("as in S(12) and O(22)", []),
        ("S(999)", ["S(999)"]),
        ("O(23)", ["O(23)"]),
        ("S(12), (14), (29), (31)-(37)", []),
        ("S(12), (53)", ["S(53)"]),
        ("S(50)-(54)", ["S(53)", "S(54)"]),
        ("S(36)\n    # and (77)", ["S(77)"]),
        ("S(17c)", []),
        ("S(17d)", ["S(17d)"]),
        ("S(12a)", ["S(12a)"]),
        ("O(4.13)", ["O(4.13)"]),
        ("EQUATIONS(99), S(theta)", []),
    ],
)
def test_the_check_detects_missing_equations(text, wrong):
    assert unknown(text) == wrong


@cache
def prose(path):
    """Comments and docstrings of a file with a year in brackets, in one line."""
    if not re.search(r"\d{4}\)", path.read_text(encoding="utf-8")):
        return ""
    with tokenize.open(path) as file:
        tokens = list(tokenize.generate_tokens(file.readline))
    kinds = (tokenize.COMMENT, tokenize.STRING)
    parts = [token.string.lstrip("#") for token in tokens if token.type in kinds]
    return " ".join(" ".join(parts).split())


def references():
    """(surnames, text) of every paper in the list of sources."""
    text = (ROOT / "docs" / "reference" / "sources.md").read_text(encoding="utf-8")
    for entry in re.split(r"\n- ", text.partition("Other papers")[2])[1:]:
        yield re.findall(r"[A-ZÄÖÜ][a-zäöü]{2,}", entry.split(":")[0]), entry


def papers(text):
    """(preceding words, year) of every citation."""
    end = 0
    for year in PAPER.finditer(text):
        yield text[max(end, year.start() - NEAR) : year.start()], year[1]
        end = year.end()


def without_reference(text):
    """Citations without a paper of that surname and year in the list."""
    known = list(references())
    return [
        f"{before}{year})"
        for before, year in papers(text)
        if not any(
            year in entry and any(name in before for name in names) for names, entry in known
        )
    ]


def test_every_cited_paper_has_its_reference():
    files = [path for path in PACKAGE if path.parent.name != "tirefit"]
    cited = {path.name: without_reference(prose(path)) for path in files}
    assert {name: wrong for name, wrong in cited.items() if wrong} == {}
    assert sum(len(list(papers(prose(path)))) for path in files) >= 5


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("in ten (ter Braak 2006)", 0),
        ("of Pacejka, *Tire and Vehicle Dynamics*, 3rd ed. (2012)", 0),
        ("as Pacejka (2013)", 1),
        ("(Applied Statistics 37, 1988)", 1),
        ("by DerSimonian and Laird (Controlled Clinical Trials 7, 1986)", 0),
        ("(Nobody 2001)", 1),
        ("2,000 rows", 0),
    ],
)
def test_the_check_detects_missing_papers(text, count):
    assert len(without_reference(text)) == count


def test_the_two_sources_are_in_docstring_and_readme():
    texts = tirefit.__doc__, (ROOT / "README.md").read_text(encoding="utf-8")
    for text in (" ".join(text.split()) for text in texts):
        for part in ("Review of Wheel Modeling and Friction Estimation", "TFRT-7607",
                     "Svendenius", "Wittenmark", "Lund Institute", "Ono", "Yasui",
                     "characteristics using wheel velocity", "1361-1370"):  # fmt: skip
            assert part in text, part
