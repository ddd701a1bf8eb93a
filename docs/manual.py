"""Write the sources of the manual to a folder: ``python docs/manual.py [FOLDER]``.

Every file keeps its path in the repository, so that a link between two Markdown files works in
the manual and where the repository is read. Pages and texts that come from the package are
written as files too, so any program that builds a site from Markdown builds this folder.
"""

import os
import re
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path.insert(0, str(ROOT))

import generated  # noqa: E402  a file beside this one, which reads the package

FOLDER = ROOT / "build" / "manual"
ALONE = (
    "*.md",
    "LICENSE",
    "CITATION.cff",
    "fits/bench/README.md",
    "tirefit/diagnosis/calibration.json",
)
FOLDERS = ("docs", "fits")
KINDS = {".md", ".png", ".css", ".csv", ".toml", ".json", ".ipynb", ".py"}
KINDS |= {".dat", ".tdx", ".mat", ".parquet", ".xlsx", ".mf4", ".mcap"}
"""Files of the folders that a page may link to, samples among them."""
IMAGE, WIDE, FLAT = re.compile(r"!\[[^\]]*\]\(([^)]+\.png)\)"), 740, 1.7
"""An image in Markdown; width in pixels, and over the height, above which its letters are small
on a phone."""


def sources():
    """Paths of the repository that the manual holds."""
    paths = [path for pattern in ALONE for path in ROOT.glob(pattern)]
    for folder in FOLDERS:
        paths += [p for p in (ROOT / folder).rglob("*") if p.suffix in KINDS]
    return sorted(p for p in paths if p.parent.name[0] != "_")


def write(folder=FOLDER):
    """Delete the folder, and write all pages and the files that they link to into it."""
    shutil.rmtree(folder, ignore_errors=True)
    files = {str(path.relative_to(ROOT)): path.read_bytes() for path in sources()}
    for name, content in generated.pages().items():
        files[name] = content if isinstance(content, bytes) else content.encode()
    for name, content in files.items():
        if name.endswith(".md"):
            text = generated.fill(content.decode())
            content = IMAGE.sub(lambda found, at=name: _sized(found, at, files), text).encode()
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)


def _sized(image, page, files):
    """An image of a page, marked if its letters are small on a phone."""
    path = os.path.normpath(Path(page).parent / image[1])
    head = files.get(path, bytes(24))
    width, height = int.from_bytes(head[16:20]), int.from_bytes(head[20:24])
    return image[0] + "{.wide}" * (width > min(WIDE, FLAT * height))


if __name__ == "__main__":
    write(*map(Path, sys.argv[1:]))
