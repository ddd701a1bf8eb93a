"""The report of a fitted Magic Formula as text and as a page."""

from math import isnan, log, sqrt

from tirefit.fitting.mf.parts import PARTS
from tirefit.fitting.mf.result import ORIGINS, MagicFormulaFit
from tirefit.params import specs
from tirefit.report.fit.report import EXPLORE, assumption_lines
from tirefit.report.fit.tables import FORCE_UNIT, fit_files
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.page import Section, named_lines, page, report_text, verdict_of
from tirefit.results import Outcome


def _sections(fit: MagicFormulaFit, full: bool) -> list[Section]:
    tables = [_coefficients(fit, part) for part in fit.parts] if full else []
    return [_forces(fit), _left_out(fit), _guards(fit, full), *tables, _origins(fit)]


def magic_formula_report(fit: MagicFormulaFit, full: bool = False) -> str:
    """Verdict, residuals, noise, predictions of rows left out and guards of a fit.

    Args:
        full: with every guard and every coefficient.
    """
    title = f"MAGIC FORMULA {fit.model}, tirefit {fit.version}"
    sentence, lines = _verdict(fit)
    verdict = Section("", named_lines("", lines))
    sections = [_data(fit)._replace(title=""), *_sections(fit, full)]
    first = [title, f"VERDICT: {sentence}", report_text([verdict])]
    return "\n".join([*filter(None, first), report_text(sections, apart=True)])


def magic_formula_page(fit: MagicFormulaFit) -> str:
    """The fit as one self-contained HTML page: verdict, figures, tables, data and record."""
    from tirefit.report.fit.mf_figures import page_pictures, title_of  # Matplotlib

    first = Section("", [EXPLORE], pictures=page_pictures(fit))
    sections = [first, *_sections(fit, full=True), _data(fit)]
    sentence, lines = _verdict(fit)
    verdict = verdict_of(f"Verdict: {sentence}", lines, not fit.outcomes)
    return page(title_of(fit), sections, verdict, f"tirefit {fit.version}", fit.to_json())


def _data(fit: MagicFormulaFit) -> Section:
    """File, signs, columns and assumptions."""
    file = fit_files(fit) if ", " in fit.data["file"] else fit.data["file"]
    columns, others = assumption_lines(fit.data["assumptions"], fit.notes)
    signs = ("convention", f"{fit.data['convention']} read; SI, ISO-W in .tir")
    return Section("Data and settings", [("file", file), signs, *columns, *others])


def _origins(fit: MagicFormulaFit) -> Section:
    """The names of the coefficients that the data determine less than their priors."""
    lines = []
    for origin, meaning in ORIGINS.items():
        names = [name for name, c in fit.coefficients.items() if c.origin == origin]
        if names:
            which = f"{len(names)} coefficients" if origin == "fitted" else ", ".join(names)
            lines.append((origin, f"{which}: {meaning}"))
    return Section("Coefficients", lines, note="values and standard errors: --full, fit.json")


def _coefficients(fit: MagicFormulaFit, part: str) -> Section:
    known = specs(fit.tire)
    rows = [["", "value ± std", "origin", "meaning"]]
    for name, coefficient in fit.coefficients.items():
        if coefficient.part == part:
            value = format_estimate(coefficient.value, coefficient.std or None)
            rows.append([name, value, coefficient.origin, known[name].meaning])
    return Section("Coefficients", (), rows, note=PARTS[part])


def _forces(fit: MagicFormulaFit) -> Section:
    """The residuals of the rows, and the noise that the bands assume."""
    head = ["force", "rows", "RMSE", "noise: constant", "of F_z", "of force"]
    rows = [[*head, "std errors", "independent"]]
    for force, (rmse, count) in fit.fitted.items():
        law, unit, each = fit.noise[force], FORCE_UNIT[force], fit.inflation[force]
        sizes = (f"{format_number(size)} {unit}" for size in (rmse, law.constant))
        of_load = f"{law.share:.2%}" if unit == "N" else f"{law.share * 1e3:.2f} mm"
        ends = f"x {fit.wider[force]:.2f}", "every row" if each < 1.5 else f"1 in {each:.0f}"
        rows.append([force, str(count), *sizes, of_load, f"{law.of_force:.1%}", *ends])
    errors = ", ".join(f"{f} {sqrt(log(2)) * law.beyond:.0%}" for f, law in fit.noise.items())
    message = "the measured loads, the bands contain an error of the formula. At twice the"
    message += f" largest load its standard deviation, relative to the force, is {errors}"
    return Section("Forces", [("beyond", message)], rows, right=(1, 2, 3, 4, 5, 6))


def _left_out(fit: MagicFormulaFit) -> Section:
    """The predictions of the parts that were left out."""
    if not fit.left_out:
        message = "nothing (--leave-out none, or fewer than three loads): the bands are"
        return Section("", [("left out", f"{message} not checked against rows left out")])
    rows = [["left out", "force", "rows", "RMSE", "RMSE if fitted", "rows in 95 % band"]]
    for part in fit.left_out:
        unit = FORCE_UNIT[part.force]
        rmse = (f"{format_number(size)} {unit}" for size in (part.rmse, part.rmse_of_all))
        within = "-" if isnan(part.within) else f"{part.within:.0%}"
        rows.append([part.label, part.force, str(part.rows), *rmse, within])
    note = "predicted from the other rows, with their band"
    return Section("Left out", (), rows, note=note, right=(2, 3, 4, 5))


def _guards(fit: MagicFormulaFit, full: bool) -> Section:
    """Which guards hold within the data and beyond; in short, those that fail."""
    low, high = fit.ranges["fz"]
    holding = ", ".join(guard.name for guard in fit.guards if guard.holds)
    lines = [("hold", holding)] if holding and not full else []
    for guard in fit.guards:
        if full or not guard.holds:
            beyond = "holds" if guard.holds else "FAILS beyond the data"
            message = beyond if guard.holds_inside else "FAILS WITHIN THE DATA"
            lines.append((guard.name, f"{message}: {guard.text}"))
    return Section("Guards", lines, note=f"F_z of the data: {low:.4g} to {high:.4g} N")


def _verdict(fit: MagicFormulaFit) -> tuple[str, list[str]]:
    """Whether the fit converged, and the reasons not to use it."""
    origins = [c.origin for c in fit.coefficients.values()]
    counts = [f"{origins.count(o)} {o}" for o in ORIGINS if o in origins]
    against = [text for o, text in fit.limits.items() if o is not Outcome.NOT_IDENTIFIED]
    message = "do not use this fit as it is" if against else "converged"
    return f"{message}; coefficients: {', '.join(counts)}", against
