"""Logistic regression with a ridge, checked on groups that it was not taught."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

__all__ = ["Case", "chance", "checked", "taught"]

RIDGE = 3.0  # 1 / variance of a weight of a clue in units of its spread
FOLDS = 8
FALSE = 0.035  # share of files with nothing unlisted that may be flagged


class Case(NamedTuple):
    """Clues of one file, whether something unlisted is there, and the kind of what is
    there: cases of one kind are left out together."""

    clues: Mapping[str, float]
    strange: bool
    group: str


def taught(cases: Sequence[Case]) -> dict:
    """{"bias": b, "clues": {name: [centre, spread, weight]}} of all cases."""
    names = list(cases[0].clues)
    clues, truth = _table(cases, names)
    center, spread = clues.mean(0), clues.std(0) + 1e-9
    unit = (clues - center) / spread

    def loss(b):
        t = unit @ b[1:] + b[0]
        value = np.sum(np.logaddexp(0, t) - truth * t) + RIDGE / 2 * b[1:] @ b[1:]
        off = 1 / (1 + np.exp(-t)) - truth
        return value, np.append(off.sum(), unit.T @ off + RIDGE * b[1:])

    bias, *weights = minimize(loss, np.zeros(len(names) + 1), jac=True).x.tolist()
    columns = zip(center.tolist(), spread.tolist(), weights, strict=True)
    return {
        "bias": bias,
        "clues": {name: list(c) for name, c in zip(names, columns, strict=True)},
    }


def chance(numbers: Mapping, clues: Mapping[str, float]) -> float:
    """Probability of something unlisted by what :func:`taught` gave."""
    total = numbers["bias"]
    for name, (center, spread, weight) in numbers["clues"].items():
        total += weight * (clues[name] - center) / spread
    return float(1 / (1 + np.exp(-total)))


def untaught(cases: Sequence[Case]) -> np.ndarray:
    """Probability of each case by the cases of other groups."""
    groups = sorted({case.group for case in cases})
    order = np.random.default_rng(0).permutation(len(groups)) % FOLDS
    fold = dict(zip(groups, order.tolist(), strict=True))
    found = np.empty(len(cases))
    for k in range(FOLDS):
        numbers = taught([case for case in cases if fold[case.group] != k])
        for number, case in enumerate(cases):
            if fold[case.group] == k:
                found[number] = chance(numbers, case.clues)
    return found


def checked(cases: Sequence[Case]) -> dict[str, float]:
    """How well the regression does on kinds that it was not taught: log loss, share of
    strange files above one half and share of the others, and share of strange files
    above the probability that :data:`FALSE` of the others exceed."""
    truth = np.array([case.strange for case in cases])
    said = untaught(cases)
    likely = np.clip(np.where(truth, said, 1 - said), 1e-9, 1.0)
    level = np.quantile(said[~truth], 1 - FALSE)
    return {
        "cases": len(cases),
        "strange": int(truth.sum()),
        "log loss": float(-np.mean(np.log(likely))),
        "flagged at 1/2": float(np.mean(said[truth] > 0.5)),
        "false at 1/2": float(np.mean(said[~truth] > 0.5)),
        f"flagged at {100 * FALSE:g} % false": float(np.mean(said[truth] > level)),
    }


def _table(cases, names) -> tuple[np.ndarray, np.ndarray]:
    clues = [[case.clues[name] for name in names] for case in cases]
    return np.array(clues, float), np.array([c.strange for c in cases], float)
