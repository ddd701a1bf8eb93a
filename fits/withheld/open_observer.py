"""The exact evidence in the open mix: listed effects, unlisted ones, both or none.

    python -m fits.withheld.open_observer out/withheld

The observer of ``observer.py`` also knows the unlisted effects of the generator: the random
functions of ``procedural.py`` and the kinds of ``UNLISTED``, with the priors of their draws and
amplitudes, how often each world is drawn, and the laws of the noise of trials without an
effect. Only the file is observed. Shapes are drawn from the generator, weighed to first
order, alone and with each listed effect, and the best of each are refitted with all of their
continuous numbers; Laplace's method gives the evidence. The forms of the truth are always
among those refitted, so that an incomplete search costs the observer little.

Each trial's probabilities are written to ``FOLDER/observed``; the table compares them with
the answers in ``FOLDER/answers``.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, toeplitz
from scipy.optimize import least_squares
from scipy.special import logsumexp, ndtr
from scipy.stats import norm, qmc, truncnorm

from fits.withheld import bound, observer
from fits.withheld.designs import DESIGNS, Design
from fits.withheld.effects import EFFECTS
from fits.withheld.judge import judge
from fits.withheld.library import Inputs, plain_world, predict_together, spread
from fits.withheld.observer import HIGH, LOW, SPREAD, laplace
from fits.withheld.open_mix import WORLDS, mean_of, world_of
from fits.withheld.patch import World, plain_brush
from fits.withheld.procedural import procedural, varying
from fits.withheld.strange import SEALED, UNLISTED
from fits.withheld.strange_rig import NEEDS

__all__ = ["Observed", "observed", "rows"]

PRIOR = {"null": 1 / 7, "listed": 2 / 7, "beside": 2 / 7, "alone": 2 / 7}
"""Shares of the worlds, as in the mix of the README; half of the listed are pairs, half of the
unlisted effects alone are procedural."""

LAWS = 6  # of the noise without an effect, equally frequent
DRAWS = {"procedural": 11, "tread_blocks": 11, "chatter": 12}
OF_KIND = 6  # binary logarithm of the number of draws of every other kind
PARENTS, VARIANTS = 40, 10  # the best draws, and changed copies of each
ALONE, BESIDE, TRUE = 12, 6, 3  # refits: of shapes alone, beside a listed effect, of the truth
FAR = 20.0  # log weight below the best of a draw that is not refitted
NUMBERS = 16  # at most, of a draw
STEP = 0.01  # of a number between 0 and 1, in a derivative: some rows for a threshold
FINE = {"chatter": 3e-4, "tread_blocks": 3e-4, "waves": 2e-3}  # the same of many waves
SCATTER = (0.1, 0.03)  # of the numbers of changed copies, in turn
SIZES = (0.4, 1.6)  # uniform, of an unlisted effect, in typical ones
TYPICAL = 0.05  # of the kinds that are not procedural
LIKELY, PERHAPS = 0.5, 0.1  # probability of an effect that is named, and of a possible one


class Replay:
    """Replaces a random generator: each draw is a function of one of the ``numbers`` (0 to 1).

    ``log_prior`` is that of the choices made, ``free`` the places of the continuous numbers
    and ``gate`` the place of the first plain number, which only decides.
    """

    def __init__(self, numbers: np.ndarray) -> None:
        self.numbers, self.at, self.log_prior = numbers, 0, 0.0
        self.free: list[int] = []
        self.choices: list[int] = []
        self.gate = 0

    def _next(self, count: int) -> np.ndarray:
        self.free += range(self.at, self.at + count)
        self.at += count
        return self.numbers[self.at - count : self.at]

    def uniform(self, low=None, high=1.0, size=None):
        if low is None:  # one number that is compared with the share of gated effects
            self.gate, value = self.at, self.numbers[self.at]
            self.at += 1
            self.choices.append(int(value < 0.3))
            self.log_prior += np.log(0.3 if value < 0.3 else 0.7)
            return value
        values = low + (high - low) * self._next(size or 1)
        return values if size else float(values[0])

    def normal(self, size):
        return norm.ppf(np.clip(self._next(size), 1e-3, 1 - 1e-3))

    def choice(self, of):
        of = list(of)
        place = min(int(self.numbers[self.at] * len(of)), len(of) - 1)
        self.at += 1
        self.choices.append(place)
        self.log_prior -= np.log(len(of))
        return of[place]


class Shape(NamedTuple):
    """One draw of an unlisted effect: its ``kind``, "procedural" or one of UNLISTED, and the
    numbers that replace the random generator."""

    kind: str
    numbers: np.ndarray

    def change(self, world: World, size: float, varies: list[str]) -> tuple[Replay, str]:
        """Changes the world; returns the draws made, and the description as in a label."""
        draws = Replay(self.numbers)
        if self.kind == "procedural":
            return draws, procedural(world, size, draws, varies)
        UNLISTED[self.kind](world, TYPICAL * size * draws.choice((-1, 1)), draws)
        return draws, self.kind


class _Pool(NamedTuple):
    """Draws, with what their choices are, the log prior of these, the places of the continuous
    numbers, and the whitened change of the forces (n, J), of typical size, at the plain brush."""

    shapes: list[Shape]
    about: list[tuple]
    log_prior: np.ndarray
    draws: list[Replay]
    columns: np.ndarray

    def joined(self, other: "_Pool") -> "_Pool":
        return _Pool(
            self.shapes + other.shapes,
            self.about + other.about,
            np.append(self.log_prior, other.log_prior),
            self.draws + other.draws,
            np.hstack([self.columns, other.columns]),
        )


def _brush(world: World) -> np.ndarray:
    """Force (and moment) of a world whose pressure is parabolic, in closed form."""
    force, moment = plain_brush(world.slip, world.fz, world.stiffness, world.mu_s)
    for change in world.after:
        force = change(world, force)
    return np.concatenate([force, moment]) if world.moment else force


def _pool(x: Inputs, seen, shapes: Sequence[Shape], unit: np.ndarray) -> _Pool:
    world = plain_world(x, x.slip, seen.c, seen.mu)
    plain, varies = _brush(world), varying(world)
    about, prior, draws, columns = [], [], [], []
    for shape in shapes:
        world = plain_world(x, x.slip, seen.c, seen.mu)
        made, description = shape.change(world, 1.0, varies)
        about.append((description, *made.choices))
        draws.append(made)
        prior.append(made.log_prior)
        columns.append(np.nan_to_num((_brush(world) - plain) / seen.std))
    matrix = np.array(columns).T
    return _Pool([*shapes], about, np.array(prior), draws, matrix - unit @ (unit.T @ matrix))


def _kinds(x: Inputs) -> list[str]:
    """Kinds that influence this design, but for rounded slips (:func:`_rounded`)."""
    omitted = (*SEALED, "quantised")
    have = x.properties
    return [k for k in UNLISTED if k not in omitted and NEEDS.get(k, frozenset()) <= have]


def _drawn(x: Inputs, generator) -> list[Shape]:
    shapes = []
    for kind in ("procedural", *_kinds(x)):
        sobol = qmc.Sobol(NUMBERS, rng=generator)
        numbers = sobol.random_base2(DRAWS.get(kind, OF_KIND))
        shapes += [Shape(kind, row) for row in numbers]
    return shapes


def _varied(pool: _Pool, places: Sequence[int], scatter: float, generator) -> list[Shape]:
    """Copies with other continuous numbers, half of them also with another gate."""
    shapes = []
    for k in dict.fromkeys(places):
        shape, draws = pool.shapes[k], pool.draws[k]
        for number in range(VARIANTS):
            numbers = shape.numbers.copy()
            moved = numbers[draws.free] + scatter * generator.standard_normal(len(draws.free))
            numbers[draws.free] = np.abs(1 - np.abs(1 - np.abs(moved)))
            if number % 2 and draws.gate:
                numbers[draws.gate :] = generator.uniform(size=NUMBERS - draws.gate)
            shapes.append(Shape(shape.kind, np.clip(numbers, 0, 1)))
    return shapes


def _alone(pool: _Pool, left: np.ndarray) -> np.ndarray:
    """Log evidence (J,) of each draw to first order, over none."""
    a = np.maximum(np.sum(pool.columns**2, axis=0), 1e-12)
    size, width = pool.columns.T @ left / a, 1 / np.sqrt(a)
    inside = ndtr((SIZES[1] - size) / width) - ndtr((SIZES[0] - size) / width)
    best = np.clip(size, *SIZES)
    exact = 0.5 * size**2 * a + np.log(np.maximum(inside, 1e-300) * width * np.sqrt(2 * np.pi))
    at_bound = best * size * a - 0.5 * best**2 * a
    return np.where(inside > 1e-9, exact, at_bound) - np.log(SIZES[1] - SIZES[0])


def _beside(pool: _Pool, own: np.ndarray, left: np.ndarray) -> np.ndarray:
    """The same of each draw with each listed key (K, J); only procedural ones are drawn so."""
    drawn = np.array([shape.kind == "procedural" for shape in pool.shapes])
    columns = pool.columns[:, drawn]
    a, b = np.sum(own**2, axis=0) + 1e-12, np.sum(columns**2, axis=0) + 1e-12
    found = np.full((own.shape[1], len(drawn)), -np.inf)
    found[:, drawn] = observer.gained_by_two(
        a[:, None], b, own.T @ columns, (own.T @ left)[:, None], columns.T @ left,
        SIZES, (np.log(HIGH / LOW), SIZES[1] - SIZES[0]), steps=6,
    )  # fmt: skip
    return found


def _refitted(x: Inputs, force: np.ndarray, seen, keys: tuple, pool: _Pool, place: int) -> float:
    """Log evidence of an unlisted effect with (or without) listed keys, by a joint fit of c,
    mu, the amplitudes and the continuous numbers of the unlisted effect."""
    shape, about = pool.shapes[place], pool.about[place][0]
    n, free = len(keys), np.array(pool.draws[place].free, int)
    waves = "waves" if "periodic" in about or about == "ripple" else about
    small = FINE.get(waves, STEP)
    varies = varying(plain_world(x, x.slip, seen.c, seen.mu))

    def missed(p):
        c, mu = np.exp(p[:2] * SPREAD) * (seen.c, seen.mu)
        numbers = shape.numbers.copy()
        numbers[free] = p[3 + n :]
        moved = Shape(shape.kind, numbers)
        if keys:
            parts = [
                (effect, form, EFFECTS[effect].typical * sign * strength, share)
                for (effect, form, share, sign), strength in zip(keys, np.exp(p[2:]), strict=False)
            ]
            found = predict_together(x, parts, c, mu, lambda w: moved.change(w, p[2 + n], varies))
        else:
            world = plain_world(x, x.slip, c, mu)
            moved.change(world, p[2 + n], varies)
            found = _brush(world)
        return np.nan_to_num((force - found) / seen.std, nan=1e3)

    low = np.array([-9, -9, *[np.log(LOW)] * n, SIZES[0], *[0.0] * len(free)])
    high = np.array([9, 9, *[np.log(HIGH)] * n, SIZES[1], *[1.0] * len(free)])

    def slopes(p):
        at, out = missed(p), []
        for k in range(len(p)):
            step = small if k > 2 + n else STEP
            step = step if p[k] + step < high[k] else -step
            out.append((missed(p + step * (np.arange(len(p)) == k)) - at) / step)
        return np.array(out).T

    start = np.clip([0, 0, *[0.0] * n, 1.0, *shape.numbers[free]], low + 1e-3, high - 1e-3)
    fit = least_squares(missed, start, slopes, bounds=(low, high), max_nfev=7, x_scale=0.3)
    ranges = np.array([*[np.log(HIGH / LOW)] * n, SIZES[1] - SIZES[0], *[1.0] * len(free)])
    return float(-fit.cost + laplace(fit.jac[:, 2:], fit.jac[:, :2], ranges))


def _best(values: np.ndarray, about: Sequence, count: int) -> list[int]:
    """Places of the largest values, one of each description."""
    found: dict = {}
    for k in np.argsort(values)[::-1]:
        found.setdefault(about[k], int(k))
        if len(found) == count:
            break
    return [*found.values()]


def _null(x: Inputs, force: np.ndarray, seen) -> float:
    """Log evidence of no effect, over the laws of the noise, up to the constant of the others:
    independent normal noise (also where only the slip has noise)."""
    n, rest = len(x.slip), seen.misses * seen.std
    slip_std, force_std, moment_std = x.stds
    clean = seen.std

    def normal(std) -> float:
        return float(-0.5 * np.sum((rest / std) ** 2) - np.sum(np.log(std)))

    def scaled(factor) -> np.ndarray:
        """Spread with this factor on the noise of force and moment."""
        own = np.concatenate([force_std, moment_std]) if x.moment else force_std
        factor = np.concatenate([factor, factor]) if x.moment else factor
        return np.sqrt(clean**2 + own**2 * (factor**2 - 1))

    def correlated() -> float:
        total = 0.0
        for rows, own in ((slice(n), force_std), (slice(n, None), moment_std))[: 1 + x.moment]:
            over = np.maximum(clean[rows] ** 2 - own**2, 0)
            cover = own[:, None] * toeplitz(0.5 ** np.arange(n)) * own + np.diag(over + 1e-9)
            factor = cho_factor(cover, lower=True)
            solved = cho_solve(factor, rest[rows])
            total -= 0.5 * float(rest[rows] @ solved) + float(np.sum(np.log(np.diag(factor[0]))))
        return total

    wide = scaled(np.full(n, 8.0))
    outliers = np.logaddexp(
        np.log(0.95) - 0.5 * (rest / clean) ** 2 - np.log(clean),
        np.log(0.05) - 0.5 * (rest / wide) ** 2 - np.log(wide),
    )
    size = np.abs(force[:n]) / np.abs(force[:n]).max()
    laws = [
        normal(clean), normal(clean), normal(scaled(0.4 + 1.6 * size)),
        normal(scaled(np.full(n, 1.5))), correlated(), float(np.sum(outliers)),
    ]  # fmt: skip
    return float(logsumexp(laws) - np.log(LAWS) + np.sum(np.log(clean)))


def _rounded(x: Inputs, seen) -> float:
    """Log evidence of a slip that was rounded before its noise was added, over every step;
    none in sweeps whose slip moves evenly, which also lies on a grid."""
    slip_std = np.maximum(x.stds[0], 1e-6)
    bends = np.abs(np.diff(x.slip, 2))
    if "sweeps" in x.properties and np.median(bends) < 4 * np.max(slip_std):
        return -np.inf
    exact = spread(replace(x, stds=(0.0, *x.stds[1:])), seen.c, seen.mu)
    steep = np.sqrt(np.maximum(seen.std**2 - exact**2, 0)) / slip_std
    steps, found = 0.5 * TYPICAL * np.linspace(*SIZES, 600), []
    for step in steps:
        off = x.slip - step * np.round(x.slip / step)
        # A tenth of the slips may lie between two steps.
        near = np.log(0.9 * step * norm.pdf(off, scale=slip_std) + 0.1)
        std = np.hypot(seen.std, steep * step / np.sqrt(12))
        rest = seen.misses * seen.std / std
        found.append(float(np.sum(near) - 0.5 * rest @ rest - np.sum(np.log(std / seen.std))))
    return float(logsumexp(found) - np.log(len(steps)))


def with_known_range(x: Inputs, design: Design) -> Inputs:
    """The inputs with the expected slips: those of steady points are drawn evenly from the
    range of the design, so that slips logged near its ends, or beyond, were inside."""
    std = x.stds[0]
    if design.order != "random" or not std:
        return x
    low, high = ((end - x.slip) / std for end in (design.lowest, design.highest))
    mean, variance = truncnorm.stats(np.minimum(low, high - 1e-3), high, x.slip, std)
    inside = (low < 8) & (high > -8)
    slip = np.where(inside, mean, np.clip(x.slip, design.lowest, design.highest))
    widths = np.sqrt(np.where(inside, variance, 0.0))
    return replace(x, slip=slip, stds=(np.maximum(widths, 1e-6), *x.stds[1:]))


class Observed(NamedTuple):
    """Posterior of a trial: probability of each (set of listed effects, unlisted)."""

    sets: dict[tuple[tuple[str, ...], bool], float]

    @property
    def unlisted(self) -> float:
        return sum(p for (_, more), p in self.sets.items() if more)

    def holding(self, effects: Sequence[str]) -> float:
        """Probability that any of these effects is there."""
        return sum(p for (key, _), p in self.sets.items() if {*effects} & {*key})

    @property
    def each(self) -> dict[str, float]:
        """Probability of each effect."""
        effects = {e for key, _ in self.sets for e in key}
        return {e: self.holding([e]) for e in sorted(effects)}


def observed(
    x: Inputs, force: np.ndarray, truth: Sequence[str] = (), kind: str = "", seed: int = 0
) -> Observed:
    """The posterior of the observer.

    Args:
        force: measured force [N] (n,), followed by the moment [N m] if measured.
        truth: listed effects whose set is refitted in any case.
        kind: description of an unlisted effect that is refitted in any case.
    """
    generator = np.random.default_rng(seed)
    seen = observer.screened(x, force)
    unit = np.linalg.qr(seen.base)[0]
    own = seen.shapes - unit @ (unit.T @ seen.shapes)
    left = seen.misses - unit @ (unit.T @ seen.misses)
    pool = _pool(x, seen, _drawn(x, generator), unit)
    for scatter in SCATTER:
        first = [_alone(pool, left) + pool.log_prior, _beside(pool, own, left).max(0)]
        parents = [k for values in first for k in _best(values, pool.about, PARENTS)]
        pool = pool.joined(_pool(x, seen, _varied(pool, parents, scatter, generator), unit))
    kinds = len(_kinds(x)) + 1
    named = np.array([about[0] for about in pool.about])
    drawn = np.array([shape.kind == "procedural" for shape in pool.shapes])
    of_kind = pool.log_prior + np.where(drawn, 0, -np.log(kinds))
    logs: dict[tuple, list[float]] = {((), False): [np.log(PRIOR["null"]) + _null(x, force, seen)]}
    value = _rounded(x, seen)
    logs[(), True] = [value + np.log(PRIOR["alone"] / 2 / kinds)]
    families = [EFFECTS[e].family for e in x.effects]
    pairs = max(sum(a != b for k, a in enumerate(families) for b in families[:k]), 1)
    for key, value in observer.evidence(x, force, truth, pairs=True).items():
        if key:
            of = {1: len(families), 2: pairs}[len(key)]
            logs[key, False] = [value + np.log(PRIOR["listed"] / 2 / of)]

    def refit(keys: tuple, k: int, first: float, prior: float, always: bool) -> None:
        if always or first + prior > max(v for of in logs.values() for v in of) - FAR:
            value = _refitted(x, force, seen, keys, pool, k)
            logs.setdefault((tuple(e for e, *_ in keys), True), []).append(value + prior)

    nothing = -0.5 * float(left @ left)
    alone = _alone(pool, left) + nothing
    for always in (True, False):
        of = np.where(named == kind, alone, -np.inf) if always else alone
        apart = range(len(of)) if always else pool.about
        for k in _best(of + of_kind, apart, TRUE if always else ALONE):
            if np.isfinite(of[k]) and (always or named[k] != kind):
                refit((), k, alone[k], of_kind[k] + np.log(PRIOR["alone"] / 2), always)
    beside = _beside(pool, own, left) + nothing
    for i, k in _with_listed(seen.keys, beside, pool, truth, kind):
        key = seen.keys[i]
        prior = np.log(PRIOR["beside"] / observer.draws_of(key) / len(families))
        refit((key,), k, beside[i, k], of_kind[k] + prior, [key[0]] == [*truth])
    total = {key: float(logsumexp(values)) for key, values in logs.items()}
    whole = logsumexp([*total.values()])
    return Observed({key: float(np.exp(value - whole)) for key, value in total.items()})


def _with_listed(
    keys: Sequence[tuple], beside: np.ndarray, pool: _Pool, truth: Sequence[str], kind: str
) -> list[tuple[int, int]]:
    """Places of listed keys and draws to be refitted together: the best of each effect."""
    value = beside + pool.log_prior
    effects = np.array([key[0] for key in keys])
    best = {e: value[effects == e].max() for e in dict.fromkeys(effects)}
    wanted = sorted(best, key=best.get, reverse=True)[:BESIDE]
    chosen = []

    def choose(ours: np.ndarray, values: np.ndarray, apart: Sequence, count: int) -> None:
        of_draw = values.max(0)
        for k in _best(of_draw, apart, count):
            if np.isfinite(of_draw[k]):
                chosen.append((int(ours[values[:, k].argmax()]), k))

    for effect in wanted:
        ours = np.flatnonzero(effects == effect)
        choose(ours, value[ours], pool.about, TRUE if effect in wanted[:2] else 1)
    true = np.array([about[0] == kind for about in pool.about])
    for form in dict.fromkeys(key[1] for key in keys if [key[0]] == [*truth]):
        ours = np.array([i for i, key in enumerate(keys) if key[1] == form])
        choose(ours, value[ours], pool.about, 1)
        choose(ours, np.where(true, value[ours], -np.inf), range(len(true)), TRUE)
    return [*dict.fromkeys(chosen)]


def _scores(found: Observed, label: Mapping) -> dict[str, float]:
    """The observer's answer, judged as that of a diagnosis (``judge.py``)."""
    each, truth, world = found.each, {*label["effects"]}, world_of(label)
    named = {e for e, p in each.items() if p > LIKELY}
    more = found.unlisted > LIKELY
    right = {
        "null": found.sets.get(((), False), 0.0) >= LIKELY,
        "listed": named == truth and not more,
        "beside": more and named <= truth,
        "alone": more,
    }
    true = (tuple(sorted(truth)), world in ("beside", "alone"))
    return {
        "of_truth": found.sets.get(true, 0.0),
        "right": right[world],
        "named": bool(truth) and truth <= named,
        "exact": named == truth,
        "exact_or_alias": truth <= {e for e, p in each.items() if p >= PERHAPS},
    }


