"""How well a file determines the parameters of models, before any fit.

The information matrix of a model is summed over the file's slips, loads and speeds from
the model's slopes in its parameters and the scatter of the file's rows. Its inverse is
the covariance that a fit would have if the model is right. It depends on the friction,
which is unknown if the tire never slid: any higher friction then describes the rows as
well, and the largest standard error under any of them is reported.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.accept import DataLike, as_data
from tirefit.data.rig.levels import levels
from tirefit.data.table import TireData
from tirefit.files import listed
from tirefit.fitting.problem.build import FitTask, build, guess_from_curve, slope_and_peak
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP, FitProblem
from tirefit.fitting.problem.noise import autocorrelation_time
from tirefit.fitting.solve.inference import inverse_of, linearise
from tirefit.fitting.uncertainty.identified import not_identified
from tirefit.params import Spec, constrain, log_jacobian
from tirefit.results import DataError

MODELS_ASKED = ("brush", "brush-d", "brush-m", "brush-n", "brush-h", "brush-load", "magic-formula")
"""Models that are evaluated by default."""

_FRICTION = ("mu", "mu_peak", "mu_s", "D", "Dx", "Dy")
_HIGHEST, _FRICTIONS = 2.0, 7
"""Friction above that of any tire, and the number of values tried up to it."""
_AS_WELL = 9.0
"""Rise of -2 log likelihood up to which a friction fits too (3 standard deviations)."""
_REACHED = {"sigma_x": (-0.9, 2.0), "alpha": (-1.2, 1.2)}  # slips that a test can go to
_INSIDE = 4.0
"""Largest unconstrained value tried, 2 % of the range from either bound: closer to it, a
step of the parameter would not change the force."""
_STEPS = 12
_WELL = 0.15
"""Half of the interval over the value, or over a quarter of the range, up to which a
parameter counts as well determined."""
_STEEPEST = 20.0
"""Largest change of a force, in loads, per unit of an unconstrained parameter (a quarter
of its range, or as much on a scale); above it the model is outside its validity."""
ROWS = 512
"""Size of the sample, evenly over loads and slips: one compiled program for all files."""
_LEAST_NOISE = 1e-3  # of the load: no rig measures better
_GUESSED_NOISE = 0.01
_SPINNING = -0.95  # slip below which a wheel spins almost on the spot
_SETTINGS = 12  # largest number of levels of a channel that are settings of a rig
_CHUNK = 12  # parts of a slip curve, each fitted by a parabola with noise residuals
WELL, ROUGHLY, NOT = "well", "roughly", "not"


class Scatter(NamedTuple):
    """The noise of a force."""

    share: float  # standard deviation over the load
    inflation: float  # rows per independent row
    how: str


class ParameterGate(NamedTuple):
    """How well the file determines one parameter."""

    name: str
    unit: str
    value: float  # guess at which it was evaluated
    std: float  # standard deviation that a fit would have
    grade: str  # "well", "roughly" or "not"
    is_size: bool  # positive by nature, so that its std is a share of it
    beside: str = ""  # the parameter it is most correlated with
    remedy: str = ""  # rows that would determine it

    @property
    def text(self) -> str:
        """Name and expected error, or what it is correlated with and what it needs."""
        if self.grade == NOT:
            reason = f"correlated with {self.beside}; " if self.beside else ""
            needs = f"needs {self.remedy}" if self.remedy else "not in a wider test either"
            return f"{self.name}: {reason}{needs}"
        about = "" if self.grade == WELL else " roughly"
        unit = "" if self.unit == "-" else f" {self.unit}"
        error = f"{100 * self.std / self.value:.2g} %" if self.is_size else f"{self.std:.2g}{unit}"
        return f"{self.name}{about} ±{error}"


class ModelGate(NamedTuple):
    """How well the file determines one model; ``reason`` if it cannot be evaluated."""

    model: str
    force: str
    parameters: tuple[ParameterGate, ...]
    reason: str = ""


@dataclass(frozen=True)
class Identifiability:
    """How well a file determines each model, by force, and the noise assumed."""

    gates: tuple[ModelGate, ...]
    noise: Mapping[str, float]
    rows: int
    effective_rows: Mapping[str, float]
    how: str

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        content = asdict(self)
        content["gates"] = [
            gate._asdict() | {"parameters": [p._asdict() for p in gate.parameters]}
            for gate in self.gates
        ]
        return content

    def summary(self) -> str:
        """A few lines per model, at most 88 columns wide."""
        if not self.gates:
            return ""
        lines = ["", "", "expected standard errors of a fit (if the model is right)"]
        for force, share in self.noise.items():
            rows = f"{self.rows} rows that count as {self.effective_rows[force]:.0f}"
            lines.append(f"  {force}: noise {100 * share:.2g} % of the load, {rows}")
        for gate in self.gates:
            start = f"  {gate.force} {gate.model:<14} "
            if gate.reason:
                lines.append(f"{start}{gate.reason}")
                continue
            known = [p.text for p in gate.parameters if p.grade != NOT]
            lines.append(f"{start}{', '.join(known) or 'none'}")
            unknown = [p.text for p in gate.parameters if p.grade == NOT]
            lines += [f"{'':<{len(start)}}not {text}" for text in unknown]
        return "\n".join(lines)


def identifiability(
    data: DataLike, models: Sequence[str] | None = None, seed: int = 0
) -> Identifiability:
    """Return how well the data determine the parameters of models, before any fit.

    Args:
        data: what ``tirefit.read`` gave, or a path, a frame, a mapping of arrays.
        models: names of ``tirefit models``; ``MODELS_ASKED`` if none.
        seed: of the random choice of rows in a large file.

    Returns:
        By model and force the standard error that each parameter would have.

    Raises:
        UsageError: no such model.
        DataError: as ``tirefit.read``.

    Example:
        >>> (gate,) = identifiability(samples / "circles.csv", ["brush"]).gates
        >>> {one.name: one.grade for one in gate.parameters}
        {'cpa2': 'well', 'mu': 'well'}
    """
    data = as_data(data)
    forces = [
        force
        for force, slip in CHANNEL_SLIP.items()
        if force != "mz"
        and force in data
        and slip in data
        and "fz" in data
        and data.n
        and np.ptp(data.usable(slip)) > 1e-9
    ]
    parts = {force: stretches(data, force) for force in forces}
    scatter = {force: scatter_of(data, force, parts[force]) for force in forces}
    some = {force: some_rows(data, parts[force], seed) for force in forces}
    curves = {}
    for force in forces:
        slope, peak, typical = slope_and_peak(data, force)
        peak = float(np.clip(peak, 0.02, 3.0))
        largest = float(np.max(np.abs(data.usable(CHANNEL_SLIP[force]))))
        curves[force] = max(slope, peak * typical / largest), peak, typical
    gates = tuple(
        _gate(some[force], data.n, curves[force], force, name, scatter[force])
        for force in forces
        for name in listed(models or MODELS_ASKED)
    )
    return Identifiability(
        gates,
        {force: s.share for force, s in scatter.items()},
        data.n,
        {force: data.n / s.inflation for force, s in scatter.items()},
        "; ".join(f"{force}: {s.how}" for force, s in scatter.items()),
    )


def _gate(
    some: TireData,
    rows: int,
    curve: tuple[float, float, float],
    force: str,
    name: str,
    scatter: Scatter,
) -> ModelGate:
    """Standard errors of a model's parameters, from ``some`` of the file's ``rows``."""
    config = parse_config({"force": force})
    try:
        task = build(some, name, config, least_rows=ROWS)
    except DataError as error:
        return ModelGate(name, force, (), error.problems[0].reason)
    problem = task.problem
    points = [_settled(problem, z) for z in _points(task, curve)]
    many = rows / (problem.n * scatter.inflation)
    weight = problem.used(problem.rows.scale[force]) / (
        scatter.share * problem.used(problem.rows.inputs.fz)
    )
    costs = np.array([float(np.sum((v * weight) ** 2)) for _, v, _ in points]) * many
    # The model may miss the rows by more than their noise; this does not reject it.
    wide = max(1.0, float(costs.min()) / (many * problem.n))
    likely = [
        point
        for point, cost in zip(points, costs, strict=True)
        if cost - costs.min() <= _AS_WELL * wide
    ]
    weight = weight * np.sqrt(many)

    def rank(gate: ParameterGate) -> tuple[int, float]:
        scale = gate.value if gate.is_size else 1.0
        return (WELL, ROUGHLY, NOT).index(gate.grade), gate.std / scale

    parameters = []
    for k in range(problem.layout.size):
        each = (_judged(problem, k, z, _information(slopes, weight)) for z, _, slopes in likely)
        worst = max(each, key=rank)  # at the likely point that determines it least
        remedy = _remedy(problem, k, likely, weight) if worst.grade == NOT else ""
        parameters.append(worst._replace(remedy=remedy))
    return ModelGate(name, force, tuple(parameters))


def _points(task: FitTask, curve: tuple[float, float, float]) -> list[np.ndarray]:
    """Unconstrained parameters, friction from the largest force upwards."""
    slope, peak, load = curve
    layout, points = task.problem.layout, []
    frictions = [p.name for p in layout.free if p.name in _FRICTION]
    highest = max(_HIGHEST / peak, 1.2)
    for times in np.geomspace(1, highest, _FRICTIONS if frictions else 1):
        there = guess_from_curve(slope, times * peak, load)
        values = {n: there.get(n, value) for n, value in task.guess.items()}
        for p in layout.free:
            low, high = p.spec.bounds
            values[p.name] = float(np.clip(values[p.name], low, high))
        points.append(np.clip(layout.unconstrained(values), -_INSIDE, _INSIDE))
    return points


def _at(problem: FitProblem, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (n,) and their slopes (n, p), without padding."""
    at = linearise(problem, z)
    name = problem.channels[0].name
    most = _STEEPEST * problem.used(problem.rows.inputs.fz / problem.rows.scale[name])
    slopes = problem.used(at.slopes[name])
    tame = np.where(np.abs(slopes) <= most[:, None], slopes, 0.0)
    return problem.used(at.values[name]), tame


