"""The table: scores of the decision with one stage or rule switched off at a time."""

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import resources
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from fits.ablation.variants import VARIANTS, Answer, Rules, decided
from fits.calibration import logistic
from fits.calibration.__main__ import lines_by
from fits.withheld.goals import STRONG, WEAK
from fits.withheld.judge import HIDDEN, Outcome, judge, kind_of
from fits.withheld.thresholds import brier, share, telling

__all__ = ["answered", "row_of", "table"]

BEFORE = "earlier rules"
"""Row of the answers of another version."""

UNLISTED = ("unlisted", "procedural")


class Scores:
    """Outcomes of trials with their labels, by name."""

    def __init__(self, labels: Mapping[str, Mapping], outcomes: Mapping[str, Outcome]):
        self.labels = {name: labels[name] for name in outcomes}
        self.outcomes = outcomes

    def of(self, *sets: str, size=(-np.inf, np.inf)) -> list[Outcome]:
        """Outcomes of these sets with a gap over the noise within these limits."""
        return [
            o
            for name, o in self.outcomes.items()
            if self.labels[name]["set"] in sets
            and size[0] <= self.labels[name].get("gap_over_noise", 0.0) <= size[1]
        ]


def _exact(*sets, size=(-np.inf, np.inf)) -> Callable:
    return lambda s: share(o.exact for o in s.of(*sets, size=size))


def _reported(*sets, size=(-np.inf, np.inf)) -> Callable:
    return lambda s: share(o.exact_or_alias for o in s.of(*sets, size=size))


def _flagged(*sets, size=(-np.inf, np.inf)) -> Callable:
    return lambda s: share(o.unknown for o in s.of(*sets, size=size))


def _false_names(s: Scores) -> tuple:
    counts = [o.false_names for o in s.of(*HIDDEN)]
    return (float(np.mean(counts)) if counts else None), len(counts)


def _alarms(s: Scores) -> tuple:
    return share(o.flagged for name, o in s.outcomes.items() if kind_of(s.labels[name]) == "null")


def _brier(s: Scores) -> tuple:
    known = [o for name, o in s.outcomes.items() if s.labels[name]["set"] != "raw"]
    return brier(known), len(known)


COLUMNS: dict[str, Callable[[Scores], tuple]] = {
    "strong: exact": _exact("singles", size=STRONG),
    "strong: reported": _reported("singles", size=STRONG),
    "weak: exact": _exact("singles", size=WEAK),
    "weak: reported": _reported("singles", size=WEAK),
    "pairs: exact": _exact("pairs"),
    "pairs: reported": _reported("pairs"),
    "unlisted, strong": _flagged(*UNLISTED, size=STRONG),
    "unlisted, weak": _flagged(*UNLISTED, size=WEAK),
    "surely misnamed": lambda s: share(o.sure_wrong for o in s.of(*UNLISTED)),
    "family left out": _flagged("leave_out"),
    "foreign": _flagged("foreign"),
    "with unlisted: effect named": lambda s: share(o.named for o in s.of("beside")),
    "false names per trial": _false_names,
    "false alarms": _alarms,
    "injected": lambda s: share(o.exact for o in telling(s.labels, s.outcomes)),
    "Brier": _brier,
}
"""Column -> function of the scores that returns (value, count)."""

SAVED = {
    "climb off": ("climbed",),
    "gain: no data left out": ("predicted",),
    "plain decision": ("climbed", "predicted", "remainder_tests"),
}
"""Row -> stages of the diagnosis that it does not need."""


def answered(
    first: Sequence[Mapping], second: Sequence[Mapping], rules: Rules
) -> dict[str, Answer]:
    """The answers to the second records by the rules, by name, calibrated on the first."""
    lines = lines_by(first, rules)
    found = {}
    for record in second:
        answer = decided(record, rules, lines)
        probability = logistic.calibrated(lines, answer.kind, answer.probability)
        found[record["name"]] = answer._replace(probability=probability)
    return found


def _bare(name: str) -> str:
    return name.rpartition("/")[2]


