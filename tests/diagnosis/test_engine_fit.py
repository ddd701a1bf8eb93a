"""A fitted set of effects and the search over sets, on a linear subject, against
quadrature, SciPy and dense formulas."""

from itertools import combinations

import numpy as np
import pytest
from conftest_diagnosis import Toy, log_normal
from scipy.integrate import quad, simpson
from scipy.optimize import least_squares
from scipy.stats import multivariate_normal, norm

from tirefit.diagnosis.engine.fit import Start, fitted
from tirefit.diagnosis.engine.search import (
    MOST_EFFECTS,
    PRIOR_OF_SIZE,
    Effort,
    Search,
    log_bayes,
    parts_of,
    searched,
)

ROWS = 60
NAMES = ("a1", "a2", "b1", "c1", "c1", "d1")
"""Two effects of one family; one effect with two variants."""


def toy(truth=(), seed=0, **other):
    """Two parameters, six tangents of which neighbours are correlated; ``truth`` are
    (atom, amplitude) pairs."""
    generator = np.random.default_rng(seed)
    columns = generator.standard_normal((ROWS, 2))
    tangents = generator.standard_normal((ROWS, 6)) + 0.6 * columns[:, :1]
    tangents[:, 1:] += 0.5 * tangents[:, :-1]
    observed = columns @ [2.0, -1.0] + generator.standard_normal(ROWS)
    for atom, size in truth:
        observed = observed + size * tangents[:, atom]
    return Toy(observed, columns, tangents, NAMES, **other)


# --- fit.py ---------------------------------------------------------------------------


def evidence_by_quadrature(subject, low):
    """Log of the integral over one parameter and one amplitude, over that without it."""
    x, t, y = subject.columns[:, 0], subject.slopes[:, 0], subject.observed
    middle = x @ y / (x @ x)
    z, a = np.linspace(middle - 9, middle + 9, 601), np.linspace(low, 9, 901)
    left = y - z[:, None, None] * x - a[:, None] * t
    density = np.exp(-0.5 * np.sum(left**2, axis=-1))
    prior = norm.pdf(a, subject.priors.center[0]) * (2.0 if low == 0 else 1.0)
    none = np.exp(-0.5 * np.sum((y - z[:, None] * x) ** 2, axis=1))
    whole = simpson(simpson(density * prior, x=a), x=z)
    return np.log(whole) - np.log(simpson(none, x=z))


@pytest.mark.parametrize("size", [0.4, 1.5])
@pytest.mark.parametrize(("low", "center"), [(-9.0, 0.0), (0.0, 0.0), (-9.0, 1.0)])
def test_evidence_agrees_with_quadrature(size, low, center):
    """With a free sign; with only the positive one, which excludes half of the prior; and
    with a prior about one. The likelihood is normal, so that Laplace's formula is exact."""
    generator = np.random.default_rng(3)
    x, t = generator.standard_normal((2, 12)) * [[1.0], [0.8]]
    y = 0.7 * x + size * t + 0.5 * generator.standard_normal(12)
    subject = Toy(y, x[:, None], t[:, None], ("a",), low=low, center=center)
    found = subject.fit((0,)).log_evidence - subject.fit(()).log_evidence
    assert found == pytest.approx(evidence_by_quadrature(subject, low), abs=1e-4)


def test_at_its_bound_an_effect_has_the_evidence_of_the_best_parameters():
    """Parameters that are correlated with an amplitude at its bound keep their best
    values: the misfit is that of no effect, and half of the normal law is on either side."""
    generator = np.random.default_rng(5)
    x = generator.standard_normal(40)
    t = x + 0.3 * generator.standard_normal(40)
    subject = Toy(x - 0.8 * t + 0.1 * t**2, x[:, None], t[:, None], ("a",), low=0.0)
    fit, null = subject.fit((0,)), subject.fit(())
    assert fit.amplitude[0] == pytest.approx(0.0, abs=1e-9)
    columns = fit.columns
    curvature = columns.T @ columns + np.diag([0.0, 1.0])
    expected = -0.5 * np.log(np.linalg.det(curvature) / (x @ x))
    assert fit.log_evidence - null.log_evidence == pytest.approx(expected, abs=1e-4)
    # A refit that ended inside is moved to the bound, with the parameters.
    z, a = np.array([0.3]), np.array([0.5])
    linear = subject.observed - fit.columns @ np.append(z, a), fit.columns
    inside = fitted(subject, (0,), Start(z, a), linear)
    assert inside.log_evidence == pytest.approx(fit.log_evidence, abs=1e-6)


def test_a_prior_of_the_parameters_is_about_zero():
    """The density of the observations, whatever the point of linearisation."""
    subject = toy([(0, 1.5)])
    whole = np.hstack([subject.columns, subject.slopes[:, [0]]])
    direct = multivariate_normal(cov=np.eye(ROWS) + whole @ whole.T).logpdf(subject.observed)
    for both in (np.zeros(3), np.array([0.5, -1.0, 2.0])):
        linear = subject.observed - whole @ both, whole
        fit = fitted(subject, (0,), Start(both[:2], both[2:]), linear, precision=1.0)
        assert fit.log_evidence == pytest.approx(direct + 0.5 * ROWS * np.log(2 * np.pi))


