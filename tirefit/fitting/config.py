"""``fit.toml``: everything a fit can be told, in one file, checked at once."""

import difflib
import tomllib
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt
from pydantic import ValidationError as _ValidationError

from tirefit.results import Problem, UsageError

__all__ = [
    "DataConfig",
    "FitConfig",
    "NoiseConfig",
    "ParameterConfig",
    "PosteriorConfig",
    "load_config",
    "parse_config",
]

Force = Literal["fx", "fy", "mz"]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Prior(_Strict):
    """Gaussian prior of a parameter, in its own unit."""

    mean: float
    std: PositiveFloat


class ParameterConfig(_Strict):
    """What a fit does with one parameter.

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


class NoiseConfig(_Strict):
    """Standard deviations of the noise; what is left out is estimated or, for slip,
    taken as none. ``<force>_relative`` is a fraction of the load."""

    fx: PositiveFloat | None = None
    fy: PositiveFloat | None = None
    mz: PositiveFloat | None = None
    fx_relative: PositiveFloat | None = None
    fy_relative: PositiveFloat | None = None
    sigma_x: PositiveFloat | None = None
    alpha: PositiveFloat | None = None
    proportional_to_load: bool = False
    loss: Literal["squares", "huber", "soft-l1", "cauchy"] = "squares"
    effective_samples: Literal["estimate", "all"] = "estimate"


class DataConfig(_Strict):
    """How to read the file: see ``tirefit.read``."""

    columns: dict[str, str] = Field(default_factory=dict)
    units: dict[str, str] = Field(default_factory=dict)
    constants: dict[str, float] = Field(default_factory=dict)
    convention: str | None = None
    slip: str | None = None
    rolling_radius: PositiveFloat | None = None
    mask_bad_rows: bool = False
    slip_min: float | None = None
    slip_max: float | None = None


class PosteriorConfig(_Strict):
    """Sampling: which sampler, and how far."""

    sampler: Literal["emcee", "hmc"] = "emcee"
    ensembles: int = Field(default=4, ge=4)
    walkers: PositiveInt | None = None
    effective_samples: PositiveInt = 4000
    max_steps: PositiveInt = 5000


class FitConfig(_Strict):
    """The whole of ``fit.toml``."""

    model: str | None = None
    force: Force | Annotated[list[Force], Field(min_length=1)] | None = None
    solver: Literal["optimistix", "jaxopt", "gauss-newton"] = "optimistix"
    starts: PositiveInt = 8
    seed: int = Field(default=0, ge=0, lt=2**32)
    data: DataConfig = DataConfig()
    noise: NoiseConfig = NoiseConfig()
    parameters: dict[str, ParameterConfig] = Field(default_factory=dict)
    posterior: PosteriorConfig = PosteriorConfig()


def _keys(model: type[BaseModel], location: tuple) -> list[str]:
    """Valid keys of the table that holds the last element of ``location``."""
    for part in location[:-1]:
        field = model.model_fields.get(str(part))
        if field is not None:
            kinds = (field.annotation, *get_args(field.annotation))
            model = next(
                kind
                for kind in kinds
                if isinstance(kind, type) and issubclass(kind, BaseModel)
            )
    return list(model.model_fields)


def parse_config(content: dict, file: str = "fit.toml") -> FitConfig:
    """Check a parsed ``fit.toml``.

    Raises:
        UsageError: unknown keys, wrong types or values; every one of them.
    """
    try:
        return FitConfig.model_validate(content)
    except _ValidationError as error:
        problems = []
        for item in error.errors():
            location = item["loc"]
            key = ".".join(str(part) for part in location)
            if item["type"] == "extra_forbidden":
                valid = _keys(FitConfig, location)
                close = difflib.get_close_matches(str(location[-1]), valid, 1)
                hint = f"did you mean {close[0]!r}? " if close else ""
                remedy = f"{hint}valid keys here: {', '.join(valid)}"
                problems.append(Problem(f"unknown key {key!r}", remedy, file))
            else:
                reason = f"{key}: {item['msg']} (got {item['input']!r})"
                problems.append(Problem(reason, "correct the value", file))
        raise UsageError(problems) from None


def load_config(path: str | Path) -> FitConfig:
    """Read and check ``fit.toml``.

    Raises:
        UsageError: no such file, not TOML, or unknown or wrong entries.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
        content = tomllib.loads(text)
    except OSError as error:
        raise UsageError(
            Problem(f"cannot read it: {error.strerror}", "check the path", str(path))
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(
            Problem(f"not valid TOML: {error}", "correct the file", str(path))
        ) from None
    return parse_config(content, str(path))