def row_of(outcomes: Mapping[str, Outcome], labels: Mapping[str, Mapping]) -> list[str]:
    """The cells of a row."""
    scores = Scores(labels, outcomes)
    found = [column(scores) for column in COLUMNS.values()]
    return ["-" if value is None else f"{value:.2f}" for value, _ in found]


def _seconds(records: Iterable[Mapping], stages: Iterable[str]) -> str:
    """Median CPU seconds of a file up to its verdict, without some stages."""
    spent = [
        r["seconds"]["in all"] - sum(r["seconds"].get(stage, 0.0) for stage in stages)
        for r in records
    ]
    return f"{np.median(spent):.2f}"


def _measured(records: Sequence[Mapping], answers: Mapping[str, Answer]) -> list[str]:
    """Scores of the measured cases: number named right of those with a known effect, and
    mean closure over that by hand, each at most 1."""
    hand, right, closed = _by_hand(), [], []
    for record in records:
        label, answer = record["label"], answers[record["name"]]
        if label["named"] or label["never"]:
            found = all(
                any(re.fullmatch(pattern, e) for e in answer.effects) for pattern in label["named"]
            )
            false = [e for e in answer.effects if re.fullmatch(label["never"], e)]
            right.append(found and not false)
        best = hand.get(_bare(record["name"]))
        if best and best["rms"][best["best"]] < 0.97 * best["rms"][""]:
            possible = 1 - best["rms"][best["best"]] / best["rms"][""]
            own = _closed(record["out"], answer.effects)
            closed.append(min(own / possible, 1.0))
    named = f"{sum(right)} of {len(right)}" if right else "-"
    return [named, f"{np.mean(closed):.2f}" if closed else "-"]


def _by_hand() -> dict:
    if find_spec("fits.measured_changes") is None:
        return {}
    at = resources.files("fits.measured_changes") / "by_hand.json"
    return json.loads(at.read_text())


def _closed(out: Mapping, effects: Sequence[str]) -> float:
    """Share of the rms on data left out that a set of effects closes; zero if the set was
    not refitted there."""
    sets = [tuple(key) for key in out["effects"]]
    key = tuple(sorted(effects))
    if key not in sets:
        return 0.0
    square = out["rows"] @ out["loss"]
    return float(1 - np.sqrt(square[sets.index(key)] / square[sets.index(())]))


def _before(answers: Path, labels: Mapping) -> dict[str, Outcome]:
    found = {}
    for name, label in labels.items():
        path = answers / Path(label["file"]).with_suffix(".json")
        if path.exists():
            found[name] = judge(name, label, json.loads(path.read_text()))
    return found


def table(
    first: Sequence[Mapping],
    second: Sequence[Mapping],
    measured: Sequence[Mapping] = (),
    before: Path | None = None,
) -> str:
    """The table in Markdown.

    Args:
        first: records for the calibration and for choosing rules.
        second: records that score every row.
        measured: records of the measured cases.
        before: folder of the answers of another version to the second trials.
    """
    labels = {_bare(r["name"]): r["label"] for r in second}
    scores = Scores(labels, {n: judge(n, labels[n], NOTHING) for n in labels})
    counts = [str(column(scores)[1]) for column in COLUMNS.values()]
    ends = ["measured: named", "closed, share of by hand", "CPU s"]
    lines = [["", *COLUMNS, *ends], ["---"] * (len(COLUMNS) + 4)]
    lines.append(["trials", *counts, "", "", ""])
    for name, rules in VARIANTS.items():
        answers = answered(first, [*second, *measured], rules)
        outcomes = {
            _bare(r["name"]): judge(_bare(r["name"]), r["label"], answers[r["name"]].document)
            for r in second
        }
        seconds = _seconds(second, SAVED.get(name, ()))
        cells = row_of(outcomes, labels)
        lines.append([name, *cells, *_measured(measured, answers), seconds])
    if before is not None and (outcomes := _before(before, labels)):
        some = f"{BEFORE} ({len(outcomes)} of {len(labels)} trials)"
        lines.insert(3, [some, *row_of(outcomes, labels), "-", "-", "-"])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


NOTHING = Answer("none", (), 0.0, ()).document
"""A document without effects, to count trials."""
