"""Fit the parameters of a simulator's formula to a tire, and compute the errors of files."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.optimize import least_squares

from tirefit.arrays import Numbers, Scalar
from tirefit.models import TireInputs, forces
from tirefit.params import Values
from tirefit.results import InputProblem, UsageError
from tirefit.slip import sigma_from_kappa
from tirefit.targets.code import compiled
from tirefit.targets.formulas import Curves, Formula, magic_formula_of
from tirefit.targets.tire import (
    ALWAYS,
    INPUTS,
    USUAL_SHARES,
    USUAL_SLIP,
    Tire,
    range_text,
    turned_range,
)

MOST = 0.05
"""Largest error over the load that is written without ``force``."""
_SLIP_OF = {"fx": "kappa", "fy": "alpha"}


def grid_of(
    ranges: Mapping[str, tuple[float, float]], kappa: int, alpha: int, fz: int
) -> np.ndarray:
    """Slips and loads (3, n) on a grid with these numbers of points; with 0, a slip is zero."""
    counts = {"kappa": kappa, "alpha": alpha, "fz": fz}
    axes = [np.linspace(*ranges[k], n) if n else [0.0] for k, n in counts.items()]
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")])


def check_loss(tire: Tire, held: Tire, target: str, force: bool) -> tuple[str, ...]:
    """A sentence on the largest error within the measured range, over usual slips where
    a slip was not measured; none if it is exact.

    Raises:
        UsageError: the error exceeds :data:`MOST` of the load, without ``force``.
    """
    if held.model is tire.model:
        return ()
    compared = {f: _SLIP_OF[f] for f in _SLIP_OF if f in tire.modelled and f in held.modelled}
    # A force whose slip was not measured, like fx of a fit to fy, is in the file as well.
    slips = compared.values()
    ranges = dict.fromkeys(slips, (-USUAL_SLIP, USUAL_SLIP))
    ranges["fz"] = USUAL_SHARES[0] * tire.load, USUAL_SHARES[-1] * tire.load
    for name, ends in ranges.items():
        low, high = np.clip(ends, *tire.measured.get(name, (-np.inf, np.inf)))
        ranges[name] = float(low), float(high)
    along, across = (31 if k in slips else 0 for k in _SLIP_OF.values())
    kappa, alpha, fz = grid_of(ranges, along, across, 5)
    at = TireInputs(sigma_from_kappa(kappa), alpha, fz, tire.speed)
    both = [forces(each.model, at)._asdict() for each in (tire, held)]
    pure, missed, sizes = kappa * alpha == 0, [0.0], []
    for name in compared:
        off = np.abs(both[0][name] - both[1][name]) / fz
        missed.append(float(np.max(off)))
        alone = float(np.max(off[pure]))
        sizes.append(f"{name} {100 * missed[-1]:.2f} % of F_z (in pure slip {100 * alone:.2f} %)")
    where = range_text(turned_range(ranges, "iso-w"))
    sentence = f"largest error of the file: {', '.join(sizes)}; over {where} (iso-w)"
    if max(missed) > MOST and not force:
        remedy = "export to c, casadi or numpy, which hold it, or accept it by --force"
        reason = f"{tire.name} for {target}: {sentence}; the limit is {MOST:.0%}"
        raise UsageError(InputProblem(reason, remedy))
    return (sentence,)


EXACT = 1e-9
"""Error over load below which a formula represents a tire exactly."""
OTHER_LOADS = 0.75, 1.25
"""Shares of the measured loads to which a file may extend: with a track of 1.5 m and a
centre of gravity at 0.55 m, a quarter of the load of a wheel shifts at 0.34 g."""
_USUAL_SLIP = 0.2  # largest |kappa| and |alpha| [rad] of the refit if no range was measured
_NARROW = 0.01  # smallest width of a measured range of slip [-] or angle [rad] that is used
_LOCKED, _SPIN = 0.95, -2.0
"""Largest canonical kappa of a range, as a locked wheel has no sigma_x."""
_SHAPES = 1.4, 1.1, 1.9
"""Values of C from which a refit starts; that of a brush is 1.3. With only the first, one
of 60 random Magic Formulas ended with an error of 120 % of F_z."""
Ranges = Mapping[str, tuple[float, float]]
"""Smallest and largest canonical kappa, alpha [rad] and fz [N]."""


class _Kind(NamedTuple):
    """A kind of slip: its name, the compared forces, the slips that vary, and the numbers
    of kappa and alpha in a fit and in its check."""

    words: str
    forces: tuple[str, ...]
    slips: tuple[str, ...]
    rough: tuple[int, int]
    fine: tuple[int, int]


_KINDS = {
    "fx": _Kind("F_x of pure slip", ("fx",), ("kappa",), (81, 0), (201, 0)),
    "fy": _Kind("F_y of pure slip", ("fy",), ("alpha",), (0, 81), (0, 201)),
    "both": _Kind("combined slip", ("fx", "fy"), ("kappa", "alpha"), (9, 9), (31, 31)),
}


class Refit(NamedTuple):
    """A formula's parameters for a tire."""

    values: dict[str, float]  # the parameters
    ranges: Ranges  # where it was compared with the tire
    miss: dict[str, float]
    """Largest error of a force over load, ``fx`` and ``fy`` in pure slip and ``both`` in combined
    slip, as far as tire and formula have them."""
    refitted: tuple[str, ...]
    """Keys of ``miss`` whose parameters are a least-squares fit; the others were converted by
    formula."""

    @property
    def largest(self) -> float:
        """The largest error, over load, of the forces that were refitted."""
        return max([self.miss[key] for key in self.refitted], default=0.0)

    def sentence(self, convention: str) -> str:
        """Sentences on the largest errors and their place."""
        exact = [k for k, miss in self.miss.items() if miss < EXACT]
        sentences = [f"{_KINDS[k].words} exactly, by formula" for k in exact]
        for kind in [k for k in self.miss if k not in exact]:
            how = "refitted" if kind in self.refitted else "by formula"
            size = f"largest error {percent(self.miss[kind])} % of F_z"
            sentences.append(f"{_KINDS[kind].words} {how}: {size}")
        used = {"fz"}.union(*(_KINDS[kind].slips for kind in self.miss))
        ranges = {name: ends for name, ends in self.ranges.items() if name in used}
        where = range_text(turned_range(ranges, convention))
        return f"{'; '.join(sentences)}; over {where} ({convention})"


