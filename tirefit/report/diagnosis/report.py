"""A diagnosis as text, as one self-contained page, and as a fragment for notebooks; and the
details, for ``--full`` and the page."""

from collections.abc import Iterator, Sequence
from typing import Any

from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.engine.decide import Status
from tirefit.diagnosis.extended import SCHEMA
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.models import MODELS
from tirefit.params import specs
from tirefit.report.diagnosis import sections, words
from tirefit.report.diagnosis.answer import answer
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.page import Rows, Section, fragment, page, report_text, verdict_of, wrapped

_LEAST = 0.005  # smallest probability of a candidate that is listed


def diagnosis_text(result: Diagnosis, full: bool = False) -> str:
    """The report of one file: the answer first, then what to do.

    Args:
        full: with where the gap lies, all candidates, forecast, noise and settings.
    """
    parts = sections.first_screen(result) + (_details(result) if full else [])
    more = "" if full else "; details: --full, or the JSON document"
    first = Section("Answer", [answer(result), *sections.head_lines(result)])
    head = wrapped(f"DIAGNOSIS of {sections.subject(result)}", "", " " * 6)
    foot = wrapped(sections.foot_line(result) + more, "", " " * 6)
    return "\n".join([*head, report_text([first, *parts]), *foot])


def diagnosis_page(result: Diagnosis) -> str:
    """The whole diagnosis as one HTML document, without script or external files: the answer,
    the figures, the tables, the settings."""
    details = [section._replace(folded=True) for section in _details(result)]
    parts = [*_first(result), *details, Section("", [sections.foot_line(result)])]
    return page(sections.subject(result), parts, _verdict(result), record=result.to_json())


def diagnosis_fragment(result: Diagnosis) -> str:
    """The answer, the figures and the first screen for a notebook."""
    title = f"{sections.subject(result)}, {result.n} rows"
    return fragment(title, _first(result), _verdict(result))


def _verdict(result: Diagnosis) -> dict[str, Any]:
    is_closed = result.verdict.status in (Status.NONE, Status.NAMED)
    return verdict_of(answer(result), list(sections.head_lines(result)), is_closed)


def _first(result: Diagnosis) -> list[Section]:
    from tirefit.report.canvas import images_of  # Matplotlib
    from tirefit.report.diagnosis.figures import panels_of

    pictures = images_of(panels_of(result).values())
    return [Section("", pictures=pictures), *sections.first_screen(result)]


# --- details --------------------------------------------------------------------------


def _details(result: Diagnosis) -> list[Section]:
    """Sections on the gap, where it lies, all candidates, forecast, noise, settings."""
    gaps = [sections.gap_line(result, result.gap, f"the {result.n} rows fitted")]
    of_changed = "The simulator, changed: " if sections.both_described(result) else ""
    changed = sections.of_effects(result) if of_changed else []
    where = [("quantity", "range", "share of energy", "p of noise")]
    for region in result.where:
        place = words.covariate_text(region.covariate), words.range_text(region)
        where.append((*place, words.share_text(region.share), words.p_text(region.p_value)))
    candidates = []
    for item in (x for x in result.candidates if x.probability >= _LEAST):
        names = {name.partition(": ")[0]: size for name, size in item.parameters.items()}
        sizes = (f"{words.name_of(k)} {words.amplitude_text(x)}" for k, x in names.items())
        text = "; ".join([words.set_name(item.effects), *sizes])
        candidates.append(f"{item.probability:.3f}  {text}")
    title = "Candidates (probability of exactly this set, by the evidence)"
    return [
        *(item._replace(title=f"{of_changed}{item.title}") for item in changed),
        Section("Gap on the rows fitted", gaps),
        Section("Where the gap lies", (), where),
        Section(title, candidates),
        Section(f"{of_changed}Parameters", (), _parameters(result)),
        Section("Also not testable", sections.missing_lines(result)[sections.MOST_MISSING :]),
        Section("Data and settings", list(_settings(result))),
    ]


def _parameters(result: Diagnosis) -> Rows:
    model = MODELS.get(result.model)
    units = {k: f"[{spec.unit}]" for k, spec in specs(model).items()} if model else {}
    rows: list[Sequence[str]]
    if changes := result.verdict.parameters:
        rows = [("parameter", "simulated", "measured", "differs")]
        for name, change in changes.items():
            sizes = format_number(change.simulated), format_estimate(change.measured, change.std)
            differs = "yes" if change.differs else "no"
            rows.append((f"{name} {units.get(name, '')}", *sizes, differs))
        return rows
    rows = [("parameter", "model alone", "with the answer")]
    for name, value in result.base_parameters.items():
        after = format_number(result.extended_parameters.get(name))
        rows.append((f"{name} {units.get(name, '')}", format_number(value), after))
    return rows


def _settings(result: Diagnosis) -> Iterator[str]:
    data, settings, noise = result.data, result.settings, result.noise
    yield f"data: {data.path or data.name}, sha256 {data.sha256 or '-'}"
    of_slip = f"; noise of {noise.slip_name} {format_number(noise.slip, 3)} ({noise.slip_source})"
    yield (
        f"{result.n} rows count as {result.n_effective:.0f} in a fit of the model, whose"
        " residuals contain its misfit, and as"
        f" {result.n / noise.inflation:.0f} where only the noise counts, after smooth functions"
        f" that represent any gap{of_slip * bool(noise.slip_name)};"
        f" {noise.outliers} rows excluded as outliers"
        f"{'; noise ' * bool(noise.flags)}{', '.join(noise.flags)}"
    )
    if result.slip_check is not None:
        yield words.slip_check_line(result.slip_check)
    if settings.rig is not None:
        known = {k: v for k, v in vars(settings.rig).items() if v}
        yield f"known of the rig: {', '.join(f'{k} = {v}' for k, v in known.items()) or 'nothing'}"
        out = [effect.id for effect in EFFECTS if effect.id not in settings.effects]
        if out:
            yield f"not looked for: {', '.join(out)}"
    yield f"files held out: {len(settings.holdout) or 'none'}; {SCHEMA}"
    yield from (f"excluded: {reason}" for reason in data.set_aside)
    yield from (*data.motion, *data.assumptions)
