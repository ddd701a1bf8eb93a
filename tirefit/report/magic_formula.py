"""The report of a fitted Magic Formula as text and as HTML."""

from math import isnan, log, sqrt

from tirefit.data.table import CANONICAL, FORCES
from tirefit.fitting.mf.parts import PARTS
from tirefit.fitting.mf.result import ORIGINS, MagicFormulaFit
from tirefit.params import specs
from tirefit.report.labels import fit_files
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.text import column_texts, table, wrapped
from tirefit.results import Outcome

_UNIT = {force: CANONICAL[force][0] for force in FORCES}


def magic_formula_report(fit: MagicFormulaFit, full: bool = False) -> str:
    """Residuals, noise, predictions of rows left out, guards and verdict of a fit.

    Args:
        full: with the stages, every guard and every coefficient.
    """
    lines = [f"MAGIC FORMULA {fit.model}, tirefit {fit.version}"]
    several = ", " in fit.data["file"]
    lines += wrapped("file", fit_files(fit) if several else fit.data["file"])
    lines += wrapped("convention", f"{fit.data['convention']} read; SI, ISO-W in .tir")
    columns, others = column_texts(fit.data["assumptions"])
    lines += wrapped("columns", columns) if columns else []
    for i, note in enumerate((*others, *fit.notes)):
        lines += wrapped("assumptions" if i == 0 else "", note)
    lines += _stages(fit) if full else []
    lines += _forces(fit)
    lines += _left_out(fit)
    lines += _guards(fit, full)
    lines += _tables(fit) if full else _undetermined(fit)
    return "\n".join([*lines, "", *_verdict(fit)])


def _undetermined(fit: MagicFormulaFit) -> list[str]:
    """The names of the coefficients that the data determine less than their priors."""
    lines = ["", "COEFFICIENTS (values and standard errors: --full, fit.json)"]
    for origin in ORIGINS:
        names = [name for name, one in fit.coefficients.items() if one.origin == origin]
        if names:
            message = f"{len(names)} coefficients" if origin == "fitted" else ", ".join(names)
            lines += wrapped(origin, f"{message}: {ORIGINS[origin]}")
    return lines


def _tables(fit: MagicFormulaFit) -> list[str]:
    """Every coefficient, by part of the tire, and what the origins mean."""
    lines = [line for part in fit.parts for line in _coefficients(fit, part)]
    there = {one.part for one in fit.coefficients.values()} - {*fit.parts}
    origins = {one.origin for one in fit.coefficients.values()}
    if left_out := [PARTS[part].meaning for part in PARTS if part in there]:
        message = f"{', '.join(left_out)}: given, borrowed or at the priors"
        lines += ["", *wrapped("not fitted", message)]
    lines.append("")
    for origin in (o for o in ORIGINS if o in origins):
        lines += wrapped(origin, ORIGINS[origin])
    return lines


def _stages(fit: MagicFormulaFit) -> list[str]:
    """The residuals of each stage, at its own end and at the end of the fit."""
    head = ["stage", "rows", "cells", "coefficients", "passes", "RMSE", "RMSE at end"]
    rows = [head]
    for stage in fit.stages:
        unit = _UNIT[stage.force]
        passes = str(stage.steps) if stage.converged else f"{stage.steps} (limit)"
        cells = [stage.name, str(stage.rows), str(stage.cells), str(stage.moved)]
        sizes = (stage.rmse, stage.rmse_at_end)
        rows.append([*cells, passes, *(f"{format_number(s)} {unit}" for s in sizes)])
    lines = ["", "STAGES (RMSE of the means of cells, at end of stage and of fit)"]
    return [*lines, *table(rows, right=(1, 2, 3, 4, 5, 6))]


