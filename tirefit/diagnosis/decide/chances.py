"""Probabilities of sets and of what is not listed, in agreement with a verdict."""

from tirefit.diagnosis.decide.verdict import Verdict, Weighed
from tirefit.diagnosis.negligible import NONZERO


def chances(verdict: Verdict, weighed: Weighed) -> dict[tuple[str, ...], float]:
    """Probability of each refitted set to be all that is there, in agreement with the
    verdict: what it and something unlisted leave for the others is shared out by their
    evidence. That of an incomplete verdict's set is the verdict's, something unlisted
    beside it."""
    listed = {
        k: float(p)
        for k, p in weighed.listed.items()
        if k and weighed.best_of[k].refitted
    }
    key = tuple(sorted(verdict.effects))
    left = 1 - chance_of_unlisted(verdict, weighed)
    if verdict.status == "none":
        left = max(left - verdict.probability, 0.0)
        scale = min(1.0, left / max(sum(listed.values()), NONZERO))
        return {k: scale * v for k, v in listed.items()}
    if verdict.status in ("named", "cannot_tell") and listed.get(key):
        mine, rest = verdict.probability, sum(listed.values()) - listed[key]
        scale = min(mine / listed[key], (left - mine) / max(rest, NONZERO))
        return {k: scale * v for k, v in listed.items()} | {key: mine}
    shared = {k: left * v for k, v in listed.items()}
    return shared | ({key: verdict.probability} if key in listed else {})


def chance_of_unknown(verdict: Verdict, weighed: Weighed) -> float:
    """Probability that what is there is not listed at all."""
    if verdict.status == "unknown":
        return verdict.probability
    return weighed.unknown_alone if verdict.status == "none" else 0.0


def chance_of_unlisted(verdict: Verdict, weighed: Weighed) -> float:
    """Probability that something unlisted is there, alone or beside listed effects."""
    if verdict.status == "none":
        return min(weighed.unlisted, 1 - verdict.probability)
    if verdict.status == "unknown":
        return verdict.probability
    if verdict.status == "incomplete":
        # That of the effects named beside it is no larger, whatever decided.
        return max(verdict.unlisted, verdict.probability)
    # What the name leaves, shared out as before trials said how sure it is.
    share = weighed.listed.get(tuple(sorted(verdict.effects)), 0.0)
    others = (1 - verdict.unlisted) * (1 - share)
    left = max(verdict.unlisted + others, NONZERO)
    return (1 - verdict.probability) * verdict.unlisted / left
