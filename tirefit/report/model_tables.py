"""The registered models as text and as data for ``tirefit models``."""

import re
import textwrap
from collections.abc import Mapping

from tirefit.models import AbstractTire
from tirefit.params import Spec, specs
from tirefit.report.numbers import format_number
from tirefit.report.text import WIDTH, table

_LETTERS = re.compile(r"d?m?(ns?|hs?)?")


def _spelled(name: str, models: Mapping[str, AbstractTire]) -> str:
    """The family that a name is spelled from, empty for a name of its own."""
    family, _, letters = name.partition("-")
    return (
        family if letters and family in models and _LETTERS.fullmatch(letters) else ""
    )


def _parameters(model: AbstractTire) -> str:
    declared = specs(model)
    return ", ".join(
        name if spec.free else f"({name})" for name, spec in declared.items()
    )


def _about(model: AbstractTire) -> str:
    text = (type(model).__doc__ or "").strip()
    return text.split("\n\n")[0].replace("\n", " ").strip()


def _parameter_rows(models: Mapping[str, AbstractTire]) -> list[list[str]]:
    known: dict[str, Spec] = {}
    for model in models.values():
        for name, spec in specs(model).items():
            known.setdefault(name, spec)
    rows = [["parameter", "unit", "bounds", "start", "source", "meaning"]]
    for name, spec in known.items():
        low, high = format_number(spec.lower, 3), format_number(spec.upper, 3)
        rows.append(
            [
                name, spec.unit, f"[{low}, {high}]", format_number(spec.default, 3),
                spec.source, spec.meaning,
            ]
        )  # fmt: skip
    return rows


def _folded(rows: list[list[str]]) -> list[str]:
    """A table whose last column is wrapped to the width."""
    heads = [row[:-1] for row in rows]
    lines = table([[*head, ""] for head in heads])
    indent = max(len(line) for line in lines) + 2
    folded = []
    texts = [rows[0][-1], "-" * len(rows[0][-1]), *(row[-1] for row in rows[1:])]
    for line, text in zip(lines, texts, strict=True):
        parts = textwrap.wrap(text, WIDTH - indent) or [""]
        folded.append((line.ljust(indent) + parts[0]).rstrip())
        folded += [" " * indent + part for part in parts[1:]]
    return folded


def models_table(models: Mapping[str, AbstractTire]) -> str:
    """Models by name, every parameter once, then the spelled combinations."""
    families: dict[str, list[str]] = {}
    named = []
    for name in models:
        family = _spelled(name, models)
        if family:
            families.setdefault(family, []).append(name)
        else:
            named.append(name)
    rows = [["model", "parameters"]]
    rows += [[name, _parameters(models[name])] for name in named]
    lines = ["MODELS (in brackets: fixed unless freed)", *_folded(rows), ""]
    lines += ["PARAMETERS", *_folded(_parameter_rows(models)), ""]
    if families:
        lines.append("SPELLED BY LETTER, in this order:")
        lines += [f"  {text}" for text in _spelling(models, families)]
        for family, names in families.items():
            lead = f"  {family + ':':<10}"
            lines += textwrap.wrap(
                " ".join(names), WIDTH, initial_indent=lead, subsequent_indent=" " * 12,
                break_on_hyphens=False,
            )  # fmt: skip
    return "\n".join(lines).rstrip() + "\n"


_MEANING = {
    "d": "asymmetric pressure",
    "m": "kinetic friction below static friction",
    "n": "friction falls linearly with sliding speed (ns: static friction too)",
    "h": "friction falls exponentially with sliding speed (hs: static friction too)",
}


def _spelling(models, families) -> list[str]:
    used = {name.partition("-")[2][:1] for names in families.values() for name in names}
    return [f"{letter}  {text}" for letter, text in _MEANING.items() if letter in used]


def models_dict(models: Mapping[str, AbstractTire]) -> dict[str, dict]:
    """The same content, JSON-able: model name -> description and parameters."""
    return {
        name: {
            "about": _about(model),
            "parameters": {k: spec._asdict() for k, spec in specs(model).items()},
        }
        for name, model in models.items()
    }
