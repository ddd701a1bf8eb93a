"""The best possible scores: of an observer who knows every form of the generator, of
unlisted effects that no listed one can fit, and of changes of measured data.

The observer names the set of effects with the largest evidence among none, one and two
effects. Hardly any method that has only the file is right more often, on average over
such trials. Given the effects and their forms, the observer also decides whether there
is evidence for each, and how much of the gap an answer closes.
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
from fits.withheld.observer import beliefs, evidence, given_effects
from fits.withheld.patch import plain_brush

__all__ = [
    "bound_rows",
    "injected_that_show",
    "observer_rows",
    "size_of_change",
    "unlisted_that_show",
]

SHOWS = 3.0  # standard errors: a test for this change finds 9 of 10 at 4 % false alarms
SHAPES = 1000
"""Number of shapes that a search for an unknown effect has to test: kinks, steps, bumps
and waves over every quantity, of stiffness, friction, slip and force."""

_ALARMS = 0.04

_STATED = ("iid", "slip_classical")
"""Noise laws that the rig file states completely."""

_SIZES = (
    ("any gap", 0, np.inf, "root_lambda"),
    ("sqrt(lambda) >= 5", 5, np.inf, "root_lambda"),
    ("strong", *STRONG, "gap_over_noise"),
    ("weak", *WEAK, "gap_over_noise"),
)
"""Ranges of the gap: name, smallest, largest, and the number of the label."""


def unlisted_that_show(labels: dict, outcomes: dict) -> list[list[str]]:
    """Rows [group, n, possible, answered]: share of trials with a gap that no listed effect
    fits at any amplitude, and share flagged; then the share found by a search over
    :data:`SHAPES` shapes that include the true one, at the same rate of false alarms."""
    groups = {
        "unlisted, strong": (("unlisted", "procedural"), *STRONG),
        "unlisted, weak": (("unlisted", "procedural"), *WEAK),
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
    """Norm of the change of the brush's residual by a change of measured data, in standard
    errors of a test for that change.

    The residual is taken as AR(1) noise within a run; stiffness and friction are
    refitted to the change.

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
    """Rows [group, n, possible, answered]: share of changes of measured data of at least
    :data:`SHOWS` standard errors, and share named."""
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
    """One trial: whether the observer's most probable set is right, its probability, and
    the scores of the answer. ``shows``: whether there is evidence for each effect, given
    the effects; ``off``: errors of the observer's and the answer's closure, where the
    answer claims one."""

    size: int
    strength: float
    gap: float
    right: bool
    chance: float
    exact: bool
    reported: bool
    answered_right: bool
    answered_chance: float
    shows: bool = False
    off: tuple[float, float] | None = None


def _observed(folder: Path, label: dict, outcome: Outcome, answer: Path) -> _Observed:
    """``answer``: the file of rows that an answer wrote."""
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
    known = given_effects(trial.x, trial.observed, forms, np.random.default_rng(0))
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
    """Rows [group, n, possible, answered] of ``count`` trials each without an effect (in the
    stated noise), with one and with two: how often the observer names the set, and the
    Brier score of its probability; given the effects, how often there is evidence for
    each, and the error of the closure."""
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
            f"{of}, effects given; or reported",
            str(len(one)),
            f"{np.mean([o.shows for o in one]):.3f}",
            f"{np.mean([o.reported for o in one]):.3f}",
        ]
        for of, one in groups.items()
        if one and one[0].size
    ]
    if each:
        mine = np.mean([(o.chance - o.right) ** 2 for o in each])
        theirs = np.mean([(o.answered_chance - o.answered_right) ** 2 for o in each])
        rows.append(["Brier score of all these", str(len(each)), f"{mine:.3f}", f"{theirs:.3f}"])
    if off := [o.off for o in each if o.off]:
        rows += [
            [
                f"closure, effects given: {name}",
                str(len(off)),
                *(f"{value:.3f}" for value in np.quantile(off, level, axis=0)),
            ]
            for name, level in (("median error", 0.5), ("90 %", 0.9))
        ]
    return rows


def bound_rows(
    folder: Path, answers: Path, labels: dict, outcomes: dict, count: int
) -> list[list[str]]:
    """Rows [group, n, possible, answered] of a table.

    They use the first ``count`` answered trials of each kind, by name, and all trials
    with an unlisted effect or with a change of measured data.
    """
    if not count:
        return []
    return [
        *observer_rows(folder, answers, labels, outcomes, count),
        *unlisted_that_show(labels, outcomes),
        *injected_that_show(folder, labels, outcomes),
    ]


class _Trial(NamedTuple):
    """A file: its inputs, the ``observed`` force, and ``more`` (n,), the force at the slip as
    logged minus that at the smoothed slip of the inputs: slip noise is no gap."""

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
