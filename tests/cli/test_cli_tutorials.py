"""The commands of the manual run as printed, and print what the manual shows."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tirefit.cli.commands import app

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "docs" / "getting-started.md", *sorted((ROOT / "docs" / "tutorials").glob("*.md"))]
FILES = (ROOT / "docs" / "reference" / "files.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```console\n(.*?)^```", re.MULTILINE | re.DOTALL)
PYTHON = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def steps(text):
    """(command, lines of output that the page shows) of each command of a page."""
    found = []
    for line in "".join(BLOCK.findall(text)).splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        elif found[-1][0].endswith("\\"):
            found[-1] = (found[-1][0][:-1] + line.strip(), [])
        else:
            found[-1][1].append(line)
    return found


def missing(shown, printed):
    """The first part that a page shows and the command did not print, in this order.
    Lines `...` between parts stand for any text; where a line is broken is no matter.
    """
    printed, at = " ".join(printed.split()), 0
    for part in " ".join(line.strip() for line in shown).split("..."):
        part = " ".join(part.split())
        found = printed.find(part, at)
        if found < 0:
            return part
        at = found + len(part)
    return None


def undocumented(path):
    """Keys of a JSON file that the reference of its schema does not list."""
    content = json.loads(path.read_text(encoding="utf-8"))
    section = FILES.partition(f"## {content['schema']}\n")[2].partition("\n## ")[0]
    keys = {
        key
        for row in re.findall(r"^\| (`.*?) \|", section, re.MULTILINE)
        for key in re.findall(r"`(\w+)`", row)
    }
    return sorted(set(content) - keys)


def run(command):
    program, *words = shlex.split(command)
    if program == "tirefit":
        result = CliRunner().invoke(app, words)
        assert result.exit_code == 0, result.output
        return result.output
    assert program == "python"
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=True)
    return done.stdout


LONG = ("rig", "simulator", "vehicle-log")
"""Pages of the dearest commands, each of which other tests of its own file run."""


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.stem, marks=[pytest.mark.long] * (page.stem in LONG))
        for page in PAGES
    ],
)
def test_commands_of_a_page_print_the_shown_output(page, unrendered, tmp_path, monkeypatch):
    text = page.read_text(encoding="utf-8")
    large = shutil.ignore_patterns("*.png", "*.ipynb")
    shutil.copytree(ROOT / "fits", tmp_path / "fits", ignore=large)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("COLUMNS", "88")
    assert steps(text)
    for command, shown in steps(text):
        printed = run(command)
        assert missing(shown, printed) is None, (command, printed)
    for code in PYTHON.findall(text):
        exec(code, {})
    written = [*tmp_path.glob("*.json"), *tmp_path.glob("[!f]*/**/*.json")]
    assert {str(path): undocumented(path) for path in written if undocumented(path)} == {}


@pytest.mark.parametrize(
    ("shown", "absent"),
    [
        ("a\nb", None),
        ("...\nb\n...\nd", None),
        ("b  c\n", None),
        ("a\nc", "a c"),
        ("...\nx", "x"),
        ("d\n...\na", "a"),
    ],
)
def test_a_line_that_is_not_printed_is_detected(shown, absent):
    assert missing(shown.splitlines(), "a\nb\nc\n d\n") == absent


def test_commands_and_their_output_are_taken_from_a_page():
    page = "Text\n\n```console\n$ tirefit fit a \\\n    --out b\nout\n...\n$ c\n```\n"
    assert steps(page) == [("tirefit fit a --out b", ["out", "..."]), ("c", [])]
