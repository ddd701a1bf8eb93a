"""``tirefit convert``: a Magic Formula as a brush."""

from contextlib import suppress
from dataclasses import replace
from enum import StrEnum
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

from tirefit.cli import options as cli
from tirefit.cli.commands.fit_one import fit_files, fit_into
from tirefit.cli.output import check_results
from tirefit.results import UsageError, exit_code

if TYPE_CHECKING:
    from tirefit.fitting.result import FitResult


_LOADS = "loads [N] (default: 0.5, 1 and 1.5 FNOMIN)"

Force = StrEnum("Force", "fx fy")


def _numbers(text: str) -> list[float]:
    """Finite numbers separated by commas."""
    with suppress(ValueError):
        numbers = [float(part) for part in text.split(",")]
        if all(map(isfinite, numbers)):
            return numbers
    raise typer.BadParameter(f"{text!r}: give numbers between commas")


def convert(
    file: Annotated[
        cli.File, typer.Argument(metavar="FILE.tir", help="Magic Formula 5.2, 6.1 or 6.2")
    ] = None,
    *,
    out: cli.Folder,
    magic_formula: Annotated[
        Any,
        cli.option("B,C,D,E", "coefficients of one curve, instead of a .tir file", parser=_numbers),
    ] = None,
    model: Annotated[
        cli.Text,
        cli.option("", "brush model to fit (default: brush)", autocompletion=cli.model_names),
    ] = None,
    force: Annotated[Force | None, cli.option("", "force to convert (default: fx)")] = None,
    slip_max: Annotated[float, cli.option("", "largest sigma_x or alpha [rad]")] = 0.3,
    slip_min: Annotated[
        cli.Number, cli.option("", "smallest slip (default: minus the largest)")
    ] = None,
    loads: Annotated[Any, cli.option("N,N,...", _LOADS, parser=_numbers)] = None,
    signs: cli.SignsOption = None,
    seed: cli.SeedOrNone = None,
) -> None:
    """Convert a Magic Formula to a brush.

    The standard errors are those of the systematic misfit over the slips and loads: the
    curve has no noise.
    """
    import numpy as np

    if (file is None) == (magic_formula is None):
        reason = "no curve" if file is None else "FILE.tir and --magic-formula"
        raise UsageError(reason, "give one FILE.tir, or --magic-formula B,C,D,E")
    if file is None and (loads is None or signs or len(magic_formula) != 4):
        remedy = "give four numbers B,C,D,E with --loads 2000,4000, without --signs"
        reason = f"--magic-formula of {len(magic_formula)} numbers has no nominal load and no signs"
        raise UsageError(reason, remedy)
    if loads and (min(loads) <= 0 or len({*loads}) < len(loads)):
        reason = f"--loads {','.join(f'{load:g}' for load in loads)}"
        raise UsageError(reason, "give positive loads [N], each once")
    low = -slip_max if slip_min is None else slip_min
    if not -1 < low < slip_max < 1:
        reason = f"slips from {low:g} to {slip_max:g}"
        raise UsageError(reason, "-1 < --slip-min < --slip-max < 1")
    check_results(fit_files(out))
    coefficients = dict(zip("BCDE", magic_formula or (), strict=False))
    slips = np.linspace(low, slip_max, 61)  # of the grid, both ends included
    curve = file, coefficients, model or "brush", force or Force.fx, slips, loads
    result = _refit(*curve, seed, out, signs)
    raise typer.Exit(exit_code(result.outcomes))


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
    import numpy as np

    from tirefit.data.tir.tir import read_tir

    tir = None if file is None else read_tir(file)
    cli.start_jax()
    from tirefit.data.table import Source, TireData
    from tirefit.fitting.predict import predict
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
        loads = loads or [share * nominal for share in (0.5, 1.0, 1.5)]
    assumptions = (
        f"{name}: {force.value} at {len(slips)} slips, {CHANNEL_SLIP[force]} ="
        f" {slips[0]:g} to {slips[-1]:g}, F_z ="
        f" {', '.join(f'{load:g}' for load in loads)} N",
        "the curve has no noise: errors are those of the systematic misfit over these"
        " slips and loads, with the effective number of rows",
    )
    source = Source(path=str(file or ""), assumptions=assumptions)
    # The loads are the runs and the slips of each ascend: the misfit of another model is then an
    # autocorrelated residual, which reduces the effective number of rows.
    fz, run = np.repeat(np.asarray(loads, float), len(slips)), np.arange(len(loads))
    columns = {CHANNEL_SLIP[force]: np.tile(np.asarray(slips, float), len(loads)), "fz": fz}
    columns |= {} if v is None else {"v": np.full(len(fz), float(v))}
    of_load = np.repeat(run, len(slips)), tuple(f"F_z {load:g} N" for load in loads)
    rows = TireData("curve", columns, np.full(len(fz), True), *of_load, source)
    measured = predict(tire, rows, coefficients)[channel]
    data = replace(rows, columns=columns | {channel: measured})
    cli.warn_of(remarks(tir, of_file, data, signs) if tir else (), file)
    result = fit_into(out, data, settings)
    cli.say("MISFIT")
    residual = result.solved.residual(channel)
    fitted_at = result.problem.used(result.problem.rows.inputs.fz)
    for load in np.unique(fitted_at):
        rmse = float(np.sqrt(np.mean(residual[fitted_at == load] ** 2)))
        cli.say(f"  F_z {load:g} N: RMSE {rmse:.4g} N, {rmse / load:.2%} of F_z")
    return result
