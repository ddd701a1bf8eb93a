"""What was possible: of an observer who knows every form of the generator, of what no
listed effect imitates, and of what shows beside what measured data lack themselves.

The observer names the set of effects of the largest evidence, and must find out how
many there are: none, one, or two. On the average over such trials hardly any method
that sees the file alone is right more often. Told the effects and their forms, he says
whether they show, and how much of the gap an answer closes.
"""

import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import norm

from fits.withheld.baselines import from_columns, read_columns
from fits.withheld.goals import STRONG, WEAK
from fits.withheld.injected import MU, C, half
from fits.withheld.judge import Outcome, true_closure
from fits.withheld.library import Inputs, base_fit
from fits.withheld.observer import beliefs, evidence, told
from fits.withheld.patch import plain_brush

__all__ = [
    "bound_rows",
    "injected_that_show",
    "observer_rows",
    "size_of_change",
    "strangers_that_show",
]

SHOWS = 3.0  # standard errors: found in 9 of 10 by who looks for it at 4 % alarms
SHAPES = 1000
"""Shapes of what is not listed that who does not know it has to look for: over every
quantity kinks, steps, bumps and waves, of stiffness, friction, slip and force."""

_ALARMS = 0.04

_STATED = ("iid", "slip_classical")
"""Laws of the noise of which the rig file states all."""

_SIZES = (
    ("any gap", 0, np.inf, "root_lambda"),
    ("sqrt(lambda) >= 5", 5, np.inf, "root_lambda"),
    ("strong", *STRONG, "gap_over_noise"),
    ("weak", *WEAK, "gap_over_noise"),
)
"""Of a gap: name, smallest, largest, and which number of the label it is."""


def strangers_that_show(labels: dict, outcomes: dict) -> list[list[str]]:
    """[of what, n, possible, answered]: whether anything shows that no listed effect,
    at any size, does as well, and whether it was flagged; the same for who looks for
    any of :data:`SHAPES`, the true one among them, at as many false alarms."""
    groups = {
        "not listed, strong": (("unlisted", "procedural"), *STRONG),
        "not listed, weak": (("unlisted", "procedural"), *WEAK),
        "family left out": (("leave_out",), 0, np.inf),
        "foreign tire": (("foreign",), 0, np.inf),
    }
    rows = []
    for of, (sets, low, high) in groups.items():
        inside = [
            k
            for k in outcomes
            if labels[k]["set"] in sets and low <= labels[k]["gap_over_noise"] <= high
        ]
        if inside:
            size = np.array([labels[k]["mimic_free"] for k in inside])
            flagged = np.mean([outcomes[k].unknown for k in inside])
            found = norm.cdf(size - norm.isf(_ALARMS / 2 / SHAPES))
            rows += [
                [name, str(len(inside)), f"{np.mean(share):.3f}", f"{flagged:.3f}"]
                for name, share in ((of, size >= SHOWS), (f"{of}, one of {SHAPES} shapes", found))
            ]
    return rows


def size_of_change(before: dict, after: dict) -> float:
    """How far a change of measured data moves what the brush leaves of them, in
    standard errors of who is told which change it is.

    What it leaves is taken for noise that remembers (first order, within a run);
    stiffness and friction adapt to the change.

    Args:
        before, after: columns of the file as measured and with the change.
    """
    run = before["run"]

    def missed(columns, p):
        slip = np.tan(columns["alpha"])
        return columns["fy"] - plain_brush(slip, columns["fz"], *np.exp(p))[0]

    fit = least_squares(lambda p: missed(before, p), np.log([C, MU]))
    left, same = missed(before, fit.x), run[1:] == run[:-1]
    memory = np.sum((left[1:] * left[:-1])[same]) / np.sum((left[:-1] ** 2)[same])

    def fresh(values):
        return (values[1:] - memory * values[:-1])[same]

    moved, base = fresh(missed(after, fit.x) - left), fresh(fit.jac)
    moved = moved - base @ np.linalg.lstsq(base, moved, rcond=None)[0]
    return float(np.linalg.norm(moved) / np.sqrt(np.mean(fresh(left) ** 2)))


def injected_that_show(folder: Path, labels: dict, outcomes: dict) -> list[list[str]]:
    """[of what, n, possible, answered]: whether a change of measured data shows, and
    whether it was named."""
    sizes: dict[str, list[tuple[bool, bool]]] = {}
    for name, outcome in outcomes.items():
        label = labels[name]
        if label["set"] == "injected":
            after = read_columns(folder / "trials" / label["file"])
            size = size_of_change(half(label["half"]), after)
            sizes.setdefault(label["kind"], []).append((size >= SHOWS, outcome.exact))
    groups = {f"injected: {kind}": of for kind, of in sorted(sizes.items())}
    if groups:
        groups = {"injected": [one for of in sizes.values() for one in of]} | groups
    return [
        [of, str(len(each)), *(f"{share:.3f}" for share in np.mean(each, axis=0))]
        for of, each in groups.items()
    ]


