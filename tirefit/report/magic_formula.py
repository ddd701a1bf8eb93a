"""The report of a fitted Magic Formula as text and as HTML."""

import html

from tirefit.data.table import CANONICAL
from tirefit.fitting.mf.parts import PARTS
from tirefit.fitting.mf.result import ORIGINS, MagicFormulaFit
from tirefit.params import specs
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.text import table, wrapped

__all__ = ["magic_formula_fragment", "magic_formula_report"]


def magic_formula_report(fit: MagicFormulaFit) -> str:
    """What was fitted, every coefficient with its origin, noise and verdict."""
    lines = [f"MAGIC FORMULA {fit.model}, tirefit {fit.version}"]
    lines += wrapped("file", fit.data["file"])
    lines += wrapped("convention", f"{fit.data['convention']} read; SI, ISO-W in .tir")
    for note in (*fit.data["assumptions"], *fit.notes):
        lines += wrapped("assumed", note)
    lines += _stages(fit)
    lines += _forces(fit)
    lines += _guards(fit)
    for part in fit.parts:
        lines += _coefficients(fit, part)
    there = {one.part for one in fit.coefficients.values()} - {*fit.parts}
    if left_out := [PARTS[part].meaning for part in PARTS if part in there]:
        where = "at the priors, or borrowed" if _borrowed(fit) else "at the priors"
        lines += ["", *wrapped("not fitted", f"{', '.join(left_out)}: {where}")]
    lines.append("")
    origins = {one.origin for one in fit.coefficients.values()}
    for origin in (o for o in ORIGINS if o in origins):
        lines += wrapped(origin, ORIGINS[origin])
    lines += ["", _verdict(fit)]
    return "\n".join(lines)


def _borrowed(fit: MagicFormulaFit) -> bool:
    return any(one.origin == "borrowed" for one in fit.coefficients.values())


def _stages(fit: MagicFormulaFit) -> list[str]:
    rows = [["stage", "values", "coefficients", "chi2/value", "passes"]]
    for stage in fit.stages:
        ratio = f"{stage.chi2 / stage.rows:.3f}"
        cells = [stage.name, str(stage.rows), str(stage.moved), ratio, str(stage.steps)]
        rows.append(cells)
    return ["", "STAGES", *table(rows, right=(1, 2, 3, 4))]


def _forces(fit: MagicFormulaFit) -> list[str]:
    rows = [["force", "values", "RMSE", "noise, constant", "share of F_z", "", "count"]]
    for force, (rmse, count) in fit.fitted.items():
        law = fit.noise[force]
        said = "estimated" if fit.noise_estimated[force] else "given"
        each = fit.inflation[force]
        unit = CANONICAL[force][0]
        rows.append(
            [
                force, str(count), f"{format_number(rmse)} {unit}",
                f"{format_number(law.constant)} {unit}", f"{law.share:.3%}", said,
                "each row" if each == 1 else f"one of {each:.1f} rows",
            ]
        )  # fmt: skip
    return ["", "FORCES", *table(rows, right=(1, 2, 3, 4))]


def _guards(fit: MagicFormulaFit) -> list[str]:
    """What holds beyond the data, and where the rows end."""
    if not fit.guards:
        return []
    low, high = fit.ranges["fz"]
    lines = ["", f"BEYOND THE DATA (F_z {low:.4g} to {high:.4g} N)"]
    for guard in fit.guards:
        said = "holds" if guard.holds else "FAILS"
        lines += wrapped(guard.name, f"{said}: {guard.text}")
    return lines


def _coefficients(fit: MagicFormulaFit, part: str) -> list[str]:
    known = specs(fit.tire)
    rows = [["", "value ± std", "origin", "meaning"]]
    for name, one in fit.coefficients.items():
        if one.part == part:
            value = format_estimate(one.value, one.std if one.std else None)
            rows.append([name, value, one.origin, known[name].meaning])
    return ["", f"COEFFICIENTS, {PARTS[part].meaning}", *table(rows)]


def _verdict(fit: MagicFormulaFit) -> str:
    origins = [one.origin for one in fit.coefficients.values()]
    counts = [f"{origins.count(o)} {o}" for o in ORIGINS if o in origins]
    said = "converged" if fit.converged else fit.outcomes[0].value
    return f"VERDICT: {said}; coefficients: {', '.join(counts)}"


def magic_formula_fragment(fit: MagicFormulaFit) -> str:
    """The same for a notebook."""
    return f"<pre>{html.escape(magic_formula_report(fit))}</pre>"
