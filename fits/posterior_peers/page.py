"""Writes coverage, widths and times of all methods as a Markdown table and a figure."""

import csv
from pathlib import Path

import numpy as np

from fits.posterior_peers.cases import CASES
from tirefit.report.canvas import COLORS, DARK, GREY, WIDE, Picture, legend_below, panel_title, tidy

__all__ = ["summary", "write_page"]

METHODS = {
    "profile": "tirefit, profile",
    "importance": "tirefit, importance",
    "emcee": "tirefit, emcee",
    "full-rank": "NumPyro SVI, full rank",
    "mean-field": "NumPyro SVI, mean field",
    "covariance": "tirefit, covariance",
    "lmfit": "lmfit, standard errors",
}
"""Methods in the order of the tables, with their names there."""

_REFERENCE = "emcee"


def _read(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def _error(inside: int, sets: int) -> float:
    """Standard error of a share, by Jeffreys' posterior: it is not zero if all are
    inside."""
    share = (inside + 0.5) / (sets + 1)
    return float(np.sqrt(share * (1 - share) / (sets + 2)))


def summary(lines: list[dict[str, str]]) -> list[dict]:
    """By method and parameter: sets, coverage with its binomial standard error, median
    width over that of emcee's interval on the same data sets, and the notes."""
    ends: dict[tuple[str, str], dict[int, np.ndarray]] = {}
    said: dict[tuple[str, str], list[str]] = {}
    truth = {line["parameter"]: float(line["truth"]) for line in lines}
    for line in lines:
        key = line["method"], line["parameter"]
        interval = np.array([float(line["low"]), float(line["high"])])
        ends.setdefault(key, {})[int(line["set"])] = interval
        said.setdefault(key, []).append(line["said"])
    rows = []
    for (method, parameter), known in ends.items():
        inside = [a <= truth[parameter] <= b for a, b in known.values()]
        share = float(np.mean(inside))
        by_emcee = ends.get((_REFERENCE, parameter), {})
        ratio = [np.ptp(known[k]) / np.ptp(by_emcee[k]) for k in known if k in by_emcee]
        rows.append(
            {
                "method": method,
                "parameter": parameter,
                "sets": len(known),
                "coverage": share,
                "error": _error(sum(inside), len(known)),
                "width": float(np.median(ratio)) if ratio else np.nan,
                "said": said[method, parameter],
            }
        )
    return rows


def _settled(lines: list[dict[str, str]], method: str) -> str:
    """The effect of three times as many steps, on the same data sets."""

    def elbo(name):
        return {int(line["set"]): float(line["said"]) for line in lines if line["method"] == name}

    longer, once = elbo(f"{method}, 3 x"), elbo(method)
    gain = [longer[k] - once[k] for k in longer]
    by = {(r["method"], r["parameter"]): r["width"] for r in summary(lines)}
    wider = [f"{p} {by[f'{method}, 3 x', p]:.2f}" for m, p in by if m == f"{method}, 3 x"]
    return (
        f"{METHODS[method]}: ELBO higher by {np.median(gain):.3f} (at most"
        f" {max(gain):.3f}), widths over emcee's {', '.join(wider)}"
    )


def _of_case(name: str, lines: list[dict[str, str]]) -> list[str]:
    rows = {(r["method"], r["parameter"]): r for r in summary(lines)}
    parameters = list(dict.fromkeys(line["parameter"] for line in lines))
    text = [f"## {CASES[name].words}", ""]
    text += ["| | data sets | " + " | ".join(f"{p}: coverage | width" for p in parameters) + " |"]
    text += ["|---|---|" + "---|---|" * len(parameters)]
    for method, words in METHODS.items():
        if (method, parameters[0]) not in rows:
            continue
        cells = [words, str(rows[method, parameters[0]]["sets"])]
        for parameter in parameters:
            row = rows[method, parameter]
            cells += [f"{row['coverage']:.0%} ± {row['error']:.0%}", f"{row['width']:.2f}"]
        text.append("| " + " | ".join(cells) + " |")
    text += ["", "Three times as many steps, on the first data sets:", ""]
    text += [
        f"- {_settled(lines, method)}"
        for method in ("full-rank", "mean-field")
        if (f"{method}, 3 x", parameters[0]) in rows
    ]
    for method in ("importance", "emcee"):
        said = rows.get((method, parameters[0]), {"said": []})["said"]
        for word in sorted({one for one in said if one}):
            text.append(f"- {METHODS[method]}: {said.count(word)} of {len(said)} {word}")
    return [*text, ""]


def write_page(folder: Path, into: Path) -> None:
    """``table.md`` and ``coverage.png`` from the intervals and times in a folder."""
    cases = {name: folder / f"{name}.csv" for name in CASES}
    there = {name: _read(path) for name, path in cases.items() if path.exists()}
    text = [
        "Written by `python -m fits.posterior_peers`. Coverage of 95 % intervals with",
        "its binomial standard error (Jeffreys'); median width over emcee's interval",
        "on the same data sets.",
        "",
    ]
    for name, lines in there.items():
        text += _of_case(name, lines)
    text += ["## Processor seconds a data set", "", "| | first | then |", "|---|---|---|"]
    for row in _read(folder / "times.csv"):
        words = METHODS.get(row["method"], "tirefit, fit with profiles")
        text.append(f"| {words} | {row['cold_s']} | {row['warm_s']} |")
    (into / "table.md").write_text("\n".join(text) + "\n")
    draw({name: summary(lines) for name, lines in there.items()}, into)


def draw(cases: dict[str, list[dict]], folder: Path) -> None:
    """Coverage and width, one row per case; adjacent marks are methods."""
    picture = Picture(figsize=(WIDE, 1.2 + 2.1 * len(cases)), layout="constrained")
    panels = picture.subplots(len(cases), 2, sharex="row", sharey="col", squeeze=False)
    colors = [DARK, *COLORS, GREY]
    for (name, rows), (left, right) in zip(cases.items(), panels, strict=True):
        parameters = list(dict.fromkeys(row["parameter"] for row in rows))
        for k, method in enumerate(METHODS):
            own = [row for row in rows if row["method"] == method]
            if not own:
                continue
            at = np.arange(len(own)) + 0.1 * (k - len(METHODS) / 2 + 0.5)
            style = {"color": colors[k], "ms": 3, "label": METHODS[method]}
            left.errorbar(
                at,
                [100 * r["coverage"] for r in own],
                [100 * r["error"] for r in own],
                fmt="o",
                lw=1,
                **style,
            )
            right.plot(at, [row["width"] for row in own], "o", **style)
        left.axhline(95, color=GREY, lw=0.8)
        right.axhline(1, color=GREY, lw=0.8)
        right.set_yscale("log")
        right.set_yticks([0.1, 0.2, 0.5, 1, 2], ["0.1", "0.2", "0.5", "1", "2"])
        right.minorticks_off()
        right.set_xticks(range(len(parameters)), parameters)
        panel_title(left, CASES[name].words)
        tidy(left, "", "inside 95 % [%]")
        tidy(right, "", "width over emcee's [-]")
    legend_below(picture, panels[0, 0].get_legend_handles_labels()[0])
    picture.savefig(folder / "coverage.png")
