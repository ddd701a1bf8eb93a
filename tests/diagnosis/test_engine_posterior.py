"""The posterior over sets, predictions of data left out, and the ladder, against dense
densities, explicit refits and hand-made numbers."""

import numpy as np
import pytest
from conftest_diagnosis import Toy, log_normal, weighed_of
from scipy.special import logsumexp
from scipy.stats import t as t_law

from tirefit.diagnosis.engine.decide import decide, findings_of, floor_of, gains_of, predictions
from tirefit.diagnosis.engine.discrepancy import LENGTHS, SIZES, Cell, Discrepancy, places_of
from tirefit.diagnosis.engine.fit import Folds
from tirefit.diagnosis.engine.left_out import (
    AS_GIVEN,
    NOISE,
    SMOOTH,
    LeftOut,
    Predicted,
    gained,
    jackknife_error,
    ladder_of,
    predicted,
    sizes_by_group,
)
from tirefit.diagnosis.engine.search import PRIOR_OF_UNKNOWN, searched, weighed

ROWS = 96
X = np.linspace(-1, 1, ROWS)
SHAPES, PLACES = places_of(X, None, 8)
SMOOTH_PART = Discrepancy(2 * SHAPES, (Cell("force", "time", PLACES, False),))


def subject(truth, seed=0, **other):
    """One parameter, two effects, and smooth functions of the time as an unlisted one."""
    generator = np.random.default_rng(seed)
    columns = generator.standard_normal((ROWS, 1))
    tangents = generator.standard_normal((ROWS, 2)) + 0.5 * columns
    observed = columns[:, 0] + truth(tangents) + generator.standard_normal(ROWS)
    return Toy(observed, columns, tangents, ("a", "b"), smooth=SMOOTH_PART, **other)


def listed(t):
    return 0.8 * t[:, 0]


def hidden(t):
    return 1.5 * np.sin(5 * X)


def both(t):
    return listed(t) + hidden(t)


# --- posterior.py ---------------------------------------------------------------------


def dense(of, atoms, more):
    """Log density of the observations with a set, and with smooth functions (l, s) too."""
    t = of.slopes[:, list(atoms)]
    wide = np.eye(ROWS) + t @ t.T
    if not more:
        return log_normal(of.observed, wide, of.columns)
    apart = np.abs(np.subtract.outer(*2 * [np.arange(8) / 7]))
    each = []
    for length in LENGTHS:
        far = np.sqrt(3) * apart / length
        prior = (1 + far) * np.exp(-far)
        for size in SIZES:
            smooth = size**2 * 4 * SHAPES @ prior @ SHAPES.T
            each.append(log_normal(of.observed, wide + smooth, of.columns))
    return logsumexp(each) - np.log(len(each))


@pytest.mark.parametrize(
    "truth", [listed, hidden, both, lambda t: 0.0], ids=["listed", "hidden", "both", "none"]
)
def test_probabilities_are_those_of_dense_densities(truth):
    """Every set of the two effects, alone and beside an unlisted one."""
    of = subject(truth)
    found = searched(of)
    posterior = weighed(found)
    sets = [(), (0,), (1,), (0, 1)]
    logs = {
        (tuple("ab"[k] for k in atoms), more): dense(of, atoms, more)
        + found.log_prior(atoms)
        + np.log(PRIOR_OF_UNKNOWN) * more
        for atoms in sets
        for more in (False, True)
    }
    total = logsumexp(list(logs.values()))
    for key, log in logs.items():
        part = posterior.beside if key[1] else posterior.sets
        assert part.get(key[0], 0.0) == pytest.approx(np.exp(log - total), abs=2e-3)
    assert posterior.unlisted == pytest.approx(
        sum(np.exp(log - total) for (_, more), log in logs.items() if more), abs=5e-3
    )
    assert posterior.best == max(("a",), ("b",), ("a", "b"), key=lambda k: logs[k, False])


def test_posterior_probabilities_sum_to_one():
    """Sets, sets with a discrepancy, and sets too improbable to refit."""
    of = weighed_of({("a",): 0.4, ("a", "b"): 0.2, (): 0.1}, {("a",): 0.15, ("b",): 0.1})
    assert of.best == ("a",) and of.unlisted == pytest.approx(0.25)
    assert sum(of.listed.values()) == pytest.approx(1.0)
    assert of.holding(("b",)) == pytest.approx(0.2 / 0.6)
    assert of.holding(("a",)) == pytest.approx(1.0)
    assert of.holding(("a",), beside=True) == pytest.approx(0.6)
    assert of.nothing_shown == pytest.approx(0.1)
    assert weighed_of({(): 1.0}).best == () and weighed_of({(): 1.0}).ranked == []


