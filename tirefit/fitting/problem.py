"""From data, a model and a configuration to a well-posed fit."""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tirefit.data.table import TireData
from tirefit.fitting.config import FitConfig, NoiseConfig, ParameterConfig
from tirefit.fitting.layout import FreeParameter, Layout, Tie
from tirefit.fitting.likelihood import CHANNEL_SLIP, Channel, Rows, SlipNodes
from tirefit.fitting.slip_noise import latent_nodes, slip_density
from tirefit.models import MODELS, AbstractTire, TireInputs, needs_speed
from tirefit.params import Spec, parameter_values, specs, with_values
from tirefit.results import DataError, Problem, UsageError

__all__ = [
    "FitProblem",
    "build",
    "find_model",
    "guess_from_curve",
    "starting_points",
    "with_scale",
]


@dataclass(frozen=True)
class FitProblem:
    """A fit ready to solve: static layout and channels, arrays in ``rows``.

    ``guess`` holds a first value of every free parameter by name; ``slip_noise`` the
    standard deviation (n,) of each noisy slip, ``slip_density`` the distribution of
    its true values; ``time`` (n,) orders the rows; ``notes`` says what was assumed.
    """

    name: str
    model: AbstractTire
    layout: Layout
    channels: tuple[Channel, ...]
    rows: Rows
    n: int
    loss: str
    guess: Mapping[str, float]
    slip_noise: Mapping[str, np.ndarray] = field(default_factory=dict)
    slip_density: Mapping[str, tuple] = field(default_factory=dict)
    time: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    @property
    def slip_name(self) -> str:
        """The slip that drives the first fitted force."""
        return CHANNEL_SLIP[self.channels[0].name]

    def block_of(self, channel: Channel) -> str:
        """The block of residuals that a channel is in: its own, or that of its slip,
        once latent slips are laid out."""
        slip = CHANNEL_SLIP[channel.name]
        return slip if slip in self.rows.nodes else channel.name

    def block_channels(self, block: str) -> tuple[Channel, ...]:
        """The channels in one block."""
        return tuple(c for c in self.channels if self.block_of(c) == block)

    def used(self, array) -> np.ndarray:
        """An array over padded rows without its padding, shape (n,)."""
        return np.asarray(array)[: self.n]


def find_model(name: str) -> AbstractTire:
    """The registered model of this name.

    Raises:
        UsageError: no such model; names the closest ones.
    """
    if name in MODELS:
        return MODELS[name]
    close = difflib.get_close_matches(name, MODELS, 3)
    hint = f"did you mean {', '.join(close)}? " if close else ""
    raise UsageError(
        Problem(f"unknown model {name!r}", f"{hint}`tirefit models` lists them")
    )


def _chosen_forces(data: TireData, config: FitConfig) -> tuple[tuple[str, ...], list]:
    possible = [c for c, slip in CHANNEL_SLIP.items() if c in data and slip in data]
    if config.force is not None:
        wanted = [config.force] if isinstance(config.force, str) else config.force
        missing = [name for name in wanted if name not in possible]
        if missing:
            needs = [f"{name} and {CHANNEL_SLIP[name]}" for name in missing]
            raise DataError(
                Problem(
                    f"cannot fit {', '.join(missing)}: needs the columns "
                    + "; ".join(needs),
                    "name the columns under [data.columns] or fit another force",
                    data.source.path or data.name,
                )
            )
        return tuple(dict.fromkeys(wanted)), []
    varied = [c for c in possible if np.ptp(data.usable(CHANNEL_SLIP[c])) > 1e-9]
    if not varied:
        raise DataError(
            Problem(
                "no force with a slip that varies: a fit needs fx with sigma_x (or"
                " kappa, s), or fy with alpha",
                "see `tirefit inspect`",
                data.source.path or data.name,
            )
        )
    chosen = varied[0]
    rest = [name for name in varied if name != chosen]
    note = f"fitted force: {chosen} against {CHANNEL_SLIP[chosen]}"
    if rest:
        note += f"; {', '.join(rest)} left out (set `force` in fit.toml to fit it)"
    return (chosen,), [note]