def test_without_some_rows_agrees_with_a_refit_by_scipy():
    subject = toy([(0, 1.5), (2, -1.0)])
    fit, out = subject.fit((0, 2)), np.arange(ROWS) % 5 == 1

    def residual(x):
        left = subject.observed - fit.columns @ x
        return np.append(left[~out], x[2:])

    direct = least_squares(residual, np.zeros(4), xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    whole = np.append(fit.z, fit.amplitude)
    np.testing.assert_allclose(whole + fit.without(out), direct, atol=1e-7)
    np.testing.assert_allclose(fit.without(np.zeros(ROWS, bool)), 0.0, atol=1e-7)


def test_remainder_products_and_errors_agree_with_dense_formulas():
    """With the covariance of rows I + T T' after the prior of an amplitude."""
    subject = toy([(0, 1.5)])
    fit, flat = subject.fit((0,)), subject.columns
    t = subject.slopes[:, [0]]
    spread = np.linalg.inv(np.eye(ROWS) + t @ t.T)
    free = spread - spread @ flat @ np.linalg.solve(flat.T @ spread @ flat, flat.T @ spread)
    left = fit.remainder()
    # The prior is about zero: the observations themselves are the residual of the prior.
    assert left @ left == pytest.approx(subject.observed @ free @ subject.observed)
    gram, score, columns = fit.further(subject.slopes[:, 1:])
    np.testing.assert_allclose(gram, subject.slopes[:, 1:].T @ free @ subject.slopes[:, 1:])
    np.testing.assert_allclose(score, subject.slopes[:, 1:].T @ free @ subject.observed, atol=1e-8)
    np.testing.assert_allclose(columns.T @ columns, gram)
    normal = fit.columns.T @ fit.columns + np.diag([0.0, 0.0, 1.0])
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(normal), rtol=1e-6)
    np.testing.assert_allclose(fit.errors, np.sqrt(np.linalg.inv(normal)[2, 2]), rtol=1e-6)
    assert fit.key == ("a1",) and fit.start.amplitude is fit.amplitude


# --- search.py ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("center", "sign"), [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 1.0)]
)
@pytest.mark.parametrize(("gram", "score"), [(4.0, 3.0), (0.3, -0.2), (9.0, -6.0)])
def test_the_bayes_factor_of_one_column_agrees_with_quadrature(center, sign, gram, score):
    def density(a):
        return norm.pdf(a, center) * np.exp(a * score - 0.5 * gram * a**2)

    low, high = (0.0 if sign > 0 else -15.0), (0.0 if sign < 0 else 15.0)
    best = (score + center) / (gram + 1)
    points = [best] if low < best < high else None
    whole = quad(density, low, high, points=points, epsabs=0)[0] * (2 if sign else 1)
    given = np.array([[gram]]), np.array([score]), np.array([center]), np.array([sign])
    assert log_bayes(*given, [(0,)])[0] == pytest.approx(np.log(whole), abs=2e-6)


def test_the_bayes_factor_of_pairs_agrees_with_quadrature():
    gram = np.array([[3.0, 1.2, 0.0], [1.2, 2.0, 0.0], [0.0, 0.0, 2.5]])
    score, center = np.array([2.0, -1.0, 1.5]), np.array([0.0, 0.5, 0.0])
    sign = np.array([0.0, 0.0, 1.0])

    sets = [(0, 1), (0, 2)]
    found = log_bayes(gram, score, center, sign, sets)
    for pair, value in zip(sets, found, strict=True):
        one, other = list(pair)
        one_sided = bool(sign[other])
        a, b = np.linspace(-8, 8, 801)[:, None], np.linspace(0.0 if one_sided else -8.0, 8, 801)
        fit = a * score[one] + b * score[other] - a * b * gram[one, other]
        fit = fit - 0.5 * (a**2 * gram[one, one] + b**2 * gram[other, other])
        prior = norm.pdf(a, center[one]) * norm.pdf(b, center[other]) * (1 + one_sided)
        whole = simpson(simpson(prior * np.exp(fit), x=b), x=a[:, 0])
        assert value == pytest.approx(np.log(whole), abs=1e-5)


def exact(subject, atoms):
    """Log evidence of a set over none, by dense normal densities."""
    t, m = subject.slopes[:, list(atoms)], subject.priors.center[list(atoms)]
    y, one = subject.observed, np.eye(ROWS)
    own = log_normal(y - t @ m, one + t @ t.T, subject.columns)
    return own - log_normal(y, one, subject.columns)


