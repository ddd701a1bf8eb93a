"""The details of a diagnosis, for ``--full`` and the page."""

from collections.abc import Iterator

from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.effects.measurement import RELATIVE
from tirefit.diagnosis.extended import SCHEMA
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.models import MODELS
from tirefit.params import specs
from tirefit.report.diagnosis_sections import both_described, gap_line, missing_lines, of_effects
from tirefit.report.diagnosis_words import (
    amount_text,
    amplitude_text,
    covariate_text,
    name_of,
    p_text,
    range_text,
    said_unit,
    set_name,
    share_text,
    slip_check_line,
)
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.page import Section

_LEAST = 0.005  # smallest probability of a candidate that is listed
_SEEN = 0.5  # an effect with a lower probability of detection may be present unseen


def details(result: Diagnosis) -> list[Section]:
    """Sections on the gap, where it lies, all candidates, forecast, noise, settings."""
    gap = result.gap
    gaps = [gap_line(result, gap, f"the {result.n} rows fitted")]
    if gap.holdout is not None:
        gaps.append(gap_line(result, gap.holdout, gap.holdout.on))
    of_changed = "The simulator, changed: " if both_described(result) else ""
    changed = of_effects(result) if of_changed else []
    return [
        *(one._replace(title=f"{of_changed}{one.title}") for one in changed),
        Section("Gap on the rows fitted", gaps),
        Section("Runs (each fitted with its own offset)", list(run_lines(result))),
        Section("Where the gap lies", (), _where(result)),
        Section(
            "Candidates (probability of exactly this set, by the evidence)",
            list(_candidate_lines(result)),
        ),
        Section(f"{of_changed}Parameters", (), _parameters(result)),
        Section("Hard to tell on this data (forecast)", confused_lines(result)),
        Section("Also not testable", missing_lines(result)[1]),
        Section("Data and settings", list(_settings(result))),
    ]


def run_lines(result: Diagnosis) -> Iterator[str]:
    """Differences between the runs of the file, one line for each kind of offset."""
    for kind, runs in result.runs.items():
        factor, unit = said_unit(runs.unit)
        common = f"{amount_text(runs.common, runs.std, runs.unit)} for all "
        if runs.unit == RELATIVE:  # what is common is the tire's own parameter
            common = ""
        spread = amount_text(runs.spread, None, runs.unit, 2)
        low, high = (format_number(factor * end, 2) for end in runs.spread_ci)
        own = (
            f"{name} {format_estimate(factor * value, factor * std)}"
            for name, (value, std) in runs.values.items()
        )
        yield (
            f"{name_of(kind)}: {common}{len(runs.values)} runs, standard"
            f" deviation between runs {spread} [{low}, {high}], p"
            f" {p_text(runs.p_value)} of none;"
            f" each run{f' [{unit}]' * bool(unit)}: {', '.join(own)}"
        )


def _where(result: Diagnosis) -> list[tuple[str, ...]]:
    rows = [
        (covariate_text(one.covariate), range_text(one), share_text(one.share), p_text(one.p_value))
        for one in result.where
    ]
    return [("quantity", "range", "share of energy", "p of noise"), *rows]


def _candidate_lines(result: Diagnosis) -> Iterator[str]:
    for one in result.candidates:
        if one.probability < _LEAST:
            continue
        line = f"{one.probability:.3f}  {set_name(one.effects)}"
        for name, amplitude in one.parameters.items():
            line += f"; {name_of(name.partition(': ')[0])} {amplitude_text(amplitude)}"
        yield line


def _parameters(result: Diagnosis) -> list[tuple[str, ...]]:
    model = MODELS.get(result.model)
    units = {k: f"[{spec.unit}]" for k, spec in specs(model).items()} if model else {}
    if changes := result.verdict.parameters:
        rows = [
            (
                f"{name} {units.get(name, '')}",
                format_number(one.simulated),
                format_estimate(one.measured, one.std),
                "yes" if one.differs else "no",
            )
            for name, one in changes.items()
        ]
        return [("parameter", "simulated", "measured", "differs"), *rows]
    after = result.extended_parameters
    pairs = [
        (f"{name} {units.get(name, '')}", format_number(value), format_number(after.get(name)))
        for name, value in result.base_parameters.items()
    ]
    return [("parameter", "model alone", "with the answer"), *pairs]


def confused_lines(result: Diagnosis, most: int = 6) -> list[str]:
    """Sentences on effects that these rows would confuse with others, and on effects
    that they would not detect at their usual amplitude."""
    lines = [
        f"{name_of(chance.effect)} of"
        f" {amount_text(chance.amplitude, None, chance.unit, 2)}: recognised with"
        f" probability {chance.recognised:.2f}, else taken for"
        f" {name_of(chance.taken_for)}"
        for chance in sorted(result.forecast, key=lambda one: one.recognised)
        if chance.taken_for and chance.seen >= max(_SEEN, chance.recognised / 0.75)
    ]
    unseen = [
        name_of(chance.effect)
        for chance in result.forecast
        if chance.seen < _SEEN and chance.effect not in result.verdict.effects
    ]
    at_usual_size = f"not seen here at their usual size: {', '.join(unseen)}"
    return lines[:most] + [at_usual_size] * bool(unseen)


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
        yield slip_check_line(result.slip_check)
    if settings.rig is not None:
        rig = {k: v for k, v in vars(settings.rig).items() if v}
        rig |= {f"noise.{k}": v for k, v in rig.pop("noise", {}).items()}
        known = ", ".join(f"{k} = {v}" for k, v in rig.items() if k != "notes")
        yield f"known of the rig: {known or 'nothing'}"
        out = [effect.id for effect in EFFECTS if effect.id not in settings.effects]
        if out:
            yield f"not looked for: {', '.join(out)}"
    yield f"files held out: {len(settings.holdout) or 'none'}; {SCHEMA}"
    yield from (f"excluded: {reason}" for reason in data.set_aside)
    yield from (*data.motion, *data.assumptions)
