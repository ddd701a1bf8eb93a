"""What a diagnosis says, as records; their fields are the keys of ``NAME.json``.

Forces in N, moments in N m, slips without unit, angles in rad; ids of effects are those
of :data:`tirefit.diagnosis.effects.EFFECTS`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from tirefit.diagnosis.decide.verdict import Each, Status
from tirefit.diagnosis.effects import NOISE_EFFECTS
from tirefit.diagnosis.rows.patterns import Look
from tirefit.diagnosis.rows.rig import Rig


@dataclass(frozen=True, kw_only=True)
class DataSummary:
    """The file and how it was read."""

    name: str
    path: str
    sha256: str
    convention: str
    channels: tuple[str, ...]
    assumptions: tuple[str, ...]
    set_aside: tuple[str, ...] = ()  # the first excluded rows with reasons, and a count
    motion: tuple[str, ...] = ()  # notes on a force derived from it
    together: tuple[str, ...] = ()  # on conditions that move together


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
    """A gap beyond the noise, rms, and how far it shrinks: ``closed`` is 1 -
    remaining_rms / rms with its 90 % interval, None where the gap is not
    ``resolvable``. It ends at zero on the rows fitted, elsewhere at
    :data:`tirefit.diagnosis.summary.closure.WORST`, where it may be any worse."""

    rms: float
    resolvable: bool
    closed: float | None
    closed_ci: tuple[float | None, float | None]
    remaining_rms: float

    @property
    def net_closed(self) -> float | None:
        """``closed``, below zero where more is left than there was."""
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
    """The gap of the first channel on the file's own rows, and of every channel;
    ``shares`` are those of several effects in the energy closed (Shapley)."""

    channels: Mapping[str, Shrinkage]
    holdout: HeldOut | None
    shares: Mapping[str, float] = field(default_factory=dict)


class Spot(NamedTuple):
    """A short stretch of a covariate that holds far more of the gap than its share of
    the rows; the p-value is corrected as that of a :class:`Region`."""

    covariate: str
    low: float
    high: float
    rows: float
    share: float
    p_value: float


class Region(NamedTuple):
    """One bin of one covariate."""

    covariate: str
    low: float
    high: float
    share: float  # of the gap's energy
    p_value: float  # of its misfit, Benjamini-Yekutieli


class Cell(NamedTuple):
    """One parameter as a free function of one covariate: its log evidence over the base
    fit, and the share of the misfit's energy that it takes away at most."""

    parameter: str
    covariate: str
    log_evidence: float
    explains: float


class Left(NamedTuple):
    """What remains of the gap beyond the noise."""

    rms: float
    share: float  # of the gap's energy
    unlisted: float  # probability that something unlisted is there
    tests: Mapping[str, float | None]  # p-values, None if rows have no such order
    looks_like: tuple[Look, ...] = ()  # shapes it resembles, the most probable first


@dataclass(frozen=True, kw_only=True)
class VerdictSummary:
    """Which effects are there, and what is left: a
    :class:`~tirefit.diagnosis.decide.verdict.Verdict` as it is reported, with a
    ``probability`` that says how often such verdicts are right; ``parameters`` are
    those of a given simulator, none of a fitted form."""

    status: Status
    effects: tuple[str, ...]
    probability: float
    each: Mapping[str, Each] = field(default_factory=dict)
    also_possible: tuple[str, ...] = ()
    left: Left
    parameters: Mapping[str, "Change"] = field(default_factory=dict)

    @property
    def names_an_effect(self) -> bool:
        """Whether effects on the mean force are named, not of the noise alone."""
        of_noise = {effect.id for effect in NOISE_EFFECTS}
        on_mean = [e for e in self.effects if e not in of_noise]
        return bool(on_mean) and on_mean != ["unknown"]


class Change(NamedTuple):
    """A parameter as simulated and as measured."""

    simulated: float
    measured: float
    std: float  # standard error of ``measured``
    differs: bool  # by more than two standard errors


class Part(NamedTuple):
    """A part of the distance from a base to the measurement of a channel; shares add to
    one."""

    part: str  # parameters, the id of an effect, unexplained or noise
    rms: float  # root of its mean square
    share: float  # of the mean square
    closed_ci: tuple[float, float]  # 90 % interval of the share


class Surrogate(NamedTuple):
    """The tire that stands in for a simulator: rms [N] of what it misses of the
    simulated force, first channel, and that as a share of the force and of the gap."""

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
    """A set of effects that may explain the gap; scores are None for the unknown."""

    effects: tuple[str, ...]
    family: str
    probability: float
    parameters: Mapping[str, Amplitude]  # ``effect: parameter`` -> size
    z: float | None  # score at the base fit
    z_given_rivals: float | None  # least amplitude over error in the set
    closed: float | None
    closed_ci: tuple[float | None, float | None]


class Untestable(NamedTuple):
    """An effect that this data cannot show, and what it needs for that."""

    effect: str
    needs: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """Smallest unlisted remainder (rms) and amplitudes that would have been seen."""

    remainder: float
    smallest_effects: Mapping[str, float]

    REMAINDER = "smallest unlisted remainder that would have been seen"

    def as_json(self) -> Mapping:
        return {self.REMAINDER: self.remainder, "smallest_effects": self.smallest_effects}


class Forecast(NamedTuple):
    """An effect of its usual size on these rows, and probabilities."""

    effect: str
    amplitude: float
    unit: str
    seen: float
    recognised: float  # seen and recognised
    taken_for: str | None  # else; None: hardly ever anything


class NextMeasurement(NamedTuple):
    """What to add, the two effects that it separates, and the probabilities to tell
    them apart without and with it."""

    add: str
    separates: tuple[str, str]
    p_now: float
    p_after: float


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What was known and asked for."""

    rig: Rig
    effects: tuple[str, ...]  # ids looked for
    holdout: tuple[str, ...]  # sha256 of files held out
    forces: tuple[str, ...] | None = None  # that matter, None for all
