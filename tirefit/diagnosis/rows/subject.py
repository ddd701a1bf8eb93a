"""Fit the base model and estimate its noise, as the start of a diagnosis."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from tirefit.diagnosis.effects import Atom, atoms_of
from tirefit.diagnosis.effects.record import Effect
from tirefit.diagnosis.engine import FLAT
from tirefit.diagnosis.engine.discrepancy import Discrepancy
from tirefit.diagnosis.engine.fit import Fit, Folds, Key, Priors, Start, fitted
from tirefit.diagnosis.rows import fits, noise
from tirefit.diagnosis.rows.discrepancy import PLACE, discrepancy_of, smooth_basis, wave_basis
from tirefit.diagnosis.rows.forces import Design, Linear, Tire, with_force
from tirefit.diagnosis.rows.noise import NoiseLevel
from tirefit.diagnosis.rows.prepared import (
    NOT_STATED,
    SCATTER,
    Prepared,
    neighbours,
    on_scale_of,
    order_of,
    slip_of,
)
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.runs import folds_of, with_runs
from tirefit.diagnosis.rows.simulator import STAND_INS, GivenSimulator, Simulated, check_signs
from tirefit.diagnosis.rows.slips import AHEAD, slip_doubt, slip_proxies
from tirefit.padding import pad_rows

_SMALL = 1e-3
"""Step of the slip, in standard deviations of its noise, for the slope of a force."""


@dataclass(frozen=True, kw_only=True)
class Base:
    """The subject "rows": a tire fitted to rows without effects, with the estimated noise, by
    channel. Parameters z, the first ``guess`` of them, and the slip over that of full sliding
    (n,). With a ``simulator``, the fit adapts its parameters to the data. Whitened values are
    over the used rows of all channels, (m, ...). ``linear`` caches the last linearised fits,
    by (z, amplitudes).
    """

    rows: Prepared
    tire: Tire
    design: Design
    z: np.ndarray
    guess: np.ndarray
    slip_fraction: np.ndarray
    simulator: Simulated | None = None
    noise: Mapping[str, NoiseLevel] = field(default_factory=dict)
    testable: tuple[int, ...] = ()
    linear: dict[tuple[bytes, ...], Linear] = field(default_factory=dict, init=False)

    @property
    def as_given(self) -> np.ndarray:
        """Parameters z that define the gap: those of the simulator, else of the fit."""
        return self.z if self.simulator is None else self.simulator.z

    @cached_property
    def atoms(self) -> tuple[Atom, ...]:
        return atoms_of(self.tire.effects)

    @cached_property
    def slip_uncertainty(self) -> np.ndarray:
        """Error of the residual that rows share through the unknown true slips: columns (m, k),
        each times an independent unit normal number."""
        rows, past = self.rows, self.rows.past
        path = None if past is None else past[:, AHEAD]  # the slips by their neighbours in time
        slip = (rows.slip_law, rows.slip, rows.slip_std)
        off = [slip_doubt(*slip, path), slip_proxies(*slip, rows.moving, path, past)]
        steep = np.asarray(self.at_null.fields)[:, PLACE["shift"]]
        return steep[:, None] * np.tile(np.hstack(off), (len(rows.channels), 1))

    @cached_property
    def _uncertain_directions(self) -> tuple[np.ndarray, np.ndarray]:
        """Orthonormal directions (m, k) of the slip uncertainty, and the share (k,) of
        the residual along each that is removed."""
        along, size, _ = np.linalg.svd(self.slip_uncertainty, full_matrices=False)
        return along, 1 - 1 / np.sqrt(1 + size**2)

    def whitened_for_slip(self, values: np.ndarray) -> np.ndarray:
        """Whitened values (m, ...), also whitened for the slip uncertainty."""
        along, unknown = self._uncertain_directions
        return values - (along * unknown) @ (along.T @ values)

    @cached_property
    def at_null(self) -> Linear:
        """:meth:`linearised` at the base fit."""
        return self.linearised(self.z, self.amplitudes())

    @cached_property
    def measured(self) -> "Base":
        """The same fit at the measured slips."""
        return self.on(fits.measured_slips(self.design, self.rows))

    def on(self, design: Design, rows: Prepared | None = None) -> "Base":
        """The same fit on another design, of other rows if given."""
        return replace(self, design=design, rows=rows or self.rows)

    def linearised(self, z: np.ndarray, amplitudes: np.ndarray) -> Linear:
        """The used rows, linearised in everything."""
        key = np.asarray(z).tobytes(), amplitudes.tobytes()
        if key not in self.linear:
            if len(self.linear) == 24:  # of 10 MB each at most
                self.linear.pop(next(iter(self.linear)))
            given = z, amplitudes, self.design, self.rows.n
            self.linear[key] = self.tire.linearised(*given)
        return self.linear[key]

    # --- what the engine asks of its subject, see engine.fit.Forward -----------------

    @property
    def priors(self) -> Priors:
        """Of the amplitudes of all atoms."""
        return self.design.priors

    @property
    def start(self) -> Start:
        """Of the refit without effects."""
        return Start(self.z, np.zeros(0))

    @property
    def floor(self) -> float:
        """Mean square of the noise of the first channel."""
        return float(np.mean(self.noise[self.rows.channels[0]].std ** 2))

    @property
    def inflation(self) -> float:
        """Rows per independent row."""
        return max(level.inflation for level in self.noise.values())

    @cached_property
    def unit(self) -> np.ndarray:
        """(m,) noise of the first channel [N], zero for other channels and excluded rows."""
        n, scale = self.rows.n, self.design.scale[self.rows.channels[0]]
        channel_noise = np.asarray(scale)[:n] * np.asarray(self.design.keep)[:n]
        return np.concatenate([channel_noise, np.zeros(n * (len(self.rows.channels) - 1))])

    @cached_property
    def plain_discrepancy(self) -> Discrepancy:
        """The unlisted effect, without regard to the slip uncertainty."""
        return discrepancy_of(self)

    @cached_property
    def discrepancy(self) -> Discrepancy:
        """The unlisted effect, with the slip uncertainty projected out."""
        plain = self.plain_discrepancy
        return replace(plain, columns=self.whitened_for_slip(plain.columns))

    def columns_at(self, fit: Fit) -> np.ndarray:
        """Whitened slopes (m, p + k) of the forces at a fit."""
        linear = self.linearised(fit.z, self.amplitudes(fit.atoms, fit.amplitude))
        return np.concatenate([linear.jacobian, linear.columns[:, list(fit.atoms)]], axis=1)

    @property
    def given_residual(self) -> np.ndarray | None:
        """(m,) whitened, of a simulator whose parameters are not refitted."""
        return self.residual(self.as_given, self.amplitudes()) if self.simulator else None

    def groups(self) -> dict[str, np.ndarray]:
        """Covariates (m,) in whose groups the size of an effect is compared."""
        rows, count = self.rows, len(self.rows.channels)
        values = {
            "slip_fraction": np.abs(self.slip_fraction),
            "signed_slip": rows.slip,
            "fz": np.asarray(rows.inputs.fz),
            "v": np.asarray(rows.covariates.v),
            "time": np.zeros(rows.n) if rows.time is None else rows.time,
            "slip_rate": np.asarray(rows.covariates.rate),
            "run": rows.run.astype(float),
        }
        return {k: np.tile(v, count) for k, v in values.items() if np.ptp(v) > 0}

    def folds(self, effects: Key) -> Folds:
        """The parts that are left out, for the naming of these effects: whole runs cannot
        show an effect that belongs to one of them."""
        of_runs = {a.effect.id for a in self.atoms if "runs" in a.effect.needs}
        folds = folds_of(self.rows, self.inflation, not of_runs & {*effects})
        return folds._replace(code=np.tile(folds.code, len(self.rows.channels)))

    def refit(self, starts: Sequence[Start], sets: Sequence[tuple[int, ...]]) -> list[Fit]:
        """Sets of atoms fitted from these starts, see :class:`engine.fit.Forward`."""
        # At a bound of the parameters, within .25 % of their interval, the slope is zero and a
        # refit could not leave it: begin at the first guess.
        begin = [
            s._replace(z=np.where(np.abs(s.z) > 6.0, self.guess, s.z)) if atoms else s
            for s, atoms in zip(starts, sets, strict=True)
        ]
        points, made, p = fits.refit(self.tire, begin, sets, self.design), [], len(self.z)
        rows = fits.weighted(self.tire, points, sets, self.design, self.rows.n)
        for point, atoms, (residual, slopes) in zip(points, sets, rows, strict=True):
            start = Start(point[:p], point[p : p + len(atoms)])
            linear = self.whitened_for_slip(residual), self.whitened_for_slip(slopes.T)
            made.append(fitted(self, atoms, start, linear))
        return made

    def tangents(self, fit: Fit) -> np.ndarray:
        """Whitened slopes (m, K) by the amplitudes of all atoms at a fit."""
        amplitudes = self.amplitudes(fit.atoms, fit.amplitude)
        return self.whitened_for_slip(self.linearised(fit.z, amplitudes).columns)

    def amplitudes(
        self, atoms: Sequence[int] = (), sizes: np.ndarray | tuple[Any, ...] = ()
    ) -> np.ndarray:
        """Amplitudes of all atoms (K,) in their own units, from those of some atoms in
        prior scales; the others are zero."""
        full, index = np.zeros(len(self.atoms)), list(atoms)
        full[index] = np.asarray(sizes)[: len(index)] * self.priors.scale[index]
        return full

    def residual(self, z: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
        """Whitened residual of the used rows, zero for outliers: (m,)."""
        n, scale, keep = self.rows.n, self.design.scale, self.design.keep
        each = self.forces(z, amplitudes).items()
        parts = [keep[:n] * (self.rows.observed[c] - f) / scale[c][:n] for c, f in each]
        return np.concatenate(parts)

    def forces(self, z: np.ndarray, amplitudes: np.ndarray) -> dict[str, np.ndarray]:
        """Mean force of every used row, by channel."""
        return self.tire.moments(z, self.design, self.rows.n, amplitudes)[0]


def fit_base(
    prepared: Prepared,
    name: str | None,
    effects: tuple[Effect, ...],
    rig: Rig,
    given: GivenSimulator | None = None,
) -> Base:
    """Fit the base model, judge the noise, and fit again under it.

    Args:
        name: of the model; None for the brush.
        given: a simulator, whose forces are in the data: the base is this simulator,
            adapted; if only its forces are known, they choose the model that stands in for it.

    Raises:
        DataError: the model does not follow the simulator, or that has other signs.
    """
    simulator, stand_in, missed = None, name or STAND_INS[0], dict[str, np.ndarray]()
    if given is not None and given.tire is None:
        stand_in, fitted, (design, missed) = fits.standing_in(prepared, effects, rig, given)
    else:
        design = fits.design_of(prepared, effects, rig)
        if given is None:
            fitted = fits.first_fit(prepared, stand_in, prepared.data, effects, rig)
        else:
            fitted = given.tire_for(prepared, effects)
            design, missed = fits.with_offset(prepared, fitted[0], design, fitted[1])
    tire, z, guess = fitted
    if given is not None:
        fits.check_followed(prepared, missed, stand_in)
        remark = check_signs(prepared, tire, z, given)
        simulator = Simulated(given=given, z=z, stand_in=stand_in, remark_on_signs=remark)
        z = fits.refit_base(tire, z, design)
    # The slip of full sliding is 3 mu F_z / (2 c) for the brush with slope and peak of the base.
    slope, mu = tire.brush(z, design)
    slope = np.maximum(np.asarray(slope)[: prepared.n], FLAT)
    side = np.where(prepared.slip < 0, -1.0, 1.0)
    size = side * np.hypot(prepared.slip, prepared.second)
    base = Base(
        rows=prepared, tire=tire, design=design, z=z, guess=guess, simulator=simulator,
        slip_fraction=size / (1.5 * float(mu) * prepared.inputs.fz / slope),
    )  # fmt: skip
    base = with_noise(base, rig, z)
    return with_runs(base.on(with_force(prepared, tire, base.design, base.z)))


def shown_slip_noise(
    prepared: Prepared, name: str, effects: tuple[Effect, ...], rig: Rig
) -> float | None:
    """Noise of the slip [-], estimated from the measured forces and the model ``name``; or None.

    It is None if the noise is stated, if the forces do not show it, if most of the scatter of
    the slip about its path may be noise, or if the force was derived from the motion and so
    has the errors of the slip.
    """
    sweeps = prepared.slip_source == SCATTER
    known = prepared.slip_source != NOT_STATED and not sweeps
    if known or prepared.derived is not None or (prepared.mode == "xy" and not sweeps):
        return None
    tire, z, _ = fits.first_fit(prepared, name, prepared.data, effects, rig)
    channel, design = prepared.channels[0], fits.design_of(prepared, effects, rig)

    def force(off: float) -> np.ndarray:
        moved = replace(prepared, slip=prepared.slip + off)
        return tire.moments(z, fits.measured_slips(design, moved), prepared.n)[0][channel]

    slope = (force(_SMALL) - force(-_SMALL)) / (2 * _SMALL)
    residual = prepared.observed[channel] - force(0.0)
    moving: float | None = 0.0
    if sweeps:
        stretches = noise.in_order(*order_of(prepared.data))
        off = noise.between(slip_of(prepared.data, prepared.mode), stretches)[prepared.kept]
        moving = noise.noise_in_motion(residual, slope, off, float(prepared.slip_std[0]))
    if moving is None or prepared.mode == "xy":
        return moving
    # Where the slip changes its sign the curve bends, and a shift of it is a gap.
    side, groups = prepared.slip > 0, neighbours(prepared)
    one_sided = [r[side[r] == positive] for r in groups for positive in (False, True)]
    in_time, fz = noise.in_order(prepared.time, prepared.run), np.asarray(prepared.inputs.fz)
    scatter = noise.slip_scatter(residual, slope**2, fz, one_sided, in_time)
    return max(scatter, moving) if sweeps else scatter or None


def with_noise(
    base: Base, rig: Rig, z: np.ndarray, amplitudes: np.ndarray | tuple[Any, ...] = (),
    outliers: bool = False,
) -> Base:  # fmt: skip
    """The base refitted with the noise of the remainder of a fit (z, amplitudes), by channel.
    ``outliers`` are excluded from a fit without a gross gap."""
    rows, fz = base.rows, np.asarray(base.rows.inputs.fz)
    mean, spread = base.tire.moments(z, base.design, rows.n, amplitudes)
    typical, levels, groups = fz / np.mean(fz), dict[str, NoiseLevel](), neighbours(rows)
    basis = smooth_basis(rows, base.slip_fraction, typical, rows.n // 6)
    of_friction = np.minimum(np.abs(base.slip_fraction), 1.0)  # of a brush, within 0.2
    for c in rows.channels:
        column = f"{c}_std"
        given = rows.column(column) if column in rows.data else rig.force_noise(c, fz)
        common = spread[c] * rows.common
        waves = partial(wave_basis, rows, typical, of_friction * mean[c])
        level = noise.judge_noise(
            rows.observed[c] - mean[c], spread[c] - common, fz, mean[c], given, basis,
            waves, groups, rows.time, rows.run, outliers,
        )  # fmt: skip
        levels[c] = level._replace(std=np.sqrt(level.std**2 + common))
    size, wide = len(base.design.keep), np.sqrt(max(x.inflation for x in levels.values()))
    scale = {c: pad_rows(level.std * wide, size) for c, level in levels.items()}
    keep = (np.arange(size) < rows.n).astype(float)
    keep[: rows.n] = ~np.any([level.outlier for level in levels.values()], axis=0)
    design = base.design._replace(scale=scale, keep=keep)
    z = fits.refit_base(base.tire, base.z, design)
    return replace(base, design=design, z=z, noise=levels)


def on_rows(base: Base, prepared: Prepared, rig: Rig) -> Base:
    """The same fit on other rows, for its forces; the noise is that of its own rows."""
    tire, prepared = base.tire, on_scale_of(prepared, base.rows)
    design = fits.design_of(prepared, tire.effects, rig)
    if base.simulator is not None:
        design, _ = fits.with_offset(prepared, tire, design, base.simulator.z)
    return base.on(with_force(prepared, tire, design, base.z), prepared)
