"""Scores the answers against the labels.

    python -m fits.withheld.score out/withheld --answers out/withheld/answers

Prints the tables (Markdown) and writes ``score.md``, ``score.json`` and
``reliability.png`` to the folder. ``--bound 40`` adds the best possible score, from 40
trials of each kind.
"""

import argparse
import hashlib
import json
from pathlib import Path

import numpy as np

from fits.withheld.baselines import read_columns
from fits.withheld.bound import bound_rows
from fits.withheld.goals import goals
from fits.withheld.judge import Outcome, judge, true_closure
from fits.withheld.open_mix import WORLDS, mix_rows
from fits.withheld.reliability import draw_reliability, reliability
from fits.withheld.thresholds import brier, check_all, expected_calibration_error, share, telling

__all__ = ["load", "main", "summary", "tables"]

HELD_OUT = "closure on rows held out, sqrt(lambda) >= 5, median"
WORSE = "held out, worse than the base"


def opened(folder: Path) -> dict:
    """The labels, after a check of their SHA-256."""
    if not (folder / "labels.json").is_file():
        raise SystemExit(f"{folder}: no labels; run fits.withheld.generate first")
    text = (folder / "labels.json").read_text()
    sealed = (folder / "labels.sha256").read_text().split()[0]
    if hashlib.sha256(text.encode()).hexdigest() != sealed:
        raise SystemExit(f"{folder}/labels.json was changed: its SHA-256 is not {sealed}")
    return json.loads(text)


def load(folder: Path, answers: Path, labels: dict) -> tuple[dict, list[str]]:
    """Outcomes by trial, and the names of trials without an answer."""
    truth = np.load(folder / "truth.npz")
    outcomes, missing = {}, []
    for name, label in labels.items():
        path = answers / label["file"].replace(".csv", ".json")
        if not path.exists():
            missing.append(name)
            continue
        try:
            answer = json.loads(path.read_text())
        except ValueError as error:
            raise SystemExit(f"{path}: unreadable answer ({error}): run it again") from None
        digest = answer.get("data", {}).get("sha256")  # absent in baselines
        trial = folder / "trials" / label["file"]
        if digest and digest != hashlib.sha256(trial.read_bytes()).hexdigest():
            raise SystemExit(f"{path}: the answer belongs to another trial: run it again")
        outcome = judge(name, label, answer)
        rows = path.with_suffix(".rows.csv")
        if rows.exists() and f"{name}_{label['force']}" in truth:
            forces = {label["force"]: truth[f"{name}_{label['force']}"]}
            closed = true_closure(read_columns(rows), forces, label["force"])
            outcome = outcome._replace(closed=closed)
        outcomes[name] = outcome
    return outcomes, missing


