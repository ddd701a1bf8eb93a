"""Fits ``tirefit/diagnosis/calibration.json`` to trials of known cause.

    python -m fits.calibration out/calibration/trials/* --records out/calibration/records

The trials are those of development seeds, never the designs and forms of the sealed ones. First
the probability that an effect is the cause, by logistic regression on the features of
:class:`tirefit.diagnosis.engine.decide.Features`, where worlds with listed effects only, with a
listed one beside an unlisted one, and with an unlisted one alone have a third of the weight
each; then, as lines in log odds, the probability of an unlisted effect and of a right verdict.

The printed table is of effects in trials that the fit did not see: each kind of unlisted effect
is left out as a whole.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from fits.calibration import logistic
from fits.calibration.collect import collect, loaded
from fits.withheld.judge import HIDDEN, judge, kind_of

PLACE = Path(__file__).parents[2] / "tirefit/diagnosis/calibration.json"

WORLDS = ("listed", "beside", "alone")
PARTS = 8  # of the trials that are left out in turn, each with whole kinds of unlisted effects
RIDGE = 1e-3  # on the weights of standardised features


def world_of(label: Mapping) -> str:
    """The world of a trial: only listed effects, one beside an unlisted one, or that alone."""
    if kind_of(label) == "beside":
        return "beside"
    return "alone" if kind_of(label) in HIDDEN else "listed"


def names_of(records: Sequence[Mapping]):
    """(features, whether it is there, world, kind of the unlisted effect) of each effect that
    helps; measured files, whose effects are unknown, are omitted."""
    from tirefit.diagnosis.engine.decide import POLICY, helping

    found = []
    for record in records:
        label, findings = record["label"], record["findings"]
        if label["set"] in ("raw", "injected", "measured", "simulators"):
            continue
        key = helping(findings, POLICY)
        for effect, features in findings.features.get(key, {}).items():
            there = effect in label["effects"]
            found.append((features, there, world_of(label), label.get("kind") or ""))
    return found


def weights_of(names) -> np.ndarray:
    """Offset and weights of the features, by logistic regression; each world counts alike."""
    features = np.array([one[0] for one in names], float)
    there = np.array([one[1] for one in names])
    worlds = [one[2] for one in names]
    share = np.array([1 / worlds.count(world) for world in worlds])
    share /= share.sum()
    mean, scale = features.mean(axis=0), features.std(axis=0) + 1e-12
    columns = np.column_stack([np.ones(len(features)), (features - mean) / scale])
    sign = np.where(there, 1.0, -1.0)

    def loss(b):
        odds = sign * (columns @ b)
        slope = -columns.T @ (share * sign * expit(-odds)) + 2 * RIDGE * np.append(0.0, b[1:])
        return share @ np.logaddexp(0, -odds) + RIDGE * b[1:] @ b[1:], slope

    offset, *weights = minimize(loss, np.zeros(columns.shape[1]), jac=True).x
    weights = np.array(weights) / scale
    return np.append(offset - weights @ mean, weights)


def left_out(names) -> np.ndarray:
    """Probability of each effect by a fit to the others, kinds of unlisted effects left out
    as a whole."""
    kinds = sorted({one[3] for one in names if one[3]})
    order = np.random.default_rng(0).permutation(len(kinds))
    place = {kinds[k]: part % PARTS for part, k in enumerate(order)}
    parts = np.array([place.get(one[3], k % PARTS) for k, one in enumerate(names)])
    stated = np.empty(len(names))
    for part in range(PARTS):
        weights = weights_of([n for n, p in zip(names, parts, strict=True) if p != part])
        for k in np.flatnonzero(parts == part):
            stated[k] = expit(weights[0] + weights[1:] @ np.array(names[k][0]))
    return stated


def table(names, stated) -> str:
    """Brier score and shares by world."""
    lines = ["| | names | right | Brier | stated > .8 and absent | present > .5 |", "|-|-|-|-|-|-|"]
    for world in WORLDS:
        mine = np.array([one[2] == world for one in names])
        there, p = np.array([one[1] for one in names])[mine], stated[mine]
        said = f"{np.mean(p[there] > 0.5):.2f}" if there.any() else "-"
        lines.append(
            f"| {world} | {len(p)} | {there.mean():.2f} | {np.mean((p - there) ** 2):.3f} |"
            f" {np.mean((p > 0.8) & ~there):.2f} | {said} |"
        )
    return "\n".join(lines)


def unlisted_of(records: Sequence[Mapping]) -> list[logistic.Stated]:
    """Probability of an unlisted effect by the evidence, and whether one is there."""
    return [
        ("unlisted", r["findings"].unlisted, kind_of(r["label"]) in HIDDEN)
        for r in records
        if r["label"]["set"] not in ("raw", "injected", "measured")
    ]


def verdicts_of(records: Sequence[Mapping], learned) -> list[logistic.Stated]:
    """Status, probability and whether right, of each trial."""
    from tirefit.diagnosis.engine.decide import POLICY, Status, decide

    found = []
    for record in records:
        if record["label"]["set"] in ("raw", "measured"):
            continue
        verdict = decide(record["findings"], POLICY, learned)
        quiet = verdict.status == Status.NONE and not verdict.also_possible
        noise = record["noise"] if quiet else ()
        answer = {
            "status": Status.NAMED if noise else verdict.status,
            "effects": noise or verdict.effects,
            "probability": verdict.probability,
            "also_possible": verdict.also_possible,
        }
        right = judge(record["name"], record["label"], {"verdict": answer}).right
        found.append(("noise" if noise else str(verdict.status), verdict.probability, right))
    return found


def main(arguments: list[str] | None = None) -> None:
    from tirefit.diagnosis.engine.decide import Features, Learned

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--records", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=PLACE)
    given = parser.parse_args(arguments)
    collect(given.folders, given.records, given.jobs)
    records = [r for folder in given.folders for r in loaded(given.records / folder.name)]
    names = names_of(records)
    print(table(names, left_out(names)))
    weights = weights_of(names)
    lines = logistic.lines_of(unlisted_of(records))
    learned = Learned({k: tuple(v) for k, v in lines.items()}, tuple(weights))
    verdicts = verdicts_of(records, learned)
    lines |= logistic.lines_of(verdicts)
    named = dict(zip(("offset", *Features._fields), np.round(weights, 4).tolist(), strict=True))
    given.out.write_text(json.dumps({"lines": lines, "cause": named}, indent=1) + "\n")
    halves = [k % 2 for k in range(len(verdicts))]
    print(json.dumps(logistic.checked(verdicts, halves), indent=1))


if __name__ == "__main__":
    main()
