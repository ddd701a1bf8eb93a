"""Hooks of mkdocs: which files the manual holds, and the pages that are generated.

Every file keeps its path in the repository as its name, so that a link between two
Markdown files works in the manual and where the repository is read.
"""

import sys
from pathlib import Path

from mkdocs.structure.files import File, Files

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import generated  # noqa: E402  a file beside this one

ROOT = HERE.parent
ALONE = (
    "*.md",
    "LICENSE",
    "CITATION.cff",
    "tests/bench/README.md",
    "tirefit/diagnosis/calibration.json",
)
FOLDERS = ("docs", "fits")
KINDS = {".md", ".png", ".csv", ".toml", ".json", ".ipynb", ".py"}
KINDS |= {".dat", ".tdx", ".mat", ".parquet", ".xlsx", ".mf4", ".mcap"}
"""Files of the folders that a page may link to, samples among them."""


def on_files(files, config):
    """The pages of the repository with the files that they link to, and those that are
    generated; of the files that mkdocs found, those of the theme."""
    paths = [path for pattern in ALONE for path in ROOT.glob(pattern)]
    for folder in FOLDERS:
        paths += [p for p in (ROOT / folder).rglob("*") if p.suffix in KINDS]
    shown = [p for p in paths if p.parent.name[0] != "_" and p.parent != HERE]
    shown += HERE.glob("*.md")
    names = sorted(str(path.relative_to(ROOT)) for path in shown)
    made = [
        File.generated(config, name, content=content) for name, content in generated.pages().items()
    ]
    stored = [File(name, str(ROOT), config.site_dir, True) for name in names]
    for file in (*stored, *made):
        file.dest_uri = file.dest_uri.removeprefix("docs/")
    theme = [file for file in files if file.src_dir != config.docs_dir]
    return Files([*theme, *stored, *made])


def on_page_markdown(markdown, page, config, files):
    """Put the text that is generated into the place of its marker."""
    return generated.fill(markdown)