def percent(share: float) -> str:
    """A share in percent, rounded up to two digits."""
    size = 10.0 ** (math.floor(math.log10(100 * share)) - 1)
    return f"{math.ceil(round(100 * share / size, 6)) * size:.3g}"


def ranges_of(tire: Tire, over: Ranges, static: bool = False) -> Ranges:
    """The ranges in which a formula is compared with a tire, in canonical signs: those
    that were measured, else usual slips and the load of the tire.

    Args:
        over: ranges that replace those of the tire.
        static: whether the load of the tire is that of a car, whatever was measured.
    """
    ranges = dict.fromkeys(("kappa", "alpha"), (-_USUAL_SLIP, _USUAL_SLIP))
    ranges["fz"] = tire.load, tire.load
    for name in ("kappa", "alpha", *([] if static else ["fz"])):
        low, high = tire.measured.get(name, (0.0, 0.0))
        if high - low > _NARROW or name == "fz" and high > 0:
            ranges[name] = low, high
    ranges |= over
    low, high = ranges["kappa"]
    ranges["kappa"] = max(low, _SPIN), min(high, _LOCKED)
    low, high = ranges["fz"]
    ranges["fz"] = max(low, 0.1 * high), high
    return ranges


def beyond_measured(tire: Tire, ranges: Ranges, convention: str) -> str:
    """Ranges in which a file describes a tire far from what was measured, beside the
    measured ones; empty if there are none, or nothing was measured.

    Loads may differ from the measured ones as they do in a drive (:data:`OTHER_LOADS`).
    A slip whose force was not fitted is not judged: the notes of the tire state that.
    """
    places = []
    force_of = {"kappa": "fx", "alpha": "fy"}
    used, known = (turned_range(ends, convention) for ends in (ranges, tire.measured))
    for name in [name for name in used if name in known]:
        (low, high), (least, most) = used[name], known[name]
        less, more = least - _NARROW, most + _NARROW
        if name == "fz":
            less, more = OTHER_LOADS[0] * least, OTHER_LOADS[1] * most
        judged = name == "fz" or not tire.fitted or force_of[name] in tire.fitted
        if judged and (low < less or high > more):
            both = (range_text({name: ends}) for ends in ((low, high), (least, most)))
            places.append(", measured ".join(both))
    return "; ".join(places)


