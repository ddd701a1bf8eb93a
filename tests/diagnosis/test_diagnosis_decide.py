"""The decision: from findings written by hand to each status, by each threshold."""

from dataclasses import fields, replace

import numpy as np
import pytest
from conftest_diagnosis import weighed_of
from scipy.stats import t

from tirefit.diagnosis.decide.findings import as_often_right, parts_of, probability_by_tests
from tirefit.diagnosis.decide.verdict import (
    POLICY,
    Findings,
    Fitted,
    Policy,
    Status,
    decide,
    no_gap_shows,
)
from tirefit.diagnosis.decide.verdict import Tests as Remainder
from tirefit.diagnosis.evidence.search import PRIOR_OF_UNKNOWN
from tirefit.diagnosis.left_out import Gain

A, B, C = ("a",), ("b",), ("c",)
AB = ("a", "b")


def gain(ratio=5.0, size=100.0, closed=0.5):
    return Gain(size, size / ratio, closed, closed / ratio, 6)


def fitted(key, error=9.0, ratio=5.0):
    """A set whose effects are equally well determined and have equal gains."""
    return Fitted(dict.fromkeys(key, error), {e: gain(ratio) for e in key})


def findings(alone, sets=None, unlisted=0.1, beside=None, **others):
    best = max((k for k in alone if k), key=alone.__getitem__)
    given = {"across_runs": True, "tests": Remainder(time=0.01), "unlisted": unlisted}
    given["sets"] = {best: fitted(best)} if sets is None else sets
    return Findings(weighed=weighed_of(alone, beside), **given | others)


NAMED = findings({A: 0.9, (): 0.02})


def test_effects_above_the_thresholds_are_named():
    verdict = decide(NAMED)
    assert (verdict.status, verdict.effects, verdict.key) == (Status.NAMED, A, A)
    assert verdict.unlisted == 0.1 and verdict.tests == NAMED.tests
    # Of exactly this set, if something is there, and of nothing unlisted.
    assert verdict.probability == pytest.approx(0.9)
    each = verdict.each["a"]
    assert (each.closed_left_out, each.closed_left_out_std) == (0.5, 0.1)
    assert each.probability == pytest.approx(1.0) and each.twins == ()


def test_the_effect_that_gains_most_comes_first():
    gains = {"a": gain(size=50.0), "b": gain(size=80.0)}
    sets = {AB: Fitted({"a": 9.0, "b": 9.0}, gains)}
    assert decide(findings({AB: 0.9, A: 0.02}, sets)).effects == ("b", "a")


@pytest.mark.parametrize(
    ("unlisted", "status", "effects"),
    [(0.5, Status.NONE, ()), (0.51, Status.UNKNOWN, ("unknown",))],
)
def test_without_a_significant_set_the_unlisted_probability_decides(unlisted, status, effects):
    verdict = decide(findings({A: 0.1, (): 0.8}, {}, unlisted))
    assert (verdict.status, verdict.effects, verdict.each) == (status, effects, {})
    assert verdict.probability == pytest.approx(max(unlisted, 1 - unlisted))


def test_an_equivalent_effect_gives_cannot_tell_and_adds_its_probability():
    """The two are equally likely; one of them is certainly there."""
    sets = {A: fitted(A)}
    verdict = decide(findings({A: 0.48, B: 0.46, (): 0.01}, sets))
    assert (verdict.status, verdict.effects) == (Status.CANNOT_TELL, A)
    assert verdict.also_possible == B and verdict.each["a"].twins == B
    assert verdict.each["a"].probability == pytest.approx(1.0)
    # A rival together with the whole set is possible, but not equivalent.
    verdict = decide(findings({A: 0.7, AB: 0.2}, sets))
    assert verdict.status == Status.CANNOT_TELL and verdict.also_possible == B
    assert verdict.each["a"].twins == ()


def test_named_effects_with_something_unlisted_are_incomplete():
    verdict = decide(replace(NAMED, unlisted=0.8))
    assert (verdict.status, verdict.effects) == (Status.INCOMPLETE, A)
    # That one more run is predicted better: Student's t of six.
    chance = t.cdf(5.0, 5)
    assert verdict.each["a"].probability == pytest.approx(chance)
    assert verdict.probability == pytest.approx(0.8 * chance)


def test_in_one_run_the_unlisted_reduces_the_probability_of_a_name():
    """In one run, sets with a discrepancy count for the probability of an effect."""
    beside = {A: 0.3, B: 0.5}
    one = findings({A: 0.9, B: 0.01}, unlisted=0.8, beside=beside, across_runs=False)
    assert decide(one).status == Status.UNKNOWN
    two = replace(one, weighed=weighed_of({A: 0.9, B: 0.01}, {A: 0.5, B: 0.3}))
    verdict = decide(two)
    assert (verdict.status, verdict.effects) == (Status.INCOMPLETE, A)
    assert verdict.each["a"].probability == pytest.approx(0.5 / 0.8)