def _bounds(name: str, spec: Spec, asked: ParameterConfig) -> Spec:
    lower = spec.lower if asked.lower is None else asked.lower
    upper = spec.upper if asked.upper is None else asked.upper
    if not (spec.lower <= lower < upper <= spec.upper):
        raise UsageError(
            Problem(
                f"parameters.{name}: bounds [{lower}, {upper}] are empty or outside"
                f" the model's [{spec.lower:.6g}, {spec.upper:.6g}]",
                "choose bounds inside those of `tirefit models`",
            )
        )
    value = spec.default if asked.value is None else asked.value
    if asked.value is not None and not lower <= value <= upper:
        raise UsageError(
            Problem(
                f"parameters.{name}: value {value} outside its bounds"
                f" [{lower:.6g}, {upper:.6g}]",
                "choose a value inside the bounds",
            )
        )
    return spec._replace(lower=lower, upper=upper)


def _make_layout(
    model: AbstractTire, config: FitConfig, runs: tuple[str, ...], forces
) -> tuple[AbstractTire, Layout]:
    known = specs(model)
    unknown = [name for name in config.parameters if name not in known]
    if unknown:
        raise UsageError(
            [
                Problem(
                    f"parameters.{name}: the model has no such parameter",
                    f"it has {', '.join(known)}",
                )
                for name in unknown
            ]
        )
    free, ties, fixed = [], [], {}
    for name, spec in known.items():
        asked = config.parameters.get(name, ParameterConfig())
        spec = _bounds(name, spec, asked)
        wanted = spec.free if asked.free is None else asked.free
        if name == "half_length" and asked.free is None:
            wanted = "mz" in forces
        if asked.prior is not None and not spec.lower < asked.prior.mean < spec.upper:
            raise UsageError(
                Problem(
                    f"parameters.{name}: prior mean {asked.prior.mean:g} outside the"
                    f" bounds [{spec.lower:.6g}, {spec.upper:.6g}]",
                    "choose a mean inside the bounds",
                )
            )
        if asked.tied is not None:
            ties.append(Tie(name, asked.tied, asked.factor))
        elif wanted:
            prior = asked.prior and (asked.prior.mean, asked.prior.std)
            per_run = asked.per_run and len(runs) > 1
            free.append(FreeParameter(name, spec, per_run, prior))
        else:
            fixed[name] = spec.default if asked.value is None else asked.value
    names = {parameter.name for parameter in free}
    for tie in ties:
        if tie.other not in names:
            raise UsageError(
                Problem(
                    f"parameters.{tie.name}: tied to {tie.other!r}, which is not free",
                    f"tie it to one of {', '.join(sorted(names)) or 'none: free one'}",
                )
            )
    if not free:
        raise UsageError(Problem("no free parameter", "free one in fit.toml"))
    return with_values(model, fixed), Layout(tuple(free), tuple(ties), runs)


def _force_scale(data: TireData, name: str, noise: NoiseConfig):
    """(scale (n_used,), estimated?, sentence) of one force."""
    fz = data.usable("fz") if "fz" in data else None
    if f"{name}_std" in data:
        scale = data.usable(f"{name}_std")
        return scale, False, f"noise of {name}: column {name}_std"
    absolute = getattr(noise, name, None)
    relative = getattr(noise, f"{name}_relative", None)
    if absolute is not None:
        return np.full(data.n, absolute), False, f"noise of {name}: {absolute:g} given"
    if relative is not None:
        return relative * fz, False, f"noise of {name}: {relative:g} fz given"
    observed = data.usable(name)
    size = 0.05 * float(np.sqrt(np.mean(observed**2))) or 1.0
    if noise.proportional_to_load:
        shape = fz / np.mean(fz)
        return size * shape, True, f"noise of {name}: estimated, proportional to load"
    return np.full(data.n, size), True, f"noise of {name}: estimated from the residuals"


def _slip_scale(data: TireData, slip: str, noise: NoiseConfig):
    given = getattr(noise, slip)
    if f"{slip}_std" in data:
        return data.usable(f"{slip}_std"), f"noise of {slip}: column {slip}_std"
    if given is not None:
        return np.full(data.n, given), f"noise of {slip}: {given:g} given"
    return None, f"noise of {slip}: none assumed"


