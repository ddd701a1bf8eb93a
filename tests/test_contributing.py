"""CONTRIBUTING.md describes the existing structure."""

import re
from pathlib import Path

from test_layers import LAYERS, PACKAGE

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
LAYER = re.compile(r"^    (\d)  (\w+) ", re.MULTILINE)


def test_the_documented_layers_are_right():
    layers = {name: int(layer) for layer, name in LAYER.findall(TEXT)}
    assert layers == {name: LAYERS[name] for name in layers} and len(layers) == 16
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders <= set(layers)


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
