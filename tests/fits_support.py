"""Runs a case of ``fits/``: its expected.toml, its fits, its independent numbers.

``expected.toml``, all parts optional but ``how`` and one list of checks::

    how.scipy = "where a number with how = "scipy" comes from"

    [[derive]]                    # vehicle logs -> NAME.csv beside the case's files
    name = "all"
    logs = ["../dart_jetracer/*/*.csv.gz"]
    vehicle = "vehicle.toml"

    [[fit]]
    name = "figure10 brush-d"
    file = "figure10.csv"         # of the case, or of a derive step
    model = "brush-d"             # instead of fit.toml's
    config = { noise = {...} }    # laid over fit.toml's tables
    posterior = true              # sample it too
    expect = [ <check>, ... ]     # `of` is a path into fit.json: parameters.d.value

    [[number]]                    # of properties() in draw.py: read off the curves
    of = "15: sigma of full sliding, d = 0"
    ...

A check is ``of``, ``how`` and what must hold: ``value`` and ``within`` (absolute) or
``relative``; ``min`` and/or ``max``; ``covers`` (an interval holds it); ``between``
(an interval lies inside); ``is``; ``contains`` (text in a list of sentences). ``ref``
names the number in ``reference()`` of reference.py, which is run again and must equal
``value`` to the same tolerance; ``per`` divides by another reference first.
"""

import importlib
import tomllib
from pathlib import Path
from typing import Any

import tirefit
from tirefit.fitting.problem.config import FitConfig, parse_config

FITS = Path(__file__).parents[1] / "fits"
CASES = sorted(path.parent for path in FITS.glob("*/expected.toml"))
_OF_A_CHECK = {
    "of", "how", "value", "within", "relative", "min", "max", "covers", "between",
    "is", "contains", "ref", "per",
}  # fmt: skip


def load(case: Path) -> dict[str, Any]:
    return tomllib.loads((case / "expected.toml").read_text(encoding="utf-8"))


def all_checks(expected: dict[str, Any]) -> list[dict[str, Any]]:
    checks = [check for fit in expected.get("fit", []) for check in fit["expect"]]
    return checks + expected.get("number", [])


def malformed(expected: dict[str, Any]) -> list[str]:
    """Checks without content, or without the source of their number."""
    found = []
    for check in all_checks(expected):
        unknown = set(check) - _OF_A_CHECK
        idle = not set(check) & {"value", "min", "max", "covers", "between", "is"}
        loose = "value" in check and not {"within", "relative"} & set(check)
        if unknown or (idle and "contains" not in check) or loose:
            found.append(f"{check}: unknown {unknown}, or it checks nothing")
        if check.get("how") not in expected["how"]:
            found.append(f"{check['of']}: `how` must name an entry of [how]")
    return found


def part_of(case: Path, module: str, function: str) -> dict[str, float]:
    """The result of ``reference()`` or ``properties()`` in a case's script, if any."""
    if not (case / f"{module}.py").exists():
        return {}
    return getattr(importlib.import_module(f"fits.{case.name}.{module}"), function)()


def config_of(case: Path, fit: dict[str, Any]) -> FitConfig:
    path = case / "fit.toml"
    content = tomllib.loads(path.read_text()) if path.exists() else {}
    for key, value in fit.get("config", {}).items():
        both = isinstance(value, dict) and isinstance(content.get(key), dict)
        content[key] = content[key] | value if both else value
    return parse_config(content, str(path))


def derive_all(case: Path, expected: dict[str, Any], folder: Path) -> None:
    for step in expected.get("derive", []):
        logs = sorted(path for glob in step["logs"] for path in case.glob(glob))
        tirefit.derive_files(logs, case / step["vehicle"], folder / f"{step['name']}.csv")


def run_fit(case: Path, fit: dict[str, Any], folder: Path):
    """The FitResult of one ``[[fit]]``."""
    config = config_of(case, fit)
    derived = folder / fit["file"]
    declared = config.data
    data = tirefit.read(
        derived if derived.exists() else case / fit["file"],
        columns=declared.columns,
        units=declared.units,
        slip=declared.slip,
        constants=declared.constants,
        convention=declared.convention,
        rolling_radius=declared.rolling_radius,
        mask_bad_rows=declared.mask_bad_rows,
    )
    result = tirefit.fit(data, fit.get("model"), config=config)
    return tirefit.sample(result) if fit.get("posterior") else result


def look_up(content: Any, path: str) -> Any:
    for key in path.split("."):
        content = content[int(key)] if isinstance(content, list) else content[key]
    return content


def broken(check: dict[str, Any], found: Any, reference: dict[str, float]) -> list[str]:
    """The checks that fail, in words; empty if all hold."""
    of, wrong = check["of"], []
    if "per" in check:
        found = found / reference[check["per"]]
    if "value" in check:
        allowed = check.get("within", 0) + check.get("relative", 0) * abs(check["value"])
        if found is None or not abs(found - check["value"]) <= allowed:
            wrong.append(f"{of} = {found}, expected {check['value']} +- {allowed}")
        if "ref" in check and not abs(reference[check["ref"]] - check["value"]) <= (allowed):
            wrong.append(f"{check['ref']} is {reference[check['ref']]} by reference.py")
    if "min" in check and not (found is not None and found >= check["min"]):
        wrong.append(f"{of} = {found}, expected at least {check['min']}")
    if "max" in check and not (found is not None and found <= check["max"]):
        wrong.append(f"{of} = {found}, expected at most {check['max']}")
    if "covers" in check and not found[0] <= check["covers"] <= found[1]:
        wrong.append(f"{of} = {found} does not cover {check['covers']}")
    if "between" in check:
        low, high = check["between"]
        if not low <= found[0] < found[1] <= high:
            wrong.append(f"{of} = {found} is not inside {check['between']}")
    if "is" in check and found != check["is"]:
        wrong.append(f"{of} is {found!r}, expected {check['is']!r}")
    if "contains" in check and not any(check["contains"] in text for text in found):
        wrong.append(f"{of} does not say {check['contains']!r}: {found}")
    return wrong
