"""The base model fitted with its noise judged: where every diagnosis starts."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tirefit.diagnosis.basis import Generic, generic, smooth_basis, wave_basis
from tirefit.diagnosis.effects import Atom
from tirefit.diagnosis.forward import (
    MOST_EFFECTS,
    Design,
    Linear,
    Present,
    Refit,
    brush_of_base,
    fill,
    moments,
    refit_all,
    tangents,
)
from tirefit.diagnosis.noise import NoiseLevel, judge_noise
from tirefit.diagnosis.rows import Prepared, neighbours
from tirefit.diagnosis.state import Covariates
from tirefit.fitting.config import parse_config
from tirefit.fitting.inference import best_of, solve_starts
from tirefit.fitting.problem import build
from tirefit.fitting.slip_noise import slip_distribution
from tirefit.fitting.solve import starting_points

__all__ = ["Base", "at_measured_slip", "fit_base", "on_rows", "with_noise_judged"]

_NODES = {count: np.polynomial.hermite_e.hermegauss(count) for count in (3, 5)}


@dataclass(frozen=True)
class Base:
    """The base fit: model, layout and z; the design of every refit; the noise.

    ``residual`` (m,), ``jacobian`` (m, p) and ``tangent`` (m, K) are whitened, over
    the used rows of all channels; ``generic`` likewise.
    """

    prepared: Prepared
    atoms: tuple[Atom, ...]
    model: object
    layout: object
    z: np.ndarray
    refit: Refit
    design: Design
    noise: dict[str, NoiseLevel]
    slip_noise: float
    slip_fraction: np.ndarray
    generic: Generic | None

    def cut(self, stacked) -> np.ndarray:
        """Used rows of whitened values (channels x padded, ...)."""
        stacked = np.asarray(stacked)
        channels = len(self.prepared.channels)
        parts = stacked.reshape(channels, -1, *stacked.shape[1:])
        return parts[:, : self.prepared.n].reshape(-1, *stacked.shape[1:])

    @property
    def arguments(self) -> tuple:
        return self.model, self.layout, self.atoms, self.prepared.mode

    @cached_property
    def finite(self) -> tuple[int, ...]:
        """Atoms whose effect is linearised over a finite amplitude."""
        return tuple(k for k, atom in enumerate(self.atoms) if atom.effect.far)

    @cached_property
    def at_null(self):
        """:meth:`linearised` at the base fit."""
        return self.linearised(self.z, np.zeros(len(self.atoms)))

    def linearised(self, z, amplitudes) -> Linear:
        """The used rows, linearised in everything."""
        present = present_in(amplitudes)
        found = tangents(*self.arguments, z, present, self.design, self.finite)
        return Linear(*(self.cut(part) for part in found))

    def residual(self, z, amplitudes) -> np.ndarray:
        """Whitened residual of the used rows, zero for outliers: (m,)."""
        keep = self.design.keep[: self.prepared.n]
        parts = [
            keep * (self.prepared.observed[c] - force)
            / self.design.scale[c][: self.prepared.n]
            for c, force in self.forces(z, amplitudes).items()
        ]  # fmt: skip
        return np.concatenate(parts)

    def forces(self, z, amplitudes) -> dict[str, np.ndarray]:
        """Mean force of every used row, by channel."""
        mean, _ = moments(*self.arguments, z, present_in(amplitudes), self.design)
        return {c: np.asarray(v)[: self.prepared.n] for c, v in mean.items()}


def present_in(amplitudes) -> Present:
    """The atoms that amplitudes of all (K,) have, at most :data:`MOST_EFFECTS`."""
    chosen = np.flatnonzero(amplitudes)
    index, values = np.full(MOST_EFFECTS, len(amplitudes)), np.zeros(MOST_EFFECTS)
    index[: len(chosen)], values[: len(chosen)] = chosen, np.asarray(amplitudes)[chosen]
    return Present(index, values)


def _first_fit(prepared: Prepared, name: str):
    """(model, layout, z) by least squares with estimated noise, slip as measured."""
    data = prepared.data
    force = list(prepared.channels)
    config = parse_config({"force": force, "noise": {"loss": "huber"}, "starts": 4})
    task = build(data, name, config)
    problem = task.problem
    if prepared.mode != "xy":
        # The base model does not know of the other slip: that is an effect.
        quiet = "alpha" if prepared.mode == "x" else "sigma_x"
        inputs = problem.rows.inputs
        silent = np.zeros_like(np.asarray(inputs.fz))
        problem = problem.with_rows(inputs=inputs._replace(**{quiet: silent}))
    starts = starting_points(task, config.starts, 0)
    solution = solve_starts(problem, starts, "gauss-newton")
    return problem.model, problem.layout, np.asarray(solution.z)[best_of(solution)]


def _pad(array, size: int):
    array = np.asarray(array, float)
    return np.concatenate([array, np.repeat(array[:1], size - len(array), axis=0)])


def _padded(n: int) -> int:
    return max(256, 2 ** int(np.ceil(np.log2(n))))


def _nodes(slip, std):
    """Latent slips and their probabilities under the file's own slip density."""
    if not np.any(std > 0):
        return slip[:, None], np.ones((len(slip), 1))
    # Enough nodes for the curvature of the force within the slip noise.
    steep = float(np.median(std)) / max(float(np.quantile(np.abs(slip), 0.9)), 1e-9)
    offset, mass = _NODES[3 if steep < 0.01 else 5]
    mean, spread = slip_distribution(slip, np.maximum(std, 1e-9)).moments(slip, std)
    nodes = mean[:, None] + spread[:, None] * offset
    return nodes, np.tile(mass / mass.sum(), (len(slip), 1))