def _settled(problem: FitProblem, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit the other parameters to the rows at a given friction.

    Returns:
        z, residuals and slopes there.
    """
    moves = np.array([p.name not in _FRICTION for _, p in problem.layout.elements])
    values, slopes = _at(problem, z)
    damping = 1e-3
    for _ in range(_STEPS if moves.any() else 0):
        inner = slopes[:, moves]
        matrix = inner.T @ inner
        matrix = matrix + damping * np.diag(np.diag(matrix)) + 1e-9 * np.eye(len(matrix))
        step = np.zeros(len(z))
        step[moves] = -np.linalg.solve(matrix, inner.T @ values)
        there = np.clip(z + np.clip(step, -1, 1), -_INSIDE, _INSIDE)
        new_values, new_slopes = _at(problem, there)
        gain = values @ values - new_values @ new_values
        if gain > 0:
            z, values, slopes, damping = there, new_values, new_slopes, damping / 5
            if gain < 1e-4 * (values @ values):
                break
        else:
            damping *= 20
    return z, values, slopes


def _is_size(spec: Spec) -> bool:
    return spec.scale == "log" or spec.lower > 0


def _grade(spec: Spec, value: float, std: float) -> str:
    """How well an interval determines a parameter, by the rules of a fit."""
    half = 1.96 * std
    if spec.scale == "log":
        times = float(np.exp(min(half / value, 25.0)))
        low, high = value / times, value * times
    else:
        low, high = max(value - half, spec.lower), min(value + half, spec.upper)
    if not_identified(spec, low, high, False, False):
        return NOT
    size = value if _is_size(spec) else max(abs(value), (spec.upper - spec.lower) / 4)
    return WELL if half <= _WELL * size else ROUGHLY


def _information(slopes: np.ndarray, weight: np.ndarray) -> np.ndarray:
    weighted = slopes * weight[:, None]
    return weighted.T @ weighted


def _judged(problem: FitProblem, k: int, z: np.ndarray, information: np.ndarray) -> ParameterGate:
    label, parameter = problem.layout.elements[k]
    spec = parameter.spec
    slope = float(np.exp(log_jacobian(z[k], spec)))
    value = float(constrain(z[k], spec))
    cov = inverse_of(information)
    std = slope * float(np.sqrt(cov[k, k]))
    grade, beside = _grade(spec, value, std), ""
    if grade != WELL and information[k, k] > 0:
        alone = slope / float(np.sqrt(information[k, k]))
        if _grade(spec, value, alone) == WELL:
            size = np.sqrt(np.diag(cov))
            other = np.abs(cov[k]) / (size * size[k])
            other[k] = 0.0
            beside = problem.layout.labels[int(np.argmax(other))]
    return ParameterGate(label, spec.unit, value, std, grade, _is_size(spec), beside)


def _remedy(
    problem: FitProblem,
    k: int,
    likely: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    weight: np.ndarray,
) -> str:
    """The first wider test that would determine the parameter, in words; empty if none."""
    slip = problem.slip_name
    for words, name, times in (
        (f"slips twice as large ({slip})", slip, (2.0,)),
        (f"slips four times as large ({slip})", slip, (4.0,)),
        (f"slips ten times as large ({slip})", slip, (10.0,)),
        ("loads from half to one and a half times as large", "fz", (0.5, 1.5)),
        ("speeds from half to twice as high", "v", (0.5, 2.0)),
    ):
        inputs, reached = problem.rows.inputs, _REACHED.get(name, (-np.inf, np.inf))
        values = [np.clip(factor * np.asarray(getattr(inputs, name)), *reached) for factor in times]
        wider = [problem.with_rows(inputs=inputs._replace(**{name: each})) for each in values]
        for z, _, slopes in likely:
            more = _information(slopes, weight)
            for rows in wider:
                more = more + _information(_at(rows, z)[1], weight)
            if _judged(problem, k, z, more).grade == NOT:
                break
        else:
            return words
    return ""


def stretches(data: TireData, force: str) -> list[np.ndarray]:
    """The used rows of each setting of the rig, in the order of slip."""
    rows = np.flatnonzero(data.used)
    if "sigma_x" in data:  # the slip of a wheel that spins on the spot is not defined
        rolls = data["sigma_x"][rows] > _SPINNING
        rows = rows[rolls] if rolls.any() else rows
    key = np.zeros(len(rows), int)
    for name in ("fz", "v", "gamma", "pressure"):
        here = levels(data[name][rows]) if name in data else None
        if here is not None and here.few(_SETTINGS):
            key = key * len(here.center) + here.code
    parts, slip = [rows[key == k] for k in np.unique(key)], CHANNEL_SLIP[force]
    return [part[np.argsort(data[slip][part], kind="stable")] for part in parts]


def some_rows(data: TireData, parts: Sequence[np.ndarray], seed: int) -> TireData:
    """Data of at most ``ROWS`` rows of the parts, evenly taken in their order."""
    order = np.concatenate(parts)
    if len(order) > ROWS:
        edges = np.linspace(0, len(order), ROWS + 1)
        place = np.random.default_rng(seed).uniform(edges[:-1], edges[1:])
        order = order[np.minimum(place.astype(int), len(order) - 1)]
    chosen = np.zeros(len(data), bool)
    chosen[order] = True
    return data.where(chosen)


def scatter_of(data: TireData, force: str, parts: Sequence[np.ndarray]) -> Scatter:
    """The noise from the residuals of the rows about a piecewise parabolic slip curve."""
    share = data[force] / data["fz"]
    rest = np.full(len(data), np.nan)
    for part in parts:
        for rows in np.array_split(part, min(_CHUNK, max(len(part) // 8, 1))):
            if len(rows) < 6:
                continue
            slip = data[CHANNEL_SLIP[force]][rows]
            at = (slip - slip.mean()) / (np.ptp(slip) or 1.0)
            terms = np.column_stack([np.ones(len(at)), at, at**2])
            left = share[rows] - terms @ np.linalg.lstsq(terms, share[rows])[0]
            rest[rows] = left * np.sqrt(len(rows) / (len(rows) - 3))
    known = np.flatnonzero(np.isfinite(rest))
    if len(known) < 12:
        how = f"too few rows to estimate it: {_GUESSED_NOISE:.0%} of the load is assumed"
        return Scatter(_GUESSED_NOISE, 1.0, how)
    size = max(float(np.sqrt(np.mean(rest[known] ** 2))), _LEAST_NOISE)
    inflation = 1.0
    if "time" in data:
        runs = [known[data.run[known] == code] for code in np.unique(data.run[known])]
        order = [rows[np.argsort(data["time"][rows], kind="stable")] for rows in runs]
        inflation = autocorrelation_time([rest[rows] for rows in order])
    return Scatter(size, inflation, "scatter about the slip curve of each load")
