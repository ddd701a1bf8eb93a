"""Tables of ``tirefit models`` and ``tirefit methods``, as text and as data."""

import re
from collections.abc import Mapping
from typing import Any

from tirefit.models import AbstractTire
from tirefit.online.base import PARAMETERS, AbstractEstimator
from tirefit.params import Spec, specs
from tirefit.report.numbers import format_number
from tirefit.report.page import table, wrapped

_LETTERS = re.compile(r"d?m?(ns?|hs?)?")


def _spelled(name: str, models: Mapping[str, AbstractTire]) -> str:
    """The family that a name is spelled from, empty for a name of its own."""
    family, _, letters = name.partition("-")
    return family if letters and family in models and _LETTERS.fullmatch(letters) else ""


def _parameters(model: AbstractTire) -> str:
    declared = specs(model)
    return ", ".join(name if spec.free else f"({name})" for name, spec in declared.items())


def _parameter_rows(models: Mapping[str, AbstractTire]) -> list[list[str]]:
    known: dict[str, Spec] = {}
    for model in models.values():
        for name, spec in specs(model).items():
            known.setdefault(name, spec)
    rows = [["parameter", "unit", "bounds", "start", "source", "meaning"]]
    for name, spec in known.items():
        *numbers, meaning = _row(name, spec)
        rows.append([*numbers, spec.source, meaning])
    return rows


def _row(label: str, spec: Spec) -> list[str]:
    """Name, unit, bounds, default and meaning of a parameter or setting."""
    low, high = format_number(spec.lower, 3), format_number(spec.upper, 3)
    default = format_number(spec.default, 3)
    return [label, spec.unit, f"[{low}, {high}]", default, spec.meaning]


def _folded(rows: list[list[str]]) -> list[str]:
    """A table whose last column is wrapped to the width."""
    lines = table([[*row[:-1], ""] for row in rows])
    indent, folded = max(map(len, lines)) + 2, []
    texts = [rows[0][-1], "-" * len(rows[0][-1]), *(row[-1] for row in rows[1:])]
    for line, text in zip(lines, texts, strict=True):
        folded += wrapped(text, line.ljust(indent), " " * indent) or [line]
    return folded


def models_table(models: Mapping[str, AbstractTire]) -> str:
    """Models by name, every parameter once, then the spelled combinations."""
    families: dict[str, list[str]] = {}
    for name in models:
        families.setdefault(_spelled(name, models), []).append(name)
    rows = [["model", "parameters"]]
    rows += [[name, _parameters(models[name])] for name in families.pop("", [])]
    lines = ["MODELS (in brackets: fixed unless freed)", *_folded(rows), ""]
    lines += ["PARAMETERS", *_folded(_parameter_rows(models)), ""]
    if families:
        lines.append("SPELLED BY LETTER, in this order:")
        used = {name.partition("-")[2][:1] for names in families.values() for name in names}
        lines += [f"  {letter}  {text}" for letter, text in _MEANING.items() if letter in used]
        for family, names in families.items():
            lines += wrapped(" ".join(names), f"  {family + ':':<10}", " " * 12)
    return "\n".join(lines).rstrip() + "\n"


_MEANING = {
    "d": "asymmetric pressure",
    "m": "kinetic friction below static friction",
    "n": "friction falls linearly with sliding speed (ns: static friction too)",
    "h": "friction falls exponentially with sliding speed (hs: static friction too)",
}


def methods_table(methods: Mapping[str, type[AbstractEstimator]]) -> str:
    """Every method with inputs, estimates, valid range of used friction, source, settings."""
    lines = ["METHODS of `tirefit estimate`"]
    known: dict[str, dict[tuple[Any, ...], list[tuple[str, Spec]]]] = {}
    for name, kind in methods.items():
        method = kind.method
        estimates = (f"{p} [{PARAMETERS[p].unit}]" for p in method.parameters)
        settings = specs(kind())
        for key, spec in settings.items():
            alike = (spec.unit, spec.bounds, spec.default)
            known.setdefault(key, {}).setdefault(alike, []).append((name, spec))
        lines += ["", f"  {name}: {method.meaning}, {method.source}"]
        items = {
            "inputs": f"time, {', '.join(method.inputs)}",
            "estimates": ", ".join(estimates),
            "valid": method.valid,
            "settings": ", ".join(settings),
        }
        for head, text in items.items():
            lines += wrapped(text, f"    {head:<10}", " " * 14)
    rows = [["setting", "unit", "bounds", "default", "meaning"]]
    for key, kinds in known.items():
        # The value that most methods have, then the exceptions by name.
        usual, *others = sorted(kinds.values(), key=len, reverse=True)
        rows.append(_row(key, usual[0][1]))
        for takers in others:
            rows += [_row(f"  {name}.{key}", spec) for name, spec in takers]
    return "\n".join([*lines, "", "SETTINGS (--set METHOD.NAME=VALUE)", *table(rows)])
