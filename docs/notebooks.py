"""The notebooks of `fits/notebooks` as pages: their text, code and stored output."""

import base64
import re
from pathlib import Path

import nbformat

FOLDER = "fits/notebooks"
ROOT = Path(__file__).parents[1]
MATH = re.compile(r"\$([^$\n]+)\$")
LETTERS = {
    r"\alpha": "α", r"\kappa": "κ", r"\sigma": "σ", r"\mu": "µ", r"\Omega": "Ω", r"\tan": "tan ",
}  # fmt: skip
"""Commands of the formulas in notebooks; others are an error."""
PICTURE = re.compile(r"data:image/png;base64,([A-Za-z0-9+/=\n]+)")


def pages():
    """Path -> content of every page and picture."""
    found = {}
    for path in sorted((ROOT / FOLDER).glob("*.ipynb")):
        found |= _page(path.stem, nbformat.read(path, as_version=4))
    return found


def with_links(markdown):
    """The Markdown with links to the pages of notebooks instead of the files."""
    return re.sub(rf"((?:{FOLDER}|notebooks)/\w+)\.ipynb\)", r"\1.md)", markdown)


def _page(name, notebook):
    pictures = {}

    def kept(data):
        file = f"{name}_{len(pictures) + 1}.png"
        pictures[f"{FOLDER}/{file}"] = base64.b64decode(data)
        return file

    parts = []
    for cell in notebook.cells:
        if cell.cell_type == "code":
            parts.append(f"```python\n{cell.source}\n```")
            parts += [_output(one, kept) for one in cell.outputs]
        elif cell.cell_type == "markdown":
            text = MATH.sub(lambda found: formula(found[1]), cell.source)
            parts.append(text.replace(".ipynb)", ".md)"))
    head, _, rest = parts[0].partition("\n")
    parts[0] = f"{head}\n{rest}\n\nThe [notebook]({name}.ipynb), which `make notebooks` runs."
    return {f"{FOLDER}/{name}.md": "\n\n".join(parts) + "\n"} | pictures


def _output(output, kept):
    """An output of a cell as Markdown; ``kept`` stores a picture and returns its file."""
    data = output.get("data", {})
    if "image/png" in data:
        return f"![output of the cell above]({kept(data['image/png'])})"
    if "text/html" in data:
        # Another folder than that of the page's source: the site serves a page as a folder.
        html = PICTURE.sub(lambda found: f"../{kept(found[1])}", data["text/html"])
        return f'<div class="output">\n{html.strip()}\n</div>'
    return f"```text\n{(output.get('text') or data['text/plain']).rstrip()}\n```"


def formula(text):
    r"""A formula such as ``c_p a^2`` or ``\mu F_z`` as HTML.

    Raises:
        ValueError: a command that is not in ``LETTERS``.
    """
    for command, letter in LETTERS.items():
        text = text.replace(command, letter)
    if "\\" in text:
        raise ValueError(f"unknown command in the formula {text}: add it to notebooks.LETTERS")
    text = text.replace("<", "&lt;").replace(">", "&gt;")
    for sign, tag in (("_", "sub"), ("^", "sup")):
        text = re.sub(rf"\{sign}(?:{{([^}}]*)}}|(.))", rf"<{tag}>\1\2</{tag}>", text)
    return f"<i>{text}</i>"
