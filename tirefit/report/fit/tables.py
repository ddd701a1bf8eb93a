"""Results of a fit as table cells and sentences, with short names of runs and files.

``fit.json`` keeps the whole names; reports use the shortest names that are distinct.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from tirefit.data.run_names import clipped, label_of_run, name_pattern, run_names
from tirefit.data.table import CANONICAL, FORCES
from tirefit.fitting.result import Estimate, FitResult
from tirefit.fitting.uncertainty.derived import derived_channel, quantities, quantity_of
from tirefit.report.numbers import format_estimate, format_interval, format_number
from tirefit.report.page import Rows, first_of

if TYPE_CHECKING:  # which imports much that other fits do not need
    from tirefit.fitting.mf.result import MagicFormulaFit

FORCE_UNIT = {force: CANONICAL[force][0] for force in FORCES}
_ROUTES = ("covariance", "profile", "posterior")


def short_run(result: FitResult, run: str) -> str:
    """The part of a run's name that differs from the others."""
    runs = [str(run) for run in result.data["runs"]]
    return run_names(runs).short[runs.index(run)] if run in runs else run


def short_label(result: FitResult, label: str) -> str:
    """``mu[run01]``: a parameter or derived quantity, with its run's short name."""
    return label_of_run(label, result.data["runs"])


def run_lines(result: FitResult) -> list[str]:
    """Lines that explain the short names; empty if they are the full names."""
    runs = [str(run) for run in result.data["runs"]]
    names = run_names(runs)
    if names.short == tuple(runs):
        return []
    if names.pattern:
        between = ", " if len(runs) == 2 else " ... "
        return [f"{names.short[0]}{between}{names.short[-1]} of {names.pattern}"]
    return [f"{i}: {run}" for i, run in enumerate(runs, 1)]


def fit_files(result: "FitResult | MagicFormulaFit", most: int = 1000) -> str:
    """The file of a fit without its folder; of several their number and pattern."""
    files = result.data["file"].replace("\\", "/").split(", ")
    if not 1 < len(files) <= len(result.data["runs"]):
        return clipped(result.data["file"].replace("\\", "/").rsplit("/", 1)[-1], most)
    pattern = name_pattern([file.rsplit("/", 1)[-1] for file in files])
    return clipped(f"{len(files)} files, {pattern}", most)


def value_text(estimate: Estimate) -> str:
    """``value ± std``, ``value (fixed)`` or ``not identified``."""
    if estimate.fixed:
        return f"{format_number(estimate.value)} (fixed)"
    if not estimate.identified:
        return "not identified"
    return format_estimate(estimate.value, estimate.std)


def _row(name: str, value: str, estimate: Estimate, note: str) -> list[str]:
    interval = format_interval(estimate.ci95, estimate.std)
    return [name, value, estimate.unit, interval, note]


def parameter_rows(result: FitResult) -> Rows:
    """Every parameter, including fixed and tied ones, with warnings on it."""
    rows = [["parameter", "value ± std", "unit", "95 % interval", ""]]
    for name, estimate in result.parameters.items():
        notes = ["at its bound"] if name in result.statistics.at_bound else []
        if not estimate.identified and np.isfinite(estimate.value):
            notes.append(f"best {format_number(estimate.value)}")
        notes += ["routes differ"] if name in result.verdict.disagreements else []
        label, note = short_label(result, name), ", ".join(notes)
        rows.append(_row(label, value_text(estimate), estimate, note))
    return rows


def route_rows(result: FitResult) -> Rows:
    """The 95 % interval of each free parameter by each route."""
    routes = [route for route in _ROUTES if result.intervals.get(route)]
    rows = [["95 % interval", *routes]]
    for label in result.labels:
        std = result.least_squares[label].std
        ends = [result.intervals[route].get(label, (None, None)) for route in routes]
        rows.append([short_label(result, label), *(format_interval(end, std) for end in ends)])
    return rows


def reference_text(result: FitResult) -> str:
    """Load and speed at which the derived quantities are computed."""
    at = f"F_z = {format_number(result.reference['fz'])} N"
    if result.reference.get("v"):
        at += f", v = {result.reference['v']:.3g} m/s"
    if any("[" in key for key in result.reference):
        at += "; for runs at another load or speed, at their own"
    return at


def derived_rows(result: FitResult) -> Rows:
    """The derived quantities that are the same for all runs."""
    channel = derived_channel(result.forces)
    rows = [["quantity", "value ± std", "unit", "95 % interval", ""]]
    if channel is None:
        return rows
    at_peak = result.derived.get("slip_at_peak")
    meanings = quantities(channel, at_peak is None or bool(np.isfinite(at_peak.value)))
    for name, estimate in result.derived.items():
        if name == quantity_of(name):
            text = value_text(estimate) if np.isfinite(estimate.value) else "not defined"
            rows.append(_row(name, text, estimate, meanings[name][1]))
    return rows


def _noise_model(result: FitResult) -> str:
    """The distribution that the likelihood assumes for the noise."""
    loss = result.noise.get("loss", "squares")
    if loss == "squares":
        return "normal in every row"
    if loss != "trimmed":
        return f"loss {loss} in every row"
    aside = result.data.get("set_aside", 0)
    return (
        f"normal; rows further than {result.noise['limit']:.1f} standard deviations"
        f" from the prediction of the others are excluded ({aside or 'none'})"
    )


