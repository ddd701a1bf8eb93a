"""The parameters that a fit estimates, and their map from an unconstrained vector z.

A parameter is free (shared by all runs, or one per run), fixed at a value, or tied to a free
one. The solver and the samplers see one unconstrained vector z; ``natural`` turns it into named
values within their bounds.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.arrays import Numbers, Same, Scalar
from tirefit.fitting.problem.config import FitConfig, ParameterConfig
from tirefit.models import AbstractTire
from tirefit.params import Spec, Values, constrain, log_jacobian, specs, unconstrain, with_values
from tirefit.results import InputProblem, UsageError, did_you_mean


@dataclass(frozen=True)
class FreeParameter:
    """A parameter to estimate: one value, or one per run where ``per_run``."""

    name: str
    spec: Spec
    per_run: bool = False
    prior: tuple[float, float] | None = None
    """Mean and standard deviation of a Gaussian prior; None is flat in the bounds."""


@dataclass(frozen=True)
class Tie:
    """``name = factor * other``."""

    name: str
    other: str
    factor: float = 1.0


@dataclass(frozen=True)
class Layout:
    """The free parameters in order, the runs of the data, and the ties."""

    free: tuple[FreeParameter, ...]
    runs: tuple[str, ...] = field(default=("run",), compare=False, repr=False)
    """Not compared: otherwise the names of the runs would force a new compilation."""
    ties: tuple[Tie, ...] = ()

    @property
    def labels(self) -> tuple[str, ...]:
        """One label per element of z: ``mu``, or ``mu[run]`` where it is per run."""
        return tuple(label for label, _ in self.elements)

    @property
    def elements(self) -> tuple[tuple[str, FreeParameter], ...]:
        """(label, parameter) of every element of z, in order."""
        elements = []
        for parameter in self.free:
            if parameter.per_run:
                elements += [(f"{parameter.name}[{run}]", parameter) for run in self.runs]
            else:
                elements.append((parameter.name, parameter))
        return tuple(elements)

    @property
    def size(self) -> int:
        """Length of z."""
        return len(self.elements)

    @property
    def is_sparse(self) -> bool:
        """Whether a row depends only on some elements of z, those of its run."""
        return any(parameter.per_run for parameter in self.free)

    def elements_of(self, run: Same) -> Same:
        """Indices (n, q) of each row's elements of z, one per free parameter."""
        count: list[int] = [len(self.runs) if p.per_run else 1 for p in self.free]
        first = np.cumsum([0, *count[:-1]])
        is_per_run = np.array([p.per_run for p in self.free])
        return run[:, None] * is_per_run[None] + first[None]

    @property
    def prior_elements(self) -> np.ndarray:
        """Indices, as :meth:`elements_of`, of each of :meth:`prior_residual`."""
        count = [len(self.runs) if p.per_run else 1 for p in self.free]
        run = np.concatenate([np.arange(n) for n in count])
        return self.elements_of(run[[p.prior is not None for _, p in self.elements]])

    def natural(self, z: Values) -> dict[str, Numbers]:
        """Named values: shape () where shared, (runs,) where per run; ties resolved."""
        values: dict[str, Numbers] = {}
        start = 0
        for parameter in self.free:
            count = len(self.runs) if parameter.per_run else 1
            part = constrain(z[start : start + count], parameter.spec)
            values[parameter.name] = part if parameter.per_run else part[0]
            start += count
        for tie in self.ties:
            values[tie.name] = tie.factor * values[tie.other]
        return values

    def vector(self, z: Same) -> Same:
        """Natural value of every element of z, shape (size,)."""
        library = jnp if isinstance(z, jax.Array) else np
        values = [constrain(z[i], p.spec) for i, (_, p) in enumerate(self.elements)]
        return library.stack(values)

    def unconstrained(self, values: Mapping[str, Numbers]) -> Values:
        """z of the given natural values, by parameter name or by label."""
        coordinates = [
            unconstrain(values[label if label in values else p.name], p.spec)
            for label, p in self.elements
        ]
        traced = any(isinstance(value, jax.Array) for value in coordinates)
        return jnp.stack(coordinates) if traced else np.array(coordinates, float)

    def log_volume(self, z: Float[Values, " p"]) -> Scalar:
        """log |d natural / d z|: the prior flat in the bounds, in coordinates z."""
        return sum(log_jacobian(z[i], p.spec) for i, (_, p) in enumerate(self.elements))

    def prior_residual(self, z: Float[Values, " p"]) -> Float[Array, " k"]:
        """Gaussian priors as pseudo-measurements, shape (number of priors,)."""
        pulls = [
            (constrain(z[i], p.spec) - p.prior[0]) / p.prior[1]
            for i, (_, p) in enumerate(self.elements)
            if p.prior is not None
        ]
        return jnp.stack(pulls) if pulls else jnp.zeros(0)


