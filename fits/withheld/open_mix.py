"""The main table: verdicts in worlds with and without unlisted effects.

Worlds: *listed* (listed effects only), *beside* (a listed and an unlisted effect), *alone* (an
unlisted effect), *null*, and all of these. Each value has its standard error over trials.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fits.withheld.judge import Outcome, kind_of

__all__ = ["WORLDS", "mean_of", "mix_rows", "world_of"]

WORLDS = ("listed", "beside", "alone", "null", "all")
SETS = {
    "singles": "listed",
    "pairs": "listed",
    "beside": "beside",
    "unlisted": "alone",
    "procedural": "alone",
    "leave_out": "alone",
    "foreign": "alone",
    "null": "null",
}
STATED = 0.8  # probability above which an absent effect is a false claim
BINS = 5


def world_of(label: Mapping) -> str | None:
    """The world of a trial; None for a trial whose effects are not all known."""
    return None if label["set"] in ("injected", "raw") else SETS[kind_of(label)]


def mean_of(values: Sequence[float]) -> str:
    """``.12 ± .03 (40)``; ``-`` without values."""
    if not len(values):
        return "-"
    error = np.std(values, ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
    return f"{np.mean(values):.3f} ± {error:.3f} ({len(values)})"


def _calibration(claims: Sequence[tuple[float, bool]]) -> str:
    """Mean distance of the stated probability from the share there, in fifths of the range."""
    if not claims:
        return "-"
    p, there = np.array(claims, float).T
    place = np.minimum((p * BINS).astype(int), BINS - 1)
    off = [np.sum(place == k) * abs(np.mean((p - there)[place == k])) for k in np.unique(place)]
    return f"{np.sum(off) / len(p):.3f} ({len(p)})"


def _claims(outcomes: Sequence[Outcome]) -> list[tuple[float, bool]]:
    return [(p, there) for o in outcomes for p, there in o.each]


FIGURES: dict[str, Callable[[Sequence[Outcome]], str]] = {
    "absent effects at > .8, per trial": lambda of: mean_of(
        [sum(p > STATED and not there for p, there in o.each) for o in of]
    ),
    "Brier score of `each`": lambda of: mean_of([(p - there) ** 2 for p, there in _claims(of)]),
    "calibration error of `each`": lambda of: _calibration(_claims(of)),
    "mean probability on the true verdict": lambda of: mean_of([o.of_truth for o in of]),
    "the same where a gap is claimed": lambda of: mean_of([o.of_truth for o in of if o.flagged]),
    "verdict right": lambda of: mean_of([o.right for o in of]),
    "all listed effects named": lambda of: mean_of([o.named for o in of]),
    "a gap is claimed": lambda of: mean_of([o.flagged for o in of]),
    "sizes inside 2 errors": lambda of: mean_of([inside for o in of for inside in o.sizes]),
}


def mix_rows(labels: Mapping, outcomes: Mapping[str, Outcome]) -> list[list[str]]:
    """Rows of the table: a figure in each world."""
    of: dict[str, list[Outcome]] = {world: [] for world in WORLDS}
    for name, outcome in outcomes.items():
        if world := world_of(labels[name]):
            of[world].append(outcome)
            of["all"].append(outcome)
    return [[name, *(figure(of[world]) for world in WORLDS)] for name, figure in FIGURES.items()]
