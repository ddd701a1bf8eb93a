"""Tables of ``tirefit models`` and ``tirefit methods``, as text and as data."""

import re
from collections.abc import Mapping

from tirefit.models import AbstractTire
from tirefit.online.base import PARAMETERS, AbstractEstimator
from tirefit.params import Spec, specs
from tirefit.report.numbers import bracketed, format_number
from tirefit.report.page import table, wrapped

_LETTERS = re.compile(r"d?m?(ns?|hs?)?")
"""Letters with which the name of a model of a family ends."""


def _parameter_rows(models: Mapping[str, AbstractTire]) -> list[list[str]]:
    rows = {"": ["parameter", "unit", "bounds", "start", "source", "meaning"]}
    for model in models.values():
        for name, spec in specs(model).items():
            *numbers, meaning = _row(name, spec)
            rows.setdefault(name, [*numbers, spec.source, meaning])
    return [*rows.values()]


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
        family, _, letters = name.partition("-")
        is_spelled = letters and family in models and _LETTERS.fullmatch(letters)
        families.setdefault(family if is_spelled else "", []).append(name)
    rows = [["model", "parameters"]]
    for name in families.pop("", []):
        declared = specs(models[name]).items()
        rows.append([name, ", ".join(key if spec.free else f"({key})" for key, spec in declared)])
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
    rows = [["setting", "unit", "bounds", "default", "meaning"]]
    for name, kind in methods.items():
        method, settings = kind.method, specs(kind())
        estimates = (p + bracketed(PARAMETERS[p].unit) for p in method.parameters)
        lines += ["", f"  {name}: {method.meaning}, {method.source}"]
        items = {
            "inputs": f"time, {', '.join(method.inputs)}",
            "estimates": ", ".join(estimates),
            "valid": method.valid,
        }
        for head, text in items.items():
            lines += wrapped(text, f"    {head:<10}", " " * 14)
        rows += [_row(f"{name}.{key}", spec) for key, spec in settings.items()]
    return "\n".join([*lines, "", "SETTINGS (--set METHOD.NAME=VALUE)", *_folded(rows)])
