"""What is known of the rig or vehicle that measured: ``rig.toml``."""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from tirefit.data.table import TireData
from tirefit.door import read_toml
from tirefit.results import InputProblem, UsageError
from tirefit.settings import Section, parse_settings

# Optional numbers, within what anybody measures.
_Force = Annotated[float | None, Field(ge=1e-9, le=1e7)]  # N, or N m
_Share = Annotated[float | None, Field(ge=1e-9, le=1e2)]
_Slip = Annotated[float | None, Field(ge=1e-12, le=10)]
_Speed = Annotated[float | None, Field(ge=1e-9, le=1e3)]  # m/s
_Length = Annotated[float | None, Field(ge=1e-9, le=1e2)]  # m
_Time = Annotated[float | None, Field(ge=1e-9, le=1e2)]  # s
_Inertia = Annotated[float | None, Field(ge=1e-9, le=1e6)]  # kg m2


class _Noise(Section):
    fx: _Force = None
    fy: _Force = None
    mz: _Force = None
    force: _Force = None
    fx_relative: _Share = None
    fy_relative: _Share = None
    mz_relative: _Share = None
    force_relative: _Share = None
    sigma_x: _Slip = None
    kappa: _Slip = None
    slip: _Slip = None
    alpha: _Slip = None
    sigma_x_speed: _Speed = None
    kappa_speed: _Speed = None
    slip_speed: _Speed = None
    alpha_speed: _Speed = None


class _Vehicle(Section):
    position: _Length = None
    clock: _Time = None
    yaw_inertia: _Share = None


_TABLES: dict[str, type[Section]] = {"noise": _Noise, "vehicle": _Vehicle}

VEHICLE = tuple(_Vehicle.model_fields)
"""What may be stated of a vehicle: keys of ``[vehicle]``."""


class _RigFile(Section):
    """``rig.toml`` as it is written."""

    rolling_radius: _Length = None
    wheel_inertia: _Inertia = None
    noise: _Noise = _Noise()
    vehicle: _Vehicle = _Vehicle()
    commanded_slip: str | None = None
    run_order: Literal["random", "sequential"] | None = None


_OWN_COLUMNS = {
    "force": ("fx_std", "fy_std"),
    "slip": ("sigma_x_std", "alpha_std"),
    "kappa": ("sigma_x_std",),
}
"""Columns of a file that say the same as a key of ``[noise]``, of those whose names do
not tell."""

_STANDS = 0.02
"""Share of the usual wheel speed or speed below which a wheel counts as standing."""


@dataclass(frozen=True)
class Rig:
    """Knowledge of the rig; everything is optional.

    ``vehicle`` holds standard errors of what a log is derived with: ``position`` [m] of
    the tracked point, ``clock`` [s] between channels, ``yaw_inertia`` as a share of it.
    ``noise`` holds standard deviations: of a force [N] or as a share of the load
    (``fx_relative``), of the slip [-] or slip angle [rad], of a speed across the patch
    [m/s] (``sigma_x_speed``), which is a slip of as much over v. ``commanded_slip``
    names the column of the slip that was asked for; ``run_order`` is "random" or
    "sequential".
    """

    rolling_radius: float | None = None
    wheel_inertia: float | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    vehicle: Mapping[str, float] = field(default_factory=dict)
    commanded_slip: str | None = None
    run_order: str | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        """Raises UsageError for a stated noise or error that is no positive number, or
        two of one force."""
        for kind in ("noise", "vehicle"):
            for name, value in getattr(self, kind).items():
                if not 0 < value < np.inf:
                    reason = f"{kind}: {name} = {value:g}"
                    raise UsageError(InputProblem(reason, "give a positive number"))
        for name in self.noise:
            if f"{name}_relative" in self.noise:
                reason = f"noise: {name} and {name}_relative are both stated"
                raise UsageError(InputProblem(reason, "state one of them"))

    def radius_for(self, data: TireData) -> float | None:
        """Rolling radius [m]: given, or v / omega with the slip along taken out (which
        lateral data need not hold); None where neither is known."""
        if self.rolling_radius:
            return self.rolling_radius
        if "omega" not in data or "v" not in data:
            return None
        omega, v = data.usable("omega"), data.usable("v")
        slip = data.usable("sigma_x") if "sigma_x" in data else np.zeros(data.n)
        # A wheel that stands, or a slip that has no bound, tells no radius.
        turning = np.abs(omega) > _STANDS * np.median(np.abs(omega))
        turning &= (v > _STANDS * np.median(np.abs(v))) & (np.abs(slip) < 1)
        if not turning.any():
            return None
        radius = v[turning] / (np.abs(omega[turning]) * (1 + slip[turning]))
        return float(np.median(radius))

    def slip_noise(self, slip: str) -> float | None:
        """Given standard deviation of a slip."""
        return self._of_slip(slip, "")

    def slip_noise_speed(self, slip: str) -> float | None:
        """Given standard deviation of the speed that a slip is worked out from [m/s]:
        of positions or wheel speeds, whose slip is the worse the slower."""
        return self._of_slip(slip, "_speed")

    def beside(self, data: TireData) -> tuple[str, ...]:
        """What it states of a noise that the data's own columns say row by row, which
        count, as sentences."""
        said = []
        for key in self.noise:
            name = key.removesuffix("_relative").removesuffix("_speed")
            said += [
                f"[noise] {key} of the rig is not used: the file has a column {column}"
                for column in _OWN_COLUMNS.get(name, (f"{name}_std",))
                if column in data
            ]
        return tuple(said)

    def _of_slip(self, slip: str, kind: str) -> float | None:
        names = ("alpha",) if slip == "alpha" else ("sigma_x", "kappa")
        keys = (f"{name}{kind}" for name in (*names, "slip"))
        return next((self.noise[k] for k in keys if k in self.noise), None)

    def force_noise(self, channel: str, fz) -> np.ndarray | None:
        """Given standard deviation of a force, shape of ``fz``, or None."""
        shared = () if channel == "mz" else ("force",)
        for name in (channel, *shared):
            if name in self.noise:
                return np.full(len(fz), self.noise[name])
            if f"{name}_relative" in self.noise:
                return self.noise[f"{name}_relative"] * fz
        return None


def load_rig(path: str | Path | None) -> Rig:
    """Read ``rig.toml``; what it says of other things is noted and left.

    Raises:
        UsageError: no such file, not TOML, a key that is nearly one of its keys, a
            value of the wrong kind or that nobody measures; all at once.
    """
    if path is None:
        return Rig()
    content, others = _of_others(read_toml(path), _RigFile)
    stated = parse_settings(_RigFile, content, str(path))
    notes = [f"{key} of {path} is not used" for key in others]
    if stated.commanded_slip is not None:
        notes.append(f"commanded_slip of {path} is noted, not used")
    try:
        return Rig(**stated.model_dump(exclude_none=True), notes=tuple(notes))
    except UsageError as error:
        raise UsageError(
            [replace(one, file=str(path)) for one in error.problems]
        ) from None


def _of_others(content: dict, kind: type[Section]) -> tuple[dict, list[str]]:
    """The content without keys that resemble none of a section's, and those keys: a
    description of a rig may serve other programs too."""
    kept, others = {}, []
    for key, value in content.items():
        if not difflib.get_close_matches(key, kind.model_fields, 1):
            others.append(key)
            continue
        kept[key] = value
        if isinstance(value, dict) and key in _TABLES:
            kept[key], inner = _of_others(value, _TABLES[key])
            others += [f"{key}.{name}" for name in inner]
    return kept, others