def summary(labels: dict, outcomes: dict[str, Outcome]) -> dict:
    """The scores of a method, by name: (value, number of trials)."""

    def of(kinds, **wanted):
        kinds = kinds.split()
        return [
            o
            for name, o in outcomes.items()
            if labels[name]["set"] in kinds and all(labels[name][k] == v for k, v in wanted.items())
        ]

    singles, pairs, unlisted = of("singles"), of("pairs"), of("unlisted")
    kinds = sorted({labels[o.name]["kind"] for o in of("null")})
    large = [o for o in singles if labels[o.name]["root_lambda"] >= 5]
    # The other effects in the raw measured data are unknown.
    everything = [o for name, o in outcomes.items() if labels[name]["set"] != "raw"]
    out = {"false alarm": share(o.flagged for o in of("null"))}
    for kind in kinds:
        found = share(o.flagged for o in of("null", kind=kind))
        out[f"false alarm, {kind}"] = found
    out |= {
        "detection": share(o.flagged for o in singles),
        "detection, sqrt(lambda) >= 5": share(o.flagged for o in large),
        "top-1 exact": share(o.exact for o in singles),
        "top-1 exact, sqrt(lambda) >= 5": share(o.exact for o in large),
        "top-1 family": share(o.family for o in singles),
        "top-1 family, sqrt(lambda) >= 5": share(o.family for o in large),
        "top-3": share(o.top3 for o in singles),
        "top-3, sqrt(lambda) >= 5": share(o.top3 for o in large),
        "exact or said so (cannot_tell)": share(o.exact_or_alias for o in singles),
        "unlisted called unknown or incomplete": share(o.unknown for o in unlisted),
        "unlisted named at > .9": share(o.sure_wrong for o in unlisted),
        "procedural called unknown or incomplete": share(o.unknown for o in of("procedural")),
        "procedural, mimic-free >= 5, flagged": share(
            o.unknown for o in of("procedural") if labels[o.name]["mimic_free"] >= 5
        ),
        "procedural named at > .9": share(o.sure_wrong for o in of("procedural")),
        "family left out, flagged": share(o.unknown for o in of("leave_out")),
        "family left out, named at > .9": share(o.sure_wrong for o in of("leave_out")),
        "foreign truth, flagged": share(o.unknown for o in of("foreign")),
        "beside a listed one: said, and only it named": share(o.right for o in of("beside")),
        "beside, the listed one named": share(o.named for o in of("beside")),
        "beside, named at > .9": share(o.sure_wrong for o in of("beside")),
        "injected, named": share(o.exact for o in telling(labels, outcomes)),
        "confident and wrong, listed": share(o.sure_wrong for o in [*singles, *pairs]),
        "pairs exact": share(o.exact for o in pairs),
        "pairs in top 5": share(o.top5 for o in pairs),
        "calibration error": (expected_calibration_error(everything), len(everything)),
        "Brier score": (brier(everything), len(everything)),
    }
    return out | simulator_numbers(of) | closure_numbers(everything, large)


def simulator_numbers(of) -> dict:
    """Scores of trials with a simulator: the verdict by the kind of trial, the parameters, and
    the error of the budget's shares; ``of(sets, **label)`` selects outcomes."""
    every = of("simulators")
    alone = of("simulators", of="null")
    named = of("simulators", of="singles")
    unlisted = of("simulators", of="procedural")
    worst = [max(o.shares_off) for o in every if o.shares_off]
    parts = [part for o in every for part in o.shares_off]
    return {
        "simulator, no effect: false alarm": share(o.flagged for o in alone),
        "simulator, one effect: exact": share(o.exact for o in named),
        "simulator, one effect: exact or said so": share(o.exact_or_alias for o in named),
        "simulator, stranger: flagged": share(o.unknown for o in unlisted),
        "simulator, intervals hold the parameter": share(
            inside for o in every for inside in o.within
        ),
        "simulator, no effect: intervals hold": share(inside for o in alone for inside in o.within),
        "simulator, median error of a share": (_median(parts), len(parts)),
        "simulator, median of a trial's worst share": (_median(worst), len(worst)),
    }


def closure_numbers(outcomes: list[Outcome], large: list[Outcome]) -> dict:
    """Claimed against true closure of all, on rows held out of the ``large`` gaps."""
    both = [o for o in outcomes if o.claimed is not None and o.closed is not None]
    kept = [o.holdout for o in large if o.holdout is not None]
    off = [abs(o.claimed - o.closed) for o in both]
    held = [o.claimed_ci[0] <= o.closed <= o.claimed_ci[1] for o in both if o.claimed_ci]
    return {
        "closure, median |claimed - true|": (_median(off), len(off)),
        "true closure inside the interval": share(held),
        HELD_OUT: (_median(kept), len(kept)),
        WORSE: share(x < 0 for x in kept),
    }


