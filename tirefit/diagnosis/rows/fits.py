"""Least-squares fits: the first fit of a base model, the tire that stands in for a
simulator known by its forces, and refits of hypotheses."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tirefit.data.table import CANONICAL, TireData
from tirefit.diagnosis.effects import atoms_of
from tirefit.diagnosis.effects.record import Effect
from tirefit.diagnosis.effects.state import Covariates
from tirefit.diagnosis.engine import NONZERO
from tirefit.diagnosis.engine.fit import Priors, Start
from tirefit.diagnosis.engine.search import MOST_EFFECTS
from tirefit.diagnosis.rows.forces import Design, Tire
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.rig import Rig, unfit
from tirefit.diagnosis.rows.simulator import STAND_INS, GivenSimulator
from tirefit.diagnosis.rows.slips import slip_nodes
from tirefit.diagnosis.rows.structure import rms, structures_of
from tirefit.fitting.mf.fit import fit_magic_formula
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.problem.noise import HUBER
from tirefit.fitting.solve.inference import REACH
from tirefit.fitting.solve.least_squares import MAX_STEPS, Normal, NormalEquations, advanced
from tirefit.fitting.solve.multistart import starting_points
from tirefit.models import TireInputs
from tirefit.models.mf import MAGIC_FORMULAS
from tirefit.padding import pad_rows, padded_size
from tirefit.params import Values
from tirefit.results import DataError

_FARTHEST = 20.0
"""Largest amplitude in prior scales."""

_LEAST_ROWS = 256
"""Smallest number of rows for which a diagnosis is compiled; small files share it."""

FARTHEST_OFF = 0.2
"""Largest error of a stand-in for a simulator over the simulated force (rms)."""


def weighted(
    model: Tire,
    points: np.ndarray,
    sets: Sequence[tuple[int, ...]],
    design: Design,
    n: int | None = None,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Whitened residual (C n,) of the first n rows and its slopes (p + k, C n), of sets of atoms,
    each at its point."""
    for mean, columns in model.slopes(points, sets, design):
        yield design.whitened(design.forces - mean, n), design.whitened(columns, n)


def refit(
    model: Tire, starts: Sequence[Start], sets: Sequence[tuple[int, ...]], design: Design
) -> np.ndarray:
    """Sets of atoms refitted: parameters and amplitudes in prior scales, padded with zeros,
    (h, p + :data:`MOST_EFFECTS`)."""
    p, none = len(starts[0].z), len(design.priors.scale)
    begin = np.zeros((len(sets), p + MOST_EFFECTS))
    for row, start in zip(begin, starts, strict=True):
        row[: p + len(start.amplitude)] = *start.z, *start.amplitude
    # Smaller sets are padded with amplitudes without effect.
    index = [[*s, *[none] * (MOST_EFFECTS - len(s))] for s in sets]
    center = np.hstack([begin[:, :p], np.append(design.priors.center, 0.0)[index]])
    bounds = []
    for side, end in ((-np.inf, design.priors.low), (np.inf, design.priors.high)):
        ends = np.clip(np.append(end, side)[index], -_FARTHEST, _FARTHEST)
        bounds.append(np.hstack([np.full((len(sets), p), side), ends]))
    pull = np.append(np.zeros(p), np.ones(MOST_EFFECTS))

    def at(numbers: Sequence[int], points: np.ndarray) -> Normal:
        """Normal equations at points (k, w), priors included."""
        off = points - center[numbers]
        cost, gradient = np.sum(pull * off**2, axis=1), pull * off
        normal = np.tile(np.diag(pull), (len(points), 1, 1))
        some = [tuple(sets[number]) for number in numbers]
        for k, (missed, rows) in enumerate(weighted(model, points, some, design)):
            used = slice(len(rows))
            cost[k] += missed @ missed
            normal[k, used, used] += rows @ rows.T
            gradient[k, used] -= rows @ missed
        return Normal(cost, normal, gradient)

    # At most 26 steps, until one more would gain less than 1e-3 of chi-squared: whole units of
    # evidence matter.
    return minimised(at, begin, bounds, NormalEquations(rtol=0.0, atol=1e-3), 26)[0]


def refit_base(model: Tire, z: np.ndarray, design: Design) -> np.ndarray:
    """Parameters z (p,) refitted without effects."""
    return refit(model, [Start(z, np.zeros(0))], [()], design)[0, : len(z)]