def test_sets_without_a_refit_that_the_data_could_not_show_are_hidden():
    """Of two sets only the one below 20 to 1 may hide an effect."""
    found = searched(subject(listed))
    whole = weighed(found).log_total
    found.guessed |= {(7,): (whole - 1.0, 2.9), (8,): (whole - 2.0, 3.1)}
    weak, clear = np.exp([-1.0, -2.0])
    assert weighed(found).hidden == pytest.approx(weak / (1 + weak + clear), rel=1e-3)


def test_variants_of_an_effect_share_its_probability():
    """One effect with two equal variants is as probable as with one."""
    generator = np.random.default_rng(2)
    columns, tangent = generator.standard_normal((2, ROWS, 1))
    observed = (columns + 0.5 * tangent)[:, 0] + generator.standard_normal(ROWS)
    other = generator.standard_normal((ROWS, 1))
    twice = np.concatenate([tangent, tangent, other], axis=1)
    once = weighed(searched(Toy(observed, columns, twice[:, 1:], ("a", "b"))))
    found = weighed(searched(Toy(observed, columns, twice, ("a", "a", "b"))))
    assert found.sets["a",] == pytest.approx(once.sets["a",], abs=1e-6)
    assert found.best_of["a",].atoms in ((0,), (1,))


# --- left_out.py ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def split():
    """Two channels, of which the second one has no unit, with six parts left out."""
    unit = np.where(np.arange(ROWS) % 3 == 2, 0.0, 5.0)
    of = subject(both, seed=3, unit=unit)
    sets = [of.fit(()), of.fit((0,)), of.fit((0, 1))]
    folds = of.folds(())
    return of, sets, folds, predicted(of, sets, sets[0], folds)


def test_predictions_agree_with_refits_to_the_other_parts(split):
    of, sets, folds, out = split
    assert out.folds == folds
    assert [*out.sets] == [(), ("a",), ("a", "b")] and out.as_given is None
    for fit in sets:
        k, found = len(fit.amplitude), out.sets[fit.key]
        prior = np.concatenate([np.zeros((k, 1)), np.eye(k)], axis=1)
        for f in range(6):
            inside = folds.code != f
            columns = np.concatenate([fit.columns[inside], prior])
            target = np.append(of.observed[inside], np.zeros(k))
            x = np.linalg.lstsq(columns, target, rcond=None)[0]
            left = (of.observed - fit.columns @ x)[~inside]
            first = of.unit[~inside] > 0
            assert found.loss[f] == pytest.approx(np.mean((5 * left[first]) ** 2), rel=1e-6)
            assert found.whitened[f] == pytest.approx(left @ left, rel=1e-6)
            np.testing.assert_allclose(found.parameters[f], x[:1], atol=1e-6)
            np.testing.assert_allclose(found.amplitude[f], x[1:], atol=1e-6)
    np.testing.assert_array_equal(
        out.rows, [np.sum(of.unit[folds.code == f] > 0) for f in range(6)]
    )


def test_anything_smooth_predicts_by_ridges_averaged_over_their_sizes(split):
    of, (null, *_), folds, out = split
    columns = SMOOTH_PART.additive
    for f in range(6):
        inside = folds.code != f
        y, a = of.observed[inside], null.columns[inside]
        logs, means = [], []
        for size in SIZES:
            smooth = columns[inside]
            wide = np.eye(inside.sum()) + size**2 * smooth @ smooth.T
            logs.append(log_normal(y, wide, a))
            z = np.linalg.solve(a.T @ np.linalg.solve(wide, a), a.T @ np.linalg.solve(wide, y))
            s = size**2 * smooth.T @ np.linalg.solve(wide, y - a @ z)
            means.append(null.columns @ z + columns @ s)
        weight = np.exp(np.array(logs) - logsumexp(logs))
        left = (of.observed - weight @ np.array(means))[~inside]
        assert out.smooth.whitened[f] == pytest.approx(left @ left, rel=1e-3)
        first = of.unit[~inside] > 0
        assert out.smooth.loss[f] == pytest.approx(np.mean((5 * left[first]) ** 2), rel=1e-3)