def _claims(found: Observed) -> list[tuple[str, float]]:
    """Probability of each effect of the most probable set with a listed effect, where a gap is
    likelier than none."""
    listed = {key: p for key, p in found.sets.items() if key[0]}
    if found.sets.get(((), False), 0.0) >= LIKELY or not listed:
        return []
    return [(e, found.holding([e])) for e in max(listed, key=listed.get)[0]]


def rows(labels: Mapping, found: Mapping[str, Observed], answers: Mapping) -> list[list[str]]:
    """Rows of the table: each figure of the observer, then of the answers to the same trials,
    in each world, and for pairs."""
    groups: dict[str, list[str]] = {world: [] for world in (*WORLDS[:-1], "pairs")}
    for name in found:
        if world := world_of(labels[name]):
            groups[world].append(name)
        if labels[name]["set"] == "pairs":
            groups["pairs"].append(name)
    judged = {name: judge(name, labels[name], answers[name]) for name in found}

    def own(names: Sequence[str]) -> list[float]:
        return [(p - (e in labels[k]["effects"])) ** 2 for k in names for e, p in _claims(found[k])]

    def same(names: Sequence[str]) -> list[float]:
        """Squared errors of the observer on the claims of the answers."""
        return [
            (found[k].holding([e, *one["twins"]]) - bool({e, *one["twins"]} & truth)) ** 2
            for k in names
            for truth in [{*labels[k]["effects"]}]
            for e, one in answers[k]["verdict"].get("each", {}).items()
        ]

    def theirs(names: Sequence[str]) -> list[float]:
        return [(p - there) ** 2 for k in names for p, there in judged[k].each]

    scored = {k: _scores(one, labels[k]) for k, one in found.items()}
    figures = {
        "mean probability on the true verdict": "of_truth",
        "verdict right": "right",
        "all listed effects named": "named",
        "exactly the listed effects named": "exact",
        "the same, or all likely": "exact_or_alias",
    }
    out = []
    for name, field in figures.items():

        def cell(score, names: Sequence[str], field=field) -> str:
            """Of the trials to which the figure applies."""
            of = [k for k in names if labels[k]["effects"] or field in ("of_truth", "right")]
            if field.startswith("exact"):
                of = [k for k in of if world_of(labels[k]) == "listed"]
            return mean_of([score(k, field) for k in of])

        out.append([name, *(cell(lambda k, field: scored[k][field], of) for of in groups.values())])
        values = (cell(lambda k, field: getattr(judged[k], field), of) for of in groups.values())
        out.append(["- answered", *values])
    squares = {
        "Brier score of `each`, own effects": own,
        "- effects of the answers": same,
        "- answered": theirs,
    }
    for name, of_names in squares.items():
        out.append([name, *(mean_of(of_names(of)) for of in groups.values())])
    return out


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--trials", type=int, default=10_000, help="the first so many of these")
    parser.add_argument("--rows", type=int, help="of these, those with so many rows")
    given = parser.parse_args(arguments)
    labels = json.loads((given.folder / "labels.json").read_text())
    kept = given.folder / "observed"
    kept.mkdir(exist_ok=True)
    found, answers = {}, {}
    for name in sorted(labels)[given.first :][: given.trials]:
        label, path = labels[name], kept / f"{name}.json"
        if given.rows and label["n"] != given.rows:
            continue
        if not path.exists():
            trial = bound._trial(given.folder, label)
            x = with_known_range(trial.x, DESIGNS[label["design"]])
            seen = observed(x, trial.observed, label["effects"], label["kind"])
            path.write_text(json.dumps([[*key, p] for key, p in seen.sets.items()]))
        found[name] = Observed({(tuple(e), u): p for e, u, p in json.loads(path.read_text())})
        answer = (given.folder / "answers" / label["file"]).with_suffix(".json")
        if answer.exists():
            answers[name] = json.loads(answer.read_text())
    of = {name: one for name, one in found.items() if name in answers}
    header = ["", *WORLDS[:-1], "pairs"]
    for line in (header, ["---"] * len(header), *rows(labels, of, answers)):
        print("| " + " | ".join(line) + " |")


if __name__ == "__main__":
    main()
