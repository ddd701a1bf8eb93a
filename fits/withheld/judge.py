"""Scores one answer against its label: pure functions of two documents."""

import math
from typing import NamedTuple

import numpy as np

from fits.withheld.effects import EFFECTS, NOISE_EFFECTS, family_of

__all__ = ["Outcome", "answer_of", "judge", "kind_of", "true_closure"]

SURE = 0.9
INTERVAL = 1.645  # standard errors on both sides of 90 %
UNIT = {
    "delay": 1, "slip_lag": 1, "stiffness_power": 1, "sign_friction": 1,
    "slip_zero": -1, "slip_zero_creeps": -1,
    "force_zero": 1e3, "force_zero_creeps": 1e3, "conicity": 1e3, "load_leaks": 1e3,
}  # fmt: skip
"""Form -> an answer's amplitude over that of the form, where both mean the same."""
HIDDEN = ("unlisted", "leave_out", "foreign", "procedural", "beside")


def kind_of(label: dict) -> str:
    """The set as which a trial is judged; of a trial with a simulator, the set it was drawn as."""
    return label.get("of", label["set"])


class Outcome(NamedTuple):
    """The scores of one trial; None where a score does not apply."""

    name: str
    flagged: bool  # the answer claims a gap in the mean
    exact: bool
    family: bool
    top3: bool
    top5: bool
    exact_or_alias: bool
    unknown: bool  # the answer reports an unlisted effect
    right: bool  # the whole verdict, for calibration
    family_right: bool
    sure_wrong: bool
    probability: float
    family_probability: float
    covered: bool  # truth among the candidates that together have 90 %
    set_size: int
    status: str
    effects: tuple[str, ...]
    also: tuple[str, ...]
    named: bool = False  # every effect that is present
    false_names: int = 0  # named effects that are absent
    unlisted: float | None = None  # reported probability of an unlisted effect
    claimed: float | None = None
    claimed_ci: tuple | None = None
    closed: float | None = None
    resolvable: bool = False
    holdout: float | None = None
    within: tuple[bool, ...] = ()  # 90 % intervals of a simulator's parameters
    shares_off: tuple[float, ...] = ()  # of the budget's parts
    each: tuple[tuple[float, bool], ...] = ()  # probability of an effect, and whether it is there
    of_truth: float = 0.0  # probability of exactly the true verdict
    sizes: tuple[bool, ...] = ()  # within two errors of the true size, each named effect there


def families(effects, listed=None) -> frozenset:
    """Families of ids; of an id not in the table, the family given in the answer."""
    listed = listed or {}
    return frozenset(
        family_of(e) if e in EFFECTS or e in NOISE_EFFECTS else listed.get(e, e) for e in effects
    )


class Answer(NamedTuple):
    status: str
    effects: tuple[str, ...]
    mean: frozenset  # ids of effects on the mean: neither noise nor "unknown"
    also: tuple[str, ...]
    probability: float
    ranked: list  # (frozenset of effects, probability), best first
    names: dict  # families of ids that are not in the table


def answer_of(result: dict) -> Answer:
    verdict = result["verdict"]
    effects = tuple(verdict["effects"])
    mean = frozenset(e for e in effects if e not in (*NOISE_EFFECTS, "unknown"))
    candidates = result.get("candidates", [])
    ranked = [(frozenset(c["effects"]), float(c["probability"] or 0)) for c in candidates]
    names = {c["effects"][0]: c["family"] for c in candidates if len(c["effects"]) == 1}
    return Answer(
        verdict["status"],
        effects,
        mean,
        tuple(verdict["also_possible"]),
        float(verdict["probability"] or 0.0),
        ranked,
        names,
    )


def _credible(ranked, level=0.9) -> list:
    """The best candidates that together have this probability, or all."""
    held, out = 0.0, []
    for effects, probability in ranked:
        out.append(effects)
        held += probability
        if held >= level:
            break
    return out


def _family_probability(answer: Answer) -> float:
    """Probability of all candidates of the verdict's families, at least that of the verdict."""
    mine = families(answer.mean, answer.names)
    same = [p for e, p in answer.ranked if families(e, answer.names) == mine]
    return min(max(sum(same), answer.probability), 1.0) if mine else answer.probability


