"""The commands of the manual run as printed, and print what the manual shows."""

import io
import json
import re
import shlex
import shutil
import subprocess
import sys
import time
from contextlib import redirect_stdout
from glob import glob
from pathlib import Path
from typing import NamedTuple

import pytest
from typer.testing import CliRunner

from tirefit.cli.commands import app
from tirefit.models import MODELS

ROOT = Path(__file__).parents[2]
FILES = (ROOT / "docs" / "reference" / "files.md").read_text(encoding="utf-8")
FENCE = re.compile(r'^ *```(\w*)(?: title="(.*)")?$')
SHELL = ("console", "sh")

REPEATED = {"docs/how-to/magic-formula.md": "docs/tutorials/rig.md"}
"""Page -> the page that runs the same commands; they take minutes."""

SCHEDULER = "tcp://127.0.0.1:8786"
"""Address on the page of clusters; another scheduler of this machine may have the port."""


class Block(NamedTuple):
    """A fenced or indented block of a page."""

    language: str  # of its fence; "console" of indented commands, else ""
    title: str | None
    lines: list[str]


def blocks(text):
    """All blocks of a page, in order."""
    found, within = [], None
    for line in text.splitlines():
        fence = FENCE.match(line)
        if fence and within != "fence":
            found.append(Block(fence[1], fence[2], []))
            within = "fence"
        elif fence:
            within = None
        elif within == "fence":
            found[-1].lines.append(line)
        elif line.startswith("    "):
            if within is None:
                found.append(Block("console" if line.startswith("    $ ") else "", None, []))
            within = "indent"
            found[-1].lines.append(line[4:])
        elif line:
            within = None  # an empty line does not end an indented block
    return found


def steps(block):
    """(command, lines of output that the page shows) of each command of a block."""
    found = []
    for line in block.lines:
        begins = line.startswith("$ ") or block.language == "sh"
        if found and found[-1][0].endswith("\\"):
            found[-1] = (found[-1][0][:-1] + line.strip(), [])
        elif begins:
            found.append((line.removeprefix("$ "), []))
        elif found:
            found[-1][1].append(line)
    return [(command, shown) for command, shown in found if command.strip()]


def has_commands(text):
    return any(block.language in (*SHELL, "python", "c") for block in blocks(text))


PAGES = {
    str(path.relative_to(ROOT)): path
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
    if has_commands(path.read_text(encoding="utf-8"))
}


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
    if "schema" not in content:  # a file of another program
        return []
    section = FILES.partition(f"## {content['schema']}\n")[2].partition("\n## ")[0]
    keys = {
        key
        for row in re.findall(r"^\| (`.*?) \|", section, re.MULTILINE)
        for key in re.findall(r"`(\w+)`", row)
    }
    return sorted(set(content) - keys)


