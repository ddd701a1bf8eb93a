"""``tirefit convert``: a Magic Formula as a brush."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

from tirefit.cli.commands.fit_one import fit_files, fit_into
from tirefit.cli.options import (
    File,
    Folder,
    Number,
    SeedOrNone,
    SignsOption,
    Text,
    model_names,
    option,
    say,
    start_jax,
    warn_of,
)
from tirefit.cli.output import check_results
from tirefit.results import InputProblem, UsageError, exit_code

if TYPE_CHECKING:
    from tirefit.fitting.result import FitResult


_SLIP_MAX = 0.3
_SHARES_OF_NOMINAL = (0.5, 1.0, 1.5)

Force = StrEnum("Force", "fx fy")


def convert(
    file: Annotated[
        File, typer.Argument(metavar="[FILE.tir]", help="Magic Formula 5.2, 6.1 or 6.2")
    ] = None,
    *,
    out: Folder,
    magic_formula: Annotated[
        Text, option("B,C,D,E", "coefficients of one curve, instead of a .tir file")
    ] = None,
    model: Annotated[
        Text, option("", "brush model to fit (default: brush)", autocompletion=model_names)
    ] = None,
    force: Annotated[Force | None, option("", "force to convert (default: fx)")] = None,
    slip_max: Annotated[
        Number, option("", f"largest sigma_x or alpha [rad] (default: {_SLIP_MAX})")
    ] = None,
    slip_min: Annotated[Number, option("", "smallest slip (default: minus the largest)")] = None,
    loads: Annotated[Text, option("N,N,...", "loads [N] (default: 0.5, 1 and 1.5 FNOMIN)")] = None,
    signs: SignsOption = None,
    seed: SeedOrNone = None,
) -> None:
    """Convert a Magic Formula to a brush.

    The standard errors are those of the systematic misfit over the slips and loads: the
    curve has no noise.
    """
    coefficients, slips, chosen = _checked(file, magic_formula, slip_min, slip_max, loads, out)
    if signs and file is None:
        raise UsageError("--signs applies to .tir files only", "leave it out")
    result = _refit(
        file, coefficients, model or "brush", force or Force.fx, slips, chosen, seed, out, signs
    )
    raise typer.Exit(exit_code(result.outcomes))


def _checked(
    file: Path | None,
    magic_formula: str | None,
    slip_min: float | None,
    slip_max: float | None,
    loads: str | None,
    out: Path,
) -> tuple[Any, Any, Any]:
    """(coefficients by name or None, slips (n,), loads or None); raises all problems."""
    import numpy as np

    problems: list[InputProblem] = []
    if (file is None) == (magic_formula is None):
        reason = "no curve" if file is None else "FILE.tir and --magic-formula"
        remedy = "give one FILE.tir, or --magic-formula B,C,D,E"
        problems.append(InputProblem(reason, remedy))
    coefficients = None
    if magic_formula is not None:
        values = _listed("--magic-formula", magic_formula, problems)
        if values and len(values) != 4:
            reason = f"--magic-formula {magic_formula!r}: {len(values)} numbers"
            problems.append(InputProblem(reason, "give four: B,C,D,E"))
        coefficients = dict(zip("BCDE", values, strict=False))
        if loads is None:
            remedy = "name them, as in --loads 2000,4000"
            problems.append(InputProblem("--magic-formula has no nominal load", remedy))
    chosen = None if loads is None else _listed("--loads", loads, problems)
    if chosen and (min(chosen) <= 0 or len(set(chosen)) < len(chosen)):
        problems.append(InputProblem(f"--loads {loads!r}", "positive loads [N], each once"))
    high = _SLIP_MAX if slip_max is None else slip_max
    low = -high if slip_min is None else slip_min
    if not -1 < low < high < 1:
        reason = f"slips from {low:g} to {high:g}"
        problems.append(InputProblem(reason, "-1 < --slip-min < --slip-max < 1"))
    UsageError.raise_for(problems)
    check_results(fit_files(out))
    return coefficients, np.linspace(low, high, 61), chosen  # slips of the grid, both ends included


def _listed(option: str, text: str, problems: list[InputProblem]) -> list[float]:
    """Finite numbers separated by commas; faults are added to ``problems``."""
    try:
        listed = [float(part) for part in text.split(",")]
        if all(abs(number) < float("inf") for number in listed):
            return listed
    except ValueError:
        pass
    problems.append(InputProblem(f"{option} {text!r}", "give numbers between commas"))
    return []


def _refit(
    file: Path | None,
    coefficients: Any,
    model: str,
    force: Force,
    slips: Any,
    loads: Any,
    seed: int | None,
    out: Path,
    signs: str | None,
) -> "FitResult":
    """Fit the model to the curve, print the result and save it in the folder."""
    from tirefit.data.tir.tir import read_tir

    tir = None if file is None else read_tir(file)
    start_jax()
    from tirefit.data.table import Source
    from tirefit.fitting.predict import curve, misfit_by_load
    from tirefit.fitting.problem.build import find_model
    from tirefit.fitting.problem.config import FitConfig, NoiseConfig
    from tirefit.fitting.problem.likelihood import CHANNEL_SLIP
    from tirefit.fitting.tir import check_gives, own_tire, remarks, tire_of
    from tirefit.models import AbstractTire

    find_model(model)
    # A curve has no outliers.
    noise = NoiseConfig(loss="squares")
    channel = cast(Literal["fx", "fy"], force.value)
    settings = FitConfig(model=model, force=[channel], seed=seed or 0, noise=noise)
    if tir is None:
        tire: AbstractTire | str = "magic-formula"
        v, name = None, "Magic Formula"
        name += "".join(f", {key} = {value:g}" for key, value in coefficients.items())
    else:
        check_gives(tir, force.value)
        described = own_tire(tir)
        tire = of_file = tire_of(tir, signs=signs)
        name = f"{file}: Magic Formula {tir.version}"
        name += f" in signs {signs}" if signs else ""
        v, nominal = described.nominal.LONGVL, described.nominal.FNOMIN
        loads = loads or [share * nominal for share in _SHARES_OF_NOMINAL]
    assumptions = (
        f"{name}: {force.value} at {len(slips)} slips, {CHANNEL_SLIP[force]} ="
        f" {slips[0]:g} to {slips[-1]:g}, F_z ="
        f" {', '.join(f'{load:g}' for load in loads)} N",
        "the curve has no noise: errors are those of the systematic misfit over these"
        " slips and loads, with the effective number of rows",
    )
    source = Source(path=str(file or ""), assumptions=assumptions)
    data = curve(tire, force, slips, loads, values=coefficients, v=v, source=source)
    warn_of(remarks(tir, of_file, data, signs) if tir else (), file)
    result = fit_into(out, data, settings)
    say("MISFIT")
    for load, rmse in misfit_by_load(result).items():
        say(f"  F_z {load:g} N: RMSE {rmse:.4g} N, {rmse / load:.2%} of F_z")
    return result
