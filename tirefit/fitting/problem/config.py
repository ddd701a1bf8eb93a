"""``fit.toml``: all settings of a fit, checked together."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    PrivateAttr,
)

from tirefit.data.rig.settings import PrepareConfig
from tirefit.door import read_toml
from tirefit.results import InputProblem
from tirefit.settings import Section, parse_settings

Force = Literal["fx", "fy", "mz"]


class Prior(Section):
    """Gaussian prior of a parameter, in its own unit."""

    mean: float
    std: PositiveFloat


class ParameterConfig(Section):
    """Settings of one parameter.

    ``value`` starts a free parameter and holds a fixed one; ``free = false`` fixes it;
    ``per_run`` estimates one value per run; ``tied`` names the parameter that it equals
    (times ``factor``).
    """

    value: float | None = None
    free: bool | None = None
    lower: float | None = None
    upper: float | None = None
    prior: Prior | None = None
    per_run: bool = False
    tied: str | None = None
    factor: float = 1.0

    def contradictions(self) -> Iterator[InputProblem]:
        rule, companion = "free = false", "value"
        idle = ["lower", "upper", "prior", "per_run"]  # keys of an estimated parameter
        if self.tied is not None:
            rule, companion, idle = f"tied = {self.tied!r}", "factor", ["value", "free", *idle]
        elif self.free is not False:
            idle = []
        for key in idle:
            if getattr(self, key) != ParameterConfig.model_fields[key].default:
                remedy = f"leave one of them out: only {companion} goes with it"
                yield InputProblem(f"{key} contradicts {rule}", remedy)
        if self.tied is None and self.factor != 1:
            yield InputProblem("factor without tied", "name the other parameter by tied")
        if self.factor == 0:
            remedy = "hold it at zero by value = 0 and free = false"
            yield InputProblem("factor = 0 ties it to nothing", remedy)
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            reason = f"lower = {self.lower:g} is not below upper = {self.upper:g}"
            remedy = "leave room between them, or hold the parameter by free = false"
            yield InputProblem(reason, remedy)


_SlipNoise = Annotated[NonNegativeFloat | None, AfterValidator(lambda std: std or None)]


class NoiseConfig(Section):
    """Standard deviations of the noise. Missing ones are estimated; missing slip noise is zero.
    ``<force>_relative`` is a fraction of the load; ``<slip>_speed`` [m/s] is noise of the slip
    velocity of the patch, a slip noise of this over v. A column of the data with the noise of every
    row, such as ``fx_std``, has precedence. ``loss``: squares of all rows, or (``trimmed``) without
    outliers (``fitting.far_rows``), or Huber's loss of all rows."""

    fx: PositiveFloat | None = None
    fy: PositiveFloat | None = None
    mz: PositiveFloat | None = None
    mx: PositiveFloat | None = None
    my: PositiveFloat | None = None
    fx_relative: PositiveFloat | None = None
    fy_relative: PositiveFloat | None = None
    sigma_x: _SlipNoise = None
    alpha: _SlipNoise = None
    sigma_x_speed: _SlipNoise = None
    alpha_speed: _SlipNoise = None
    proportional_to_load: bool = False
    loss: Literal["trimmed", "squares", "huber"] = "trimmed"
    effective_samples: Literal["estimate", "all"] = "estimate"

    def contradictions(self) -> Iterator[InputProblem]:
        for name in ("fx", "fy"):
            if None not in (getattr(self, name), getattr(self, f"{name}_relative")):
                yield InputProblem(
                    f"{name} contradicts {name}_relative",
                    "keep one: the standard deviation itself, or its share of the load",
                )


class DataConfig(Section):
    """How to read the file: see ``tirefit.read``."""

    columns: dict[str, str] = Field(default_factory=dict)
    units: dict[str, str] = Field(default_factory=dict)
    constants: dict[str, float] = Field(default_factory=dict)
    convention: Literal["braking", "iso-w", "sae", "adapted-sae"] | None = None
    slip: Literal["sigma_x", "kappa", "s", "slip_ratio"] | None = None
    rolling_radius: PositiveFloat | None = None
    mask_bad_rows: bool = False


class PosteriorConfig(Section):
    """The posterior: which sampler, and how many samples."""

    sampler: Literal["emcee", "importance"] | None = None
    walkers: Annotated[int, Field(ge=1, le=10_000)] | None = None
    effective_samples: Annotated[int, Field(ge=1, le=10_000_000)] | None = None
    max_steps: Annotated[int, Field(ge=1, le=10_000_000)] = 5000


def _listed(force: object) -> object:
    """``force = "fx"`` is short for ``force = ["fx"]``."""
    if isinstance(force, str):
        return [force]
    return list(force) if isinstance(force, tuple) else force


class FitConfig(Section):
    """The whole of ``fit.toml``."""

    model: str | None = None
    force: Annotated[list[Force], Field(min_length=1), BeforeValidator(_listed)] | None = None
    solver: Literal["optimistix", "jaxopt", "gauss-newton"] = "gauss-newton"
    starts: Annotated[int, Field(ge=1, le=10_000)] = 8
    seed: int = Field(default=0, ge=0, lt=2**32)
    data: DataConfig = DataConfig()
    noise: NoiseConfig = NoiseConfig()
    parameters: dict[str, ParameterConfig] = Field(default_factory=dict)
    posterior: PosteriorConfig = PosteriorConfig()
    prepare: PrepareConfig = PrepareConfig()
    _source: str = PrivateAttr("config")

    @property
    def source(self) -> str:
        """The origin of the settings: the path of the file, or ``config``."""
        return self._source


def parse_config(content: dict[str, Any], source: str = "config") -> FitConfig:
    """Check the content of a ``fit.toml``; ``source`` is its origin.

    Raises:
        UsageError: unknown keys, wrong types or values, contradictions; it lists all.
    """
    config = parse_settings(FitConfig, content, source)
    config._source = source
    return config


def load_config(path: str | Path) -> FitConfig:
    """Read and check ``fit.toml``.

    Raises:
        UsageError: no such file, not TOML, or an error of :func:`parse_config`.
    """
    return parse_config(read_toml(path), str(path))