@pytest.fixture
def served(tmp_path):
    """Start a `dask` command of a page in the background; its processes end with the test."""
    processes, file = [], tmp_path / "scheduler.json"

    def start(words):
        if words[1] == "scheduler":
            words = [*words, "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
            words += ["--scheduler-file", str(file)]
        else:
            words = [word for word in words if word != SCHEDULER] + ["--scheduler-file", str(file)]
        line = [str(Path(sys.executable).parent / "dask"), *words[1:]]
        with (tmp_path / f"{words[1]}.log").open("w") as log:
            processes.append(subprocess.Popen(line, stdout=log, stderr=log))
        while not file.exists():
            assert processes[0].poll() is None, (tmp_path / "scheduler.log").read_text()
            time.sleep(0.1)

    start.address = lambda: json.loads(file.read_text())["address"]
    yield start
    for process in reversed(processes):
        process.terminate()
        process.wait()


def run(command, served):
    """Run a command here if it is tirefit, else as a process; what it prints."""
    words = shlex.split(command, comments=True)
    if words[0] == "dask":
        served(words)
        return ""
    words = [served.address() if word == SCHEDULER else word for word in words]
    given = None
    if "<" in words:
        given = Path(words[words.index("<") + 1]).read_text(encoding="utf-8")
        words = words[: words.index("<")]
    words[1:] = [one for word in words[1:] for one in (sorted(glob(word)) or [word])]
    if words[0] == "tirefit":
        result = CliRunner().invoke(app, words[1:], input=given)
        # An exported tire may exceed the ellipse, which its page shows or states.
        code = 4 if "the tire fails a check of its forces" in result.output else 0
        # The sample's drive does not reach the peak, nor do some of the fits.
        code = code or 6 * ("friction rests on the shape of the model:" in result.output)
        assert result.exit_code == code, (command, result.output, result.exception)
        return result.output
    if words[0] in ("make", "source", "pip"):  # the installation, which the tests stand on
        return ""
    assert words[0] in ("python", "gcc", "./call", "mkdir")
    words[0] = sys.executable if words[0] == "python" else words[0]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout


def run_block(block, names, served):
    """Run the commands or the code of a block; what code printed."""
    if block.title and "." in block.title:  # a file that later commands read
        text = "\n".join([*block.lines, ""])
        Path(block.title).write_text(text, encoding="utf-8")
    elif block.language == "python":
        printed = io.StringIO()
        with redirect_stdout(printed):
            exec("\n".join(block.lines), names)
        return printed.getvalue()
    elif block.language in SHELL:
        for command, shown in steps(block):
            if command.startswith(("gcc", "./call")) and shutil.which("gcc") is None:
                continue
            printed = run(command, served)
            assert missing(shown, printed) is None, (command, printed)
    return ""


SHORT = ("docs/getting-started.md", "docs/tutorials/friction.md")
"""Pages whose commands take less than 10 s of processor time."""


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(name, marks=[pytest.mark.long] * (name not in SHORT))
        for name in PAGES
        if name not in REPEATED
    ],
)
def test_commands_of_a_page_print_the_shown_output(page, unrendered, served, tmp_path, monkeypatch):
    large = shutil.ignore_patterns("*.png", "*.ipynb")
    shutil.copytree(ROOT / "fits", tmp_path / "fits", ignore=large)
    for samples in ("docs/samples", "tirefit/samples", "tests/data/tir"):
        shutil.copytree(ROOT / samples, tmp_path / samples)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("COLUMNS", "88")
    monkeypatch.setitem(MODELS, "saturating", None)  # which one page adds for good
    names, printed = {"__name__": "page"}, ""
    for block in blocks(PAGES[page].read_text(encoding="utf-8")):
        if not block.language and printed:  # the output of the code above it
            assert missing(block.lines, printed) is None, printed
        printed = run_block(block, names, served)
    written = [*tmp_path.glob("*.json"), *tmp_path.glob("[!fdt]*/**/*.json")]
    if "how-to" not in page:
        assert {str(path): undocumented(path) for path in written if undocumented(path)} == {}


def commands(page):
    """All commands of a page, without comments."""
    text = PAGES[page].read_text(encoding="utf-8")
    found = [command for one in blocks(text) if one.language in SHELL for command, _ in steps(one)]
    return [shlex.split(command, comments=True) for command in found]


@pytest.mark.parametrize("page", REPEATED)
def test_the_commands_of_a_page_that_is_not_run_are_those_of_another(page):
    assert commands(page)
    assert [one for one in commands(page) if one not in commands(REPEATED[page])] == []


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
    page = (
        "Text\n\n```console\n$ tirefit fit a \\\n    --out b\nout\n...\n$ c\n```\n"
        "```sh\nd  # why\ne \\\n  f\n```\n\n    $ g\n    said\n\n    more\n\nText\n\n    h\n"
        '\n```c title="call.c"\nint i;\n```\n'
    )
    found = blocks(page)
    assert [block.language for block in found] == ["console", "sh", "console", "", "c"]
    assert steps(found[0]) == [("tirefit fit a --out b", ["out", "..."]), ("c", [])]
    assert steps(found[1]) == [("d  # why", []), ("e f", [])]
    assert steps(found[2]) == [("g", ["said", "more"])]
    assert (found[4].title, found[4].lines) == ("call.c", ["int i;"])