def over_problems(over: Ranges) -> list[InputProblem]:
    """Problems of the ranges that a user states for a refit."""
    problems = []
    for name, (low, high) in over.items():
        least = 0.0 if name == "fz" else _NARROW
        is_known = name in INPUTS[:ALWAYS] and (name != "fz" or low > 0)
        if not is_known or not least < high - low < math.inf:
            reason = f"--over {name}={low:g}:{high:g} is not a range"
            remedy = "give kappa, alpha or fz as NAME=LOW:HIGH, with LOW below HIGH by more than"
            remedy += f" {least:g}, and fz above zero; without fz, one load"
            problems.append(InputProblem(reason, remedy))
    return problems


def refit(tire: Tire, formula: Formula, ranges: Ranges) -> Refit:
    """Fit a formula's parameters to the forces of a tire.

    A Magic Formula is converted by formula. If that is not exact, and for other tires,
    least squares fits the parameters of each stage of the formula.

    Args:
        tire: upright, at nominal pressure and :attr:`Tire.speed`. Its
            load is the nominal load of the formula.
        formula: the formula.
        ranges: as from :func:`ranges_of`.

    Returns:
        The parameters, and the largest error on a grid finer than that of the fit.

    Raises:
        UsageError: the tire has none of the forces of the formula, or one that is not
            finite within the ranges.
    """
    stages = formula.stages
    has = [name for name in formula.outputs if name in tire.modelled]
    if not has:
        reason = f"{tire.name} has no {' or '.join(formula.outputs)} to be written"
        raise UsageError(InputProblem(reason, "export a tire that has it"))
    kinds = [*has, *(["both"] if len(has) == 2 else [])]
    kinds = [kind for kind in kinds if kind in stages or not stages]
    every = [*kinds, *kinds]
    grids = [grid_of(ranges, *_KINDS[kind].rough, 5) for kind in kinds]
    grids += [grid_of(ranges, *_KINDS[kind].fine, 7) for kind in kinds]
    wanted = _forces(tire, every, grids)
    if not all(np.isfinite(part).all() for part in wanted):
        reason = f"a force of {tire.name} is not finite within the range of the refit"
        raise UsageError(InputProblem(reason, "narrow it, as with --over fz=LOW:HIGH"))
    cases = list(zip(every, grids, wanted, strict=True))
    starts = [formula.start(curves) for curves in _curves(tire)]
    values, fitted = dict(starts[0]), []
    rough = {kind: case for kind, *case in cases[: len(kinds)]}
    lost = formula.of_load if len({*ranges["fz"]}) == 1 else ()
    for kind in [kind for kind in stages if kind in kinds]:
        if _miss(formula, values, kind, *rough[kind]) > EXACT:
            names = tuple(name for name in stages[kind] if name not in lost)
            values |= _solved(formula, values, starts, kind, names, *rough[kind])
            fitted.append(kind)
    miss = {kind: _miss(formula, values, kind, *case) for kind, *case in cases[len(kinds) :]}
    return Refit(values, ranges, miss, tuple(fitted))