def _forces(fit: MagicFormulaFit) -> list[str]:
    """The residuals of the rows, and the noise that the bands assume."""
    head = ["force", "rows", "RMSE", "noise: constant", "of F_z", "of force"]
    rows = [[*head, "std errors", "independent"]]
    for force, (rmse, count) in fit.fitted.items():
        law, unit = fit.noise[force], _UNIT[force]
        each = fit.inflation[force]
        rows.append(
            [
                force,
                str(count),
                f"{format_number(rmse)} {unit}",
                f"{format_number(law.constant)} {unit}",
                f"{law.share:.2%}" if unit == "N" else f"{law.share * 1e3:.2f} mm",
                f"{law.of_force:.1%}",
                f"x {fit.wider[force]:.2f}",
                "every row" if each < 1.5 else f"1 in {each:.0f}",
            ]
        )
    lines = ["", "FORCES", *table(rows, right=(1, 2, 3, 4, 5, 6))]
    errors = ", ".join(f"{f} {sqrt(log(2)) * law.beyond:.0%}" for f, law in fit.noise.items())
    message = "the measured loads, the bands contain an error of the formula. At twice the"
    message += f" largest load its standard deviation, relative to the force, is {errors}"
    return [*lines, *wrapped("beyond", message)]


def _left_out(fit: MagicFormulaFit) -> list[str]:
    """The predictions of the parts that were left out."""
    if not fit.left_out:
        message = "nothing (--leave-out none, or fewer than three loads): the bands are"
        message += " not checked against rows left out"
        return ["", *wrapped("left out", message)]
    head = ["left out", "force", "rows", "RMSE", "RMSE if fitted", "rows in 95 % band"]
    rows = [head]
    for part in fit.left_out:
        unit = _UNIT[part.force]
        sizes = (part.rmse, part.rmse_of_all)
        rmse = (f"{format_number(size)} {unit}" for size in sizes)
        within = "-" if isnan(part.within) else f"{part.within:.0%}"
        rows.append([part.label, part.force, str(part.rows), *rmse, within])
    lines = ["", "LEFT OUT (predicted from the other rows, with their band)"]
    return [*lines, *table(rows, right=(2, 3, 4, 5))]


def _guards(fit: MagicFormulaFit, full: bool) -> list[str]:
    """Which guards hold within the data and beyond; in short, those that fail."""
    if not fit.guards:
        return []
    low, high = fit.ranges["fz"]
    lines = ["", f"GUARDS (F_z of the data: {low:.4g} to {high:.4g} N)"]
    holding = [guard.name for guard in fit.guards if guard.holds]
    if holding and not full:
        lines += wrapped("hold", ", ".join(holding))
    for guard in fit.guards:
        if guard.name in holding and not full:
            continue
        message = "holds" if guard.holds else "FAILS beyond the data"
        message = message if guard.holds_inside else "FAILS WITHIN THE DATA"
        lines += wrapped(guard.name, f"{message}: {guard.text}")
    return lines


def _coefficients(fit: MagicFormulaFit, part: str) -> list[str]:
    known = specs(fit.tire)
    rows = [["", "value ± std", "origin", "meaning"]]
    for name, one in fit.coefficients.items():
        if one.part == part:
            value = format_estimate(one.value, one.std if one.std else None)
            rows.append([name, value, one.origin, known[name].meaning])
    return ["", f"COEFFICIENTS, {PARTS[part].meaning}", *table(rows)]


def _verdict(fit: MagicFormulaFit) -> list[str]:
    """Whether the fit converged, or the reasons not to use it."""
    origins = [one.origin for one in fit.coefficients.values()]
    counts = [f"{origins.count(o)} {o}" for o in ORIGINS if o in origins]
    against = [text for o, text in fit.limits.items() if o is not Outcome.NOT_IDENTIFIED]
    message = "do not use this fit as it is" if against else "converged"
    lines = [f"VERDICT: {message}; coefficients: {', '.join(counts)}"]
    for text in against:
        lines += wrapped("", text)
    beyond = [one.name for one in fit.guards if one.holds_inside and not one.holds]
    if beyond:
        lines += wrapped("", f"guards that fail beyond the data: {', '.join(beyond)}")
    return lines
