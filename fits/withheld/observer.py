"""The exact evidence with the generator's own forms, as an ideal observer has it.

The observer knows the plain brush, every form of every effect in the generator, the
prior of the amplitudes and the law of the noise. Amplitude, stiffness and friction are fitted,
and Laplace's method gives the evidence.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import softmax

from fits.withheld.effects import EFFECTS
from fits.withheld.library import Inputs, base_fit, directions, predict, predict_together

__all__ = ["Given", "beliefs", "evidence", "given_effects"]

REFITTED = 10
SHARES = tuple(np.linspace(0.05, 0.95, 10))  # of the range of a form's random draws
LOW, HIGH = 0.5, 2.0  # amplitudes, in typical ones: log-uniform
SPREAD = np.array([0.09, 0.06])  # of log c and log mu, as they are drawn
DRAWN = {0: 134, 1: 200, 2: 33}  # trials without an effect, with one, with two


def _hypotheses(x: Inputs) -> Iterator[tuple]:
    """Keys (effect, form, share, sign) of all hypotheses with one amplitude."""
    for effect in x.effects:
        about = EFFECTS[effect]
        for form in about.forms:
            for part in SHARES if form.startswith("road_") else (0.5,):
                for sign in (about.sign,) if about.sign else (-1, 1):
                    yield effect, form, part, sign


def _force(x: Inputs, keys: Sequence[tuple], strengths, c, mu) -> np.ndarray:
    parts = [
        (effect, form, EFFECTS[effect].typical * sign * strength, share)
        for (effect, form, share, sign), strength in zip(keys, strengths, strict=True)
    ]
    if len(parts) > 1:
        return predict_together(x, parts, c, mu)
    ((effect, form, size, share),) = parts
    return predict(x, effect, size, c, mu, share, form)


class _Fit(NamedTuple):
    """A joint fit of forms: ``p`` are the logarithms of c, mu (in their spreads) and of each
    amplitude, between ``low`` and ``high``; ``evidence`` is the log evidence, up to a
    constant that all hypotheses share."""

    p: np.ndarray
    low: np.ndarray
    high: np.ndarray
    jacobian: np.ndarray
    evidence: float

    def drawn(self, generator) -> np.ndarray:
        """One draw of the posterior: normal about the fit, clipped to the bounds."""
        square = self.jacobian.T @ self.jacobian + 1e-9 * np.eye(len(self.p))
        step = np.linalg.solve(np.linalg.cholesky(square).T, generator.standard_normal(len(self.p)))
        return np.clip(self.p + step, self.low, self.high)


def _refitted(x, observed, std, keys: Sequence[tuple], c, mu) -> _Fit:
    """The joint fit of these forms to the file."""

    def rest(p):
        ratio = np.exp(p[:2] * SPREAD)
        force = _force(x, keys, np.exp(p[2:]), c * ratio[0], mu * ratio[1])
        return np.nan_to_num((observed - force) / std, nan=1e3)

    n = len(keys)
    low, high = [-9, -9, *[np.log(LOW)] * n], [9, 9, *[np.log(HIGH)] * n]
    fit = least_squares(
        rest,
        np.zeros(2 + n),
        bounds=(low, high),
        max_nfev=4 + 4 * n,
        diff_step=1e-3,
        x_scale=[0.1, 0.1, *[0.3] * n],
    )
    value = -fit.cost + laplace(fit.jac[:, 2:], fit.jac[:, :2])
    return _Fit(fit.x, np.array(low), np.array(high), fit.jac, value)


def laplace(along: np.ndarray, base: np.ndarray, ranges=np.log(HIGH / LOW)) -> float:
    """Log of the posterior over the prior width of the amplitudes.

    Args:
        along: (n, k) or (n,) whitened change with the logarithm of each amplitude.
        base: (n, 2) of the parameters.
        ranges: prior width of each.
    """
    along = along.reshape(len(along), -1)
    left = along - base @ np.linalg.lstsq(base, along, rcond=None)[0]
    lengths = np.abs(np.diag(np.linalg.qr(left)[1]))
    widths = np.sqrt(2 * np.pi) / np.maximum(lengths, 1e-9)
    return float(np.sum(np.log(np.minimum(widths / ranges, 1.0))))


class _Screen(NamedTuple):
    """The change of the forces by each single effect of typical size, at the plain brush.

    ``misses`` (n,), ``base`` (n, 2) and ``shapes`` (n, K) of the ``keys`` are whitened.
    """

    c: float
    mu: float
    std: np.ndarray
    misses: np.ndarray
    base: np.ndarray
    keys: list[tuple]
    shapes: np.ndarray


def screened(x: Inputs, observed: np.ndarray) -> _Screen:
    (c, mu), misses, std = base_fit(x, observed)
    plain = observed - misses * std
    base = directions(x, c, mu) / std[:, None]
    keys = list(_hypotheses(x))
    shapes = [(_force(x, [key], [1.0], c, mu) - plain) / std for key in keys]
    return _Screen(c, mu, std, misses, base, keys, np.nan_to_num(np.array(shapes).T))


def _first_of_one(seen: _Screen) -> dict[tuple, float]:
    """Log evidence of each key, to first order."""
    first = {}
    for key, shape in zip(seen.keys, seen.shapes.T, strict=True):
        columns = np.column_stack([seen.base, shape])
        scale = np.linalg.norm(columns, axis=0) + 1e-12
        size = np.linalg.lstsq(columns / scale, seen.misses, rcond=None)[0] / scale
        left = seen.misses - np.clip(size[2], LOW, HIGH) * shape
        left -= seen.base @ np.linalg.lstsq(seen.base, left, rcond=None)[0]
        first[key] = -0.5 * float(left @ left) + laplace(shape, seen.base)
    return first


def _first_of_two(seen: _Screen) -> dict[tuple[tuple, tuple], float]:
    """The same for every two keys of different families, with bounded amplitudes."""
    unit = np.linalg.qr(seen.base)[0]
    own = seen.shapes - unit @ (unit.T @ seen.shapes)
    rest = seen.misses - unit @ (unit.T @ seen.misses)
    gram, score = own.T @ own, own.T @ rest
    families = np.array([EFFECTS[key[0]].family for key in seen.keys])
    one, two = np.nonzero(np.triu(families[:, None] != families, 1))
    a, b, ab = gram[one, one] + 1e-12, gram[two, two] + 1e-12, gram[one, two]
    of_one, of_two = score[one], score[two]
    gained = gained_by_two(a, b, ab, of_one, of_two) - 0.5 * rest @ rest
    keys = seen.keys
    return {(keys[i], keys[j]): float(v) for i, j, v in zip(one, two, gained, strict=True)}


def gained_by_two(
    a, b, ab, of_one, of_two, bounds=(LOW, HIGH), ranges=(np.log(HIGH / LOW),) * 2, steps=20
) -> np.ndarray:
    """Log evidence of two columns over none.

    Args:
        a, b, ab: products of the columns, projected on what the parameters cannot fit.
        of_one, of_two: their products with the residual.
        bounds: of the second amplitude; the first is between LOW and HIGH.
        ranges: prior widths of the two.
        steps: of the search of the best amplitudes within their bounds.
    """
    size = (b * of_one - ab * of_two) / np.maximum(a * b - ab**2, 1e-12)
    for _ in range(steps):  # each in turn, within its bounds
        size = np.clip(size, LOW, HIGH)
        other = np.clip((of_two - ab * size) / b, *bounds)
        size = (of_one - ab * other) / a
    size = np.clip(size, LOW, HIGH)
    energy = size * size * a + other * other * b + 2 * size * other * ab
    gained = size * of_one + other * of_two - 0.5 * energy
    for length, width in ((a, ranges[0]), (np.maximum(b - ab**2 / a, 0), ranges[1])):
        of = np.sqrt(2 * np.pi / np.maximum(length, 1e-18)) / width
        gained = gained + np.log(np.minimum(of, 1.0))
    return gained


def draws_of(key: tuple) -> int:
    """Number of keys of an effect."""
    about = EFFECTS[key[0]]
    of_form = len(SHARES) if key[1].startswith("road_") else 1
    return of_form * (2 - abs(about.sign)) * len(about.forms)


def _refitted_sets(x, observed, seen: _Screen, first: dict, more) -> dict:
    """Log evidence of sets of effects, from refits of the keys with the largest evidence to
    first order, and in any case of the best keys of the set ``more``."""
    nearest = sorted(first, key=first.get, reverse=True)[:REFITTED]
    wanted = [keys for keys in first if {key[0] for key in keys} == set(more)]
    nearest += sorted(wanted, key=first.get, reverse=True)[: REFITTED // 2]
    parts: dict = {}
    for keys in dict.fromkeys(nearest):
        value = _refitted(x, observed, seen.std, keys, seen.c, seen.mu).evidence
        value -= float(np.sum(np.log([draws_of(key) for key in keys])))
        parts.setdefault(tuple(sorted(key[0] for key in keys)), []).append(value)
    return {k: float(np.logaddexp.reduce(values)) for k, values in parts.items()}


def evidence(
    x: Inputs, observed: np.ndarray, more: Sequence[str] = (), pairs: bool = False
) -> dict[tuple[str, ...], float]:
    """Log evidence of no effect, (), and of single effects, over their forms; with
    ``pairs`` also of two effects of different families. Only the sets that are best to
    first order are refitted; the others are omitted.

    Args:
        more: effects whose set is refitted in any case.
    """
    seen = screened(x, observed)
    ones = {(key,): value for key, value in _first_of_one(seen).items()}
    found = _refitted_sets(x, observed, seen, ones, more)
    if pairs:
        found |= _refitted_sets(x, observed, seen, _first_of_two(seen), more)
    return found | {(): -0.5 * float(seen.misses @ seen.misses)}


def beliefs(x: Inputs, evidences: dict[tuple[str, ...], float]) -> dict:
    """Probability of no effect, each single effect and each pair from :func:`evidence`, with
    the frequencies of the check as prior."""
    families = [EFFECTS[effect].family for effect in x.effects]
    two = sum(a != b for k, a in enumerate(families) for b in families[:k])
    sets = {0: 1, 1: len(families), 2: max(two, 1)}
    keys = list(evidences)
    logs = [evidences[k] + np.log(DRAWN[len(k)] / sets[len(k)]) for k in keys]
    return dict(zip(keys, softmax(logs).tolist(), strict=True))


class Given(NamedTuple):
    """Results for given effects: whether there is evidence for each of them (``shows``),
    and posterior draws of the forces (d, n)."""

    shows: bool
    forces: np.ndarray


def _keys_of(forms: dict[str, str]) -> list[tuple]:
    """All joint keys of effects in these forms: their signs and random draws."""
    signs = [(EFFECTS[e].sign,) if EFFECTS[e].sign else (-1, 1) for e in forms]
    road = any(form.startswith("road_") for form in forms.values())
    return [
        tuple((*of, share, sign) for of, sign in zip(forms.items(), each, strict=True))
        for share, each in product(SHARES if road else (0.5,), product(*signs))
    ]


def given_effects(
    x: Inputs, observed: np.ndarray, forms: dict[str, str], generator, draws: int = 100
) -> Given:
    """Evidence for effects that are given with their forms, and their posterior.

    ``shows`` is true if the evidence for all is larger than for all but any one of them
    (or for no effect). An observer without that knowledge is right less often.

    Args:
        forms: form of each effect.
    """
    (c, mu), misses, std = base_fit(x, observed)

    def fits_of(forms) -> dict[tuple, _Fit]:
        keys = _keys_of(forms)
        return {key: _refitted(x, observed, std, key, c, mu) for key in keys}

    def evidence_of(found) -> float:
        each = [fit.evidence for fit in found.values()]
        return float(np.logaddexp.reduce(each) - np.log(len(each)))

    whole = fits_of(forms)
    less = [{e: form for e, form in forms.items() if e != one} for one in forms]
    nothing = -0.5 * float(misses @ misses)
    without = [evidence_of(fits_of(kept)) if kept else nothing for kept in less]
    chances, every = softmax([fit.evidence for fit in whole.values()]), [*whole.items()]
    drawn = []
    for k in generator.choice(len(every), draws, p=chances):
        key, fit = every[k]
        p = fit.drawn(generator)
        ratio = np.exp(p[:2] * SPREAD)
        drawn.append(_force(x, key, np.exp(p[2:]), c * ratio[0], mu * ratio[1]))
    return Given(evidence_of(whole) > max(without), np.array(drawn))