def _forces(tire: Tire, kinds: Sequence[str], grids: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Canonical forces of a tire over load (rows, n) on each grid: those of its kind of
    slip; zero if the tire has none."""
    kappa, alpha, fz = np.concatenate(grids, axis=1)
    given = forces(tire.model, TireInputs(sigma_from_kappa(kappa), alpha, fz, tire.speed))
    ends = np.cumsum([grid.shape[1] for grid in grids])[:-1]
    shares = [0 * fz if f is None else np.asarray(f) / fz for f in (given.fx, given.fy)]
    rows = {"fx": [0], "fy": [1], "both": [0, 1]}
    parts = np.split(np.stack(shares), ends, axis=1)
    return [part[rows[kind]] for kind, part in zip(kinds, parts, strict=True)]


def _off(
    formula: Formula, kind: str, computed: Sequence[Numbers], grid: Values, wanted: Values
) -> list[Any]:
    """Forces of a formula minus those of the tire, over load: a list of rows."""
    places = [formula.outputs.index(name) for name in _KINDS[kind].forces]
    return [computed[k] / grid[2] - row for k, row in zip(places, wanted, strict=True)]


def _miss(
    formula: Formula, values: Mapping[str, float], kind: str, grid: np.ndarray, wanted: np.ndarray
) -> float:
    """Largest error, by the program that is also checked, without a compiler."""
    computed = compiled(formula.program(values, "braking"))(*grid)
    off = _off(formula, kind, computed, grid, wanted)
    return float(np.max(np.linalg.norm(off, axis=0)))


@cache
def _compiled(
    formula: Formula, kind: str, names: tuple[str, ...]
) -> tuple[Callable[..., Array], Callable[..., Array]]:
    """Residuals of the parameters ``names`` and their Jacobian."""

    def residuals(z: Array, others: Mapping[str, Scalar], grid: Array, wanted: Array) -> Array:
        values = {**others, **{name: z[k] for k, name in enumerate(names)}}
        computed = formula.canonical(values, *grid)
        return jnp.concatenate(_off(formula, kind, computed, grid, wanted))

    return jax.jit(residuals), jax.jit(jax.jacfwd(residuals))


def _solved(
    formula: Formula, values: Mapping[str, float], starts: Sequence[Mapping[str, float]], kind: str,
    names: tuple[str, ...], *at: np.ndarray,
) -> dict[str, float]:  # fmt: skip
    """Least squares of the parameters ``names``: the best from all starts."""
    residuals, jacobian = _compiled(formula, kind, names)
    low, high = np.array([formula.stages[kind][name] for name in names]).T
    # Start within the bounds and not at them.
    edge = 1e-3 * (high - low)
    solutions = [
        least_squares(
            lambda z: np.asarray(residuals(z, values, *at)),
            np.clip(start, low + edge, high - edge),
            lambda z: np.asarray(jacobian(z, values, *at)),
            bounds=(low, high),
            x_scale="jac",
        )
        for start in dict.fromkeys(tuple(initial[n] for n in names) for initial in starts)
    ]
    best = min(solutions, key=lambda solution: solution.cost)
    return dict(zip(names, map(float, best.x), strict=True))


def _curves(tire: Tire) -> list[Curves]:
    """B, C, D, E of both pure slips: those of the tire, and those from slope, peak and
    each of :data:`_SHAPES`."""
    slips = np.concatenate([[1e-4, -1e-4], np.linspace(0.01, 0.9, 90)])
    zero, load = np.zeros_like(slips), np.full_like(slips, tire.load)
    pure = [(slips, zero, load), *((zero, slips, k * load) for k in (1.0, 0.9, 1.1))]
    slopes = []  # slope of each force over load, and its peak beyond
    for (force,) in _forces(tire, ("fx", "fy", "fy", "fy"), [np.stack(inputs) for inputs in pure]):
        peak = np.max(force[2:], where=np.isfinite(force[2:]), initial=1e-9)
        slopes.append((float(force[0] - force[1]) / 2e-4, float(peak)))
    along, across, less, more = slopes
    fall = float(np.clip(-np.log(more[1] / less[1]) / np.log(1.1 / 0.9), 0.0, 1.0))
    along = along if "fx" in tire.modelled else across
    across = across if "fy" in tire.modelled else along
    formula = magic_formula_of(tire.model)
    weights = formula[2] if formula else {}
    begun = [Curves(formula[0], formula[1], tire.load, fall, weights)] if formula else []
    for shape in _SHAPES:
        x, y = ((k / (shape * top), shape, top, 0.0) for k, top in (along, across))
        begun.append(Curves(x, y, tire.load, fall, weights))
    return begun
