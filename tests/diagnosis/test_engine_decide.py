"""The decision: from findings written by hand to each status, by each threshold."""

from dataclasses import fields, replace

import numpy as np
import pytest
from conftest_diagnosis import weighed_of
from scipy.special import expit

from tirefit.diagnosis.engine.decide import (
    POLICY,
    Features,
    Findings,
    Learned,
    Policy,
    Status,
    calibration,
    decide,
    helping,
    no_gap_shows,
    swaps_of,
)
from tirefit.diagnosis.engine.fit import Folds
from tirefit.diagnosis.engine.left_out import Gain, LeftOut, Predicted
from tirefit.diagnosis.engine.search import parts_of

A, B = ("a",), ("b",)
AB = ("a", "b")
PLAIN = Learned({}, (0.0, *[0.0] * 2, 1.0, *[0.0] * 6))
"""A calibration that leaves every probability: a cause is as likely as its sets."""


def gain(ratio=5.0, size=100.0, closed=0.5):
    """A gain of ``ratio`` standard errors on six parts."""
    return Gain(size, size / ratio, closed, closed / ratio)


def gains(key, ratio=5.0):
    """A set whose effects have equal gains."""
    return {e: gain(ratio) for e in key}


def features(odds=7.0, **others):
    blank = dict.fromkeys(Features._fields, 0.0) | {"listed": odds}
    return Features(**blank | others)


def findings(alone, sets=None, unlisted=0.1, beside=None):
    """``sets`` are the gains by set; those of the best one if not given."""
    best = max((k for k in alone if k), key=alone.__getitem__)
    sets = {best: gains(best)} if sets is None else sets
    each = {key: {e: features() for e in key} for key in sets}
    weighed = weighed_of(alone, beside)
    return Findings(weighed=weighed, gains=sets, features=each, unlisted=unlisted)


def decided(found, policy=POLICY, learned=PLAIN):
    return decide(found, policy, learned)


NAMED = findings({A: 0.9, (): 0.02})


def test_effects_above_the_thresholds_are_named():
    verdict = decided(NAMED)
    assert (verdict.status, verdict.effects, verdict.key) == (Status.NAMED, A, A)
    # Of these causes, and of nothing unlisted: odds are limited to exp(7).
    assert verdict.unlisted == pytest.approx(0.1)
    each = verdict.each["a"]
    assert each.probability == pytest.approx(expit(7.0)) and each.twins == ()
    assert verdict.probability == pytest.approx(0.9 * expit(7.0))
    assert (each.closed_left_out, each.closed_left_out_std) == (0.5, 0.1)
    assert verdict.acts_like == () == verdict.also_possible


def test_the_effect_that_gains_most_comes_first():
    sets = {AB: {"a": gain(size=50.0), "b": gain(size=80.0)}}
    assert decided(findings({AB: 0.9, A: 0.02}, sets)).effects == ("b", "a")


@pytest.mark.parametrize(
    ("unlisted", "status", "effects"),
    [(0.5, Status.NONE, ()), (0.51, Status.UNKNOWN, ("unknown",))],
)
def test_without_a_gap_the_unlisted_probability_decides(unlisted, status, effects):
    verdict = decided(findings({A: 0.1, (): 0.8}, {}, unlisted))
    assert (verdict.status, verdict.effects, verdict.each) == (status, effects, {})
    assert verdict.probability == pytest.approx(max(unlisted, 1 - unlisted))


def test_an_equivalent_effect_gives_cannot_tell_and_adds_its_probability():
    """The two are equally likely; one of them is certainly there."""
    verdict = decided(findings({A: 0.48, B: 0.46, (): 0.01}))
    assert (verdict.status, verdict.effects) == (Status.CANNOT_TELL, A)
    assert verdict.also_possible == B and verdict.each["a"].twins == B
    assert verdict.each["a"].probability == pytest.approx(expit(7.0))
    # A rival together with the whole set is possible, but not equivalent.
    verdict = decided(findings({A: 0.7, AB: 0.2}))
    assert verdict.status == Status.CANNOT_TELL and verdict.also_possible == B
    assert verdict.each["a"].twins == ()


def test_twins_count_together_beside_an_unlisted_effect_too():
    beside = {A: 0.3, B: 0.3, (): 0.2}
    found = findings({A: 0.1, B: 0.09, (): 0.01}, unlisted=0.8, beside=beside)
    weights = dict.fromkeys(Features._fields, 0.0) | {"beside": 1.0}
    learned = Learned({}, (0.0, *weights.values()))
    verdict = decided(found, learned=learned)
    assert verdict.each["a"].probability == pytest.approx(0.6 / 0.8)
    assert verdict.status == Status.INCOMPLETE
    assert verdict.probability == pytest.approx(0.75 * 0.8)


