"""The decision as shipped, and the same with one stage or rule switched off.

All is computed again from the records of :mod:`fits.ablation.collect`. A stage that
changes which sets the search refits (slip uncertainty) is switched off only for the sets
that were refitted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fits.calibration import logistic
from fits.withheld.judge import HIDDEN, kind_of
from tirefit.diagnosis.decide.findings import parts_of, probability_by_tests
from tirefit.diagnosis.decide.verdict import (
    POLICY,
    UNKNOWN,
    Findings,
    Fitted,
    Policy,
    Status,
    Tests,
    decide,
    no_gap_shows,
)
from tirefit.diagnosis.effects import NOISE_EFFECTS
from tirefit.diagnosis.evidence.posterior import Key, Weighed
from tirefit.diagnosis.evidence.search import PRIOR_OF_UNKNOWN
from tirefit.diagnosis.left_out import Gain
from tirefit.diagnosis.rows.basis import of_any_kind

__all__ = ["VARIANTS", "Answer", "Rules", "decided", "reproduced", "stated_unlisted", "weighed_of"]

ALWAYS = 1e9
"""As a limit in standard errors: no effect is refused."""

NEVER = 1.0
"""As a limit of a set's probability over that of the best: no set is a rival."""


@dataclass(frozen=True)
class Rules:
    """Rules of the diagnosis that are on.

    Attributes:
        policy: thresholds of the decision.
        plain: no rule but the evidence: the most probable of no effect, a set, a set with
            an unlisted effect, and an unlisted effect alone.
        climb: with an unlisted effect, the set that predicts whole runs best is used.
        calibrated: the probability of an unlisted effect is calibrated on trials; else it
            is that of the evidence.
        beside: the probability of an effect given an unlisted one comes from the runs
            left out, or from the sets with a discrepancy; else from all sets.
        each: an effect needs a probability above one half.
        forms: listed effects also have other forms.
        doubt: slip uncertainty lowers the evidence of a set.
        tests: the tests of the residual may detect an unlisted effect.
        without: kinds of discrepancy that are not fitted.
    """

    policy: Policy = POLICY
    plain: bool = False
    climb: bool = True
    calibrated: bool = True
    beside: bool = True
    each: bool = True
    forms: bool = True
    doubt: bool = True
    tests: bool = True
    without: tuple[str, ...] = ()


VARIANTS: dict[str, Rules] = {
    "plain decision": Rules(plain=True),
    "as shipped": Rules(),
    "known: amplitude over error not required": Rules(Policy(known=0.0)),
    "gain: no data left out": Rules(Policy(gain=-ALWAYS)),
    "each effect likelier than not: off": Rules(each=False),
    "own probability with an unlisted effect: off": Rules(beside=False),
    "climb off": Rules(climb=False),
    "also possible: off": Rules(Policy(perhaps=NEVER)),
    "probability of an unlisted effect not calibrated": Rules(calibrated=False),
    "discrepancy: smooth off": Rules(without=("smooth",)),
    "discrepancy: waves off": Rules(without=("waves",)),
    "discrepancy: patterns off": Rules(without=("patterns",)),
    "other forms off": Rules(forms=False),
    "slip uncertainty off": Rules(doubt=False),
    "tests of the residual off": Rules(tests=False),
}
"""The rows of the table."""


class Answer(NamedTuple):
    """The judged part of a verdict."""

    status: str
    effects: tuple[str, ...]
    probability: float
    also: tuple[str, ...]

    @property
    def document(self) -> dict:
        """The same in the form of a diagnosis document."""
        return {
            "verdict": {
                "status": self.status,
                "effects": self.effects,
                "probability": self.probability,
                "also_possible": self.also,
            }
        }

    @property
    def kind(self) -> str:
        """The status, or "noise" if only effects on the noise are named."""
        noise = {effect.id for effect in NOISE_EFFECTS}
        on_noise = self.effects and set(self.effects) <= noise
        return "noise" if on_noise else self.status


def weighed_of(record: Mapping, rules: Rules) -> Weighed:
    """The posterior over sets of a record under the rules."""
    kept, best, logs = record["weighed"], {}, {}
    rest, hidden = [], []
    for key, evidence, prior, due, refitted in record["hypotheses"]:
        evidence -= 0.0 if rules.doubt else due
        if refitted:
            logs.setdefault(key, []).append(evidence + prior)
            if key not in best or evidence + prior > sum(best[key][:2]):
                best[key] = evidence, prior, due
        else:
            rest.append(evidence + prior)
            hidden += [evidence + prior] if evidence < SHOWS else []
    total = {key: _sum(values) for key, values in logs.items()}
    evidence = {key: fit[0] for key, fit in best.items()}
    if rules.forms:
        for key in kept["gains"]:
            # The evidence that other forms add to that of the formulas.
            due = 0.0 if rules.doubt else best[key][2]
            form = kept["evidence"][key] - evidence[key] - due
            total[key] += form
            evidence[key] += form
    gains = {
        key: {kind: v for kind, v in of.items() if kind not in rules.without}
        for key, of in kept["gains"].items()
    }
    beside = {
        key: total[key] + of_any_kind(of) + float(np.log(PRIOR_OF_UNKNOWN))
        for key, of in gains.items()
    }
    everything = _sum([*total.values(), *beside.values(), *rest])
    return Weighed(
        best_of={},
        log_weight=total,
        log_beside=beside,
        evidence=evidence,
        other_form=frozenset(kept["other_form"] if rules.forms else ()),
        gains=gains,
        log_total=everything,
        hidden=float(np.sum(np.exp(np.array(hidden) - everything))),
    )


