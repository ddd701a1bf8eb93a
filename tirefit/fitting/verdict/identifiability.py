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
from numpy.polynomial import Polynomial

from tirefit.data.accept import DataLike, as_data
from tirefit.data.rig.levels import levels
from tirefit.data.table import TireData
from tirefit.files import listed
from tirefit.fitting.problem.build import FitTask, build, guess_from_curve, slope_and_peak
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP, FitProblem
from tirefit.fitting.problem.noise import autocorrelation_time
from tirefit.fitting.solve.inference import inverse_of, linearise
from tirefit.fitting.solve.least_squares import Normal, on_host
from tirefit.fitting.uncertainty.identified import limited
from tirefit.params import Spec, constrain, log_jacobian
from tirefit.results import DataError

MODELS_ASKED = ("brush", "brush-d", "brush-m", "brush-n", "brush-h", "brush-load", "magic-formula")
"""Models that are evaluated by default."""

_FRICTION = ("mu", "mu_peak", "mu_s", "D", "Dx", "Dy")
_HIGHEST, _FRICTIONS = 2.0, 7
"""Friction above that of any tire, and the number of values tried up to it."""
_AS_WELL = 9.0
"""Rise of -2 log likelihood up to which a friction fits too (3 standard deviations)."""
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
_GUESSED_NOISE = 0.01  # of the load: where there are too few rows to estimate it
_SPINNING = -0.95  # slip below which a wheel spins almost on the spot
_SETTINGS = 12  # largest number of levels of a channel that are settings of a rig
_CHUNK = 12  # parts of a slip curve, each fitted by a parabola with noise residuals
WELL, ROUGHLY, NOT = "well", "roughly", "not"


class Scatter(NamedTuple):
    """The noise of a force."""

    share: float  # standard deviation over the load
    inflation: float  # rows per independent row


class ParameterGate(NamedTuple):
    """How well the file determines one parameter."""

    name: str
    unit: str
    value: float  # guess at which it was evaluated
    std: float  # standard deviation that a fit would have
    grade: str  # "well", "roughly" or "not"
    is_size: bool  # positive by nature, so that its std is a share of it

    @property
    def text(self) -> str:
        """Name and expected error."""
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
            unknown = [f"not {p.name}" for p in gate.parameters if p.grade == NOT]
            lines.append(f"{start}{', '.join(known + unknown)}")
        return "\n".join(lines)


def identifiability(data: DataLike, models: Sequence[str] | None = None) -> Identifiability:
    """Return how well the data determine the parameters of models, before any fit.

    Args:
        data: what ``tirefit.read`` gave, or a path, a frame, a mapping of arrays.
        models: names of ``tirefit models``; ``MODELS_ASKED`` if none.

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
        for force, slip in (("fx", "sigma_x"), ("fy", "alpha"))
        if all(name in data for name in (force, slip, "fz"))
        and data.n
        and np.ptp(data.usable(slip)) > 1e-9
    ]
    parts = {force: stretches(data, force) for force in forces}
    scatter = {force: scatter_of(data, force, parts[force]) for force in forces}
    some = {force: some_rows(data, parts[force]) for force in forces}
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
        each = (_judged(problem, k, z, s.T @ (s * weight[:, None] ** 2)) for z, _, s in likely)
        parameters.append(max(each, key=rank))  # at the likely point that determines it least
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

    def at(z: np.ndarray) -> Normal:
        values, slopes = _at(problem, z)
        return Normal(values @ values, slopes.T @ slopes, slopes.T @ values)

    if moves.any():
        lower, upper = (np.where(moves, end, z) for end in (-_INSIDE, _INSIDE))
        z = on_host(at, z, lower=lower, upper=upper, max_steps=_STEPS).z
    return z, *_at(problem, z)


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
    if not limited(spec, low, high):
        return NOT
    size = value if _is_size(spec) else max(abs(value), (spec.upper - spec.lower) / 4)
    return WELL if half <= _WELL * size else ROUGHLY


def _judged(problem: FitProblem, k: int, z: np.ndarray, information: np.ndarray) -> ParameterGate:
    label, parameter = problem.layout.elements[k]
    spec = parameter.spec
    slope = float(np.exp(log_jacobian(z[k], spec)))
    value = float(constrain(z[k], spec))
    cov = inverse_of(information)
    std = slope * float(np.sqrt(cov[k, k]))
    return ParameterGate(label, spec.unit, value, std, _grade(spec, value, std), _is_size(spec))


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


def some_rows(data: TireData, parts: Sequence[np.ndarray]) -> TireData:
    """Data of at most ``ROWS`` rows of the parts, evenly taken in their order."""
    order = np.concatenate(parts)
    chosen = np.zeros(len(data), bool)
    chosen[order[np.linspace(0, len(order) - 1, min(len(order), ROWS)).astype(int)]] = True
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
            curve = Polynomial.fit(slip, share[rows], 2, domain=[slip[0] - 1e-9, slip[-1] + 1e-9])
            rest[rows] = (share[rows] - curve(slip)) * np.sqrt(len(rows) / (len(rows) - 3))
    known = np.flatnonzero(np.isfinite(rest))
    if len(known) < 12:
        return Scatter(_GUESSED_NOISE, 1.0)
    size = max(float(np.sqrt(np.mean(rest[known] ** 2))), _LEAST_NOISE)
    inflation = 1.0
    if "time" in data:
        runs = [known[data.run[known] == code] for code in np.unique(data.run[known])]
        order = [rows[np.argsort(data["time"][rows], kind="stable")] for rows in runs]
        inflation = autocorrelation_time([rest[rows] for rows in order])
    return Scatter(size, inflation)
