"""Every command prints an assumption about many files once, with a count."""

import re
from pathlib import Path

import numpy as np
import pytest

FILES = 3


@pytest.fixture
def sweeps(tmp_path):
    """Braking sweeps, each at another load, which its header and a column state."""
    rng = np.random.default_rng(8)
    slip = np.linspace(-0.05, 0.2, 90)
    for number in range(FILES):
        load = 2000 + 500 * number
        force = load * np.tanh(12 * slip) + rng.normal(0, 10, len(slip))
        rows = [f"{k:.5f},{f:.1f},7,{load}" for k, f in zip(slip, force, strict=True)]
        text = "\n".join(["kappa,Fx,note,Fz", *rows]) + "\n"
        Path(tmp_path, f"sweep_{number}.csv").write_text(text)
    return [f"sweep_{number}.csv" for number in range(FILES)]


COMMANDS = {
    "inspect": ["inspect", "--no-gate"],
    "fit": ["fit", "--no-posterior", "--out", "fits"],
    "fit, joint": ["fit", "--no-posterior", "--joint", "--out", "joint"],
    "fit, Magic Formula": ["fit", "--model", "mf61", "--part", "fx", "--out", "mf"],
    "prepare": ["prepare", "--rate", "50", "--out", "cut"],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_every_note_is_printed_once_with_its_count(run, sweeps, no_figures, name):
    first, *rest = COMMANDS[name]
    done = run(first, *sweeps, *rest)
    stderr, stdout = (" ".join(text.split()) for text in (done.stderr, done.stdout))
    warning = f"warning: {FILES} files: no convention declared: read as braking"
    assert stderr.count(warning) == stderr.count("no convention declared") == 1
    if name == "prepare":  # it prints no assumptions, its record has them
        return
    column = "column 'kappa' read as kappa in -"
    if name in ("fit, joint", "fit, Magic Formula"):  # one report has a line of columns
        column = "columns kappa"
    for said in (column, "columns not read: 'note'"):
        assert len(re.findall(re.escape(said), stdout)) == 1, said
        assert said.startswith("columns kappa") or f"{FILES} files: {said}" in stdout


def test_the_report_of_one_file_has_all_notes(run, sweeps):
    done = run("inspect", "--no-gate", sweeps[0])
    assert "what was assumed\n" in done.stdout and "files" not in done.stdout
    assert done.stderr == ""


def test_the_page_of_each_fit_has_its_notes_and_that_of_all_those_kept_too(run, unrendered, sweeps):
    command = ("fit", *sweeps[:2], "--no-posterior", "--html", "--out", "o")
    run(*command)
    assert "columns not read" in Path("o/sweep_0/fit.html").read_text()
    text = Path("o/fits.html").read_text()
    Path("o/sweep_1/fit.html").unlink()
    assert run(*command, "--resume").stdout.count("done before, kept") == 1
    assert Path("o/fits.html").read_text() == text and "of 2 files" in text