def minimised(
    at: Callable[..., Any],
    starts: np.ndarray,
    bounds: Sequence[np.ndarray],
    solver: NormalEquations,
    most: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Least squares from each of some starts (h, w), in lockstep, as ``at`` is faster for many.

    Args:
        at: normal equations at points (k, w) of some of these, by their numbers (k,).
        bounds: smallest and largest values, (h, w) each.

    Returns:
        The ends (h, w), and their sums of squares (h,).
    """
    z, (low, high) = np.array(starts), bounds
    states = [solver.begin(start) for start in np.clip(starts, low, high)]
    for _ in range(most):
        going = [k for k, state in enumerate(states) if not state.done]
        if not going:
            break
        normals = at(going, np.array([states[k].trial for k in going]))
        for k, *normal in zip(going, *normals[:3], strict=True):
            given = z[k], states[k], Normal(*normal), low[k], high[k]
            z[k], states[k] = advanced(solver, *given)
    return z, np.array([float(state.best.cost) for state in states])


def design_of(prepared: Prepared, effects: tuple[Effect, ...], rig: Rig) -> Design:
    """The rows as padded arrays."""
    size = padded_size(prepared.n, _LEAST_ROWS)
    slips, weight = slip_nodes(prepared.slip_law, prepared.slip, prepared.slip_std)
    observed, fz, v = prepared.observed, prepared.inputs.fz, prepared.inputs.v
    atoms = atoms_of(effects)
    priors = zip(*(atom.prior(prepared, rig) for atom in atoms), strict=True)
    scale, center, low, high = map(np.array, priors)
    odds = [atom.effect.odds(prepared) if atom.effect.odds else 0.0 for atom in atoms]
    return Design(
        inputs=TireInputs(*(pad_rows(x, size) for x in prepared.inputs)),
        slip=pad_rows(slips, size),
        weight=pad_rows(weight, size),
        second=pad_rows(prepared.second, size),
        observed={c: pad_rows(x, size) for c, x in observed.items()},
        # A first guess; the noise is estimated later.
        scale={c: np.full(size, 0.05 * np.std(x)) for c, x in observed.items()},
        offset={c: np.zeros(size) for c in observed},
        keep=(np.arange(size) < prepared.n).astype(float),
        rows=Covariates(*(pad_rows(x, size) for x in prepared.covariates)),
        priors=Priors(center / scale, low / scale, high / scale, np.array(odds), scale),
        reference=np.array([np.median(fz), np.median(v)]),
    )


def measured_slips(design: Design, prepared: Prepared) -> Design:
    """The same design at the measured slips."""
    slips = np.repeat(prepared.slip[:, None], design.slip.shape[1], axis=1)
    return design._replace(slip=pad_rows(slips, len(design.keep)))


def with_offset(
    prepared: Prepared, tire: Tire, design: Design, z: np.ndarray
) -> tuple[Design, dict[str, np.ndarray]]:
    """The design with the offset of a simulator from its tire at the measured slips;
    that offset by channel (n,)."""
    at_measured = tire.moments(z, measured_slips(design, prepared), prepared.n)[0]
    missed = {c: prepared.column(f"{c}_sim") - at_measured[c] for c in prepared.channels}
    offset = {c: pad_rows(values, len(design.keep)) for c, values in missed.items()}
    return design._replace(offset=offset), missed


def first_fit(
    prepared: Prepared, name: str, data: TireData, effects: tuple[Effect, ...], rig: Rig
) -> tuple[Tire, np.ndarray, np.ndarray]:
    """(tire, z, first guess of z) by least squares with Huber's loss at the measured slips."""
    if prepared.n < data.n:  # a large file is diagnosed on some of its rows
        used = np.zeros(len(data), bool)
        used[np.flatnonzero(data.used)[prepared.kept]] = True
        data = replace(data, used=used)
    # Half the starts of `tirefit fit`.
    config = parse_config({"force": list(prepared.channels), "starts": 4})
    task = build(data, name, config, _LEAST_ROWS)
    model, layout, rows = task.problem.model, task.problem.layout, task.problem.rows
    tire = Tire(model, layout, tuple(effects), prepared.mode)
    observed, scale = (
        {c: np.asarray(x) for c, x in part.items()} for part in (rows.observed, rows.scale)
    )
    design = measured_slips(design_of(prepared, effects, rig), prepared)
    design = design._replace(observed=observed, scale=scale)

    def at(numbers: Sequence[int], points: np.ndarray) -> Normal:
        normals = []
        for missed, by in weighted(tire, points, [()] * len(points), design):
            size = np.abs(missed)
            root = np.sqrt(np.maximum(2 * HUBER * size - HUBER**2, HUBER**2))
            beyond = size > HUBER
            missed = np.where(beyond, np.sign(missed) * root, missed)
            by = by * np.where(beyond, HUBER / root, 1.0)
            normals.append((missed @ missed, by @ by.T, -by @ missed))
        return Normal(*(np.array(part) for part in zip(*normals, strict=True)))

    starts = np.asarray(starting_points(task, config.starts, 0))
    bounds = np.full_like(starts, -REACH), np.full_like(starts, REACH)
    z, costs = minimised(at, starts, bounds, NormalEquations(), MAX_STEPS)
    return tire, z[int(np.argmin(costs))], starts[0]


def as_measured(data: TireData, channels: tuple[str, ...]) -> TireData:
    """The data with the simulated forces in place of the measured ones."""
    dropped = {f"{c}_std" for c in channels}
    columns = {k: v for k, v in data.columns.items() if k not in dropped}
    return replace(data, columns=columns | {c: data[f"{c}_sim"] for c in channels})


def missed_share(prepared: Prepared, channel: str, values: Values) -> float:
    """Error (n,) of a tire as a share of the simulated force, rms."""
    return rms(values) / max(rms(prepared.column(f"{channel}_sim")), NONZERO)


def check_followed(prepared: Prepared, missed: dict[str, Any], name: str) -> None:
    """Raises DataError if the stand-in ``name`` does not follow the simulated forces and these
    show no structure that explains it; ``missed`` is its error (n,) by channel."""
    for c, values in missed.items():
        share = missed_share(prepared, c, values)
        if share > FARTHEST_OFF:
            reason = (
                f"the tire fitted to the simulator ({name}) does not follow it: the error"
                f" of {c}_sim is {rms(values):.3g} {CANONICAL[c][0]} rms,"
                f" {100 * share:.0f} % of it ({100 * FARTHEST_OFF:.0f} % at most)"
            )
            remedy = f"check that {c}_sim is the force of these very rows, in their order, and its"
            remedy += " sign and unit"
            force, measured = prepared.column(f"{c}_sim"), prepared.observed[c]
            varies = np.ptp(force) > 0 and np.ptp(measured) > 0
            along = np.corrcoef(force, measured)[0, 1] if varies else 0.0
            if along < -0.8:  # a wrong sign of its slip gives the force the wrong sign
                remedy = f"reverse the sign of {c}_sim: it is opposite to the measured {c}"
                remedy += f" (correlation {along:.2f})"
            elif any(x.channel == c and x.id != "no_load" for x in structures_of(prepared)):
                continue  # both are described; a missing load explains no misfit of this size
            raise unfit(prepared.data, reason, remedy)


Fitted = tuple[Tire, np.ndarray, np.ndarray]
"""A tire, its parameters z, and the first guess of them."""

StandIn = tuple[str, Fitted, tuple[Design, dict[str, np.ndarray]]]
"""The name of a model, the tire fitted to a simulator's forces, and :func:`with_offset` of it."""


def standing_in(
    prepared: Prepared, effects: tuple[Effect, ...], rig: Rig, given: GivenSimulator
) -> StandIn:
    """The first of :data:`STAND_INS` that follows closely, else the better one. The simulator's
    forces alone choose it."""
    simulated = as_measured(prepared.data, prepared.channels)

    def tried(model: str) -> StandIn:
        if model in MAGIC_FORMULAS:
            # Its coefficients follow the simulator; only scaling factors are adapted.
            followed = replace(given, tire=fit_magic_formula(simulated, model).tire)
            fitted = followed.tire_for(prepared, effects)
        else:
            fitted = first_fit(prepared, model, simulated, effects, rig)
        design = design_of(prepared, effects, rig)
        return model, fitted, with_offset(prepared, fitted[0], design, fitted[1])

    plain, flexible = STAND_INS
    first = tried(plain)
    if max(missed_share(prepared, c, v) for c, v in first[-1][1].items()) <= 0.01:
        return first  # the simplest one that follows closely
    try:
        other = tried(flexible)
    except DataError:  # too few rows for its coefficients
        return first

    def energy(stand_in: StandIn) -> float:
        return sum(float(np.mean(values**2)) for values in stand_in[-1][1].values())

    return min(first, other, key=energy)
