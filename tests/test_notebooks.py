"""The notebooks of ``fits/`` run and reproduce their stored output."""

import base64
import re
import runpy
import shutil
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "fits" / "notebooks").glob("*.ipynb"))
DATA = (
    Path("dart_rear_axle", "free_driving.csv"),
    Path("diagnosis_measured", "diagnosed.csv"),
    Path("diagnosis_measured", "held_out.csv"),
    Path("dart_simulator", "circles.csv"),
    Path("dart_simulator", "free_driving.csv"),
    *(Path("export", f"{t}_{axle}.csv") for t in "ad" for axle in ("front", "rear")),
    Path("export", "avoidance.py"),
    Path("replay", "cars.py"),
    *(Path("measured_changes", "f1tenth", f"{tires}.csv.gz") for tires in "ad"),
    Path("measured_changes", "f1tenth", "vehicle.toml"),
)
NAMES = [path.stem for path in NOTEBOOKS]

execute = runpy.run_path(str(ROOT / "fits" / "run_notebooks.py"))["execute"]

# "mu  0.702 ± 0.034" of a report, "mu = 0.702 ± 0.034" of a comparison.
ESTIMATE = re.compile(r"\b([A-Za-z]\w*)(?: =)? +(-?[\d.]+) ± ([\d.]+)")


# Kernels inherit the compilation cache of the tests (conftest.py), which fits of the
# same data have filled. JAX warns where another process is just writing an entry.
KERNEL = {"PYTHONWARNINGS": "ignore:Error reading persistent compilation cache"}


def outputs(notebook):
    return [
        output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs
    ]


def text(notebook) -> str:
    """The visible text of the outputs, without figures and tags."""
    parts = []
    for output in outputs(notebook):
        data = output.get("data", {})
        seen = output.get("text") or data.get("text/html") or ""
        parts.append(re.sub(r"<img[^>]*>|</?\w+[^>]*>", " ", seen))
    return "\n".join(parts)


def rich(notebook, kind: str) -> list:
    found = (output.get("data", {}).get(kind) for output in outputs(notebook))
    return [content for content in found if content is not None]


def test_all_six_notebooks_exist():
    assert NAMES == [
        "brush_against_magic_formula",
        "diagnose_a_measured_case",
        "diagnose_a_simulator",
        "explore_a_fit",
        "export_a_tire",
        "predict_a_car",
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=NAMES)
def test_committed_notebooks_are_clean(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert path.stat().st_size < 700_000
    assert notebook.metadata.kernelspec.name == "python3"
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert all(not cell.metadata for cell in notebook.cells)
    kinds = {output.output_type for output in outputs(notebook)}
    assert kinds <= {"stream", "execute_result", "display_data"}
    assert all(output.get("name", "stdout") == "stdout" for output in outputs(notebook))
    content = re.sub(r'"image/png": "[^"]*"|base64,[^"\\]*', "", path.read_text("utf-8"))
    machine = re.search(r"/home|/root|/tmp|/work|/Users|[A-Z]:\\\\| at 0x", content)
    assert machine is None, content[machine.start() - 40 : machine.end() + 40]


@pytest.mark.long
@pytest.mark.parametrize("path", NOTEBOOKS, ids=NAMES)
def test_notebooks_reproduce_their_stored_output(path, tmp_path):
    place = tmp_path / "fits" / "notebooks" / path.name
    for source, target in (
        (path, place),
        *((ROOT / "fits" / data, tmp_path / "fits" / data) for data in DATA),
    ):
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source, target)
    committed = nbformat.read(path, as_version=4)
    new = execute(place, **KERNEL)

    assert [o.output_type for o in outputs(new)] == [o.output_type for o in outputs(committed)]
    pictures = rich(new, "image/png")
    assert pictures
    assert all(base64.b64decode(one).startswith(b"\x89PNG") for one in pictures)
    before, now = (ESTIMATE.findall(text(book)) for book in (committed, new))
    assert len(before) >= 10
    assert [label for label, *_ in now] == [label for label, *_ in before]
    for (label, *old), (_, *found) in zip(before, now, strict=True):
        (value, std), (new_value, new_std) = map(float, old), map(float, found)
        # Estimates repeat to rounding; 0.1 std is what the sampling may move.
        moved = f"{label}: {old} in the committed notebook, now {found}: make notebooks"
        assert abs(new_value - value) <= 0.1 * std + rounding(old[0]), moved
        assert abs(new_std - std) <= 0.1 * std + rounding(old[1]), moved


def rounding(number: str) -> float:
    """One unit of the last printed digit."""
    return 10.0 ** -len(number.partition(".")[2])


def test_data_and_fit_have_a_notebook_display():
    book = next(path for path in NOTEBOOKS if path.stem == "explore_a_fit")
    tables = rich(nbformat.read(book, as_version=4), "text/html")
    assert len([one for one in tables if "<table" in one]) >= 3
    data, fit = tables[:2]
    assert "2642 rows" in data
    assert "read as alpha in rad" in data
    assert "Verdict" in fit
    assert "data:image/png;base64," in fit
