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


def test_the_page_of_a_fit_is_linked_to_its_sliders_beside_it(run, unrendered):
    pytest.importorskip("plotly")
    run("fit", CIRCLES, "--no-posterior", "--html", "--out", "out")
    page = Path("out/fit.html")
    before = page.read_text()
    assert "tirefit explore fit.json" in before
    run("explore", "brush", "--out", "out/brush.html")  # of another tire
    run("explore", "out", "--out", "elsewhere.html")  # in another folder
    assert page.read_text() == before
    said = run("explore", "out/fit.json", "--out", "out/my tire.html").stdout
    assert said.endswith("linked from out/fit.html\n")
    link = '<a href="my%20tire.html">sliders of load, camber, speed and slip</a>'
    assert link in page.read_text() and "tirefit explore" not in page.read_text()
    assert len(page.read_text()) == pytest.approx(len(before), abs=100)
    mine = "sliders of load, camber, speed and slip: run tirefit explore fit.json in this folder"
    page.write_text(mine)  # not written by tirefit
    run("explore", "out/fit.json", "--out", "out/my tire.html")
    assert page.read_text() == mine


@pytest.mark.parametrize(
    ("arguments", "code", "reason"),
    [
        (["none.json"], 3, "none.json: cannot read it"),
        (["."], 3, "neither a fit.json nor a .tir file in this folder"),
        (["brush"] * 7, 3, "7 tires: a page shows 1 to 6"),
        (["brush", "--data", "none.csv"], 3, "none.csv"),
        (["brush", "--out", "none/tire.html"], 2, "there is no folder none"),
        (["brush", "--out", "tire.txt"], 2, "tire.txt: the output is a HTML"),
        (["brusch"], 2, "did you mean 'brush'"),
        (["no folder"], 2, "no folder: there is no such file or folder"),
    ],
)
def test_a_fault_is_named_and_nothing_written(run, arguments, code, reason):
    ended = run("explore", *arguments, exit_code=code)
    assert reason in ended.stderr and "remedy:" in ended.stderr
    assert not list(Path().iterdir())
