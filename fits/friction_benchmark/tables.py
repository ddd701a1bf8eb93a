"""Writes the tables as CSV and Markdown, and the figure, from the results of ``run``."""

import csv
import shutil
from pathlib import Path

__all__ = ["markdown", "publish"]

_SCORES = {
    "estimator": "estimator",
    "log": "log",
    "use": "use",
    "bias": "bias",
    "bias_brush": "bias against the closest brush",
    "std": "std",
    "covered": "95 % interval contains the truth",
    "supported": "rows supported",
    "bias_after": "bias after a drop",
    "covered_after": "interval after a drop",
    "note": "",
}
_CHANGES = {
    "estimator": "estimator",
    "log": "log",
    "use": "use",
    "found_60": "drop to 0.6 found",
    "delay_60": "delay [s]",
    "found_80": "drop to 0.8 found",
    "delay_80": "delay [s]",
    "false_per_hour": "false alarms per hour",
    "below_found": "below 0.79 after a drop to 0.6",
    "below_delay": "delay [s]",
    "below_false_per_hour": "below 0.79 without a drop, per hour",
}
_MEASURED = {
    "log": "log",
    "estimator": "estimator",
    "offline": "offline",
    "last": "at the end",
    "last_std": "± std",
    "bias": "bias",
    "std": "std",
    "covered": "interval contains the offline value",
    "supported": "rows supported",
    "alarms": "alarms",
    "note": "",
}
_DETECTORS = {
    "detector": "detector",
    "surprise_of": "surprises of",
    "use": "use",
    "threshold": "threshold",
    "found_60": "drop to 0.6 found",
    "delay_60": "delay [s]",
    "found_80": "drop to 0.8 found",
    "delay_80": "delay [s]",
    "false_per_hour": "false alarms per hour",
}
_SHARES = ("use", "covered", "supported", "covered_after", "found_", "below_found")
_SIGNED = ("bias",)


def _cell(key: str, text: str) -> str:
    try:
        number = float(text)
    except ValueError:
        return text
    if number != number:
        return "–"
    if key.startswith(_SHARES):
        return f"{100 * number:.0f} %"
    if key.startswith(_SIGNED):
        return f"{number:+.3f}"
    if "per_hour" in key:
        return f"{number:.1f}" if number < 10 else f"{number:.0f}"
    if "delay" in key:
        return f"{number:.2f}"
    return f"{number:.3f}" if key not in ("threshold", "alarms") else f"{number:g}"


def markdown(lines: list[dict[str, str]], columns: dict[str, str]) -> str:
    """A table of chosen columns, key -> heading, with rounded numbers."""
    rows = [[_cell(key, line[key]) for key in columns] for line in lines]
    head = [list(columns.values()), ["---"] * len(columns)]
    return "\n".join("| " + " | ".join(row) + " |" for row in [*head, *rows])


def _read(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def publish(results: Path, into: Path) -> str:
    """table.csv, table.md, measured.csv, detectors.csv, trade_off.png in a folder."""
    into.mkdir(parents=True, exist_ok=True)
    scores, measured = _read(results / "scores.csv"), _read(results / "measured.csv")
    run = [line for line in scores if not line["note"]]
    parts = [
        "# Friction estimators on the same logs",
        "Written by `make friction-benchmark`; explained in [README.md](README.md).",
        "## Friction: constant, and after a drop to 0.6",
        markdown(scores, _SCORES),
        "## A drop of friction: alarms, and estimates below 0.79",
        markdown(run, _CHANGES),
        "## Measured logs, against the offline fit",
        markdown(measured, _MEASURED),
    ]
    names = {"scores": "table", "measured": "measured"}
    if (results / "detectors.csv").exists():
        names["detectors"] = "detectors"
        detectors = _read(results / "detectors.csv")
        parts += ["## Detectors on the same surprises", markdown(detectors, _DETECTORS)]
        from fits.friction_benchmark.draw import draw

        draw(detectors, into / "trade_off.png")
    for name, kept in names.items():
        if (results / f"{name}.csv") != (into / f"{kept}.csv"):
            shutil.copyfile(results / f"{name}.csv", into / f"{kept}.csv")
    text = "\n\n".join(parts) + "\n"
    (into / "table.md").write_text(text)
    return text