def test_a_simulator_as_given_is_not_refitted(split):
    of, sets, folds, _ = split
    given = Toy(of.observed, of.columns, of.slopes, of.names, smooth=SMOOTH_PART, unit=of.unit)
    given.given_residual = of.observed + 0.5
    out = predicted(given, sets[:1], sets[0], folds)
    for f in range(6):
        own = (folds.code == f) & (of.unit > 0)
        assert out.as_given.loss[f] == pytest.approx(25 * np.mean((of.observed[own] + 0.5) ** 2))
    steps = ladder_of(out, (), 20.0).steps
    assert [step.effects for step in steps] == [AS_GIVEN, (), SMOOTH, NOISE]
    # The gap is that of the simulator; its parameters close a part.
    assert steps[0].closed == 0 and steps[0].gain == 0
    before, after = (
        np.average(x, weights=out.rows) for x in (out.as_given.loss, out.sets[()].loss)
    )
    assert steps[1].gain == pytest.approx(before - after)
    assert steps[1].closed == pytest.approx(1 - np.sqrt((after - 20) / (before - 20)))


def drawn(seed=0, parts=6):
    """Losses of four sets with the truth a + b: (Predicted, floor)."""
    generator = np.random.default_rng(seed)
    sets, truth = ((), ("a",), ("b",), ("a", "b")), np.array([900.0, 400, 700, 150])
    loss = truth * generator.uniform(0.7, 1.3, (parts, 4))
    rows = generator.integers(20, 90, parts)
    whitened = loss * rows[:, None] / 100
    each = [LeftOut(*of, None, None) for of in zip(loss.T, whitened.T, strict=True)]
    smooth = LeftOut(loss[:, 3] - 20, (loss[:, 3] - 20) * rows / 100, None, None)
    sets = dict(zip(sets, each, strict=True))
    return Predicted(Folds(rows, "6 parts"), rows, sets, smooth), 100.0


def closed_by_hand(after, before, rows, floor):
    gap, left = (np.average(x, weights=rows) - floor for x in (before, after))
    return 1 - np.sqrt(left / gap)


@pytest.mark.parametrize("seed", range(3))
def test_a_gain_and_its_error_agree_with_a_loop_over_the_parts(seed):
    out, floor = drawn(seed)
    gain, old, new = gained(out, ("a",), (), floor), out.sets[()], out.sets["a",]
    each = [old.whitened[f] - new.whitened[f] for f in range(6)]
    assert gain.gain == pytest.approx(sum(each))
    assert gain.std == pytest.approx(np.sqrt(6) * np.std(each, ddof=1))
    closed, one_less = closed_by_hand(new.loss, old.loss, out.rows, floor), []
    for f in range(6):
        kept = [k for k in range(6) if k != f]
        one_less.append(closed_by_hand(new.loss[kept], old.loss[kept], out.rows[kept], floor))
    assert gain.closed == pytest.approx(closed)
    jackknife = np.sqrt(5 / 6 * np.sum((one_less - np.mean(one_less)) ** 2))
    assert gain.closed_std == pytest.approx(jackknife)
    # Each effect of a set against the set without it.
    gains = gains_of(out, ("a", "b"), floor)
    both = "a", "b"
    assert gains == {x: gained(out, both, (y,), floor) for x, y in (both, both[::-1])}


def test_the_ladder_descends_from_no_effect_to_the_noise():
    out, floor = drawn()
    ladder = ladder_of(out, ("a", "b"), floor)
    names = [step.effects for step in ladder.steps]
    assert names == [(), ("a",), ("a", "b"), SMOOTH, NOISE] and ladder.on == "6 parts"
    squares = [step.rms_left_out**2 for step in ladder.steps]
    losses = [out.sets[key].loss for key in names[:3]]
    means = [np.average(loss, weights=out.rows) for loss in losses]
    np.testing.assert_allclose(squares[:3], means)
    assert squares == sorted(squares)[::-1] and squares[-1] == pytest.approx(floor)
    # Each step gains what the rms falls by; the last two against the last set.
    gains = [step.gain for step in ladder.steps]
    falls = [0, *(-np.diff(squares[:4])), squares[2] - squares[4]]
    np.testing.assert_allclose(gains, falls, atol=1e-9)
    parts = out.rows / out.rows.sum() * (losses[0] - losses[1])
    assert ladder.steps[1].gain_std == pytest.approx(np.sqrt(6) * np.std(parts, ddof=1))
    assert ladder.steps[0].closed == 0 and ladder.steps[-1].closed == 1
    assert 0 < ladder.steps[1].closed < ladder.steps[2].closed < 1
    # Neither a set without a refit nor an unnamed one is a step.
    others = {("c",) if key == ("b",) else key: left for key, left in out.sets.items()}
    less = out._replace(sets=others)
    assert [s.effects for s in ladder_of(less, ("a", "b"), floor).steps] == names
    assert [s.effects for s in ladder_of(out, (), floor).steps] == [(), SMOOTH, NOISE]


