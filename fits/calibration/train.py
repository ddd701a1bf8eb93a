"""Logistic regression with a ridge, checked on groups that it was not taught."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

__all__ = ["STRANGE", "taught"]

STRANGE = ("unlisted", "leave_out", "foreign", "procedural", "beside")
"""Sets of trials with something that the library does not have."""

SAID = 0.5
"""Probability of something unlisted from which effects are asked for beside it."""

RIDGE = 3.0
FOLDS = 8


def _group(record) -> str:
    """What is left out together: trials of one kind of stranger or one family."""
    kind = (record["kind"] or "").split(" by ")[0]
    return f"{record['set']}/{kind}/{','.join(record['families'])}"


def _fitted(clues: np.ndarray, truth: np.ndarray, counts: np.ndarray):
    """(center, spread, weights, bias) of a ridge logistic regression; each case counts
    as so many."""
    center, spread = clues.mean(0), clues.std(0) + 1e-9
    unit = (clues - center) / spread

    def loss(b):
        t = unit @ b[1:] + b[0]
        value = counts @ (np.logaddexp(0, t) - truth * t) + RIDGE / 2 * b[1:] @ b[1:]
        off = counts * (1 / (1 + np.exp(-t)) - truth)
        return value, np.append(off.sum(), unit.T @ off + RIDGE * b[1:])

    b = minimize(loss, np.zeros(clues.shape[1] + 1), jac=True).x
    return center, spread, b[1:], b[0]


def _predicted(fit, clues) -> np.ndarray:
    center, spread, weights, bias = fit
    return 1 / (1 + np.exp(-((clues - center) / spread @ weights + bias)))


def _calibration_error(chance, truth, counts) -> float:
    """Mean distance of predicted and observed share over tenths of the probability."""
    place = np.minimum((chance * 10).astype(int), 9)
    off = np.bincount(place, counts * (chance - truth))
    return float(np.abs(off).sum() / counts.sum())


def _reliability(chance, truth, counts) -> list[list[float]]:
    """[mean probability, observed share, cases] of each tenth that holds any."""
    place = np.minimum((chance * 10).astype(int), 9)
    return [
        [
            round(float(np.average(values[own], weights=counts[own])), 3)
            for values in (chance, truth)
        ]
        + [int(own.sum())]
        for own in (place == k for k in np.unique(place))
    ]


def _evenly(truth) -> np.ndarray:
    """Counts by which what is true and what is not are as common, as many in all."""
    truth = np.array(truth, float)
    return np.where(truth == 1, 0.5 / truth.mean(), 0.5 / (1 - truth.mean()))


def _regression(names: Sequence[str], clues, truth, groups, counts) -> dict:
    clues, truth = np.array(clues, float), np.array(truth, float)
    kinds = sorted(set(groups))
    order = np.random.default_rng(0).permutation(len(kinds)) % FOLDS
    fold = np.array([dict(zip(kinds, order, strict=True))[g] for g in groups])
    chance = np.zeros(len(truth))
    for k in range(FOLDS):
        chance[fold == k] = _predicted(
            _fitted(clues[fold != k], truth[fold != k], counts[fold != k]),
            clues[fold == k],
        )
    center, spread, weights, bias = _fitted(clues, truth, counts)
    wrong = (chance > 0.5) != truth
    return {
        "bias": float(bias),
        "clues": {
            name: [float(c), float(s), float(w)]
            for name, c, s, w in zip(names, center, spread, weights, strict=True)
        },
        "checked": {
            "cases": len(truth),
            "of them true": int(truth.sum()),
            "groups": len(kinds),
            "Brier score": round(
                float(np.average((chance - truth) ** 2, weights=counts)), 4
            ),
            "wrong at 1/2": round(float(np.average(wrong, weights=counts)), 4),
            "calibration error": round(_calibration_error(chance, truth, counts), 4),
            "reliability": _reliability(chance, truth, counts),
        },
    }  # fmt: skip


def _table(records, which) -> np.ndarray:
    return np.array([list(r[which].values()) for r in records], float)


def _strange(records) -> np.ndarray:
    return np.array([r["set"] in STRANGE for r in records], float)


def taught(records: Sequence[dict]) -> dict:
    """Both regressions from the clues of trials (see ``collect``).

    To the first, one gap of two holds something unlisted, however many of the trials
    do: so one begins who knows nothing. The second is asked where the first says that
    something unlisted is there, so it is taught there, wrongly said or not. A trial of
    a measured file is left out of the first: what it holds is not known. A foreign tire
    is left out of the second: its friction may well fall with the speed.
    """
    seen = [r for r in records if r["more"]]
    first = [r for r in seen if r["set"] not in ("injected", "raw", "null")]
    strange = _strange(first)
    more = _regression(
        list(first[0]["more"]), _table(first, "more"), strange,
        [_group(r) for r in first], _evenly(strange),
    )  # fmt: skip
    fit = _fitted(_table(first, "more"), strange, _evenly(strange))
    said = _predicted(fit, _table(seen, "more")) >= SAID
    pairs = [
        (r, effect, clues)
        for r, so in zip(seen, said, strict=True)
        if so and r["set"] not in ("foreign", "raw", "null")
        for effect, clues in r["beside"].items()
    ]
    beside = _regression(
        list(pairs[0][2]), [list(clues.values()) for *_, clues in pairs],
        [effect in r["effects"] for r, effect, _ in pairs],
        [_group(r) for r, *_ in pairs], np.ones(len(pairs)),
    )  # fmt: skip
    return {"more": more, "beside": beside}