@pytest.mark.parametrize(
    ("lacks", "error", "unlisted", "is_twin"),
    [
        (9.0, 9.1, 0.1, True),  # within a standard error of the difference
        (9.1, 9.0, 0.1, False),
        (9.9, 0.0, 0.6, True),  # a tenth of the gain of 100, which something unlisted may have
        (10.1, 0.0, 0.6, False),
        (9.9, 0.0, 0.4, False),
        (-5.0, 1.0, 0.1, True),  # it predicts better
    ],
)
def test_an_effect_that_predicts_data_left_out_as_well_is_a_twin(lacks, error, unlisted, is_twin):
    found = findings({A: 0.99, B: 1e-9, (): 1e-6}, unlisted=unlisted)
    found = replace(found, swaps={"a": {"b": Gain(lacks, error, 0.0, 0.0)}})
    verdict = decided(found)
    assert (verdict.each["a"].twins == B) is is_twin is (verdict.also_possible == B)


def test_what_is_known_beside_the_rows_excludes_a_twin():
    found = findings({A: 0.99, B: 1e-9, (): 1e-6})
    found = replace(found, swaps={"a": {"b": Gain(0.0, 1.0, 0.0, 0.0)}})
    for odds, is_twin in ((2.2, True), (2.4, False)):  # a tenth is 2.303
        known = replace(found, odds={A: 1.5, B: 1.5 - odds})
        assert (decided(known).each["a"].twins == B) is is_twin


def test_an_effect_that_does_not_help_has_no_twin_by_data_left_out():
    sets = {AB: {"a": gain(), "b": gain(0.9)}, A: gains(A)}
    found = replace(findings({AB: 0.8, A: 0.02}, sets), swaps={"b": {"c": gain(0.1, 1.0)}})
    assert decided(found).also_possible == B
    found = replace(found, swaps={"a": {"c": gain(0.1, 1.0)}})
    assert decided(found).also_possible == (*B, "c")


def test_swaps_are_gains_over_sets_with_another_effect_in_the_place_of_one():
    rng = np.random.default_rng(3)
    effects = ((), A, B, AB, ("a", "c"), ("c", "d"), ("b", "c"))
    loss = rng.uniform(1, 2, (5, len(effects)))
    left = {k: LeftOut(x, 10 * x, x, x) for k, x in zip(effects, loss.T, strict=True)}
    out = Predicted(Folds(loss, "parts"), np.full(5, 10), left, left[()])
    swaps = swaps_of(out, AB, 0.1)
    assert {e: {*others} for e, others in swaps.items()} == {"b": {"c"}, "a": {"c"}}
    parts = 10 * (loss[:, 4] - loss[:, 3])
    assert swaps["b"]["c"].gain == pytest.approx(parts.sum())
    assert swaps["b"]["c"].std == pytest.approx(np.sqrt(5 * parts.var(ddof=1)))
    assert {*swaps_of(out, A, 0.1)["a"]} == {"b"} and swaps_of(out, (), 0.1) == {}


def test_an_effect_that_helps_but_is_hardly_the_cause_acts_like_one():
    """By its features, in the order and with the offset of the calibration."""
    found = findings({AB: 0.9, A: 0.02})
    odds = {"a": features(spread=-1.0), "b": features(spread=2.0)}
    found = replace(found, features={AB: odds})
    weights = dict.fromkeys(Features._fields, 0.0) | {"spread": -1.0}
    verdict = decided(found, learned=Learned({}, (0.25, *weights.values())))
    assert (verdict.effects, verdict.acts_like, verdict.key) == (A, B, AB)
    assert verdict.each["a"].probability == pytest.approx(expit(1.25))
    assert verdict.each["b"].probability == pytest.approx(expit(-1.75))
    assert verdict.probability == pytest.approx(0.9 * expit(1.25))
    # Without any cause the status is unknown, whatever helps.
    verdict = decided(found, learned=Learned({}, (-9.0, *weights.values())))
    assert (verdict.status, verdict.effects) == (Status.UNKNOWN, ("unknown",))
    assert {*verdict.acts_like} == {"a", "b"} == {*verdict.each}


def test_the_probability_of_the_unlisted_is_calibrated():
    learned = Learned({"unlisted": (1.0, 0.5)}, PLAIN.weights)
    verdict = decided(replace(NAMED, unlisted=0.2), learned=learned)
    assert verdict.unlisted == pytest.approx(expit(1.0 + 0.5 * np.log(0.25)))
    assert verdict.status == Status.INCOMPLETE


def test_the_largest_part_that_helps_is_named():
    sets = {AB: {"a": gain(), "b": gain(0.9)}, A: gains(A), B: gains(B)}
    found = findings({AB: 0.8, A: 0.02, B: 0.01}, sets)
    verdict = decided(found)
    assert helping(found) == verdict.effects == A and verdict.also_possible == B


def test_an_unexplained_gap_is_unknown_unless_it_may_be_noise():
    weak = {A: gains(A, 0.5)}
    verdict = decided(findings({A: 0.9, (): 0.05}, weak))
    assert (verdict.status, verdict.effects) == (Status.UNKNOWN, ("unknown",))
    assert verdict.also_possible == A and verdict.probability == 0.5
    quiet = decided(findings({A: 0.7, (): 0.2}, weak))
    assert (quiet.status, quiet.also_possible) == (Status.NONE, A)
    assert decided(findings({A: 0.3, (): 0.6}, weak, unlisted=0.7)).status == Status.UNKNOWN