class _Observed(NamedTuple):
    """One trial: what the observer believes most, how much, and whether it is so; what
    was answered. ``shows``: whether the effects do, to who is told them; ``off``: by
    how much he and the answer miss what the answer closes, where it claims any."""

    size: int
    strength: float
    gap: float
    right: bool
    chance: float
    exact: bool
    said: bool
    answered_right: bool
    answered_chance: float
    shows: bool = False
    off: tuple[float, float] | None = None


def _observed(folder: Path, label: dict, outcome: Outcome, answer: Path) -> _Observed:
    """``answer``: the rows that an answer wrote."""
    trial = _trial(folder, label)
    truth = tuple(sorted(label["effects"]))
    found = beliefs(trial.x, evidence(trial.x, trial.observed, truth, pairs=True))
    best = max(found, key=found.get)
    seen = _Observed(
        len(truth),
        label["root_lambda"],
        label["gap_over_noise"],
        best == truth,
        found[best],
        outcome.exact if truth else not outcome.flagged,
        outcome.exact_or_alias,
        outcome.right,
        outcome.probability,
    )
    if not truth:
        return seen
    forms = dict(zip(label["effects"], label["forms"], strict=True))
    known = told(trial.x, trial.observed, forms, np.random.default_rng(0))
    seen = seen._replace(shows=known.shows)
    if not outcome.claimed or outcome.closed is None:
        return seen
    rows, channel, n = read_columns(answer), trial.x.force, len(trial.more)
    closed = [
        true_closure(rows, {channel: forces[:n] + trial.more}, channel) for forces in known.forces
    ]
    missed = abs(np.median(closed) - outcome.closed)
    return seen._replace(off=(missed, abs(outcome.claimed - outcome.closed)))


def observer_rows(
    folder: Path, answers: Path, labels: dict, outcomes: dict, count: int
) -> list[list[str]]:
    """[of what, n, possible, answered] of as many trials without an effect, in the
    noise that is stated, with one and with two: how often who knows all forms names the
    set, the Brier score of what he believes of it; of those with effects, whether who
    is told which they are sees them, and how far off he says what is closed."""
    each = []
    for of in ("null", "singles", "pairs"):
        names = [
            k
            for k in sorted(outcomes)
            if labels[k]["set"] == of and (of != "null" or labels[k]["kind"] in _STATED)
        ]
        each += [
            _observed(
                folder,
                labels[k],
                outcomes[k],
                (answers / labels[k]["file"]).with_suffix(".rows.csv"),
            )
            for k in names[:count]
        ]
    groups = {
        "nothing": [o for o in each if o.size == 0],
        "one effect, any gap": [o for o in each if o.size == 1],
        **{
            f"one effect, {of}": [
                o
                for o in each
                if o.size == 1 and low <= (o.strength if by == "root_lambda" else o.gap) <= high
            ]
            for of, low, high, by in _SIZES[1:]
        },
        "pairs": [o for o in each if o.size == 2],
    }
    rows = [
        [
            of,
            str(len(one)),
            f"{np.mean([o.right for o in one]):.3f}",
            f"{np.mean([o.exact for o in one]):.3f}",
        ]
        for of, one in groups.items()
        if one
    ]
    rows += [
        [
            f"{of}, told which; or said so",
            str(len(one)),
            f"{np.mean([o.shows for o in one]):.3f}",
            f"{np.mean([o.said for o in one]):.3f}",
        ]
        for of, one in groups.items()
        if one and one[0].size
    ]
    if each:
        mine = np.mean([(o.chance - o.right) ** 2 for o in each])
        said = np.mean([(o.answered_chance - o.answered_right) ** 2 for o in each])
        rows.append(["Brier score of all these", str(len(each)), f"{mine:.3f}", f"{said:.3f}"])
    if off := [o.off for o in each if o.off]:
        rows += [
            [
                f"closure, told which: {name}",
                str(len(off)),
                *(f"{value:.3f}" for value in np.quantile(off, level, axis=0)),
            ]
            for name, level in (("median error", 0.5), ("90 %", 0.9))
        ]
    return rows


def bound_rows(
    folder: Path, answers: Path, labels: dict, outcomes: dict, count: int
) -> list[list[str]]:
    """[of what, n, possible, answered] for a table.

    Of the first ``count`` trials of each kind that have an answer, by name; of all
    with something that is not listed, or with a change of measured data.
    """
    if not count:
        return []
    return [
        *observer_rows(folder, answers, labels, outcomes, count),
        *strangers_that_show(labels, outcomes),
        *injected_that_show(folder, labels, outcomes),
    ]


class _Trial(NamedTuple):
    """A file: its inputs, what was ``observed``, and what the force (n,) is more at the
    slip as logged than at that of the inputs: the noise of the slip is no gap."""

    x: Inputs
    observed: np.ndarray
    more: np.ndarray


def _trial(folder: Path, label: dict) -> _Trial:
    path = folder / "trials" / label["file"]
    columns = read_columns(path)
    rig = tomllib.loads((path.parent / "rig.toml").read_text())
    x, observed = from_columns(columns, rig)
    logged = columns["sigma_x"] if x.force == "fx" else np.tan(columns["alpha"])
    fit = base_fit(x, observed)[0]
    then, now = (plain_brush(slip, x.fz, *fit)[0] for slip in (x.slip, logged))
    return _Trial(x, observed, now - then)
