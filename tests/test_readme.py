"""The README and the manual are right: examples print the shown output, commands are
complete, exit codes are the existing ones."""

import re
import shutil
import textwrap
from pathlib import Path

import pytest

import tirefit
from tirefit.cli.commands import app
from tirefit.results import ExitCode

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
# The code, then its output, indented.
EXAMPLE = re.compile(r"```python\n(import jax\n.*?)```\n\n((?:    [^\n]*\n)+)", re.DOTALL)


def test_the_readme_is_short():
    assert len(README.splitlines()) <= 200


@pytest.mark.parametrize("page", ["README.md", "docs/how-to/model.md"])
def test_the_example_prints_the_shown_output(page, tmp_path, monkeypatch, capsys):
    text = (ROOT / page).read_text(encoding="utf-8")
    code, said = EXAMPLE.search(text).groups()
    case = tmp_path / "fits" / "dart_rear_axle"
    case.mkdir(parents=True)
    shutil.copy(ROOT / "fits" / "dart_rear_axle" / "free_driving.csv", case)
    monkeypatch.chdir(tmp_path)
    # The example of a model adds it for good: it is taken out again.
    monkeypatch.setitem(tirefit.MODELS, "saturating", None)
    exec(code, {})
    assert capsys.readouterr().out == textwrap.dedent(said)
    for figure in re.findall(r"savefig\(\"(.*?)\"\)", code):
        assert (tmp_path / figure).read_bytes().startswith(b"\x89PNG")


def test_every_simulate_command_names_its_output():
    """Without it the command refuses."""
    (row,) = re.findall(r"^\| (`tirefit simulate.*?) \|", README, re.MULTILINE)
    commands = re.findall(r"`[^`]*`", row)
    assert len(commands) == 3
    assert all(re.search(r" --out [A-Z]+\.csv", command) for command in commands)


def test_every_exit_code_is_listed(capsys):
    with pytest.raises(SystemExit):
        app(["--help"])
    listed = " ".join(capsys.readouterr().out.split())
    codes = [*(int(code) for code in ExitCode), 130]
    for text in (listed, " ".join(README.split())):
        said = text[text.index("Exit codes: ") :]
        assert all(re.search(rf"\b{code} [a-z]", said[:160]) for code in codes)