@pytest.mark.parametrize("least", [0.5, POLICY.gain, 4.0])
def test_an_effect_must_gain_on_data_left_out(least):
    """More than the policy's number of standard errors, and of no other number."""
    policy = replace(POLICY, gain=least)
    for ratio, named in ((0.99, False), (1.01, True)):
        found = findings({A: 0.9, (): 0.02}, {A: gains(A, ratio * least)})
        assert (decided(found, policy).status == Status.NAMED) == named


@pytest.mark.parametrize("likely", [0.3, 0.5, 0.9])
def test_a_cause_and_an_unlisted_effect_reach_the_required_probability(likely):
    policy = Policy(likely=likely)
    weights = dict.fromkeys(Features._fields, 0.0) | {"spread": 1.0}
    learned = Learned({}, (0.0, *weights.values()))
    for p in (likely - 0.01, likely + 0.01):
        odds = {A: {"a": features(spread=np.log(p / (1 - p)))}}
        verdict = decided(replace(NAMED, features=odds), policy, learned)
        assert (verdict.effects == A) == (p > likely)
        verdict = decided(replace(NAMED, unlisted=p), policy)
        assert verdict.status == (Status.INCOMPLETE if p > likely else Status.NAMED)


@pytest.mark.parametrize("perhaps", [0.05, 0.1, 0.4])
def test_a_rival_is_reported_from_the_required_probability(perhaps):
    for share, also in ((1.02 * perhaps, B), (0.98 * perhaps, ())):
        found = findings({A: 0.6, B: 0.6 * share}, unlisted=0.0)
        assert decided(found, Policy(perhaps=perhaps)).also_possible == also


def test_no_gap_is_reported_if_no_significant_set_is_probable():
    few = {A: 0.3, (): 0.6}
    assert no_gap_shows(weighed_of(few))
    assert no_gap_shows(weighed_of({(): 1.0}))  # nothing was fitted
    assert not no_gap_shows(weighed_of({A: 0.6, (): 0.3}))
    # Sets whose evidence does not reach 20 to 1 say as little as none.
    assert no_gap_shows(weighed_of({A: 0.6, (): 0.3}, evidence={A: 2.9, (): 0.0}))
    assert no_gap_shows(weighed_of({A: 0.3, (): 0.3}, hidden=0.3))
    assert not no_gap_shows(weighed_of({A: 0.01, (): 0.6}, {(): 0.55}))


def test_every_status_satisfies_its_definition():
    """For any findings, each status satisfies its definition without repetition."""
    generator = np.random.default_rng(1)
    seen, keys = set(), [(), *parts_of(("a", "b", "c"))]
    weights = dict.fromkeys(Features._fields, 0.0) | {"spread": 1.0}
    learned = Learned({}, (0.0, *weights.values()))
    for _ in range(400):
        p = dict(zip(keys, generator.dirichlet(np.full(8, 0.3)) + 1e-6, strict=True))
        best = max(keys[1:], key=p.__getitem__)
        parts = [] if generator.uniform() < 0.2 else parts_of(best)
        sets = {key: {e: gain(float(generator.uniform(0.5, 6))) for e in key} for key in parts}
        found = findings({k: float(x) for k, x in p.items()}, sets, float(generator.uniform()))
        odds = {k: {e: features(spread=generator.normal()) for e in k} for k in parts}
        verdict = decided(replace(found, features=odds), learned=learned)
        seen.add(verdict.status)
        assert 0 <= verdict.probability <= 1
        assert set(verdict.each) == set(verdict.key)
        assert not set(verdict.also_possible) & set(verdict.key)
        causes = {e for e, one in verdict.each.items() if one.probability > POLICY.likely}
        assert set(verdict.acts_like) == set(verdict.key) - causes
        if verdict.status not in (Status.NONE, Status.UNKNOWN):
            assert set(verdict.effects) == causes and causes
            more = verdict.status == Status.INCOMPLETE
            assert more == (verdict.unlisted > POLICY.likely)
            assert (verdict.status == Status.CANNOT_TELL) <= bool(verdict.also_possible)
        else:
            assert not causes
    assert seen == set(Status)


def test_every_threshold_and_feature_is_explained():
    for record in (Policy, Features):
        names = getattr(record, "_fields", None) or [f.name for f in fields(record)]
        assert all(f"{name}:" in record.__doc__ for name in names)
    assert len(calibration().weights) == 1 + len(Features._fields)


@pytest.mark.parametrize("status", [*Status, "noise", "unlisted", "no such status"])
def test_calibration_is_a_line_in_log_odds(status):
    learned = calibration()
    offset, slope = learned.lines.get(status, (0.0, 1.0))
    assert slope > 0
    for odds in (-3.0, 0.0, 2.0):
        assert learned.often(status, expit(odds)) == pytest.approx(expit(offset + slope * odds))
    # Certainty is not distinguished from odds of exp(7), in either direction.
    for certain, far in ((1.0, 7.0), (0.0, -7.0)):
        assert learned.often(status, certain) == pytest.approx(expit(offset + slope * far))
