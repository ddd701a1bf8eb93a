"""Records of a diagnosis; their fields are the keys of ``NAME.json``.

Forces are in N, moments in N m, slips without unit, angles in rad; ids of effects are
those of :data:`tirefit.diagnosis.effects.EFFECTS`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from tirefit.diagnosis.effects import NOISE_EFFECTS
from tirefit.diagnosis.engine.decide import Each, Status
from tirefit.diagnosis.engine.sizes import SizeByGroup
from tirefit.diagnosis.rows.rig import Rig


@dataclass(frozen=True, kw_only=True)
class DataSummary:
    """The file, and how it was read."""

    name: str
    path: str
    sha256: str
    convention: str
    channels: tuple[str, ...]
    assumptions: tuple[str, ...]
    set_aside: tuple[str, ...] = ()  # the first excluded rows with reasons, and a count
    motion: tuple[str, ...] = ()  # notes on a force derived from it


@dataclass(frozen=True, kw_only=True)
class NoiseSummary:
    """Standard deviations of the noise."""

    forces: Mapping[str, float]  # median over the rows
    slip_name: str
    slip: float
    slip_source: str
    source: str
    flags: tuple[str, ...]
    inflation: float  # rows per independent row
    outliers: int  # number of excluded rows
    excess: float = 1.0  # over the stated noise, 1 where none was stated

    def as_json(self) -> Mapping:
        """Each level under the name of its column."""
        return {
            **self.forces,
            self.slip_name: self.slip,
            f"{self.slip_name}_source": self.slip_source,
            "source": self.source,
            "flags": self.flags,
            "inflation": self.inflation,
            "outliers": self.outliers,
            "excess": self.excess,
        }


@dataclass(frozen=True, kw_only=True)
class Shrinkage:
    """The rms gap beyond the noise and its closure: ``closed`` is 1 - remaining_rms / rms
    with its 90 % interval, None if the gap is not ``resolvable``. Its lower limit is zero
    on the fitted rows, elsewhere :data:`tirefit.diagnosis.summary.closure.WORST`, which
    includes all worse values."""

    rms: float
    resolvable: bool
    closed: float | None
    closed_ci: tuple[float | None, float | None]
    remaining_rms: float

    @property
    def net_closed(self) -> float | None:
        """``closed``, negative if the gap has become larger."""
        if self.closed != 0 or self.remaining_rms <= self.rms:
            return self.closed
        return 1 - self.remaining_rms / self.rms

    @property
    def energy_closed(self) -> float | None:
        """Share of the gap's energy that is closed."""
        closed = self.net_closed
        return None if closed is None else 1 - (1 - closed) ** 2


@dataclass(frozen=True, kw_only=True)
class HeldOut(Shrinkage):
    """The gap on data not used; ``on`` says which."""

    on: str


@dataclass(frozen=True, kw_only=True)
class Gap(Shrinkage):
    """The gap of the first channel on the rows of the file, and of every channel."""

    channels: Mapping[str, Shrinkage]
    holdout: HeldOut | None


class Region(NamedTuple):
    """One bin of one covariate."""

    covariate: str
    low: float
    high: float
    share: float  # of the gap's energy
    p_value: float  # of its misfit, Benjamini-Yekutieli


class Look(NamedTuple):
    """A quantity as a function of a covariate that fits the remainder."""

    parameter: str
    covariate: str
    is_wave: bool
    at: float  # covariate of the largest change; period of a wave
    size: float  # largest change: relative (stiffness, friction), a slip, force over load
    probability: float  # among all such functions
    explains: float  # share of the mean square of the remainder


class Left(NamedTuple):
    """The remaining gap beyond the noise."""

    rms: float
    share: float  # of the gap's energy
    unlisted: float  # probability that an unlisted effect is present
    looks_like: tuple[Look, ...] = ()  # shapes it resembles, the most probable first


@dataclass(frozen=True, kw_only=True)
class VerdictSummary:
    """The effects that are present, and the remainder: a
    :class:`~tirefit.diagnosis.decide.verdict.Verdict` for the report, with a calibrated
    ``probability``, the share of such verdicts that are right; ``sizes`` of each named effect
    by groups of each covariate, the most unequal first; ``parameters`` are those of a given
    simulator, empty for a fitted form."""

    status: Status
    effects: tuple[str, ...]
    acts_like: tuple[str, ...] = ()
    probability: float
    each: Mapping[str, Each] = field(default_factory=dict)
    also_possible: tuple[str, ...] = ()
    left: Left
    sizes: Mapping[str, tuple[SizeByGroup, ...]] = field(default_factory=dict)
    parameters: Mapping[str, "Change"] = field(default_factory=dict)

    @property
    def names_an_effect(self) -> bool:
        """Whether effects on the mean force are named, and not only on the noise."""
        of_noise = {effect.id for effect in NOISE_EFFECTS}
        on_mean = [e for e in self.effects if e not in of_noise]
        return bool(on_mean) and on_mean != ["unknown"]

    @property
    def helping(self) -> tuple[str, ...]:
        """The effects of the ladder: named causes, then those that act like one."""
        return (*self.effects, *self.acts_like) if self.names_an_effect else self.acts_like


class Change(NamedTuple):
    """A parameter as simulated and as measured."""

    simulated: float
    measured: float
    std: float  # standard error of ``measured``
    differs: bool  # whether they differ by more than two standard errors


class Part(NamedTuple):
    """A part of the distance from a base to the measurement of a channel; shares add to one."""

    part: str  # parameters, the id of an effect, unexplained or noise
    rms: float  # root of its mean square
    share: float  # of the mean square
    closed_ci: tuple[float, float]  # 90 % interval of the share


class Surrogate(NamedTuple):
    """The tire that stands in for a simulator: its rms error [N] in the simulated force
    of the first channel, and that error over the force and over the gap."""

    model: str
    rms: float
    of_force: float
    of_gap: float


class SimulatorSummary(NamedTuple):
    """A simulator that was diagnosed; ``kind`` is columns, model, fit or tir."""

    kind: str
    source: str
    sha256: str | None
    surrogate: Surrogate


class Amplitude(NamedTuple):
    """Amplitude of an effect with its standard error, in its own unit."""

    value: float
    std: float
    unit: str
    formula: str = ""  # which of the effect's, in words; "" where there is one


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A set of effects that may explain the gap."""

    effects: tuple[str, ...]
    family: str
    probability: float
    parameters: Mapping[str, Amplitude]  # ``effect: parameter`` -> size


class Untestable(NamedTuple):
    """An effect that these data cannot show, and the data that it needs."""

    effect: str
    needs: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """Smallest unlisted remainder (rms) and amplitudes that would have been detected."""

    remainder: float
    smallest_effects: Mapping[str, float]

    REMAINDER = "smallest unlisted remainder that would have been seen"

    def as_json(self) -> Mapping:
        return {self.REMAINDER: self.remainder, "smallest_effects": self.smallest_effects}


class Forecast(NamedTuple):
    """Forecast probabilities for an effect of usual size on these rows."""

    effect: str
    amplitude: float
    unit: str
    seen: float
    recognised: float  # detected and recognised
    taken_for: str | None  # effect found most often instead; None: hardly any


class NextMeasurement(NamedTuple):
    """A further measurement, the two effects that it distinguishes, and the probabilities
    of distinguishing them without and with it."""

    add: str
    separates: tuple[str, str]
    p_now: float
    p_after: float


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the diagnosis."""

    rig: Rig
    effects: tuple[str, ...]  # ids searched
    holdout: tuple[str, ...]  # sha256 of held-out files
    forces: tuple[str, ...] | None = None  # that matter, None for all