def _sum(logs: Sequence[float]) -> float:
    return float(np.logaddexp.reduce(logs))


UNLISTED = "unlisted"
"""Key of the calibration of the probability of an unlisted effect."""

SHOWS = 3.0
"""As in tirefit/diagnosis/evidence/posterior.py; the table states how many verdicts are
reproduced."""


@dataclass(frozen=True, kw_only=True)
class _Asked(Findings):
    """Findings with some rules switched off."""

    rules: Rules = field(default_factory=Rules)

    def probability(self, effect: str, key: Key, policy: Policy) -> float:
        if not self.rules.each:
            return 1.0
        if not self.rules.beside:
            return min(self.weighed.holding((effect,)), 1.0)
        return super().probability(effect, key, policy)


def stated_unlisted(records: Sequence[Mapping], rules: Rules) -> list[logistic.Stated]:
    """Probability of an unlisted effect by the evidence, and whether one is present.
    Measured files, whose effects are unknown, are omitted."""
    found = []
    for record in records:
        label = record["label"]
        if label["set"] not in ("raw", "injected", "measured"):
            there = kind_of(label) in HIDDEN
            found.append((UNLISTED, weighed_of(record, rules).unlisted, there))
    return found


def findings_of(record: Mapping, weighed: Weighed, unlisted: float, rules: Rules) -> Findings:
    """The findings of a record, the input of ``decide``."""
    out = record["out"]
    key = () if no_gap_shows(weighed, rules.policy) else weighed.best
    if key and unlisted > rules.policy.likely and out["across_runs"] and rules.climb:
        key = tuple(out["climbed"]) or key
    sets = {part: _fitted(record, part) for part in parts_of(key) if part in weighed.log_weight}
    return _Asked(
        weighed=weighed,
        sets=sets,
        across_runs=out["across_runs"],
        unlisted=unlisted,
        tests=Tests(),
        rules=rules,
    )


def _fitted(record: Mapping, key: Key) -> Fitted:
    """The figures of a set. If they were not recorded: each effect's largest amplitude over
    its error in other sets, and no data left out."""
    if key in record["fitted"]:
        errors, gains = record["fitted"][key]
        return Fitted(errors, {effect: Gain(*of) for effect, of in gains.items()})
    known = [errors for errors, _ in record["fitted"].values()]
    some = {e: max((k[e] for k in known if e in k), default=np.inf) for e in key}
    return Fitted(some, {})


def decided(record: Mapping, rules: Rules, lines: Mapping) -> Answer:
    """The answer to a record under the rules; ``lines`` of :func:`logistic.lines_of`."""
    weighed = weighed_of(record, rules)
    if rules.plain:
        answer = _plainly(weighed)
    else:
        unlisted = weighed.unlisted
        if rules.calibrated:
            unlisted = logistic.calibrated(lines, UNLISTED, unlisted)
        if rules.tests:
            tests = Tests(**record["found"].get("tests", {}))
            unlisted = max(unlisted, probability_by_tests(tests))
        found = findings_of(record, weighed, unlisted, rules)
        verdict = decide(found, rules.policy)
        answer = Answer(
            str(verdict.status), verdict.effects, verdict.probability, verdict.also_possible
        )
    named = {effect.flag: effect.id for effect in NOISE_EFFECTS if effect.flag}
    odd = tuple(named[flag] for flag in record["flags"] if flag in named)
    if answer.status == Status.NONE and odd:
        return answer._replace(status=str(Status.NAMED), effects=odd)
    return answer


def _plainly(weighed: Weighed) -> Answer:
    """The most probable of no effect, a set of listed effects, a set with an unlisted
    effect, and an unlisted effect alone."""
    listed = max(weighed.sets, key=weighed.sets.__getitem__)
    beside = max(weighed.beside, key=weighed.beside.__getitem__)
    unlisted, nothing = weighed.unlisted, weighed.nothing_shown
    if nothing > 0.5 or nothing > max(weighed.sets[listed], weighed.beside[beside]):
        return Answer(str(Status.NONE), (), nothing, ())
    if unlisted > 0.5:
        status = Status.INCOMPLETE if beside else Status.UNKNOWN
        return Answer(str(status), beside or (UNKNOWN,), unlisted, ())
    best, also = weighed.best, []
    least = weighed.log_weight[best] + np.log(POLICY.perhaps)
    for key, log in weighed.log_weight.items():
        smaller = len(key) <= len(best) or set(best) < set(key)
        if key != best and smaller and log > least:
            also += [effect for effect in key if effect not in best]
    status = Status.CANNOT_TELL if also else Status.NAMED
    probability = weighed.listed_given_gap(best) * (1 - unlisted)
    return Answer(str(status), best, probability, tuple(dict.fromkeys(also)))


def reproduced(record: Mapping) -> bool:
    """Whether the record reproduces the verdict as shipped."""
    rules = Rules()
    weighed = weighed_of(record, rules)
    verdict = decide(findings_of(record, weighed, record["found"]["unlisted"], rules))
    shipped = record["verdict"]
    return (
        verdict.effects == tuple(shipped["effects"])
        and abs(verdict.probability - shipped["probability"]) < 1e-6
    )