def test_the_largest_significant_part_of_a_set_is_named():
    sets = {
        AB: Fitted({"a": 9.0, "b": 1.2}, {"a": gain(), "b": gain()}),
        A: fitted(A),
        B: fitted(B),
    }
    verdict = decide(findings({AB: 0.8, A: 0.02, B: 0.01}, sets))
    assert (verdict.effects, verdict.also_possible) == (A, B)
    # As likely as all sets that hold it.
    assert verdict.probability == pytest.approx(0.9 * 0.82 / 0.83)


def test_an_unexplained_gap_is_unknown_unless_it_may_be_noise():
    weak = {A: Fitted({"a": 1.0}, {"a": gain()})}
    verdict = decide(findings({A: 0.9, (): 0.05}, weak))
    assert (verdict.status, verdict.effects) == (Status.UNKNOWN, ("unknown",))
    assert verdict.also_possible == A and verdict.probability == 0.5
    quiet = decide(findings({A: 0.7, (): 0.2}, weak))
    assert (quiet.status, quiet.also_possible) == (Status.NONE, A)
    sure = findings({A: 0.3, (): 0.6}, weak, unlisted=0.7)
    assert decide(sure).status == Status.UNKNOWN


STANDS = {
    "known": lambda x: {A: Fitted({"a": x}, {"a": gain()})},
    "gain": lambda x: {A: Fitted({"a": 9.0}, {"a": gain(x)})},
}


@pytest.mark.parametrize(
    ("rule", "passes", "fails", "strict"), [("known", 2.0, 1.99, False), ("gain", 1.01, 1.0, True)]
)
def test_every_threshold_can_prevent_a_name(rule, passes, fails, strict):
    def named(value, policy=POLICY):
        verdict = decide(findings({A: 0.9, (): 0.02}, STANDS[rule](value)), policy)
        return verdict.status == Status.NAMED

    assert named(passes) and not named(fails)
    # It is the policy's number, and no other.
    for least in (0.5, 4.0):
        policy = replace(POLICY, **{rule: least})
        values = (0.9 * least, least, 1.1 * least)
        assert [named(v, policy) for v in values] == [False, not strict, True]


@pytest.mark.parametrize("likely", [0.3, 0.5, 0.9])
def test_a_named_effect_reaches_the_required_probability(likely):
    """With pairs, whose effects are not alternatives of each other."""
    policy, sets = Policy(likely=likely, perhaps=0.99), {AB: fitted(AB)}

    def named(p):
        rest = {("c", "d", "e"): 1 - p} if p < 1 else {}
        return decide(findings({AB: p} | rest, sets, 0.01), policy).status.names

    assert named(likely + 0.01) and not named(likely - 0.01)
    # Also above the limit for reporting something unlisted.
    for unlisted in (likely - 0.01, likely + 0.01):
        verdict = decide(replace(NAMED, unlisted=unlisted), policy)
        more = unlisted > likely
        assert verdict.status == (Status.INCOMPLETE if more else Status.NAMED)


@pytest.mark.parametrize("perhaps", [0.05, 0.1, 0.4])
def test_a_rival_is_reported_from_the_required_probability(perhaps):
    for share, also in ((1.02 * perhaps, B), (0.98 * perhaps, ())):
        found = findings({A: 0.6, B: 0.6 * share}, {A: fitted(A)}, 0.0)
        assert decide(found, Policy(perhaps=perhaps)).also_possible == also


def test_no_gap_is_reported_if_no_significant_set_is_probable():
    few = {A: 0.3, (): 0.6}
    assert no_gap_shows(weighed_of(few))
    assert no_gap_shows(weighed_of({(): 1.0}))  # nothing was fitted
    assert not no_gap_shows(weighed_of({A: 0.6, (): 0.3}))
    # Sets whose evidence does not reach 20 to 1 say as little as none.
    assert no_gap_shows(weighed_of({A: 0.6, (): 0.3}, evidence={A: 2.9, (): 0.0}))
    assert no_gap_shows(weighed_of({A: 0.3, (): 0.3}, hidden=0.3))
    assert not no_gap_shows(weighed_of({A: 0.01, (): 0.6}, {(): 0.55}))


def random_findings(generator, unlisted):
    """Three effects and their sets in any order of weight; whole runs left out."""
    keys = [(), *parts_of(("a", "b", "c"))]
    p = dict(zip(keys, generator.dirichlet(np.full(8, 0.3)) + 1e-6, strict=True))
    beside = {key: float(x) * generator.uniform() for key, x in p.items()}
    sets = {}
    for key in keys[1:]:
        errors = {e: float(generator.uniform(1.5, 9)) for e in key}
        gains = {e: gain(float(generator.uniform(0.5, 6))) for e in key}
        sets[key] = Fitted(errors, gains)
    best = max(keys[1:], key=p.__getitem__)
    sets = {key: sets[key] for key in parts_of(best)}
    alone = {key: float(x) for key, x in p.items()}
    return findings(alone, sets, unlisted, beside)


