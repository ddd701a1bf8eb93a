"""Write the sources of the manual to a folder: ``python docs/manual.py [FOLDER]``.

Every file keeps its path in the repository, so that a link between two Markdown files works in
the manual and where the repository is read. Pages and texts that come from the package are
written as files too, so any program that builds a site from Markdown builds this folder.
"""

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
    "tests/bench/README.md",
    "tirefit/diagnosis/calibration.json",
)
FOLDERS = ("docs", "fits")
KINDS = {".md", ".png", ".csv", ".toml", ".json", ".ipynb", ".py"}
KINDS |= {".dat", ".tdx", ".mat", ".parquet", ".xlsx", ".mf4", ".mcap"}
"""Files of the folders that a page may link to, samples among them."""


def sources():
    """Paths of the repository that the manual holds."""
    paths = [path for pattern in ALONE for path in ROOT.glob(pattern)]
    for folder in FOLDERS:
        paths += [p for p in (ROOT / folder).rglob("*") if p.suffix in KINDS]
    return sorted(p for p in paths if p.parent.name[0] != "_")


def write(folder=FOLDER):
    """Delete the folder, and write all pages and the files that they link to into it."""
    shutil.rmtree(folder, ignore_errors=True)
    for path in sources():
        target = folder / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".md":
            text = generated.fill(path.read_text(encoding="utf-8"))
            target.write_text(text, encoding="utf-8")
        else:
            shutil.copyfile(path, target)
    for name, content in generated.pages().items():
        data = content if isinstance(content, bytes) else content.encode()
        (folder / name).write_bytes(data)


if __name__ == "__main__":
    write(*map(Path, sys.argv[1:]))