def _priors(prepared: Prepared, atoms, rig) -> tuple[np.ndarray, np.ndarray]:
    priors = []
    for atom in atoms:
        prior, adapt = atom.prior, atom.effect.prior
        priors.append(prior if adapt is None else adapt(prior, prepared, rig))
    scale = np.array([prior.scale for prior in priors])
    return scale, np.array([prior.center for prior in priors]) / scale


def fit_base(prepared: Prepared, name: str, atoms, rig) -> Base:
    """Fit the base model, judge the noise, and fit again under it."""
    model, layout, z = _first_fit(prepared, name)
    design = _design(prepared, atoms, rig)
    fraction = _slip_fraction(prepared, model, layout, z, design)
    base = Base(
        prepared, atoms, model, layout, z, None, design, {},
        float(np.median(prepared.slip_std)), fraction, None,
    )  # fmt: skip
    silent = np.zeros(len(atoms))
    base = with_noise_judged(base, rig, z, silent, outliers=False)
    return replace(base, design=_with_force(base, silent))


def with_noise_judged(base: Base, rig, z, amplitudes, outliers: bool = True) -> Base:
    """The base refitted under the noise that the remainder of a fit shows.

    Args:
        z, amplitudes: the fit whose remainder is judged, smooth parts taken out.
        outliers: whether rows far off are set aside; only a fit without a gross gap
            can tell them.
    """
    noise = _noise(base, rig, z, amplitudes, outliers)
    base = replace(base, noise=noise, design=_with_noise(base, noise))
    refit = refit_all(
        *base.arguments, *fill([(base.z, np.zeros(0))], [()], len(base.atoms)),
        base.design,
    )  # fmt: skip
    base = replace(base, z=np.asarray(refit.z)[0], refit=refit)
    return replace(base, generic=_whitened_generic(base))


def at_measured_slip(base: Base) -> Base:
    """The same fit at the slips as they were measured, not as they are believed."""
    nodes = base.design.slip.shape[1]
    slips = np.repeat(base.prepared.slip[:, None], nodes, axis=1)
    slips = _pad(slips, len(base.design.keep))
    return replace(base, design=base.design._replace(slip=slips))


def on_rows(base: Base, prepared: Prepared, rig) -> Base:
    """The same fit looked at on other rows: forces only, its noise does not carry."""
    design = _design(prepared, base.atoms, rig)
    other = replace(base, prepared=prepared, design=design)
    return replace(other, design=_with_force(other, np.zeros(len(base.atoms))))


def _design(prepared: Prepared, atoms, rig) -> Design:
    size = _padded(prepared.n)
    slips, weight = _nodes(prepared.slip, prepared.slip_std)
    scale, center = _priors(prepared, atoms, rig)
    fz, v = prepared.inputs.fz, prepared.inputs.v
    keep = (np.arange(size) < prepared.n).astype(float)
    return Design(
        type(prepared.inputs)(*(_pad(part, size) for part in prepared.inputs)),
        _pad(slips, size), _pad(weight, size), _pad(prepared.second, size),
        {c: _pad(x, size) for c, x in prepared.observed.items()},
        {c: np.full(size, 0.05 * np.std(x)) for c, x in prepared.observed.items()},
        keep, Covariates(*(_pad(x, size) for x in prepared.covariates)),
        scale, center, np.array([np.median(fz), np.median(v)]),
    )  # fmt: skip


