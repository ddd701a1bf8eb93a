"""The report of a fit as plain text, at most 88 columns wide."""

import textwrap

import numpy as np

from tirefit.fitting.derived import derived_channel, quantities
from tirefit.fitting.likelihood import row_moments
from tirefit.fitting.result import Estimate, FitResult, PosteriorSummary
from tirefit.report.numbers import format_estimate, format_interval, format_number

__all__ = [
    "WIDTH",
    "fit_report",
    "format_estimate",
    "note_on",
    "parameter_lines",
    "table",
    "value_text",
    "verdict_line",
    "wrapped",
]

WIDTH = 88
_FORCE_UNIT = {"fx": "N", "fy": "N", "mz": "N m"}
_ROUTES = ("covariance", "profile", "posterior")


def table(rows: list[list[str]], right: tuple[int, ...] = ()) -> list[str]:
    """Lines of a table whose first row is the header, indented by two.

    Args:
        rows: cells of equal number.
        right: columns to align to the right.
    """
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            cell.rjust(width) if i in right else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append(("  " + "  ".join(cells)).rstrip())
    rule = ("  " + "  ".join("-" * width for width in widths)).rstrip()
    return [line[:WIDTH] for line in (lines[0], rule, *lines[1:])]


def _short(label: str, most: int = 24) -> str:
    return label if len(label) <= most else label[: most - 1] + "…"


def wrapped(name: str, text: str) -> list[str]:
    """Lines of a text behind its name, within the width."""
    lead = f"  {name:<13}"
    return textwrap.wrap(
        text, WIDTH, initial_indent=lead, subsequent_indent=" " * len(lead)
    ) or [lead.rstrip()]


def value_text(estimate: Estimate) -> str:
    """``value ± std``, or that it is fixed or not identified."""
    if estimate.fixed:
        return f"{format_number(estimate.value)} (fixed)"
    if not estimate.identified:
        return "not identified"
    return format_estimate(estimate.value, estimate.std)


def note_on(result: FitResult, name: str) -> str:
    """What a reader must know about one parameter; empty for most."""
    estimate = result.parameters[name]
    notes = []
    if name in result.statistics.at_bound:
        notes.append("at its bound")
    if not estimate.identified and np.isfinite(estimate.value):
        notes.append(f"best {format_number(estimate.value)}")
    if name in result.verdict.get("disagreements", {}):
        notes.append("routes differ")
    return ", ".join(notes)


def _header(result: FitResult) -> list[str]:
    data = result.data
    masked = data["rows"] - data["used"]
    rows = f"{data['used']} used of {data['rows']}"
    if masked:
        rows += f" ({masked} masked)"
    if len(data["runs"]) > 1:
        rows += f", {len(data['runs'])} runs"
    lines = [f"tirefit {result.version}: {result.model} fitted to {data['file']}"]
    lines = textwrap.wrap(lines[0], WIDTH)
    lines += ["", *wrapped("rows", rows), *wrapped("force", ", ".join(result.forces))]
    lines += wrapped(
        "convention",
        f"braking positive, SI (file: {data['convention']}, slip"
        f" {data['slip_definition']})",
    )
    notes = [*data["assumptions"], *result.noise.get("notes", ())]
    for i, note in enumerate(notes):
        lines += wrapped("assumptions" if i == 0 else "", note)
    for i, problem in enumerate(data["masked"][:5]):
        lines += wrapped("masked" if i == 0 else "", str(problem).replace("\n", " "))
    if len(data["masked"]) > 5:
        lines += wrapped("", f"and {len(data['masked']) - 5} more")
    return lines + wrapped("solver", f"{result.solver}, seed {result.seed}")


def parameter_lines(result: FitResult) -> list[str]:
    """The table of the parameters, after an empty line."""
    rows = [["parameter", "value ± std", "unit", "95 % interval", ""]]
    for name, estimate in result.parameters.items():
        rows.append(
            [
                _short(name), value_text(estimate), estimate.unit,
                format_interval(estimate.ci95, estimate.std), note_on(result, name),
            ]
        )  # fmt: skip
    return ["", f"PARAMETERS ({result.source})", *table(rows)]


def _routes(result: FitResult) -> list[str]:
    routes = [route for route in _ROUTES if result.intervals.get(route)]
    rows = [["95 % interval", *routes]]
    for label in result.labels:
        std = result.least_squares[label].std
        ends = [result.intervals[route].get(label, (None, None)) for route in routes]
        rows.append([_short(label, 18), *(format_interval(end, std) for end in ends)])
    return ["", "INTERVALS BY ROUTE", *table(rows)]


def _derived(result: FitResult) -> list[str]:
    channel = derived_channel(result.forces)
    if channel is None or not result.derived:
        return []
    at = f"F_z = {format_number(result.reference['fz'])} N"
    if result.reference.get("v"):
        at += f", v = {result.reference['v']:.3g} m/s"
    meanings = quantities(channel)
    rows = [["quantity", "value ± std", "unit", "95 % interval", ""]]
    for name, estimate in result.derived.items():
        known = np.isfinite(estimate.value)
        rows.append(
            [
                name, value_text(estimate) if known else "not defined", estimate.unit,
                format_interval(estimate.ci95, estimate.std), meanings[name][1],
            ]
        )  # fmt: skip
    return ["", f"DERIVED (at {at}; {result.source})", *table(rows)]


def _noise_text(result: FitResult) -> str:
    parts = []
    for name, record in result.noise.items():
        if isinstance(record, dict) and "median_std" in record:
            unit = _FORCE_UNIT.get(name, "rad" if name == "alpha" else "-")
            unit = "" if unit == "-" else f" {unit}"
            std = format_number(record["median_std"], 3)
            parts.append(f"{name} {std}{unit} ({record['source']})")
    return ", ".join(parts)