def _check_slip_noise(data: TireData, slip: str, std: np.ndarray) -> None:
    """Measured slips vary by at least their noise; if not, it places no row."""
    noise, spread = float(np.median(std)), float(np.std(data.usable(slip)))
    if noise > 0.7 * spread:
        raise DataError(
            Problem(
                f"the noise of {slip} ({noise:.3g}) is as large as the spread of the"
                f" measured slips (standard deviation {spread:.3g}): they say nothing"
                " about where on the curve a row lies",
                "check the unit of the noise",
                data.source.path or data.name,
                column=f"{slip}_std",
            )
        )


def _padded_size(n: int) -> int:
    """The next of 2^k and 1.5 * 2^k: few shapes to compile, at most 50 % padding."""
    power = 2 ** int(np.floor(np.log2(max(n, 8))))
    return next(size for size in (power, power * 3 // 2, power * 2) if size >= n)


def _pad(array, size: int):
    array = np.asarray(array)
    return np.concatenate([array, np.repeat(array[:1], size - len(array))])


def _inputs(data: TireData, size: int) -> TireInputs:
    def column(name):
        values = data.usable(name) if name in data else np.zeros(data.n)
        return _pad(np.nan_to_num(values), size)

    return TireInputs(*(column(name) for name in TireInputs._fields))


def _first_guess(model, data: TireData, forces, layout: Layout) -> dict[str, float]:
    """Slope of the low-slip half and the largest force, in terms of the parameters."""
    name = "fx" if "fx" in forces else ("fy" if "fy" in forces else None)
    guess = {p.name: float(parameter_values(model)[p.name]) for p in layout.free}
    if name is None:
        return guess
    slip, force = data.usable(CHANNEL_SLIP[name]), data.usable(name)
    fz = data.usable("fz")
    size = np.abs(slip)
    low = size <= max(np.quantile(size, 0.3), 0.15 * size.max())
    stiffness = float(slip[low] @ force[low] / max(slip[low] @ slip[low], 1e-12))
    peak = float(np.quantile(np.abs(force) / fz, 0.97))
    load = float(np.median(fz))
    stiffness = max(1.2 * stiffness, peak * load / max(size.max(), 1e-6))
    peak = min(max(1.03 * peak, 0.02), 4.0)
    found = guess_from_curve(stiffness, peak, load)
    return {name: found.get(name, value) for name, value in guess.items()}


def guess_from_curve(stiffness, peak, load) -> dict:
    """First values of the parameters that a look at the curve gives.

    Args:
        stiffness: slope of the force at small slip [N].
        peak: largest force over load [-].
        load: typical load [N].
    """
    return {
        "cpa2": stiffness / 2,
        "mu": peak,
        "mu_peak": peak,
        "mu_c": 0.6 * peak,
        "D": peak,
        "B": stiffness / (1.5 * peak * load),
    }


def _check_size(data: TireData, layout: Layout, channels, n_values: int) -> None:
    unknowns = layout.size + sum(c.noise_estimated for c in channels)
    if n_values <= unknowns:
        raise DataError(
            Problem(
                f"{n_values} measured values for {unknowns} unknowns"
                f" ({', '.join(layout.labels)}"
                + (" and the noise level)" if unknowns > layout.size else ")"),
                "measure more points, or fix parameters in fit.toml",
                data.source.path or data.name,
            )
        )


def _limited(data: TireData, config: FitConfig, slip: str) -> TireData:
    low, high = config.data.slip_min, config.data.slip_max
    if low is None and high is None:
        return data
    values = data[slip]
    inside = (values >= (-np.inf if low is None else low)) & (
        values <= (np.inf if high is None else high)
    )
    return data.where(inside)


def build(data: TireData, name: str, config: FitConfig) -> FitProblem:
    """Choose forces, noise, free parameters and a first guess.

    Raises:
        UsageError: unknown model or parameter, impossible bounds or ties.
        DataError: columns the model needs are missing, or too few rows.
    """
    template = find_model(name)
    forces, notes = _chosen_forces(data, config)
    data = _limited(data, config, CHANNEL_SLIP[forces[0]])
    _require(data, name, template, forces)
    model, layout = _make_layout(template, config, data.runs, forces)
    size = _padded_size(data.n)
    observed, scale, channels = {}, {}, []
    for force in forces:
        values, estimated, note = _force_scale(data, force, config.noise)
        observed[force] = _pad(data.usable(force), size)
        scale[force] = _pad(values, size)
        channels.append(Channel(force, estimated))
        notes.append(note)
    _check_size(data, layout, channels, data.n * len(forces))
    slip_noise, densities = {}, {}
    for slip in dict.fromkeys(CHANNEL_SLIP[force] for force in forces):
        std, note = _slip_scale(data, slip, config.noise)
        notes.append(note)
        if std is not None:
            _check_slip_noise(data, slip, std)
            slip_noise[slip] = std
            densities[slip] = slip_density(data.usable(slip), std)
    rows = Rows(
        _inputs(data, size),
        _pad(data.run[data.used], size).astype(int),
        (np.arange(size) < data.n).astype(float),
        observed,
        scale,
        {},
    )
    time = data.usable("time") if "time" in data else None
    guess = _first_guess(model, data, forces, layout)
    guess |= {k: v.value for k, v in config.parameters.items() if v.value is not None}
    return FitProblem(
        name, model, layout, tuple(channels), rows, data.n, config.noise.loss,
        guess, slip_noise, densities, time, tuple(notes),
    )  # fmt: skip


def _require(data: TireData, name: str, model, forces) -> None:
    problems = []
    file = data.source.path or data.name
    if "mz" in forces and name == "magic-formula":
        raise UsageError(
            Problem("magic-formula has no aligning moment", "fit fy, or a brush model")
        )
    if needs_speed(model) and "v" not in data:
        problems.append(
            Problem(
                f"{name} needs the speed of every row (column v, m/s): its friction"
                " depends on sliding speed",
                "name the column, or give --constant v=20 for a constant speed",
                file,
            )
        )
    if data.n == 0:
        problems.append(Problem("no usable row", "see `tirefit inspect`", file))
    if problems:
        raise DataError(problems)


def with_scale(problem: FitProblem, scale: Mapping[str, float], slope) -> FitProblem:
    """The same problem with force scales multiplied and latent slips laid out for them.

    Args:
        scale: factor by channel.
        slope: largest slope of force over slip [N], sets the number of nodes.
    """
    scales = {k: v * scale.get(k, 1.0) for k, v in problem.rows.scale.items()}
    nodes = {}
    for slip, std in problem.slip_noise.items():
        forces = [c.name for c in problem.channels if CHANNEL_SLIP[c.name] == slip]
        force_std = min(float(np.median(problem.used(scales[k]))) for k in forces)
        steep = _bucket(slope * float(np.max(std)) / force_std)
        values = problem.used(getattr(problem.rows.inputs, slip))
        density = problem.slip_density[slip]
        slips, log_weight = latent_nodes(values, std, density, steep)
        size = len(problem.rows.weight)
        repeat = size - problem.n
        slips = np.concatenate([slips, np.repeat(slips[:1], repeat, 0)])
        log_weight = np.concatenate([log_weight, np.repeat(log_weight[:1], repeat, 0)])
        nodes[slip] = SlipNodes(slips, log_weight)
    return replace(problem, rows=problem.rows._replace(scale=scales, nodes=nodes))


def _bucket(steepness: float) -> float:
    """Round up to a power of sqrt(2), so that few shapes are compiled."""
    return float(2 ** (np.ceil(2 * np.log2(max(steepness, 1.0))) / 2))


def starting_points(problem: FitProblem, count: int, seed: int):
    """First guess and scattered starts around it, shape (count, size)."""
    first = problem.layout.unconstrained(problem.guess)
    generator = np.random.default_rng(seed)
    scatter = generator.normal(size=(count - 1, problem.layout.size))
    # The stiffness guess is good; on its log scale over 11 decades a step of 1 in z
    # would be a factor of 500.
    widths = np.array(
        [0.1 if p.spec.scale == "log" else 1.0 for _, p in problem.layout.elements]
    )
    return np.concatenate([first[None], first + scatter * widths])
