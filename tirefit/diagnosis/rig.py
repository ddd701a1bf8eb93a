"""What is known of the rig or vehicle that measured: ``rig.toml``."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tirefit.data.table import TireData
from tirefit.door import read_toml
from tirefit.results import InputProblem, UsageError

__all__ = ["VEHICLE", "Rig", "load_rig"]

_NUMBERS = ("rolling_radius", "wheel_inertia")
_NOISE = (
    "fx", "fy", "mz", "fx_relative", "fy_relative", "mz_relative", "sigma_x", "kappa",
    "slip", "alpha", "force", "force_relative", "sigma_x_speed", "kappa_speed",
    "slip_speed", "alpha_speed",
)  # fmt: skip

VEHICLE = ("position", "clock", "yaw_inertia")
"""What may be stated of a vehicle: keys of ``[vehicle]``."""

_LEAST, _MOST = 1e-12, 1e9
"""Sizes that anything of a rig has, SI: beyond, noise drowns or divides everything."""

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
    """Read ``rig.toml``.

    Raises:
        UsageError: no such file, not TOML, or a value of the wrong kind; all at once.
    """
    if path is None:
        return Rig()
    return _checked(read_toml(path), str(path))


def _checked(content: dict, path: str) -> Rig:
    problems: list[InputProblem] = []
    notes: list[str] = []

    def number(key, value):
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not good or not _LEAST <= value <= _MOST:
            reason = f"{key} = {value!r} is not a positive number"
            remedy = f"give an SI value from {_LEAST:g} to {_MOST:g}"
            problems.append(InputProblem(reason, remedy, path))
            return None
        return float(value)

    values = {k: number(k, content[k]) for k in _NUMBERS if k in content}

    def table(section, keys, example):
        given = content.get(section, {})
        if not isinstance(given, dict):
            reason = f"{section} = {given!r} is not a table"
            problems.append(InputProblem(reason, f"write {example}", path))
            return {}
        unused = [key for key in given if key not in keys]
        notes.extend(
            f"{section}.{k} of {path} is not used; known: {keys}" for k in unused
        )
        return {k: number(f"{section}.{k}", v) for k, v in given.items() if k in keys}

    levels = table("noise", _NOISE, "[noise] with fx = ... [N]")
    vehicle = table("vehicle", VEHICLE, "[vehicle] with position = ... [m]")
    order = content.get("run_order")
    if order not in (None, "random", "sequential"):
        reason = f"run_order = {order!r}"
        problems.append(InputProblem(reason, 'write "random" or "sequential"', path))
    command = content.get("commanded_slip")
    if command is not None and not isinstance(command, str):
        reason = f"commanded_slip = {command!r} is not a column name"
        problems.append(InputProblem(reason, "give the header of its column", path))
    known = {*_NUMBERS, "noise", "vehicle", "run_order", "commanded_slip"}
    notes += [f"{k} of {path} is not used" for k in content if k not in known]
    if command is not None:
        notes.append(f"commanded_slip of {path} is noted, not used")
    if problems:
        raise UsageError(problems)
    return Rig(noise=levels, vehicle=vehicle, commanded_slip=command, run_order=order,
               notes=tuple(notes), **values)  # fmt: skip