def _quality(result: FitResult) -> list[str]:
    s = result.statistics
    unit = _FORCE_UNIT[result.forces[0]]
    lines = ["", "QUALITY"]
    lines += wrapped("RMSE", f"{format_number(s.rmse)} {unit}   R² {s.r2:.5f}")
    if s.chi2_dof is not None:
        lines += wrapped("χ²/dof", format_number(s.chi2_dof, 3))
    lines += wrapped("information", f"AICc {s.aicc:.2f}   BIC {s.bic:.2f}")
    lines += wrapped(
        "rows", f"n {s.n}   n_effective {s.n_effective:.0f}   dof {s.dof:.0f}"
    )
    noise = _noise_text(result)
    loss = result.noise.get("loss", "squares")
    lines += wrapped("noise", noise if loss == "squares" else f"{noise}; loss {loss}")
    ending = "converged" if s.converged else "NOT CONVERGED"
    lines += wrapped("solution", f"{ending}, {s.starts_agreeing} of {s.starts} starts")
    return lines


def _by_run(result: FitResult) -> list[str]:
    """RMSE and bias of every run, where there are several."""
    problem = result.problem
    if problem is None or len(result.data["runs"]) < 2:
        return []
    name = result.forces[0]
    mean, _ = row_moments(problem, result.z)
    residual = problem.used(problem.rows.observed[name]) - mean[name]
    run = problem.used(problem.rows.run)
    rows = [["run", "rows", f"RMSE [{_FORCE_UNIT[name]}]", "bias"]]
    for code in np.unique(run):
        part = residual[run == code]
        rms = float(np.sqrt(np.mean(part**2)))
        rows.append(
            [
                _short(str(problem.layout.runs[code]), 48), str(len(part)),
                format_number(rms, 3), format_number(float(part.mean()), 2),
            ]
        )  # fmt: skip
    return ["", "BY RUN (bias: measured - fitted)", *table(rows, right=(1, 2, 3))]


def _posterior(result: FitResult) -> list[str]:
    p = result.posterior
    if p is None:
        return []
    rows = [["parameter", "ESS", "R-hat", "τ [steps]"]]
    for label in result.labels:
        if label in p.rhat:
            rows.append(
                [
                    _short(label), f"{p.ess[label]:.0f}", f"{p.rhat[label]:.4f}",
                    f"{p.tau[label]:.1f}",
                ]
            )  # fmt: skip
    said = [_posterior_head(p), p.note] if p.note else [_posterior_head(p)]
    lines = [
        line
        for text in said
        for line in textwrap.wrap(
            text, WIDTH, initial_indent="  ", subsequent_indent="  "
        )
    ]
    chains = table(rows, right=(1, 2, 3)) if p.rhat else []
    return ["", "POSTERIOR", *lines, *chains]


def _posterior_head(p: PosteriorSummary) -> str:
    """One sentence on what the sampler did."""
    if p.sampler == "importance":
        draws = round(p.acceptance * p.steps)
        return (
            f"importance: {p.steps} points of Student's t, worth {draws} independent"
            f" draws; Pareto k-hat {p.k_hat:.2f} (below 0.7: to be trusted); no chain,"
            f" so no trace; seed {p.seed}"
        )
    many = "chains" if p.sampler == "nuts" else "walkers"
    text = (
        f"{p.sampler}: {p.ensembles} ensembles × {p.walkers} {many} × {p.steps} steps"
        f" ({p.discarded} discarded), acceptance {p.acceptance:.2f}, seed {p.seed}"
    )
    return text if p.divergences is None else f"{text}, {p.divergences} divergences"


def _correlations(result: FitResult, above: float = 0.9) -> list[str]:
    matrix, labels = np.asarray(result.correlation), result.labels
    pairs = [
        (abs(matrix[i, j]), f"  {labels[j]} and {labels[i]}: {matrix[i, j]:+.3f}")
        for i in range(len(labels))
        for j in range(i)
        if abs(matrix[i, j]) > above
    ]
    if not pairs:
        return []
    pairs.sort(key=lambda pair: -pair[0])
    lines = [text[:WIDTH] for _, text in pairs[:10]]
    if len(pairs) > 10:
        lines.append(f"  and {len(pairs) - 10} more")
    return ["", f"CORRELATIONS ABOVE {above}", *lines]


def verdict_line(result: FitResult) -> str:
    """The verdict in one sentence."""
    status = result.verdict.get("status", "not judged")
    sentences = result.verdict.get("sentences", [])
    if status != "ok" and sentences:
        return f"{status}: {sentences[0]}"
    s = result.statistics
    unit = _FORCE_UNIT[result.forces[0]]
    text = f"{status}: RMSE {format_number(s.rmse, 3)} {unit}, R² {s.r2:.4f}"
    return f"{text}, every free parameter identified" if result.identified else text


def _verdict(result: FitResult) -> list[str]:
    lines = textwrap.wrap(
        f"VERDICT: {verdict_line(result)}", WIDTH, subsequent_indent="         "
    )
    sentences = result.verdict.get("sentences", [])
    rest = sentences if result.verdict.get("status") == "ok" else sentences[1:]
    for sentence in rest:
        lines += textwrap.wrap(
            sentence, WIDTH, initial_indent="       - ", subsequent_indent="         "
        )
    return ["", *lines]


def fit_report(result: FitResult) -> str:
    """Everything a reader needs of one fit; the verdict stands last."""
    parts = (
        _header, parameter_lines, _routes, _derived, _quality, _by_run, _posterior,
        _correlations, _verdict,
    )  # fmt: skip
    return "\n".join(line for part in parts for line in part(result)) + "\n"
