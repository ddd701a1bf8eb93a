"""What may be said of the most probable set: its standing binds the verdict."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from conftest_diagnosis import RIG, TRUTHS, brush, record
from scipy.optimize import minimize_scalar
from tirefit.diagnosis.decide.adequacy import UNTESTED
from tirefit.diagnosis.decide.chances import (
    chance_of_unknown,
    chance_of_unlisted,
    chances,
)
from tirefit.diagnosis.decide.conclusion import Judge, bound_by, probability_of_rest
from tirefit.diagnosis.decide.standing import standing, steadiness

import tirefit
from tirefit.data.read import read_frame
from tirefit.diagnosis.decide import conclusion
from tirefit.diagnosis.decide.verdict import (
    Verdict,
    Weighed,
    _formulas_first,
    _rivals,
    stand_ins,
    swapped_beside,
)
from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.engine import diagnose
from tirefit.diagnosis.evidence.base import Base, fit_base
from tirefit.diagnosis.evidence.posterior import linear_at
from tirefit.diagnosis.evidence.search import PRIOR_OF_UNKNOWN, Hypothesis, Search
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.summary.records import HeldOut


def test_probability_of_a_rest_is_that_of_the_best_alternative():
    """The largest Bayes factor of densities a p^(a-1), 0 < a <= 1, against the uniform
    (Sellke, Bayarri and Berger 2001), found by search."""
    for p in (0.3, 0.05, 0.005, 1e-4):
        best = minimize_scalar(
            lambda a, p=p: -a * p ** (a - 1), bounds=(1e-6, 1), method="bounded",
            options={"xatol": 1e-10},
        )  # fmt: skip
        odds = -best.fun * PRIOR_OF_UNKNOWN / (1 - PRIOR_OF_UNKNOWN)
        assert probability_of_rest(p) == pytest.approx(odds / (1 + odds), rel=1e-6)
    assert probability_of_rest(1.0) == PRIOR_OF_UNKNOWN


NO_EFFECT, ONE_EFFECT = (
    Hypothesis((), effects, 0.0, 0.0, np.zeros(0), np.zeros(0), np.zeros((0, 0)), 0.0)
    for effects in ((), ("load_friction",))
)
NOTHING = Weighed(
    sets={}, best_of={(): NO_EFFECT}, unknown_alone=0.2, unknown_beside={},
    other_form=frozenset(), evidence={}, log_weight={}, log_beside={}, hidden=0.0,
    gains={},
)  # fmt: skip


def held(closed, resolvable=True):
    return HeldOut(
        rms=9.0, resolvable=resolvable, closed=closed, closed_ci=(closed, closed),
        remaining_rms=1.0, on="highest load",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("status", "closed", "on_others", "then"),
    [
        ("named", 0.9, held(0.85), "named"),
        ("named", 0.97, held(0.27), "incomplete"),
        ("named", 0.09, held(-0.13), "unknown"),
        ("incomplete", 0.5, held(-0.01), "unknown"),
        ("cannot_tell", 0.9, held(0.2), "incomplete"),
        ("named", 0.9, held(-1.0, resolvable=False), "named"),
        ("named", 0.9, None, "named"),
        ("none", None, None, "none"),
    ],
)
def test_rows_left_out_bind_the_verdict(status, closed, on_others, then):
    rivals = ("load_offset",) if status == "cannot_tell" else ()
    verdict = Verdict(
        status, ("load_friction",), 0.9, rivals, 0.0, ONE_EFFECT, UNTESTED
    )
    bound = bound_by(verdict, NOTHING, closed, on_others)
    assert bound.status == then
    # Who reads the verdict must be told that these rows decided it.
    assert bound.fails_elsewhere == (then != status)
    if then == "incomplete":
        assert bound.unlisted >= 0.5
        assert bound.also_possible == rivals
    if then == "unknown":
        assert bound.effects == ("unknown",) and bound.chosen is NO_EFFECT


@pytest.mark.parametrize("name", ["slip_offset", "load_friction", "none"])
def test_what_explains_everything_passes(diagnosed, name):
    found, _ = diagnosed(name)
    assert found.verdict.adequacy.passed
    assert found.verdict.status in ("named", "cannot_tell", "none")


def test_a_ripple_is_left_and_said(diagnosed):
    found, _ = diagnosed("unknown")
    assert not found.verdict.adequacy.passed
    assert found.verdict.status in ("unknown", "incomplete")
    assert "has structure" in str(found)


@pytest.mark.parametrize(("p_value", "may_be"), [(0.001, False), (0.004, True)])
def test_a_name_that_its_own_tests_refuse_is_not_all(monkeypatch, p_value, may_be):
    """One of six tests fails by chance at 0.004 of one name in forty."""

    def refused(*given):
        found = standing(*given)
        return found._replace(adequacy=found.adequacy._replace(time=p_value))

    monkeypatch.setattr(conclusion, "standing", refused)
    columns, _ = record(TRUTHS["slip_offset"], seed=3)
    found = diagnose(
        read_frame(columns, "refused", convention="braking"), rig=RIG, holdout=()
    )
    verdict = found.verdict
    assert "slip_offset" in (*verdict.effects, *verdict.also_possible)
    assert verdict.adequacy.passed == may_be
    assert (verdict.status in ("named", "cannot_tell")) == may_be


def test_a_name_has_an_error_bar_below_half_its_value(diagnosed):
    for name in ("slip_offset", "load_friction", "relaxation_length"):
        found, _ = diagnosed(name)
        chosen = next(c for c in found.candidates if c.effects == found.verdict.effects)
        for amplitude in chosen.parameters.values():
            assert amplitude.std < 0.5 * abs(amplitude.value)


def test_what_only_resembles_listed_effects_is_not_named():
    """Friction with a sharp peak at one load: load and pressure effects draw most of
    it, and leave the peak."""

    def truth(slip, time, fz, v):
        extra = 0.12 * np.exp(-(((np.abs(slip) - 0.1) / 0.02) ** 2) / 2)
        return brush(slip, 5e4, 0.9, fz) + np.sign(slip) * fz * extra * (fz > 5000)

    columns, _ = record(truth, seed=11)
    found = diagnose(read_frame(columns, "peak", convention="braking"), rig=RIG)
    assert found.verdict.status in ("unknown", "incomplete")
    assert not found.verdict.adequacy.passed


def test_of_sets_that_draw_alike_the_one_whose_formulas_do_best_is_the_likeliest():
    """They exchange their weights: no verdict is less probable than a candidate."""
    a, b, both, far = ("a",), ("b",), ("a", "b"), ("c",)
    weights = {a: 5.0, b: 6.0, both: 9.0, far: 9.0}
    fits = {k: SimpleNamespace(log_weight=w) for k, w in weights.items()}
    total = {(): 0.0, a: 8.0, b: 7.0, both: 7.5, far: 5.0}
    assert _formulas_first(total, fits) == total | {a: 7.0, b: 8.0}


def test_a_gap_in_one_place_is_no_row_of_outliers():
    """A rig that shakes at one speed: a fifth more force on rows that all lie about it,
    of which a robust fit takes each for an outlier. Single ones stay what they are."""
    generator = np.random.default_rng(7)
    time = np.arange(600) * 0.05
    slip, v = 0.1 * np.sin(2 * np.pi * time / 3), 5 + 20 * time / time[-1]
    force = brush(slip, 5e4, 0.9, 4000.0) + 60 * generator.standard_normal(600)
    data = {"time": time, "sigma_x": slip, "fx": force, "fz": 0 * v + 4000.0, "v": v}
    near = np.abs(v - 13) < 1.5
    shaken = data | {"fx": force + 800 * near}
    single = data | {"fx": force + 800 * (np.arange(600) % 12 == 5)}
    found = diagnose(read_frame(shaken, "shaken"))
    assert not set(found.effects) & {"outliers", "noise_autocorrelated"}
    assert found.verdict.status != "none"
    assert diagnose(read_frame(single, "single")).effects == ("outliers",)


def test_chances_agree_with_the_verdict():
    """What the verdict leaves is shared out by evidence among the listed."""
    a, b = ("load_friction",), ("slip_offset",)
    fits = {(): NO_EFFECT, a: ONE_EFFECT, b: replace(ONE_EFFECT, effects=b)}
    sets = {(): 0.1, a: 0.6, b: 0.2}
    log = {key: np.log(p) for key, p in sets.items()}
    weighed = replace(
        NOTHING, sets=sets, best_of=fits, unknown_alone=0.1, log_weight=log
    )

    def of(status, effects, probability):
        more = 0.8 if status in ("unknown", "incomplete") else 0.0
        verdict = Verdict(
            status, effects, probability, (), 0.0, ONE_EFFECT, UNTESTED, unlisted=more
        )
        return chances(verdict, weighed), chance_of_unknown(verdict, weighed)

    shared, unknown = of("named", a, 0.5)
    assert shared[a] == pytest.approx(0.5) and unknown == 0
    assert shared[b] == pytest.approx(0.5 / 3)
    # Named though another explains more, which these data cannot show by itself.
    shared, unknown = of("cannot_tell", b, 0.9)
    assert shared[b] == 0.9 and shared[a] == pytest.approx(0.1)
    shared, unknown = of("unknown", ("unknown",), 0.8)
    assert unknown == 0.8
    assert shared[a] == pytest.approx(0.2 * 0.6 / 0.9)
    shared, unknown = of("incomplete", a, 0.7)
    assert shared[a] == 0.7 and shared[b] == pytest.approx(0.2 * 0.2 / 0.9)
    shared, unknown = of("none", (), 0.7)
    assert unknown == 0.1 and shared[a] == pytest.approx(0.2 * 0.6 / 0.8)
    # What a name leaves is shared by the others and the unlisted in their own odds,
    # however sure of the name trials are: a third of 0.7 to 0.3.
    verdict = Verdict("cannot_tell", a, 0.8, (), 0.0, ONE_EFFECT, unlisted=0.3)
    odds = 0.7 / 3 / 0.3
    unlisted = chance_of_unlisted(verdict, weighed)
    assert unlisted == pytest.approx(0.2 / (1 + odds))
    assert chances(verdict, weighed) == pytest.approx(
        {a: 0.8, b: 0.2 * odds / (1 + odds)}
    )


@pytest.mark.parametrize(
    ("status", "probability", "unlisted", "said"),
    [
        ("named", 0.6, 0.3, 0.4 * 0.3 / (0.3 + 0.7 * 0.25)),
        ("incomplete", 0.47, 0.99, 0.99),
        ("incomplete", 0.7, 0.5, 0.7),
        ("unknown", 0.8, 0.8, 0.8),
        ("none", 0.5, 0.0, 0.1 + 0.15),
        ("none", 0.9, 0.0, 0.1),
    ],
)
def test_the_unlisted_is_as_likely_as_the_verdict_says(
    status, probability, unlisted, said
):
    """Alone (0.1) or beside (0.15), by the tests where they were asked, and never
    against the verdict: what it says is there, what it says is not. What a name leaves
    is the unlisted's and the other sets', here a quarter."""
    key = ("load_friction",)
    weighed = replace(
        NOTHING, unknown_alone=0.1, unknown_beside={key: 0.15},
        log_weight={key: np.log(3.0), (): 0.0},
    )  # fmt: skip
    verdict = Verdict(status, key, probability, (), 0.0, ONE_EFFECT, unlisted=unlisted)
    assert chance_of_unlisted(verdict, weighed) == pytest.approx(said)


@pytest.mark.parametrize("name", ["unknown", "slip_offset", "none"])
def test_the_document_says_how_likely_the_unlisted_is(diagnosed, name):
    verdict = json.loads(diagnosed(name)[0].to_json())["verdict"]
    unlisted = verdict["left"]["unlisted"]
    if name == "unknown":
        assert unlisted >= max(0.5, verdict["probability"])
    else:
        assert 0 < unlisted <= 1 - verdict["probability"] < 0.5


def test_what_another_form_explains_is_no_remainder():
    """A zero of the slip that settles within a tenth of the record, about its mean,
    against the formulas alone, which cannot, and with their other forms."""

    def settling(slip, time, fz, v):
        return brush(slip + 0.02 * (np.exp(-time / 2.4) - 0.12), 5e4, 0.9, fz)

    frame, _ = record(settling, seed=3)
    base = fit_base(prepare(read_frame(frame), RIG, ("fx",)), "brush", EFFECTS, RIG)
    hypothesis = _of_one(base, "slip_zero_drift")
    linear = linear_at(base, hypothesis)
    alone, freed = (
        standing(base, hypothesis, one.used_up, np.random.default_rng(0)).adequacy
        for one in (linear, linear.in_other_form())
    )
    assert not alone.passed and alone.held_out < 1e-3
    assert freed.passed and freed.held_out > 0.1


def _of_one(base, effect: str) -> Hypothesis:
    """An effect, refitted from one prior scale."""
    atom = next(k for k, atom in enumerate(base.atoms) if atom.effect.id == effect)
    refit = base.refit([(base.z, np.array([1.0]))], [(atom,)])
    p = len(refit.z[0])
    return Hypothesis(
        (atom,), (effect,), 0.0, 0.0, refit.z[0], refit.amplitude[0][:1],
        refit.covariance[0][: p + 1, : p + 1], float(refit.chi2[0]),
    )  # fmt: skip


def test_an_effect_is_steady_where_the_truth_has_one_size():
    """A slip offset of one size, against one that comes and goes with the time: the
    same error by the rows, another between the parts of the record."""

    def drifting(slip, time, fz, v):
        return brush(slip + 0.008 * np.sin(0.9 * time), 5e4, 0.9, fz)

    steadiest = {}
    for name, truth in (("steady", TRUTHS["slip_offset"]), ("drifts", drifting)):
        frame, _ = record(truth, seed=3)
        base = fit_base(prepare(read_frame(frame), RIG, ("fx",)), "brush", EFFECTS, RIG)
        hypothesis = _of_one(base, "slip_offset")
        steady, moved = steadiness(
            base, hypothesis, linear_at(base, hypothesis).used_up
        )
        steadiest[name] = steady[0]
        # One part left out, against a refit without it.
        slips = np.abs(base.prepared.slip)
        out = slips > np.quantile(slips, 0.8)
        keep = np.array(base.design.keep)
        keep[: base.prepared.n] *= ~out
        design = base.design._replace(keep=keep)
        start = [(hypothesis.z, hypothesis.amplitude)]
        again = base.refit(start, [hypothesis.atoms], design).amplitude[0][0]
        size = float(hypothesis.amplitude[0])
        assert abs(again - size) / abs(size) < 1.2 * moved[0] + 0.02
    assert steadiest["steady"] > 5
    assert steadiest["drifts"] < 3


class Told(Judge):
    """Every effect of a set is as likely as the set is told to say."""

    def __init__(self, log_weight):
        self.weighed = replace(NOTHING, log_weight=log_weight)

    def clues_by_effect(self, key):
        return {effect: {"chance": SAID[key]} for effect in key}


SAID = {
    ("a", "b", "x"): 0.2, ("a", "c", "x"): 0.6, ("a", "d", "x"): 0.7, ("e",): 0.9,
}  # fmt: skip
ALIKE = {("a", "b", "x"): 0.30, ("a", "c", "x"): 0.29, ("a", "d", "x"): 0.28}


@pytest.mark.parametrize("far", [0.0, -5000.0])
def test_what_all_leading_sets_hold_is_asked_over_all(monkeypatch, far):
    """Which of three that draw a gap as well comes first does not decide, however much
    better something unlisted explains it."""
    monkeypatch.setattr(conclusion, "probability_beside", lambda clues: clues["chance"])

    def asked(key, weights):
        log = {k: np.log(p) + far for k, p in weights.items()}
        judge = Told(log)
        return judge.leading(key), judge.beside(key)

    leading, found = asked(("a", "b", "x"), ALIKE | {("e",): 0.01, (): 0.12})
    assert sum(leading.values()) == pytest.approx(1) and ("e",) not in leading
    mean = (0.30 * 0.2 + 0.29 * 0.6 + 0.28 * 0.7) / 0.87
    assert found["a"] == found["x"] == pytest.approx(mean)
    assert (found["b"], found["d"]) == (pytest.approx(0.2), pytest.approx(0.7))
    for key in ALIKE:
        assert asked(key, ALIKE)[1]["a"] == pytest.approx(mean)
    # The set that is asked about is asked, however improbable.
    assert asked(("e",), ALIKE | {("e",): 1e-9})[1]["e"] == pytest.approx(0.9)


def test_effects_beside_the_best_set_are_said_too():
    sets = {("a",): 0.5, ("a", "b"): 0.3, ("c", "d"): 0.2, ("e",): 0.02}
    assert _rivals(sets, ("a",)) == ("b",)
    assert _rivals(sets, ("a", "b")) == ("c", "d")


def test_what_takes_its_place_beside_others_nearly_as_well_is_said():
    """Within odds of 30 of the best set; of the last it is told apart."""
    log = {
        ("a", "b"): 0.0, ("b", "c"): -2.0, ("a", "d"): -3.0, ("d", "e"): -3.3,
        ("a",): -9.0, ("f",): -9.0, ("b", "g"): -4.0,
    }  # fmt: skip
    weighed = replace(NOTHING, log_weight=log)
    assert set(swapped_beside(weighed, ("a",))) == {"c", "e"}
    assert set(swapped_beside(weighed, ("b",))) == {"d"}


def test_what_moves_the_same_and_differs_by_less_than_is_left_may_be_there_instead():
    """Beside a remainder of log evidence 30."""
    log = {
        ("slip_offset_speed",): -10.0, ("slip_offset",): -35.0,
        ("speed_zero",): -45.0, ("force_offset",): -12.0,
    }  # fmt: skip
    gains = {("slip_offset_speed",): {"smooth": 30.0, "cells": 2.0}}
    weighed = replace(NOTHING, log_beside=log, gains=gains)
    atoms = [SimpleNamespace(effect=effect) for effect in EFFECTS]
    search = Mock(spec=Search, base=SimpleNamespace(atoms=atoms))
    # Of the others one explains too little, and one moves the force.
    assert stand_ins(search, weighed, ("slip_offset_speed",)) == ("slip_offset",)
    assert stand_ins(search, weighed, ("force_offset", "speed_zero")) == ()


def test_the_heading_of_another_day_may_be_a_zero_that_moves_with_speed():
    """Of this car it is known to be constant; this day alone cannot say so."""
    folder = Path(__file__).parents[2] / "fits" / "dart_simulator"
    circles = tirefit.fit(folder / "circles.csv", "brush")
    verdict = tirefit.diagnose(folder / "free_driving.csv", sim=circles).verdict
    assert verdict.status == "incomplete"
    assert "slip_offset" in {*verdict.effects, *verdict.also_possible}


def nothing_of(nothing=0.01, passed=True, excess=1.0):
    """A verdict where no effect is known to half its size."""
    sets, evidence = {(): nothing, ("a",): 0.9 - nothing}, {(): 0.0, ("a",): 9.0}
    weighed = replace(NOTHING, sets=sets, evidence=evidence)
    left = SimpleNamespace(adequacy=UNTESTED._replace(time=1e-6, passed=passed))
    base = Mock(spec=Base, noise={"fx": SimpleNamespace(excess=excess)})
    search = SimpleNamespace(base=base)
    judge = Mock(spec=Judge, weighed=weighed, of=lambda key: left, search=search)
    asked = Verdict("cannot_tell", ("a",), 0.9, ("b",), 0.001, ONE_EFFECT)
    return conclusion._nothing_stands(asked, judge)


@pytest.mark.parametrize("nothing, also", [(0.01, ("a", "b")), (0.1, ())])
def test_what_the_evidence_asks_for_is_said_where_no_effect_is_known(
    nothing, also, monkeypatch
):
    """All tests passed: perhaps it is there, unless nothing may be there as well."""
    monkeypatch.setattr(conclusion, "hidden_by_noise", lambda base, chosen: False)
    monkeypatch.setattr(conclusion, "probability_of_rest", lambda p: 0.1)
    verdict = nothing_of(nothing)
    assert (verdict.status, verdict.effects) == ("none", ())
    assert verdict.also_possible == also
    assert verdict.probability == pytest.approx(1 - max(0.1, NOTHING.unknown_alone))


def test_a_gap_that_no_known_effect_explains_says_what_may():
    verdict = nothing_of(passed=False)
    assert (verdict.status, verdict.effects) == ("unknown", ("unknown",))
    assert verdict.also_possible == ("a", "b")


@pytest.mark.parametrize("excess, hidden", [(2.5, False), (1.0, True)])
def test_no_gap_is_said_where_the_noise_is_none(excess, hidden, monkeypatch):
    monkeypatch.setattr(conclusion, "hidden_by_noise", lambda base, chosen: hidden)
    assert nothing_of(excess=excess).status == "unknown"


def test_what_is_known_of_a_set_is_as_likely_as_all_that_hold_it():
    """Beside an effect whose size nobody can see."""
    log = {("a",): -4.0, ("a", "b"): 0.0, ("a", "c"): -1.0, ("b",): -2.0, (): -9.0}
    weighed = replace(NOTHING, log_weight=log)
    odds = {key: np.exp(value) for key, value in log.items()}
    without_a = odds["b",] + odds[()]
    assert weighed.holding(("a",)) == pytest.approx(1 - without_a / sum(odds.values()))
    assert weighed.holding(("a", "b")) == pytest.approx(
        weighed.among_listed(("a", "b"))
    )


ERRORS = {
    ("a", "b", "x"): (6.0, 2.5, 4.0), ("a", "x"): (2.4, 1.1), ("a",): (2.4,),
    ("b",): (2.9,), ("x",): (9.0,), ("a", "y"): (5.0, 5.0),
}  # fmt: skip
"""Amplitude over its error of each effect of a set, by set."""


@pytest.mark.parametrize(
    ("likely", "imitating", "named"),
    [
        # Of the likeliest set one is not known: what is known of it stands by itself.
        ("ax", (), ("x",)),
        # Firm in the leading set, though not beside what its own leaves.
        ("a", (), ("a",)),
        # Firm nowhere.
        ("b", (), ()),
        ("", (), ()),
        ("ay", (("a", "y"),), ("a",)),
        ("axy", (("a", "y"),), ("x",)),
    ],
)
def test_beside_something_unlisted_what_is_firm_is_named(likely, imitating, named):
    log = {("a", "b", "x"): -1.0, ("a", "y"): -2.0, ("a", "x"): -3.0, ("x",): -4.0,
           ("a",): -5.0, ("b",): -6.0, (): -90.0}  # fmt: skip

    def firm(key, least):
        return tuple(e for e, z in zip(key, ERRORS[key], strict=True) if z >= least)

    judge = Mock(spec=Judge, weighed=replace(NOTHING, log_weight=log), firm=firm)
    judge.is_known = lambda key: Judge.is_known(judge, key)
    judge.leading = lambda key: {key: 1.0}
    judge.imitates = lambda key: key in imitating
    chances = {e: 0.4 if e in likely else 0.05 for e in "abxy"}
    assert conclusion._earned(judge, ("a", "b", "x"), chances) == named