def _slip_fraction(prepared: Prepared, model, layout, z, design):
    """Slip over that of full sliding (n,), 3 mu F_z / (2 c) of the brush with the
    base's slope and peak."""
    stiffness, mu = brush_of_base(model, layout, prepared.mode, z, design)
    stiffness = np.asarray(stiffness)[: prepared.n]
    full = 1.5 * float(mu) * prepared.inputs.fz / np.maximum(stiffness, 1e-9)
    size = np.hypot(prepared.slip, prepared.second)
    side = np.where(prepared.slip < 0, -1.0, 1.0)
    return side * size / full


def _noise(base: Base, rig, z, amplitudes, outliers) -> dict[str, NoiseLevel]:
    prepared = base.prepared
    mean, spread = moments(*base.arguments, z, present_in(amplitudes), base.design)
    fz = prepared.inputs.fz
    typical = fz / np.mean(fz)
    basis = smooth_basis(prepared, base.slip_fraction, typical, prepared.n // 6)
    waves, groups, found = wave_basis(prepared, typical), neighbours(prepared), {}
    for channel in prepared.channels:
        residual = prepared.observed[channel] - np.asarray(mean[channel])[: prepared.n]
        std = f"{channel}_std"
        given = (
            prepared.column(std)
            if std in prepared.data
            else rig.force_noise(channel, fz)
        )
        found[channel] = judge_noise(
            residual, np.asarray(spread[channel])[: prepared.n], fz, given, basis,
            waves, groups, prepared.time, prepared.run, outliers,
        )  # fmt: skip
    return found


def _with_noise(base: Base, noise) -> Design:
    size = len(base.design.keep)
    inflation = max(level.inflation for level in noise.values())
    scale = {
        c: _pad(level.std * np.sqrt(inflation), size) for c, level in noise.items()
    }
    keep = (np.arange(size) < base.prepared.n).astype(float)
    outlier = np.any([level.outlier for level in noise.values()], axis=0)
    keep[: base.prepared.n] = ~outlier
    return base.design._replace(scale=scale, keep=keep)


def _with_force(base: Base, silent) -> Design:
    """The base model's force over its peak, for the effects that follow it."""
    channel = base.prepared.channels[0]
    mean = base.forces(base.z, silent)[channel]
    size = len(base.design.keep)
    peak = np.max(np.abs(mean) / base.prepared.inputs.fz)
    share = _pad(mean / (peak * base.prepared.inputs.fz), size)
    pull = _pull(base, silent)[channel]
    rows = base.design.rows._replace(
        force=share, usage=np.abs(share), pull=_pad(pull, size),
        traction=_pad(mean / np.mean(base.prepared.inputs.fz), size),
    )  # fmt: skip
    return base.design._replace(rows=rows)


def _pull(base: Base, silent) -> dict[str, np.ndarray]:
    """Forces of the base model at the past of every row: (n, k) by channel."""
    past, design = base.prepared.covariates.past, base.design
    if "sweeps" not in base.prepared.has:
        return {c: np.zeros_like(past) for c in base.prepared.channels}
    alone, size = np.zeros_like(design.weight), len(design.keep)
    alone[:, 0] = 1.0
    columns = []
    for k in range(past.shape[1]):
        slip = np.repeat(_pad(past[:, [k]], size), alone.shape[1], axis=1)
        there = [_pad(part[:, k], size) for part in base.prepared.before]
        there = type(design.inputs)(*there)
        then = design._replace(slip=slip, weight=alone, inputs=there)
        columns.append(replace(base, design=then).forces(base.z, silent))
    return {c: np.stack([one[c] for one in columns], axis=1) for c in columns[0]}


def _whitened_generic(base: Base) -> Generic:
    """Generic functions for each channel by itself, whitened: (m, b)."""
    n, channels = base.prepared.n, base.prepared.channels
    keep, found = base.design.keep[:n, None], []
    for channel in channels:
        typical = base.prepared.inputs.fz / np.asarray(base.design.scale[channel])[:n]
        found.append(generic(base.prepared, base.slip_fraction, typical))

    def stacked(parts):
        blocks = [
            np.concatenate([
                part * keep if row == k else np.zeros((n, part.shape[1]))
                for row in range(len(channels))
            ])
            for k, part in enumerate(parts)
        ]  # fmt: skip
        basis = np.concatenate(blocks, axis=1)
        return basis / np.maximum(np.linalg.norm(basis, axis=0), 1e-12)

    return Generic(*(stacked(parts) for parts in zip(*found, strict=True)))