def _differs(record: dict[str, Any]) -> str:
    """How the noise of a force varies between rows; empty if it is constant."""
    text = ""
    if "share_of_force" in record:
        text = (
            f"; by row {format_number(record['constant'], 3)} N,"
            f" {100 * record['share_of_load']:.2g} % of the load and"
            f" {100 * record['share_of_force']:.2g} % of the force, added in quadrature"
        )
    if "by_run" in record:
        least, most = min(record["by_run"].values()), max(record["by_run"].values())
        text += f"; times {least:.2g} to {most:.2g} by run"
    return text


def noise_text(result: FitResult) -> str:
    """Standard deviation of each noise, its source, and the distribution assumed; for noise of
    a slip also its part of the scatter, and what is assumed of the true slips."""
    parts, of_slip = [], ""
    for name, record in result.noise.items():
        if isinstance(record, dict) and "median_std" in record:
            unit = FORCE_UNIT.get(name, "rad" if name == "alpha" else "-")
            unit = "" if unit == "-" else f" {unit}"
            std = format_number(record["median_std"], 3)
            parts.append(f"{name} {std}{unit} ({record['source']}{_differs(record)})")
            for force, share in record.get("share_of_variance", {}).items():
                of_slip += f"; noise of {name}: {100 * share:.2g} % of the variance of {force}"
    if of_slip:
        of_slip += " about its prediction; true slips: a smooth density that is estimated here"
    return f"{', '.join(parts)}; {_noise_model(result)}{of_slip}"


def quality_items(result: FitResult) -> list[tuple[str, str]]:
    """(name, text) of misfit, information criteria, noise and solution."""
    s = result.statistics
    rmse = f"{format_number(s.rmse)} {FORCE_UNIT[result.forces[0]]}   R² {s.r2:.5f}"
    ending = "converged" if s.converged else "NOT CONVERGED"
    how = f"{s.starts_agreeing} of {s.starts} starts ({result.solver})"
    items = [
        ("RMSE", f"{rmse}   {s.n} rows count as {s.n_effective:.0f}"),
        ("χ²/dof", "" if s.chi2_dof is None else format_number(s.chi2_dof, 3)),
        ("information", f"AICc {s.aicc:.2f}   BIC {s.bic:.2f}   dof {s.dof:.0f}"),
        ("noise", noise_text(result)),
        ("solution", f"{ending}, {how}, seed {result.seed}"),
    ]
    return [item for item in items if item[1]]


def run_rows(result: FitResult) -> Rows:
    """Rows, RMSE and bias of every run, if there are several."""
    problem, name = result.problem, result.forces[0]
    rows = [["run", "rows", f"RMSE [{FORCE_UNIT[name]}]", "bias"]]
    if len(result.data["runs"]) < 2:
        return rows
    residual, run = result.solved.residual(name), problem.used(problem.rows.run)
    for code in np.unique(run):
        part, label = residual[run == code], short_run(result, str(problem.layout.runs[code]))
        rms = format_number(float(np.sqrt(np.mean(part**2))), 3)
        rows.append([label, str(len(part)), rms, format_number(float(part.mean()), 2)])
    return rows


def chain_rows(result: FitResult) -> Rows:
    """Effective samples, R-hat and tau of every parameter, if chains were sampled."""
    p = result.posterior
    rows = [["parameter", "ESS", "R-hat", "τ [steps]"]]
    for label in result.labels:
        if p is not None and label in p.rhat:
            numbers = f"{p.ess[label]:.0f}", f"{p.rhat[label]:.4f}", f"{p.tau[label]:.1f}"
            rows.append([short_label(result, label), *numbers])
    return rows


def posterior_lines(result: FitResult) -> list[str]:
    """Settings and result of the sampler; empty without a posterior."""
    p = result.posterior
    if p is None:
        return []
    head = (
        f"{p.sampler}: {p.ensembles} ensembles × {p.walkers} walkers × {p.steps} steps"
        f" ({p.discarded} discarded), acceptance {p.acceptance:.2f}, seed {p.seed}"
    )
    if p.sampler == "importance":
        head = (
            f"importance: {p.steps} points of Student's t, worth {round(p.acceptance * p.steps)}"
            f" independent draws; Pareto k-hat {p.k_hat:.2f} (below 0.7: to be trusted); no chain,"
            f" so no trace; seed {p.seed}"
        )
    return [head, p.note] if p.note else [head]


def rows_text(result: FitResult) -> str:
    """Number of rows used, and the reasons for the others."""
    data = result.data
    aside = data.get("set_aside", 0)
    masked = data["rows"] - data["used"] - aside
    text = f"{data['used']} used of {data['rows']}"
    left_out = {"masked": masked, "excluded as outliers": aside}
    if any(left_out.values()):
        messages = [f"{count} {why}" for why, count in left_out.items() if count]
        text += f" ({', '.join(messages)})"
    return text + (f", {len(data['runs'])} runs" if len(data["runs"]) > 1 else "")


def far_lines(result: FitResult) -> list[str]:
    """Outliers: file, row, reason, and whether they were excluded."""
    lines = [
        f"{'excluded' if row.set_aside else 'kept'}: {row.file}, row {row.row}, column"
        f" {row.column!r}: {row.reason}"
        for row in result.far_rows
    ]
    return first_of(lines, 8, ": far_rows in fit.json")


def correlation_lines(result: FitResult) -> list[str]:
    """The pairs correlated above 0.9, the ten strongest first."""
    matrix = np.tril(np.asarray(result.correlation, float), -1)
    names = [short_label(result, label) for label in result.labels]
    pairs = sorted(np.argwhere(np.abs(matrix) > 0.9), key=lambda pair: -abs(matrix[*pair]))
    return first_of([f"{names[j]} and {names[i]}: {matrix[i, j]:+.3f}" for i, j in pairs], 10)