def choose_layout(
    model: AbstractTire, config: FitConfig, runs: tuple[str, ...], forces: Sequence[str]
) -> tuple[AbstractTire, Layout, list[str]]:
    """Choose the parameters that a fit estimates, and their bounds.

    The bounds of a tied parameter narrow those of the other one.

    Args:
        model: template of the fit.
        config: settings of the fit.
        runs: names of the runs of the data.
        forces: fitted forces; only ``mz`` lets the half-length be estimated.

    Returns:
        The model that holds the fixed values, the layout, and what was narrowed.

    Raises:
        UsageError: unknown names, impossible bounds, values, priors, ties.
    """
    known, unknowns, fixed = specs(model), [], {}
    problems = [
        InputProblem(
            f"parameters.{name}: the model has no such parameter", f"it has {', '.join(known)}"
        )
        for name in config.parameters
        if name not in known
    ]
    settings = {name: config.parameters.get(name, ParameterConfig()) for name in known}
    bounded, free, ties = {}, [], []
    for name, asked in settings.items():
        chosen = "mz" in forces if name == "half_length" else known[name].free
        if asked.tied is not None:
            ties.append(Tie(name, asked.tied, asked.factor))
            chosen = False
        free += [name] * (chosen if asked.free is None else asked.free)
        bounded[name], wrong = _bounded(name, known[name], asked)
        problems += wrong
    notes = _narrow(ties, bounded, free, problems)
    for name, asked in settings.items():
        problems += _misplaced(name, bounded[name], asked, name in free)
        if name in free:
            prior = None if asked.prior is None else (asked.prior.mean, asked.prior.std)
            per_run = asked.per_run and len(runs) > 1
            unknowns.append(FreeParameter(name, bounded[name], per_run, prior))
        elif asked.tied is None:
            fixed[name] = known[name].default if asked.value is None else asked.value
    if not unknowns:
        problems.append(InputProblem("no free parameter", "free one under [parameters]"))
    if problems:
        raise UsageError([replace(p, file=config.source) for p in problems])
    return with_values(model, fixed), Layout(tuple(unknowns), runs, tuple(ties)), notes


def _narrow(
    ties: Sequence[Tie], bounded: dict[str, Spec], free: Sequence[str], problems: list[InputProblem]
) -> list[str]:
    """Narrow the bounds of parameters to which others are tied to the bounds of those; adds
    impossible ties to the problems and returns what was narrowed."""
    notes = []
    for name, of, factor in ((tie.name, tie.other, tie.factor) for tie in ties):
        if of not in free:
            reason = f"parameters.{name}: tied to {of!r}, which is not free"
            remedy = f"tie it to one of {', '.join(free)}" if free else "free a parameter"
            if of not in bounded:
                reason = f"parameters.{name}: tied to {of!r}: the model has no such parameter"
                remedy = f"{did_you_mean(of, bounded)}it has {', '.join(bounded)}"
            problems.append(InputProblem(reason, remedy))
            continue
        tied, other = bounded[name], bounded[of]
        low, high = sorted((tied.lower / factor, tied.upper / factor))
        narrow = other._replace(lower=max(other.lower, low), upper=min(other.upper, high))
        if narrow.lower >= narrow.upper:
            reason = f"parameters.{name}: tied = {of!r} with factor = {factor:g} is outside its"
            reason += f" bounds {_interval(tied)} for every {of} in {_interval(other)}"
            remedy = f"change the factor, or the bounds of {of}"
            problems.append(InputProblem(reason, remedy))
        elif narrow != other:
            bounded[of] = narrow
            text = f"{of} held to {_interval(narrow)}, so that {name} = {factor:g} {of} stays"
            notes.append(f"{text} within {_interval(tied)}")
    return notes


def _interval(spec: Spec) -> str:
    return f"[{spec.lower:.6g}, {spec.upper:.6g}]"


def _bounded(name: str, spec: Spec, asked: ParameterConfig) -> tuple[Spec, list[InputProblem]]:
    """The spec with the bounds of the configuration, and the problems of these bounds."""
    lower = spec.lower if asked.lower is None else asked.lower
    upper = spec.upper if asked.upper is None else asked.upper
    if spec.lower <= lower < upper <= spec.upper:
        return spec._replace(lower=lower, upper=upper), []
    reason = (
        f"parameters.{name}: bounds [{lower:.6g}, {upper:.6g}] are empty or outside the"
        f" model's {_interval(spec)}"
    )
    remedy = "choose lower and upper inside those of `tirefit models`"
    return spec, [InputProblem(reason, remedy)]


def _misplaced(name: str, spec: Spec, asked: ParameterConfig, free: bool) -> Iterator[InputProblem]:
    """Problems: values and priors outside the bounds, keys that a fixed parameter ignores."""
    key, prior = f"parameters.{name}", asked.prior
    if asked.value is not None and not spec.lower <= asked.value <= spec.upper:
        reason = f"value {asked.value:g} outside its bounds {_interval(spec)}"
        yield InputProblem(f"{key}: {reason}", "choose a value inside the bounds")
    if prior is not None and not spec.lower < prior.mean < spec.upper:
        reason = f"prior mean {prior.mean:g} outside its bounds {_interval(spec)}"
        yield InputProblem(f"{key}: {reason}", "choose a mean inside the bounds")
    if prior is not None:
        width = prior.mean if spec.scale == "log" else spec.upper - spec.lower
        if prior.std < 1e-9 * abs(width):
            reason = f"prior std {prior.std:g} leaves it no room in {_interval(spec)}"
            remedy = f"hold it by value = {prior.mean:g} and free = false"
            yield InputProblem(f"{key}: {reason}", remedy)
    if free or asked.free is False or asked.tied is not None:
        return
    idle = [k for k in ("lower", "upper", "prior") if getattr(asked, k) is not None]
    idle += ["per_run"] if asked.per_run else []
    remedy = "fit mz too" if name == "half_length" else f"set {key}.free = true"
    for setting in idle:
        reason = f"{setting} has no effect: this fit does not estimate {name}"
        yield InputProblem(f"{key}: {reason}", f"{remedy}, or leave {setting} out")