def discrepancy_numbers(folder: Path, labels: dict, outcomes: dict) -> dict:
    """True closures of the smooth discrepancy on the fitted rows and on rows left out."""
    path = folder / "baseline_ridge.npz"
    if not path.exists():
        return {}
    found, truth = np.load(path), np.load(folder / "truth.npz")
    inside, outside = [], []
    for name in outcomes:
        label = labels[name]
        if label["set"] != "singles" or label["root_lambda"] < 5:
            continue
        base, extended, held = (found[f"{name}_{part}"] for part in ("base", "extended", "held"))
        force = truth[f"{name}_{label['force']}"]
        for rows, closures in ((~held, inside), (held, outside)):
            before, after = (force - base)[rows], (force - extended)[rows]
            closures.append(1 - np.linalg.norm(after) / np.linalg.norm(before))
    return {
        HELD_OUT: (_median(outside), len(outside)),
        WORSE: share(x < 0 for x in outside),
        "closure on the rows fitted, median": (_median(inside), len(inside)),
    }


def _median(values) -> float | None:
    return float(np.median(values)) if len(values) else None


def shown(pair) -> str:
    value, count = pair
    return "-" if value is None else f"{value:.3f} ({count})"


def table(header: list[str], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def cells(labels, outcomes, key) -> list[list[str]]:
    """Rows of detection, top-1, family and top-3 of single effects, grouped by ``key``."""
    groups: dict = {}
    for name, outcome in outcomes.items():
        if labels[name]["set"] == "singles":
            groups.setdefault(key(labels[name]), []).append(outcome)
    flags = ("flagged", "exact", "family", "top3", "exact_or_alias", "sure_wrong")
    return [
        [group, str(len(found))]
        + [f"{np.mean([getattr(o, flag) for o in found]):.2f}" for flag in flags]
        for group, found in sorted(groups.items())
    ]


def confusions(labels, outcomes) -> list[list[str]]:
    """The most frequent wrong answers to single effects with sqrt(lambda) >= 5."""
    counts: dict = {}
    for name, o in outcomes.items():
        label = labels[name]
        if label["set"] == "singles" and not o.exact and label["root_lambda"] >= 5:
            answer = " + ".join(o.effects) or "none"
            key = (label["effects"][0], answer)
            counts.setdefault(key, []).append(o.status)
    ranked = sorted(counts.items(), key=lambda item: -len(item[1]))
    return [[*key, str(len(found)), ", ".join(sorted(set(found)))] for key, found in ranked[:25]]


def by_kind(labels, outcomes) -> list[list[str]]:
    """Unlisted effects by kind: number of trials, share flagged, share surely misnamed."""
    groups: dict = {}
    for name, o in outcomes.items():
        label = labels[name]
        if label["set"] in ("unlisted", "foreign", "procedural", "beside"):
            kind = label["kind"].split(" of ")[0]
            groups.setdefault(f"{label['set']}: {kind}", []).append(o)
    return [
        [
            kind,
            str(len(of)),
            f"{np.mean([o.unknown for o in of]):.2f}",
            f"{np.mean([o.sure_wrong for o in of]):.2f}",
        ]
        for kind, of in sorted(groups.items())
    ]


def tables(labels: dict, outcomes: dict, summaries: dict, seconds=None, bound=()) -> str:
    """All tables in Markdown; ``summaries``: method -> its scores, tirefit first;
    ``bound``: rows of the best possible scores, if ``--bound`` is given."""
    keys = {key: None for found in summaries.values() for key in found}
    rows = [
        [key, *(shown(found.get(key, (None, 0))) for found in summaries.values())] for key in keys
    ]
    columns = ["n", "detected", "top-1", "family", "top-3", "or reported", "surely wrong"]
    asked, wanted = (
        [[str(c.number), c.requirement, c.limit, c.found, c.verdict] for c in checks]
        for checks in (check_all(labels, outcomes, seconds), goals(labels, outcomes))
    )
    known = [o for name, o in outcomes.items() if labels[name]["set"] != "raw"]
    tenths = [
        [f"{b.probability:.2f}", f"{b.right:.2f}", f"{b.low:.2f}-{b.high:.2f}", str(b.count)]
        for b in reliability(known)
    ]
    possible = (
        {
            "Possible: exact evidence with the generator's own forms": table(
                ["", "n", "possible", "answered"], bound
            )
        }
        if bound
        else {}
    )
    parts = {
        "Open mix: value ± standard error (number)": table(
            ["", *WORLDS], mix_rows(labels, outcomes)
        ),
        "Results: share (number of trials)": table(["", *summaries], rows),
        "Goals": table(["#", "goal", "pass", "found", ""], wanted),
        "Thresholds": table(["#", "requirement", "pass", "found", ""], asked),
        **possible,
        "Reliability (reliability.png)": table(
            ["probability", "share right", "90 % of it", "n"], tenths
        ),
        "Unlisted effects by kind": table(
            ["kind", "n", "flagged", "surely wrong"], by_kind(labels, outcomes)
        ),
        "By effect": table(
            ["effect", *columns], cells(labels, outcomes, lambda x: x["effects"][0])
        ),
        "By form": table(
            ["form", *columns],
            cells(labels, outcomes, lambda x: f"{x['effects'][0]}: {x['forms'][0]}"),
        ),
        "By design and noise": table(
            ["design, noise", *columns],
            cells(labels, outcomes, lambda x: f"{x['design']} {x['noise']}"),
        ),
        "By rows": table(["rows", *columns], cells(labels, outcomes, lambda x: f"{x['n']:5d}")),
        "Wrong answers where sqrt(lambda) >= 5": table(
            ["truth", "answer", "n", "status"], confusions(labels, outcomes)
        ),
    }
    return "\n\n".join(f"## {title}\n\n{text}" for title, text in parts.items()) + "\n"


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Score answers against sealed labels")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--answers", type=Path)
    parser.add_argument(
        "--bound", type=int, default=0, help="trials of each kind for the best possible score"
    )
    given = parser.parse_args(arguments)
    answers = given.answers or given.folder / "answers"
    labels = opened(given.folder)
    outcomes, missing = load(given.folder, answers, labels)
    if not outcomes:
        raise SystemExit(f"no answers in {answers}: run fits.withheld.run first")
    summaries = {"tirefit": summary(labels, outcomes)}
    known = [name for name in outcomes if labels[name]["set"] != "raw"]
    diagrams = {"tirefit": reliability([outcomes[name] for name in known])}
    for path in sorted(given.folder.glob("baseline_*.json")):
        found = json.loads(path.read_text())
        judged = {
            name: judge(name, labels[name], found[name]) for name in outcomes if name in found
        }
        method = path.stem.removeprefix("baseline_")
        summaries[method] = summary(labels, judged)
        diagrams[method] = reliability([judged[k] for k in known if k in judged])
    summaries["ridge"] = discrepancy_numbers(given.folder, labels, outcomes)
    ran = answers / "run.json"
    seconds = json.loads(ran.read_text())["seconds_per_case"] if ran.exists() else None
    draw_reliability(diagrams, given.folder / "reliability.png")
    bound = bound_rows(given.folder, answers, labels, outcomes, given.bound)
    text = tables(labels, outcomes, summaries, seconds, bound)
    if missing:
        text = f"{len(missing)} trials without an answer: {', '.join(missing)}\n\n{text}"
    (given.folder / "score.md").write_text(text)
    document = {
        "missing": missing,
        "seconds_per_case": seconds,
        "methods": summaries,
        "thresholds": [c._asdict() for c in check_all(labels, outcomes, seconds)],
        "goals": [c._asdict() for c in goals(labels, outcomes)],
        "bound": bound,
        "trials": {name: o._asdict() for name, o in outcomes.items()},
    }
    (given.folder / "score.json").write_text(json.dumps(document, indent=1))
    print(text)


if __name__ == "__main__":
    main()
