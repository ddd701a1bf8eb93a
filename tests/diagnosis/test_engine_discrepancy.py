"""The unlisted effect as a Gaussian process over one covariate, or a wave in time, and the
sizes of an effect by group, against dense formulas."""

import numpy as np
import pytest
from conftest_diagnosis import Toy, log_normal
from scipy.special import logsumexp

from tirefit.diagnosis.engine.discrepancy import (
    LENGTHS,
    SIZES,
    Cell,
    Discrepancy,
    likeliest_beside,
    places_of,
)
from tirefit.diagnosis.engine.left_out import grouped, sizes_by_group

ROWS = 72
X = np.linspace(-1, 1, ROWS)
LOADS = np.tile([2.0, 4.0, 6.0], ROWS // 3)
EVEN, EVEN_PLACES = places_of(X, None, 9)
BY_LOAD, LOAD_PLACES = places_of(LOADS, np.array([2.0, 4.0, 6.0]), 9)
SLOPE = 2 + np.cos(7 * X)
"""Whitened force of a usual change of the quantity."""


def discrepancy():
    columns = np.concatenate([SLOPE[:, None] * EVEN, BY_LOAD], axis=1)
    cells = (Cell("friction", "slip", EVEN_PLACES, False), Cell("force", "fz", LOAD_PLACES, True))
    return Discrepancy(columns, cells)


def matern(length, count=9):
    """Covariance of Matern 3/2 at evenly spaced places of a range of one."""
    apart = np.sqrt(3) * np.abs(np.subtract.outer(*2 * [np.arange(count) / (count - 1)])) / length
    return (1 + apart) * np.exp(-apart)


def subject_of(residual, **other):
    """One free parameter and one effect with its prior."""
    columns = np.column_stack([X**2])
    tangent = np.column_stack([np.sin(3 * X) + 0.2 * X])
    return Toy(residual, columns, tangent, ("a",), **other)


def noise(seed=0):
    return np.random.default_rng(seed).standard_normal(ROWS)


def test_values_between_places_are_interpolated():
    values = np.random.default_rng(1).uniform(0, 5, 50)
    weights, places = places_of(values, None, 6)
    np.testing.assert_allclose(places, np.linspace(values.min(), values.max(), 6))
    curve = np.array([0.0, 3.0, -1.0, 2.0, 2.5, 0.5])
    np.testing.assert_allclose(weights @ curve, np.interp(values, places, curve), atol=1e-12)
    chosen, settings = places_of(np.array([2.1, 5.8, 3.9]), np.array([2.0, 4.0, 6.0]), 6)
    np.testing.assert_array_equal(chosen, np.eye(3)[[0, 2, 1]])
    np.testing.assert_array_equal(settings, [2.0, 4.0, 6.0])


@pytest.mark.parametrize("atoms", [(), (0,)])
def test_evidence_of_a_cell_agrees_with_a_dense_gaussian_process(atoms):
    """Averaged over lengths and sizes; beside a free parameter, and beside an effect with
    its prior. A cell of settings has a value of its own for each."""
    found, subject = discrepancy(), subject_of(noise() + 1.5 * SLOPE * np.sin(4 * X))
    fit = subject.fit(atoms)
    tangent = subject.slopes[:, list(atoms)]
    plain = np.eye(ROWS) + tangent @ tangent.T
    shapes = found.columns[:, :9], found.columns[:, 9:]
    right = []
    for columns, priors in zip(
        shapes, ([matern(length) for length in LENGTHS], [np.eye(3)] * 3), strict=True
    ):
        each = [
            log_normal(
                subject.observed, plain + size**2 * columns @ prior @ columns.T, subject.columns
            )
            for prior in priors
            for size in SIZES
        ]
        none = log_normal(subject.observed, plain, subject.columns)
        right.append(logsumexp(each) - np.log(len(each)) - none)
    by_cell = {one.cell.quantity: one.log_evidence for one in found.components(fit)}
    by_cell = [by_cell[cell.quantity] for cell in found.cells]
    np.testing.assert_allclose(by_cell, right, atol=2e-3)
    assert right[0] > 5 > right[1]
    assert found.log_evidence(fit) == pytest.approx(logsumexp(right) - np.log(2), abs=2e-3)


def test_without_cells_nothing_is_unlisted():
    none = Discrepancy(np.zeros((ROWS, 0)), ())
    assert none.log_evidence(subject_of(noise()).fit(())) == -np.inf


def test_noise_gives_little_evidence_of_something_unlisted():
    logs = [discrepancy().log_evidence(subject_of(noise(k)).fit(())) for k in range(40)]
    # By its definition the mean Bayes factor of noise is one.
    assert np.mean(logs) < 0 and np.mean(np.array(logs) > 3) <= 0.05


def test_a_known_function_is_found_within_its_error():
    """40 records of a smooth function of the slip: the right cell, and a value that misses the
    truth by a third of its size."""
    missed = []
    for seed in range(40):
        generator = np.random.default_rng(seed)
        truth = 2 * np.linalg.cholesky(matern(0.2) + 1e-9 * np.eye(9)) @ generator.normal(size=9)
        subject = Toy(SLOPE * (EVEN @ truth) + noise(seed + 100), X[:, None] ** 8, EVEN[:, :0], ())
        first = discrepancy().components(subject.fit(()))[0]
        assert (first.cell.quantity, first.cell.covariate) == ("friction", "slip")
        assert first.probability > 0.9 and 0.2 < first.explains <= 1
        missed.append(np.linalg.norm(first.value - truth) / np.linalg.norm(truth))
    assert np.median(missed) < 0.35


def test_the_function_found_is_the_posterior_mean():
    subject = Toy(3 * noise(), X[:, None], EVEN[:, :0], ())
    found = {one.cell.covariate: one for one in discrepancy().components(subject.fit(()))}
    free = np.eye(ROWS) - np.outer(X, X) / (X @ X)
    columns = free @ BY_LOAD
    rest = free @ subject.observed
    posterior = {size: np.linalg.inv(columns.T @ columns + np.eye(3) / size**2) for size in SIZES}
    means = {size: inverse @ (columns.T @ rest) for size, inverse in posterior.items()}
    best = min(SIZES, key=lambda size: np.abs(means[size] - found["fz"].value).max())
    np.testing.assert_allclose(found["fz"].value, means[best], rtol=1e-4)
    explained = means[best] @ columns.T @ rest / (rest @ rest)
    assert found["fz"].explains == pytest.approx(explained, rel=1e-3)


def test_a_smooth_part_is_the_ridge_estimate_with_the_best_size():
    generator = np.random.default_rng(6)
    columns = generator.standard_normal((ROWS, 5)) * [1, 1, 0.5, 0.2, 0.01]
    subject = subject_of(noise() + columns @ [2.0, -3.0, 1.0, 0.0, 0.0])
    fit = subject.fit((0,))
    tangent, flat = subject.slopes, subject.columns
    wide = np.eye(ROWS) + tangent @ tangent.T
    logs = [log_normal(subject.observed, wide + s**2 * columns @ columns.T, flat) for s in SIZES]
    size = SIZES[int(np.argmax(logs))]
    # Weights of generalised least squares, with the free parameter projected out.
    weight = np.linalg.inv(wide)
    weight -= weight @ flat @ np.linalg.solve(flat.T @ weight @ flat, flat.T @ weight)
    covariance = np.linalg.inv(columns.T @ weight @ columns + np.eye(5) / size**2)
    value, root = likeliest_beside(columns, fit)
    right = covariance @ columns.T @ weight @ subject.observed
    np.testing.assert_allclose(value, right, atol=1e-4)
    np.testing.assert_allclose(root @ root.T, covariance, atol=1e-4)


def test_additive_columns_have_the_covariance_of_the_sum_of_all_cells():
    found = discrepancy()
    smooth, loads = found.columns[:, :9], found.columns[:, 9:]
    right = 0.5 * (smooth @ matern(LENGTHS[1]) @ smooth.T + loads @ loads.T)
    np.testing.assert_allclose(found.additive @ found.additive.T, right, atol=1e-6)


# --- sizes.py -------------------------------------------------------------------------


def test_groups_are_the_settings_or_parts_of_equal_number():
    np.testing.assert_array_equal(grouped(LOADS), np.tile([0, 1, 2], ROWS // 3))
    code = grouped(np.random.default_rng(0).permutation(X))
    np.testing.assert_array_equal(np.bincount(code), [ROWS // 4] * 4)


def grown(sizes, seed=0, rows=600):
    """An effect whose amplitude is one of two sizes, by load: (fit, groups)."""
    generator = np.random.default_rng(seed)
    column, tangent = generator.standard_normal((2, rows))
    group = np.arange(rows) % 2
    observed = column + np.array(sizes)[group] * tangent + generator.standard_normal(rows)
    subject = Toy(observed, column[:, None], tangent[:, None], ("a",))
    return subject.fit((0,)), {"fz": group.astype(float), "run": np.zeros(rows)}


def test_sizes_by_group_agree_with_separate_fits():
    """With one parameter for all groups, by dense least squares."""
    fit, groups = grown((1.0, 2.0))
    (found,) = sizes_by_group(fit, 0, groups)
    column, tangent = fit.columns.T
    of_group = [tangent * (groups["fz"] == k) for k in (0, 1)]
    observed = fit.residual + fit.columns @ np.append(fit.z, fit.amplitude)
    columns = np.column_stack([*of_group, column])
    size = np.linalg.lstsq(columns, observed, rcond=None)[0]
    std = np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    np.testing.assert_allclose(found.size, size[:2], rtol=1e-6)
    np.testing.assert_allclose(found.std, std[:2], rtol=1e-6)
    np.testing.assert_array_equal(found.at, [0.0, 1.0])
    # Two sizes explain what one leaves.
    rest = fit.residual @ fit.residual + fit.amplitude[0] ** 2
    left = np.sum((observed - columns @ size) ** 2)
    assert found.explains == pytest.approx(1 - left / rest, abs=0.01)
    (wide,) = sizes_by_group(fit, 0, groups, noise=4.0)
    np.testing.assert_allclose(wide.std, 2 * np.array(found.std))


def spread_by_hand(size, std, whole):
    """DerSimonian and Laird (1986), term by term."""
    weights = [1 / s**2 for s in std]
    mean = sum(w * x for w, x in zip(weights, size, strict=True)) / sum(weights)
    q = sum(w * (x - mean) ** 2 for w, x in zip(weights, size, strict=True))
    scale = sum(weights) - sum(w**2 for w in weights) / sum(weights)
    return np.sqrt(max((q - (len(size) - 1)) / scale, 0.0)) / abs(whole)


def test_the_spread_tells_a_cause_from_a_stand_in():
    """Sizes of one and two differ by a standard deviation of .71 about their mean; equal
    ones by nothing beyond their errors."""
    unlike = [sizes_by_group(*_first(grown((1.0, 2.0), k)))[0] for k in range(10)]
    alike = [sizes_by_group(*_first(grown((1.5, 1.5), k)))[0] for k in range(10)]
    for one, fit in [(one, grown((1.0, 2.0), k)[0]) for k, one in enumerate(unlike)]:
        assert one.spread == pytest.approx(spread_by_hand(one.size, one.std, fit.amplitude[0]))
    assert np.mean([one.spread for one in unlike]) == pytest.approx(0.71 / 1.5, rel=0.1)
    # The error of one size is .06: four such differences are the largest of ten spreads.
    assert np.median([one.spread for one in alike]) < 0.03
    assert max(one.spread for one in alike) < 0.16
    assert max(one.explains for one in alike) < 0.02 < min(one.explains for one in unlike)


def _first(made):
    fit, groups = made
    return fit, 0, groups
