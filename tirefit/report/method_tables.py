"""The online methods as text and as data for ``tirefit methods``."""

import textwrap
from collections.abc import Mapping

from tirefit.online.base import PARAMETERS, AbstractEstimator
from tirefit.params import Spec, specs
from tirefit.report.numbers import format_number
from tirefit.report.text import WIDTH, table


def _settings(kind: type[AbstractEstimator]) -> dict[str, Spec]:
    return specs(kind())


def _wrapped(head: str, text: str) -> list[str]:
    lead = f"    {head:<10}"
    return textwrap.wrap(
        text, WIDTH, initial_indent=lead, subsequent_indent=" " * len(lead)
    )


def _row(label: str, spec: Spec) -> list[str]:
    low, high = format_number(spec.lower, 3), format_number(spec.upper, 3)
    default = format_number(spec.default, 3)
    return [label, spec.unit, f"[{low}, {high}]", default, spec.meaning]


def methods_table(methods: Mapping[str, type[AbstractEstimator]]) -> str:
    """Every method with inputs, estimates, valid use of friction, source, settings."""
    lines = ["METHODS of `tirefit estimate`"]
    known: dict[str, dict[tuple, list[tuple[str, Spec]]]] = {}
    for name, kind in methods.items():
        method = kind.method
        estimates = (f"{p} [{PARAMETERS[p].unit}]" for p in method.parameters)
        settings = _settings(kind)
        for key, spec in settings.items():
            alike = (spec.unit, spec.bounds, spec.default)
            known.setdefault(key, {}).setdefault(alike, []).append((name, spec))
        lines += ["", f"  {name}: {method.meaning}, {method.source}"]
        lines += _wrapped("inputs", f"time, {', '.join(method.inputs)}")
        lines += _wrapped("estimates", ", ".join(estimates))
        lines += _wrapped("valid", method.valid)
        lines += _wrapped("settings", ", ".join(settings))
    rows = [["setting", "unit", "bounds", "default", "meaning"]]
    for key, kinds in known.items():
        # What most methods have, then those that have it otherwise, by name.
        usual, *others = sorted(kinds.values(), key=len, reverse=True)
        rows.append(_row(key, usual[0][1]))
        for takers in others:
            rows += [_row(f"  {name}.{key}", spec) for name, spec in takers]
    return "\n".join([*lines, "", "SETTINGS (--set METHOD.NAME=VALUE)", *table(rows)])


def methods_dict(methods: Mapping[str, type[AbstractEstimator]]) -> dict[str, dict]:
    """The same content, JSON-able: method name -> what it is."""
    return {
        name: {
            "meaning": kind.method.meaning,
            "inputs": ["time", *kind.method.inputs],
            "parameters": {p: PARAMETERS[p]._asdict() for p in kind.method.parameters},
            "valid": kind.method.valid,
            "source": kind.method.source,
            "settings": {k: spec._asdict() for k, spec in _settings(kind).items()},
        }
        for name, kind in methods.items()
    }