def test_jackknife_error_of_a_mean_is_its_standard_error():
    """For a mean the jackknife is exact: the sample deviation over the root of n."""
    sample = np.random.default_rng(4).normal([3.0, -1.0], [0.2, 5.0], (7, 2))
    means = [np.delete(sample, k, axis=0).mean(axis=0) for k in range(7)]
    np.testing.assert_allclose(jackknife_error(means), sample.std(axis=0, ddof=1) / np.sqrt(7))


# --- from a subject to its verdict ----------------------------------------------------


def found_in(truth, seed=1, **other):
    search = searched(subject(truth, seed, **other))
    posterior, out = predictions(search)
    return search, posterior, out


@pytest.mark.parametrize("size", [0.8, 0.35])
def test_the_findings_come_from_the_fits_and_the_data_left_out(size):
    """The features of each effect, by hand; the gains against the set without it. A small
    effect has other odds beside an unlisted one."""
    search, posterior, out = found_in(lambda t: size * t[:, 0] + hidden(t))
    found = findings_of(search, posterior, out)
    best = next(iter(found.gains))
    assert best == posterior.best and best in found.features
    fit, floor = posterior.best_of[best], floor_of(search.subject, out)
    for effect, gain in found.gains[best].items():
        less = tuple(e for e in best if e != effect)
        assert gain == gained(out, best, less, floor)
        features = found.features[best][effect]
        place = fit.effects.index(effect)
        known = abs(fit.amplitude[place]) / fit.errors[place]
        assert features.known == pytest.approx(np.log(known))
        rest = fit.residual @ fit.residual + fit.amplitude @ fit.amplitude
        assert features.left == pytest.approx(np.log(rest / ROWS), abs=1e-3)
        p = posterior.holding((effect,))
        assert features.listed == pytest.approx(np.clip(np.log(p / (1 - p)), -7, 7))
        p = posterior.holding((effect,), beside=True)
        assert features.beside == pytest.approx(np.clip(np.log(p / (1 - p)), -7, 7))
        assert (features.closed, features.others) == (pytest.approx(gain.closed), len(best))
        sizes = sizes_by_group(fit, fit.atoms[place], search.subject.groups(), rest / ROWS)
        mean = np.mean([one.spread for one in sizes])
        assert features.spread == pytest.approx(np.log(mean + 0.05), abs=0.01)
        assert features.unequal**2 == pytest.approx(max(one.explains for one in sizes))


def test_without_a_gap_there_are_no_findings():
    search, posterior, out = found_in(lambda t: 0.0)
    found = findings_of(search, posterior, out)
    assert found.gains == {} and decide(found).status == "none"


def test_the_floor_is_at_most_the_loss_without_effects():
    search, _, out = found_in(lambda t: 0.0)
    loss = np.average(out.sets[()].loss, weights=out.rows)
    assert floor_of(search.subject, out) == pytest.approx(min(1.0, loss))
    search.subject.floor = 1e9
    assert floor_of(search.subject, out) == pytest.approx(loss)


def test_nothing_unlisted_is_claimed_where_smooth_functions_predict_no_better():
    """The posterior finds something smooth; leaving out parts that others cover does not."""
    search, posterior, out = found_in(hidden)
    assert posterior.unlisted > 0.9
    better = out.sets[posterior.best].whitened
    worse = out._replace(smooth=out.smooth._replace(whitened=better + np.arange(6)))
    limited = findings_of(search, posterior, worse).unlisted
    # Student's t of the six parts.
    gain = -np.arange(6.0)
    z = gain.sum() / (np.sqrt(6) * np.std(gain, ddof=1))
    assert limited == pytest.approx(t_law.cdf(z, 5)) and limited < 0.1
    # What belongs to one part of the data, no other part could predict.
    (cell,) = SMOOTH_PART.cells
    local = Discrepancy(SMOOTH_PART.columns, (cell._replace(is_local=True),))
    search.subject.discrepancy = local
    assert findings_of(search, posterior, worse).unlisted == pytest.approx(posterior.unlisted)
    search.subject.discrepancy = SMOOTH_PART
    worse = worse._replace(folds=out.folds._replace(is_covered=False))
    assert findings_of(search, posterior, worse).unlisted == posterior.unlisted
