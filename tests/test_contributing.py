"""CONTRIBUTING.md describes the existing structure."""

import re
from pathlib import Path

from test_layers import FLOORS, PACKAGE

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
FLOOR = re.compile(r"^    (\d)  (\w+) ", re.MULTILINE)


def test_the_documented_layers_are_right():
    rooms = {name: int(floor) for floor, name in FLOOR.findall(TEXT)}
    assert rooms == {name: FLOORS[name] for name in rooms} and len(rooms) == 16
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders <= set(rooms)


def test_the_named_files_exist():
    paths = re.findall(r"`((?:tirefit|tests|fits)/[^`\s]*)`", TEXT)
    assert len(paths) > 10
    assert [path for path in paths if not (ROOT / path).exists()] == []
    targets = set(re.findall(r"`make ([a-z-]+)`", TEXT))
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    made = {
        name
        for line in re.findall(r"^([a-z -]+):", makefile, re.MULTILINE)
        for name in line.split()
    }
    assert len(targets) > 5 and targets <= made
