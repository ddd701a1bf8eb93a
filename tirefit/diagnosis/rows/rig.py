"""``rig.toml``, the user's statements on the rig or vehicle, and checks of the data."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, create_model

from tirefit.data.table import TireData
from tirefit.data.units import slip_from_sigma, slip_from_speeds
from tirefit.diagnosis.engine import UNSEEN
from tirefit.door import read_toml
from tirefit.results import DataError, UsageError
from tirefit.settings import Section, parse_settings

# Optional numbers with the range of plausible values.
_Share = Annotated[float | None, Field(ge=1e-9, le=1e2)]
_Length = Annotated[float | None, Field(ge=1e-9, le=1e2)]  # m
_Time = Annotated[float | None, Field(ge=1e-9, le=1e2)]  # s

_NOISE: dict[Any, tuple[str, ...]] = {
    Annotated[float | None, Field(ge=1e-9, le=1e7)]: ("fx", "fy", "mz", "force"),  # N, or N m
    _Share: ("fx_relative", "fy_relative", "mz_relative", "force_relative"),
    Annotated[float | None, Field(ge=1e-12, le=10)]: ("sigma_x", "kappa", "slip", "alpha"),
    Annotated[float | None, Field(ge=1e-9, le=1e3)]: (  # m/s
        "sigma_x_speed", "kappa_speed", "slip_speed", "alpha_speed",
    ),
}  # fmt: skip
_KEYS: dict[str, Any] = {key: (kind, None) for kind, keys in _NOISE.items() for key in keys}
_Noise = create_model("_Noise", __base__=Section, **_KEYS)


class _Vehicle(Section):
    position: _Length = None
    clock: _Time = None
    yaw_inertia: _Share = None


class _RigFile(Section):
    rolling_radius: _Length = None
    wheel_inertia: Annotated[float | None, Field(ge=1e-9, le=1e6)] = None  # kg m2
    noise: _Noise = _Noise()  # type: ignore[valid-type]
    vehicle: _Vehicle = _Vehicle()
    run_order: Literal["random", "sequential"] | None = None


STANDS = 0.03  # share of the median speed below which a wheel counts as standing

LEAST_ROWS = 20
"""Smallest number of rows of a diagnosis, and of a run with its own offset."""


@dataclass(frozen=True)
class Rig:
    """Statements about the rig; all are optional.

    Attributes:
        rolling_radius: effective radius of the wheel [m].
        wheel_inertia: moment of inertia of the wheel about its axle [kg m2].
        noise: standard deviations: of a force [N] or over the load (``fx_relative``), of the slip
            [-] or slip angle [rad], of the sliding speed [m/s] (``sigma_x_speed``).
        vehicle: standard errors of the inputs of a derived log: ``position`` [m] of the
            tracked point, ``clock`` [s] between channels, ``yaw_inertia`` (relative).
        run_order: ``random`` or ``sequential``, the order in which runs were measured.

    Example:
        >>> rig = Rig(rolling_radius=0.31, noise={"fx_relative": 0.02})
        >>> rig.force_noise("fx", np.array([1000.0, 2000.0]))
        array([20., 40.])
    """

    rolling_radius: float | None = None
    wheel_inertia: float | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    vehicle: Mapping[str, float] = field(default_factory=dict)
    run_order: str | None = None

    def __post_init__(self) -> None:
        """Raises UsageError for a value not above zero, or two of one force."""
        for kind in ("noise", "vehicle"):
            for name, value in getattr(self, kind).items():
                if not 0 < value < np.inf:
                    reason = f"{kind}: {name} = {value:g}"
                    raise UsageError(reason, "give a positive number")
        for name in self.noise:
            if f"{name}_relative" in self.noise:
                reason = f"noise: {name} and {name}_relative are both stated"
                raise UsageError(reason, "state one of them")

    def radius_for(self, data: TireData) -> float | None:
        """Return the rolling radius [m], stated or the median of v / (omega (1 + slip)).

        Args:
            data: rows; without ``omega`` and ``v`` the radius is None if not stated.
        """
        if self.rolling_radius:
            return self.rolling_radius
        if "omega" not in data or "v" not in data:
            return None
        omega, v = data.usable("omega"), data.usable("v")
        slip = data.usable("sigma_x") if "sigma_x" in data else np.zeros(data.n)
        turning = np.abs(omega) > STANDS * np.median(np.abs(omega))
        turning &= (v > STANDS * np.median(np.abs(v))) & (np.abs(slip) < 1)
        if not turning.any():
            return None
        radius = v[turning] / (np.abs(omega[turning]) * (1 + slip[turning]))
        return float(np.median(radius))

    def slip_noise(self, slip: str, kind: str = "") -> float | None:
        """Return the stated standard deviation of a slip or its speed, None without.

        Args:
            slip: ``sigma_x`` or ``alpha``.
            kind: ``""`` for the slip [- or rad], ``"_speed"`` for the sliding speed [m/s].
        """
        names = ("alpha",) if slip == "alpha" else ("sigma_x", "kappa")
        keys = (f"{name}{kind}" for name in (*names, "slip"))
        return next((self.noise[k] for k in keys if k in self.noise), None)

    def beside(self, data: TireData) -> tuple[str, ...]:
        """Return a sentence for each stated noise that a column of the data replaces.

        Args:
            data: rows that may have columns such as ``fx_std``.
        """
        names = {k: k.removesuffix("_relative").removesuffix("_speed") for k in self.noise}
        # Keys whose column is not named KEY_std.
        others = {"force": ["fx_std", "fy_std"], "slip": ["sigma_x_std", "alpha_std"]}
        others["kappa"] = ["sigma_x_std"]
        return tuple(
            f"[noise] {key} of the rig is not used: the file has a column {column}"
            for key, name in names.items()
            for column in others.get(name, [f"{name}_std"])
            if column in data
        )

    def force_noise(self, channel: str, fz: np.ndarray) -> np.ndarray | None:
        """Return the stated standard deviation (n,) of a force or moment, None without.

        Args:
            channel: ``fx``, ``fy`` [N] or ``mz`` [N m].
            fz: load [N], shape (n,).
        """
        for name in (channel, *(["force"] if channel != "mz" else [])):
            if name in self.noise:
                return np.full(np.shape(fz), self.noise[name])
            if f"{name}_relative" in self.noise:
                return self.noise[f"{name}_relative"] * fz
        return None


def load_rig(path: str | Path | None) -> Rig:
    """Read what is stated of a rig from ``rig.toml``.

    Args:
        path: the file; None for a rig of which nothing is stated.

    Returns:
        The statements.

    Raises:
        UsageError: an unknown key, or a value of the wrong type or out of its range.
        DataError: the file cannot be read.

    Example:
        >>> _ = (folder / "rig.toml").write_text("rolling_radius = 0.31")
        >>> load_rig(folder / "rig.toml").rolling_radius
        0.31
    """
    if path is None:
        return Rig()
    stated = parse_settings(_RigFile, read_toml(path), str(path))
    try:
        return Rig(**stated.model_dump(exclude_none=True))
    except UsageError as error:
        problems = [replace(problem, file=str(path)) for problem in error.problems]
        raise UsageError(problems) from None


def unfit(data: TireData, reason: str, remedy: str, column: str = "") -> DataError:
    """The error of data that cannot be diagnosed."""
    return DataError(reason, remedy, data.file, column=column or None)


def check_data(data: TireData, channels: tuple[str, ...], rig: Rig) -> None:
    """Raises DataError for a missing load, too few rows, or a force or a stated noise far
    above all loads."""
    if "fz" not in data:
        remedy = "name its column with --column fz=HEADER, or --constant fz=4000"
        raise unfit(data, "a diagnosis needs fz (load, N) for every row", remedy)
    if data.n < LEAST_ROWS:
        reason = f"{data.n} usable rows: a diagnosis needs {LEAST_ROWS} or more"
        raise unfit(data, reason, "measure more points")
    fz = data.usable("fz")
    largest = float(np.max(np.abs(fz)))
    for force in sorted({"fx", "fy"} & set(data.columns)):
        most = np.max(np.abs(data.usable(force))) / largest
        if not most < 1e4:
            reason = f"{most:.0e} times the largest load, which no tire reaches"
            remedy = f"give its unit with --unit {force}=..., or that of the load"
            raise unfit(data, reason, remedy, force)
    for channel in channels:
        column = f"{channel}_std"
        measured = column in data
        stated = data.usable(column) if measured else rig.force_noise(channel, fz)
        if stated is not None and np.median(stated) > largest:
            source = column if measured else f"[noise] of the rig for {channel}"
            reason = f"noise of {np.median(stated):.3g}, beyond the largest load"
            remedy = f"check the unit of the noise, {source}"
            raise unfit(data, reason, remedy, column if measured else channel)


FOR, BESIDE, AGAINST = 3.0, 1.5, -1.5
"""Changes of the log odds of an effect if the :class:`SlipCheck` shows it (a prior of one
in 25 becomes even), shows it or an error of the speeds, or would have shown it."""

_BETTER = 0.7
"""Largest scatter of the best definition of the slip over that of another one."""


class SlipCheck(NamedTuple):
    """Comparison of the slip column with (v - omega R) / (omega R). The column or the
    speeds may be wrong; definitions are those of the column."""

    read_as: str  # definition of the slip
    fits: str  # the definition that fits best
    radius: float  # [m] that was used
    rms: float  # difference from the computed slip in ``read_as``
    scatter: float  # about a line of offset and gain in ``fits``
    offset: float
    offset_std: float
    gain: float
    told_apart: bool  # whether all other definitions fit clearly worse

    @property
    def shifted(self) -> bool:
        """Whether the offset is significant: 4 standard errors."""
        return abs(self.offset) > 4 * self.offset_std

    @property
    def agrees(self) -> bool:
        """Whether column and speeds agree, except for a wrong radius (2 % of gain)."""
        same = self.fits == self.read_as and not self.shifted
        return same and abs(self.gain - 1) < 0.02


def _line(computed: np.ndarray, logged: np.ndarray) -> dict[str, float]:
    """Least-squares line logged = offset + gain computed."""
    columns = np.stack([np.ones_like(computed), computed], axis=1)
    (offset, gain), *_ = np.linalg.lstsq(columns, logged, rcond=None)
    left = logged - columns @ (offset, gain)
    scatter = float(np.sqrt(np.sum(left**2) / (len(left) - 2)))
    error = max(float(scatter * np.sqrt(np.linalg.inv(columns.T @ columns)[0, 0])), UNSEEN)
    return dict(scatter=scatter, offset=float(offset), gain=float(gain), offset_std=error)


def check_slip(data: TireData, radius: float | None) -> SlipCheck | None:
    """The comparison; None without omega, v, a radius [m] and slips that vary."""
    if radius is None or not {"omega", "v", "sigma_x"} <= set(data.columns):
        return None
    omega, v, sigma = (data.usable(name) for name in ("omega", "v", "sigma_x"))
    computed = slip_from_speeds(omega, v, radius)
    largest = 3.0  # above, the wheel hardly turns
    good = (np.abs(computed) < largest) & (np.abs(sigma) < largest) & (omega > 0)
    good &= computed > -1 + 1 / (1 + largest)
    if good.sum() < LEAST_ROWS or np.ptp(computed[good]) < UNSEEN:
        return None
    alpha = data.usable("alpha")[good] if "alpha" in data else None
    read_as = data.source.slip_definition
    declared = "kappa" if read_as == "s" else read_as
    logged = slip_from_sigma(sigma[good], read_as, alpha)
    definitions = ("sigma_x", "kappa", "slip_ratio")
    meant = {name: slip_from_sigma(computed[good], name) for name in definitions}
    lines = {name: _line(x, logged) for name, x in meant.items()}
    best = min(lines, key=lambda name: lines[name]["scatter"])
    if lines[best]["scatter"] > _BETTER * lines[declared]["scatter"]:
        best = declared
    others = [line["scatter"] for name, line in lines.items() if name != best]
    return SlipCheck(
        read_as=read_as,
        fits=read_as if best == declared else best,
        radius=radius,
        rms=float(np.sqrt(np.mean((logged - meant[declared]) ** 2))),
        told_apart=lines[best]["scatter"] < _BETTER * min(others),
        **lines[best],
    )
