"""What the manual takes from the package: effects, models, commands, the API."""

import inspect
import re
import textwrap
from pathlib import Path

import effect_pages
import gallery
import notebooks
import typer

import tirefit
from tirefit.cli.commands import app
from tirefit.display import Record
from tirefit.models import MODELS
from tirefit.report.model_tables import methods_table, models_table

MARKER = re.compile(r"^<!-- generated: (\w+) ?(\w*) -->$", re.MULTILINE)


def pages():
    """Path in the repository -> content, of every page and figure that is generated."""
    return effect_pages.pages() | notebooks.pages()


def fill(markdown):
    """The Markdown with every marker replaced by the text that it names."""
    markdown = MARKER.sub(lambda found: TEXTS[found[1]](*filter(None, [found[2]])), markdown)
    return notebooks.with_links(markdown)


def _module_of(name):
    """Module of a public name, as `tirefit/__init__.py` has it."""
    source = Path(tirefit.__file__).read_text(encoding="utf-8")
    of_modules = re.findall(r'"([\w.]+)": \[([^\]]*)\]', source)
    return next(module for module, names in of_modules if f'"{name}"' in names)


def _api():
    """A section for each public name: its call, and its docstring as Markdown."""
    names = sorted(tirefit.__all__, key=str.lower)
    return "\n\n".join(f"## {name}\n\n{_described(name, getattr(tirefit, name))}" for name in names)


def _described(name, shown):
    called = f"from {tirefit.__name__}.{_module_of(name)}"
    if not callable(shown):
        return f"`tirefit.{name}`, {called}: {LISTED[name]}."
    given = [
        f"    {one.replace(annotation=one.empty)},"
        for one in inspect.signature(shown).parameters.values()
    ]
    call = "\n".join([f"tirefit.{name}(", *given, ")"] if given else [f"tirefit.{name}()"])
    return f"```python\n{call}\n```\n\n{as_markdown(inspect.getdoc(shown) or '')}"


def _record():
    """The base of all results: its docstring, and the first lines of its methods."""
    rows = []
    for name in RECORD:
        shown = getattr(Record, name)
        text = as_markdown(inspect.getdoc(shown)).partition("\n\n")[0].replace("\n", " ")
        given = "" if isinstance(shown, property) else str(inspect.signature(shown))
        given = re.sub(r": .*?(?=[,)=])|^\(self(, )?| ->.*", "", given).rstrip(")")
        called = name if isinstance(shown, property) else f"{name}({given})"
        rows.append(f"| `{called}` | {text} |")
    return (
        "\n".join(["| of a result | is |", "|---|---|", *rows])
        + "\n\n"
        + as_markdown(inspect.getdoc(Record))
    )


RECORD = ("status", "outcomes", "warnings", "summary", "plot", "save", "to_dict", "to_json")
"""Properties and methods of all results that the reference lists."""
LISTED = {
    "EFFECTS": "the [effects of a diagnosis](../effects/README.md)",
    "METHODS": "the [methods of `estimate`](../how-to/estimate.md), by name",
    "MODELS": "the [tire models](../choosing-a-model.md), by name",
}
ROLE = re.compile(r":\w+:`~?([^`]+)`")
SECTION = re.compile(r"^([A-Z]\w+):\n((?:    .*(?:\n|$)|\n(?=\n*    ))+)", re.MULTILINE)
ITEM = re.compile(r"^(\S[^\n:]*): ?", re.MULTILINE)


def as_markdown(docstring):
    """A docstring with sections such as ``Args:`` as Markdown."""
    text = SECTION.sub(lambda found: _section(*found.groups()), ROLE.sub(r"`\1`", docstring))
    return re.sub(r"::$", ":", text, flags=re.MULTILINE)


def _section(title, text):
    text = textwrap.dedent(text).strip("\n")
    if title == "Example":
        return f"**{title}**\n\n```pycon\n{text}\n```\n"
    if title in ("Args", "Attributes", "Raises"):
        text = ITEM.sub(r"- `\1`: ", text)
    return f"**{title}**\n\n{text}\n"


def _commands():
    """The help of every command."""
    return "\n\n".join(_help("tirefit", typer.main.get_command(app)))


def _help(name, command):
    level = "##" if name.count(" ") < 2 else "###"
    context = typer.Context(command, info_name=name, terminal_width=88)
    yield f"{level} {name}\n\n```text\n{command.get_help(context)}\n```"
    for part, below in getattr(command, "commands", {}).items():
        yield from _help(f"{name} {part}", below.loaded() if " " not in name else below)


def _literal(text):
    return f"```text\n{text}\n```"


TEXTS = {
    "api": _api,
    "commands": _commands,
    "record": _record,
    "effects": effect_pages.table,
    "gallery": gallery.text,
    "models": lambda: _literal(models_table(MODELS)),
    "methods": lambda: _literal(methods_table(tirefit.METHODS)),
}