def test_across_runs_the_unlisted_removes_no_name():
    generator = np.random.default_rng(0)
    for _ in range(400):
        found = random_findings(generator, 0.2)
        before, after = (decide(replace(found, unlisted=chance)) for chance in (0.2, 0.95))
        if before.key == next(iter(found.sets)):
            assert after.key == before.key and after.status == Status.INCOMPLETE
        assert len(after.key) >= len(before.key)


def test_every_status_satisfies_its_definition():
    """For any findings, each status satisfies its definition without repetition."""
    generator = np.random.default_rng(1)
    seen = set()
    for _ in range(400):
        found = random_findings(generator, float(generator.uniform()))
        if generator.uniform() < 0.2:
            found = replace(found, sets={})
        verdict = decide(found)
        seen.add(verdict.status)
        assert 0 <= verdict.probability <= 1
        assert set(verdict.each) == set(verdict.key)
        assert not set(verdict.also_possible) & set(verdict.effects)
        assert bool(verdict.key) == verdict.status.names
        if verdict.key:
            assert set(verdict.effects) == set(verdict.key)
        more = found.unlisted > POLICY.likely
        assert more == (verdict.status in (Status.INCOMPLETE, Status.UNKNOWN)) or (
            verdict.status == Status.UNKNOWN and not verdict.key
        )
        assert all(0 <= each.probability <= 1 for each in verdict.each.values())
    assert seen == set(Status)


def test_every_threshold_is_explained():
    assert len(fields(Policy)) <= 15
    for field in fields(Policy):
        assert f"{field.name}:" in Policy.__doc__, field.name


def test_posterior_probabilities_sum_to_one():
    """Sets, sets with a discrepancy, and sets too improbable to refit."""
    of = weighed_of({A: 0.4, AB: 0.2, (): 0.1}, {A: 0.15, B: 0.1})
    assert of.best == A and of.unlisted == pytest.approx(0.25)
    assert sum(of.listed.values()) == pytest.approx(1.0)
    assert of.holding(B) == pytest.approx(0.2 / 0.6)
    assert of.holding(A) == pytest.approx(1.0)
    assert of.holding_beside(A) == pytest.approx(0.6)
    assert of.listed_given_gap(A) == pytest.approx(0.4 / 0.6)
    assert of.nothing_shown == pytest.approx(0.1)


def test_parts_of_a_set_come_largest_first():
    assert parts_of(("a", "b", "c"))[:2] == [("a", "b", "c"), ("a", "b")]
    assert [len(k) for k in parts_of(("a", "b", "c"))] == [3, 2, 2, 2, 1, 1, 1]


@pytest.mark.parametrize("p", [1e-6, 0.004, 0.1])
def test_probability_by_tests_is_the_bound_of_the_bayes_factor(p):
    """The bound is the largest ratio of a density b x^(b-1) of p-values to a uniform one."""
    b = np.linspace(1e-4, 1.0, 400_001)
    ratio = np.max(b * p ** (b - 1))
    prior = PRIOR_OF_UNKNOWN
    expected = prior * ratio / (prior * ratio + 1 - prior)
    assert probability_by_tests(Remainder(time=p)) == pytest.approx(expected, rel=1e-6)
    # Of two tests, the smaller p-value counts twice.
    two = Remainder(time=p / 2, line=0.9)
    assert probability_by_tests(two) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("tests", [{}, {"time": 0.5}, {"time": 0.3, "line": 0.2, "local": 0.9}])
def test_tests_that_find_nothing_leave_the_prior(tests):
    assert probability_by_tests(Remainder(**tests)) == pytest.approx(PRIOR_OF_UNKNOWN)


@pytest.mark.parametrize("status", [*Status, "noise", "unlisted"])
def test_calibration_is_a_line_in_log_odds(status):
    p = 1 / (1 + np.exp(-np.array([-3.0, -1.0, 0.0, 2.0, 4.0])))
    right = np.array([as_often_right(status, x) for x in p])
    odds = np.log(right / (1 - right))
    assert np.all(np.diff(odds) > 0)
    np.testing.assert_allclose(np.diff(odds) / [2, 1, 2, 2], odds[3] / 2 - odds[2] / 2)
    # Certainty is not distinguished from odds of exp(7), in either direction.
    for certain, far in ((1.0, 7.0), (0.0, -7.0)):
        limit = odds[2] + (odds[3] - odds[2]) / 2 * far
        assert as_often_right(status, certain) == pytest.approx(1 / (1 + np.exp(-limit)))


def test_a_status_without_calibration_keeps_its_probability():
    assert as_often_right("no such status", 0.3) == pytest.approx(0.3)
