"""``tirefit explore`` writes one page, or says why not."""

from importlib.resources import files
from pathlib import Path

import pytest

CIRCLES = Path(str(files("tirefit") / "samples" / "circles.csv"))


def test_a_page_of_two_tires_and_rows(run):
    pytest.importorskip("plotly")
    said = run("explore", "brush", "lugre", "--data", CIRCLES, "--out", "tire.html").stdout
    assert "measured rows" in said and said.endswith("wrote tire.html: open it in a browser\n")
    page = Path("tire.html").read_text()
    assert "brush against lugre" in page and '"schema": "tirefit.explore/1"' in page
    run("explore", "brush")  # its own page is replaced
    run("explore", "lugre")
    assert sorted(path.name for path in Path().iterdir()) == ["explore.html", "tire.html"]


@pytest.mark.parametrize(
    ("arguments", "code", "reason"),
    [
        (["none.json"], 3, "none.json: cannot read it"),
        (["."], 3, "neither a fit.json nor a .tir file in this folder"),
        (["brush"] * 7, 3, "7 tires: a page shows 1 to 6"),
        (["brush", "--data", "none.csv"], 3, "none.csv"),
        (["brush", "--out", "none/tire.html"], 2, "the folder none does not exist"),
        (["brush", "--out", "tire.txt"], 2, "tire.txt: the output is a HTML"),
        (["brusch"], 2, "did you mean brush"),
    ],
)
def test_a_fault_is_named_and_nothing_written(run, arguments, code, reason):
    ended = run("explore", *arguments, exit_code=code)
    assert reason in ended.stderr and "remedy:" in ended.stderr
    assert not list(Path().iterdir())