def judge(name: str, label: dict, result: dict) -> Outcome:
    """Scores one diagnosis by the rules of README.md, "What is checked"."""
    a, truth = answer_of(result), frozenset(label["effects"])
    unknown = a.status in ("unknown", "incomplete") or "unknown" in a.effects
    flagged = a.status != "none" and (bool(a.mean) or unknown)
    hidden = kind_of(label) in HIDDEN
    exact = flagged and not hidden and bool(truth) and a.mean == truth
    if label["set"] == "injected":  # the measured data have another gap as well
        exact = truth <= a.mean
    family = flagged and not hidden and bool(truth)
    family = family and families(a.mean, a.names) == families(truth)
    possible = a.mean | frozenset(a.also)
    alias = a.status == "cannot_tell" and bool(truth) and truth <= possible
    if hidden:
        right = family_right = unknown
        if label["set"] == "beside":  # named effects must be present
            right = family_right = unknown and a.mean <= truth
    elif label["set"] == "injected":
        right, family_right = exact, exact
    elif truth:
        right, family_right = exact and not unknown, family and not unknown
    else:
        right = family_right = not flagged
    named = bool(a.mean) and a.status == "named"
    best = [effects for effects, _ in a.ranked]
    credible = _credible(a.ranked)
    return Outcome(
        name=name, flagged=flagged, exact=exact, family=family,
        top3=exact or truth in best[:3], top5=exact or truth in best[:5],
        exact_or_alias=exact or alias, unknown=unknown, right=right,
        family_right=family_right,
        sure_wrong=named and a.probability > SURE and not right,
        probability=a.probability, family_probability=_family_probability(a),
        covered=truth in credible, set_size=len(credible), status=a.status,
        effects=a.effects, also=a.also, named=bool(truth) and truth <= a.mean,
        false_names=len(a.mean - truth),
        unlisted=result["verdict"].get("left", {}).get("unlisted"),
        each=_each(result, truth), of_truth=_of_truth(result, truth, hidden),
        sizes=_sizes(label, result), **_gap(result), **_simulator(label, result),
    )  # fmt: skip


def _each(result: dict, truth: frozenset) -> tuple[tuple[float, bool], ...]:
    """Stated probability of each effect that helps, and whether it is there; a twin counts."""
    each = result["verdict"].get("each", {})
    return tuple(
        (one["probability"], bool(truth & {name, *one["twins"]})) for name, one in each.items()
    )


def _of_truth(result: dict, truth: frozenset, unlisted: bool) -> float:
    """Probability that the answer gives to exactly the effects that are there, by the
    probabilities of each and of an unlisted effect."""
    verdict = result["verdict"]
    each, left = verdict.get("each", {}), verdict.get("left", {}).get("unlisted")
    if left is None or not truth <= each.keys():
        return 0.0
    chances = (
        one["probability"] if e in truth else 1 - one["probability"] for e, one in each.items()
    )
    return math.prod(chances) * (left if unlisted else 1 - left)


def _sizes(label: dict, result: dict) -> tuple[bool, ...]:
    """Whether the size of each named effect that is there is within two errors of the truth,
    for the forms whose amplitude has the meaning of the answer's."""
    verdict = result["verdict"]
    helping = {*verdict["effects"], *verdict.get("acts_like", ())}
    found = next((c for c in result.get("candidates", []) if {*c["effects"]} == helping), {})
    inside = []
    for effect, form, size in zip(
        label["effects"], label["forms"], label.get("amplitudes", ()), strict=False
    ):
        for name, amplitude in found.get("parameters", {}).items():
            if form in UNIT and effect in verdict["effects"] and name.startswith(f"{effect}: "):
                off = amplitude["value"] - UNIT[form] * size
                inside.append(abs(off) <= 2 * amplitude["std"])
    return tuple(inside)


def _simulator(label: dict, result: dict) -> dict:
    """Whether the parameters' intervals contain the truth, and the errors of the budget's
    shares: parameters, effects, unexplained.

    The share of a named effect that is absent counts nowhere.
    """
    if label["set"] != "simulators":
        return {}
    found = result["verdict"].get("parameters") or {}
    within = tuple(
        abs(found[name]["measured"] - about["true"]) <= INTERVAL * found[name]["std"]
        for name, about in label["parameters"].items()
        if about["scored"] and name in found
    )
    shares = {part["part"]: part["share"] for part in result.get("budget", [])}
    if not shares:
        return {"within": within}
    shares["effects"] = sum(shares.get(e, 0.0) for e in label["effects"])
    parts = ["parameters", "unexplained", *(["effects"] if label["effects"] else [])]
    off = tuple(abs(shares.get(p, 0.0) - label["budget"][p]) for p in parts)
    return {"within": within, "shares_off": off}


def _gap(result: dict) -> dict:
    gap = result.get("gap", {})
    interval = gap.get("closed_ci") or [None, None]
    holdout = gap.get("holdout") or {}
    return {
        "claimed": gap.get("closed"),
        "claimed_ci": None if None in interval else tuple(interval),
        "resolvable": bool(gap.get("resolvable")),
        "holdout": holdout.get("closed"),
    }


def true_closure(rows: dict, truth: dict, channel: str) -> float | None:
    """1 - RMS(truth - extended) / RMS(truth - base) of a channel, without masked rows."""
    base, extended = rows[f"base_{channel}"], rows[f"extended_{channel}"]
    keep = (rows["masked"] == 0) & np.isfinite(base) & np.isfinite(extended)
    before = np.sqrt(np.mean((truth[channel] - base)[keep] ** 2))
    after = np.sqrt(np.mean((truth[channel] - extended)[keep] ** 2))
    return float(1 - after / before) if before > 0 else None