def test_the_search_finds_a_planted_pair_as_every_set_by_itself_would():
    """All sets of up to three effects, weighed by dense densities: the best is the same,
    and so is the weight of each refitted set."""
    subject = toy([(1, 1.2), (2, -1.1)], seed=4)
    search = searched(subject)
    every = [
        atoms
        for size in range(MOST_EFFECTS + 1)
        for atoms in combinations(range(6), size)
        if len({NAMES[k] for k in atoms}) == size
    ]
    weights = {atoms: exact(subject, atoms) + search.log_prior(atoms) for atoms in every}
    best = max(weights, key=weights.__getitem__)
    assert search.ranked[0].atoms == best == (1, 2)
    assert search.fits.keys() <= weights.keys()
    for atoms, fit in search.fits.items():
        assert search.weight(fit) == pytest.approx(weights[atoms], abs=1e-4)
    # Those that were not refitted have the linear weight, which is exact here.
    for atoms, (weight, evidence) in search.guessed.items():
        assert weight == pytest.approx(weights[atoms], abs=1e-4)
        assert evidence == pytest.approx(exact(subject, atoms), abs=1e-4)
    seen = logsum([w for a, w in weights.items() if a in {*search.fits, *search.guessed}])
    assert seen == pytest.approx(logsum(list(weights.values())), abs=0.02)
    # Also the subsets of the two best sets were refitted.
    for fit in search.ranked[:2]:
        assert {*parts_of(fit.atoms)} <= {*search.fits}


def logsum(values):
    return float(np.logaddexp.reduce(values))


def test_a_pair_that_is_visible_only_together_is_found():
    """Nearly parallel tangents with opposite amplitudes: alone, neither explains much."""
    subject = toy(seed=1)
    x = subject.columns[:, 0] * 0 + np.sin(np.arange(ROWS))
    subject.slopes[:, 2] = 8 * x + subject.slopes[:, 2]
    subject.slopes[:, 5] = 8 * x + subject.slopes[:, 5]
    subject.observed = subject.observed + 1.6 * (subject.slopes[:, 2] - subject.slopes[:, 5])
    search = searched(subject, Effort(singles=1, variants=1, beam=1, width=1, near=0.0))
    assert search.ranked[0].effects == ("b1", "d1")


@pytest.mark.parametrize("center", [0.0, 0.7])
def test_refits_start_at_the_best_amplitudes_of_a_linear_subject(center):
    """From the expected amplitudes; a pair also at small ones of the other sign."""
    subject, begun = toy([(0, 1.5)], center=center), {}
    refit = subject.refit

    def noted(starts, sets):
        for start, atoms in zip(starts, sets, strict=True):
            begun.setdefault(atoms, []).append(start.amplitude)
        return refit(starts, sets)

    subject.refit, search = noted, Search(subject)
    search.singles()
    search.pairs()
    pairs = [atoms for atoms in begun if len(atoms) == 2]
    for atoms in begun.keys() - {(), *(pairs if center else ())}:
        np.testing.assert_allclose(begun[atoms][0], search.fits[atoms].amplitude, atol=1e-6)
    assert pairs and all(np.all(begun[pair][1] == (center or -0.3)) for pair in pairs)


def test_priors_sum_to_those_of_their_size():
    """Over all single effects; over pairs, less those of one effect with itself."""
    search = Search(toy())
    assert np.exp(search.log_prior(())) == pytest.approx(PRIOR_OF_SIZE[0])
    single = np.exp([search.log_prior((k,)) for k in range(6)]) / PRIOR_OF_SIZE[1]
    # Four families; "a" has two effects, "c1" has two variants.
    np.testing.assert_allclose(single, [1 / 8, 1 / 8, 1 / 4, 1 / 8, 1 / 8, 1 / 4])
    pairs = [p for p in combinations(range(6), 2) if NAMES[p[0]] != NAMES[p[1]]]
    total = sum(np.exp(search.log_prior(p)) for p in pairs) / PRIOR_OF_SIZE[2]
    each = np.array([1 / 8, 1 / 8, 1 / 4, 1 / 4, 1 / 4])
    assert total == pytest.approx(1 - np.sum(each**2))
    search.subject.priors = search.subject.priors._replace(odds=np.full(6, -1.0))
    assert search.log_prior((2,)) == pytest.approx(np.log(PRIOR_OF_SIZE[1] / 4) - 1)
    assert sum(PRIOR_OF_SIZE) <= 1


@pytest.mark.parametrize("mistaken", [{"b1": ("d1",)}, {"d1": ("b1",)}])
def test_an_effect_is_refitted_in_the_place_of_one_that_is_mistaken_for_it(mistaken):
    """Whichever of the two lists the other; with the amplitudes of least squares."""
    subject = toy([(0, 2.0), (2, 2.0)], **mistaken)
    search = Search(subject)
    search.refit({key: [search.null.start] for key in ((0, 2), (0,), (2,))})
    (exchanged,) = search.refit_exchanged(search.fits[0, 2])
    assert exchanged.effects == ("a1", "d1")
    columns = np.concatenate([subject.columns, subject.slopes[:, [0, 5]]], axis=1)
    prior = np.diag([0.0, 0.0, 1.0, 1.0])
    best = np.linalg.solve(columns.T @ columns + prior, columns.T @ subject.observed)
    np.testing.assert_allclose([*exchanged.z, *exchanged.amplitude], best, rtol=1e-6)


def test_parts_of_a_set_come_largest_first():
    assert parts_of(("a", "b", "c"))[:2] == [("a", "b", "c"), ("a", "b")]
    assert [len(k) for k in parts_of(("a", "b", "c"))] == [3, 2, 2, 2, 1, 1, 1]
