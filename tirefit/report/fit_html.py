"""A fit as one self-contained page."""

from tirefit.fitting.result import SCHEMA, FitResult
from tirefit.report.fit_panels import PANELS, page_panels
from tirefit.report.fit_tables import (
    chain_rows,
    correlation_lines,
    derived_by_run,
    derived_rows,
    far_lines,
    open_lines,
    parameter_rows,
    posterior_lines,
    quality_items,
    reference_text,
    route_rows,
    rows_text,
    run_rows,
)
from tirefit.report.html import Section, page, verdict_parts
from tirefit.report.labels import fit_files, run_lines
from tirefit.report.panels import images_of

_MANY = 8  # largest number of parameters whose profiles are shown at once


def _asked(result: FitResult) -> list[str]:
    """Free parameters with bounds and priors, and ties."""
    lines = []
    for p in result.problem.layout.free:
        unit = "" if p.spec.unit == "-" else f" {p.spec.unit}"
        text = f"{p.name} free in [{p.spec.lower:g}, {p.spec.upper:g}]{unit}"
        text += ", one per run" if p.per_run else ""
        if p.prior is not None:
            text += f", prior {p.prior[0]:g} ± {p.prior[1]:g}"
        lines.append(text)
    ties = result.problem.layout.ties
    return [*lines, *(f"{t.name} = {t.factor:g} {t.other}" for t in ties)]


def _provenance(result: FitResult) -> list[str]:
    data = result.data
    file = fit_files(result) if len(data["runs"]) > 1 else data["file"]
    columns = [
        f"{name} from {header!r} in {data['units'].get(name, '-')}"
        for name, header in data["columns"].items()
    ]
    masked = [str(problem).replace("\n", " ") for problem in data["masked"]]
    more = [f"and {len(masked) - 20} more masked"] if len(masked) > 20 else []
    return [
        f"data: {file}, sha256 {data['sha256'] or '-'}",
        f"rows: {rows_text(result)}",
        f"convention of the file: {data['convention']}, slip"
        f" {data['slip_definition']}; this page is braking positive, in SI units",
        *([f"columns: {', '.join(columns)}"] if columns else []),
        f"model {result.model}, forces {', '.join(result.forces)}",
        *_asked(result),
        f"solver {result.solver}, seed {result.seed}",
        *data["assumptions"],
        *result.noise.get("notes", ()),
        *masked[:20],
        *more,
        f"tirefit {result.version}, {SCHEMA}; "
        + ", ".join(f"{k} {v}" for k, v in result.versions.items()),
    ]


_NONE = ["nothing that was asked: every parameter and derived quantity is identified"]
_ROUTES = "95 %, by each of the ways; where they agree, any will do"


def _sections(result: FitResult) -> list[Section]:
    pictures = dict.fromkeys(PANELS, list[dict]())
    pictures |= {name: images_of(panels) for name, panels in page_panels(result).items()}
    runs, at = "; ".join(run_lines(result)), f"at {reference_text(result)}; {result.source}"
    pairs = [f"correlated: {line}" for line in correlation_lines(result, most=20)]
    many = len(result.parameters) > _MANY
    quality = [f"{name}: {text}" for name, text in quality_items(result)]
    return [
        Section("", [f"runs: {runs}"] * bool(runs), (), pictures["fit"]),
        Section("Parameters", (), parameter_rows(result), (), result.source),
        Section("Derived quantities", (), derived_rows(result), (), at),
        Section("Derived quantities by run", (), derived_by_run(result), (), at),
        Section("Run by run", (), (), pictures["runs"]),
        Section("What the data do not tell", [*(open_lines(result) or _NONE), *pairs]),
        Section("Rows far from everything", far_lines(result)),
        Section("Residuals", quality, (), pictures["residuals"]),
        Section("Residuals by run", (), run_rows(result), (), "bias: measured − fitted"),
        Section("Intervals", (), route_rows(result), (), _ROUTES),
        Section("Profile likelihood of each", (), (), pictures["profile"], folded=many),
        Section("Posterior", posterior_lines(result), (), pictures["corner"]),
        Section("The chains, in order", (), chain_rows(result), pictures["trace"], folded=True),
        Section("Where this comes from", _provenance(result)),
    ]


def fit_page(result: FitResult) -> str:
    """The whole fit as one HTML document with its pictures, no script or resource."""
    subtitle = f"{', '.join(result.forces)}, {result.statistics.n} rows; braking positive, SI;"
    subtitle += f" seed {result.seed}; tirefit {result.version}"
    title = f"{result.model} fitted to {fit_files(result, 60)}"
    return page(title, _sections(result), verdict_parts(result), subtitle, result.to_json())
