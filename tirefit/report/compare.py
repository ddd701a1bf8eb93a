"""The report of a comparison: text, figure, page."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from tirefit.diagnosis.summary.compare import Apart, Comparison, Number
from tirefit.diagnosis.summary.forces import ForceCurve, ForceDifference
from tirefit.report.canvas import Panel, Picture, axes_panel, colors_of, images_of, together
from tirefit.report.diagnosis.words import name_of, readable_unit
from tirefit.report.fit.curves import FORCE_LABEL, slip_axis
from tirefit.report.fit.tables import FORCE_UNIT
from tirefit.report.numbers import bracketed, format_estimate, format_number, plain_text
from tirefit.report.page import Rows, Section, fragment, page, report_text, verdict_of
from tirefit.results import UsageError

_NAMED = 6  # largest number of parameters that do not differ and are named
_JUDGING = "diagnosis", "description"  # kinds of sources that name effects


def answer(result: Comparison) -> list[str]:
    """What differs, and what does not: parameters, forces, effects."""
    if result.models:
        names, least = _fits(result), result.models[0].aicc
        best, *others = (names[model.name] for model in result.models)
        by = (model.aicc - least for model in result.models[1:])
        above = ", ".join(f"{x:.1f} above it: {name}" for x, name in zip(by, others, strict=True))
        return [f"of these fits of the same rows, {best} has the lowest AICc ({above})"]
    lines = [*result.meanings, *_on_numbers(result)]
    for gap in result.forces:
        lines += [_on_force(gap, name, x) for name, x in gap.curves.items() if x.slip is not None]
    lines += _on_effects(result)
    lines.sort(key=lambda text: " not differ" in text)  # what differs is told first
    return lines or ["the sources have nothing in common to compare"]


def _fits(result: Comparison) -> dict[str, str]:
    """Name of a ranked source -> its model, and the name where several have this model."""
    models = [source.model for source in result.sources]
    return {
        source.name: source.model + f" ({source.name})" * (models.count(source.model) > 1)
        for source in result.sources
    }


def _by(value: float, std: float, unit: str, errors: float) -> str:
    unit = "" if unit in ("", "-") else f" {unit}"
    return f"{format_estimate(value, std)}{unit} ({errors:.1f} errors)"


def _on_numbers(result: Comparison) -> Iterator[str]:
    same = []
    for number in (number for number in result.numbers if number.p is not None):
        if number.differs:
            yield f"{number.name} differs: {_difference(number)}"
        else:
            same.append(f"{number.name} ({number.errors:.1f} errors)")
    if same:
        more = f" and {len(same) - _NAMED} more" if len(same) > _NAMED else ""
        verb = "does" if len(same) == 1 else "do"
        yield f"{', '.join(same[:_NAMED])}{more} {verb} not differ beyond the errors"


def _difference(number: Apart) -> str:
    """The difference of the source that is farthest; of two sources, with both values."""
    assert number.difference is not None and number.std is not None and number.errors is not None
    size = _by(number.difference, number.std, number.unit, number.errors)
    known = [name for name, x in number.values.items() if x.std is not None]
    if len(known) > 2:
        return f"{number.farthest} less the mean of the others {size}"
    return f"{', '.join(f'{_cell(number, name)} in {name}' for name in known)}: difference {size}"


def _on_force(gap: ForceDifference, name: str, at: ForceCurve) -> str:
    first, unit = next(iter(gap.curves)), FORCE_UNIT[gap.force]
    axis = slip_axis(gap.slip, gap.slips)
    place = float(axis.shown(np.array([at.slip]))[0])
    where = f"{gap.slip} {place:.3g} {axis.unit}".removesuffix(" -") + f", F_z {at.load:.4g} N"
    share = f"rms {100 * (at.rms_share or 0):.1f} % of the largest force"
    assert at.difference is not None
    if at.error is None:
        size = f"{format_number(at.difference, 3)} {unit}"
        return f"{gap.force} of {name} less {first}: up to {size} at {where}; {share}; no errors"
    verb = "differs" if at.differs else "does not differ beyond the errors"
    size = _by(at.difference, at.error, unit, abs(at.difference) / at.error if at.error else 0.0)
    return f"{gap.force} {verb}: {name} less {first} up to {size} at {where}; {share}"


def _named(result: Comparison) -> dict[str, list[str]]:
    """Effect -> names of the sources in which it helps."""
    named: dict[str, list[str]] = {}
    for source in result.sources:
        for effect, standing in source.standing.items():
            if standing in ("named", "acts like one"):
                named.setdefault(effect, []).append(source.name)
    return named


def _on_effects(result: Comparison) -> Iterator[str]:
    judging = [source for source in result.sources if source.kind in _JUDGING]
    named = _named(result)
    if len(judging) > 1 and not named:
        yield "no diagnosis names an effect"
    for effect, where in named.items():
        mine = [x for x in result.effects if x.name.startswith(f"{effect}: ")]
        sizes = [_in_words(x) for x in mine if x.p is not None]
        text = "in all" if len(where) == len(judging) > 1 else f"in {', '.join(where)} only"
        for size in sizes:
            same = f"its sizes agree ({size.errors:.1f} errors)"
            of = size.name.removeprefix(f"{effect}: ").replace("amplitude", "its size")
            text += f"; {f'{of} differs: {_difference(size)}' if size.differs else same}"
        claims = {source.standing.get(effect) for source in judging}
        is_named = "named" in claims
        name = name_of(effect)
        yield f"{name} is named {text}" if is_named else f"the gap acts like {name} {text}"


def _in_words(number: Apart) -> Apart:
    """The size of an effect in the unit of reports: % of the mean F_z for 1e-3 of it."""
    factor, unit = readable_unit(number.unit)
    return number._replace(
        unit=unit,
        values={
            k: Number(factor * x.value, x.std and factor * x.std, unit)
            for k, x in number.values.items()
        },
        difference=number.difference and factor * number.difference,
        std=number.std and factor * number.std,
    )


def _numbers_table(given: Sequence[Apart], names: Sequence[str], what: str) -> Rows:
    head = (what, *names, "difference ± error", "errors")
    rows: list[Sequence[str]] = [head]
    for number in given:
        cells = ["-"] * 2
        if number.p is not None and number.difference is not None:
            size = format_estimate(number.difference, number.std)
            size += f" ({number.farthest})" * (len(number.values) > 2)
            cells = [size, f"{number.errors:.1f}" + ": differs" * number.differs]
        effect, colon, amplitude = number.name.removesuffix(": amplitude").partition(": ")
        name = f"{name_of(effect) if what == 'effect' else effect}{colon}{amplitude}"
        name += bracketed(number.unit)
        rows.append((name, *(_cell(number, name) for name in names), *cells))
    return rows


def _cell(number: Apart, name: str) -> str:
    value = number.values.get(name)
    return "-" if value is None else format_estimate(value.value, value.std)


def sections_of(result: Comparison) -> list[Section]:
    """Parameters, effects, sources, notes."""
    if result.models:
        return [_ranking(result)]
    names = [source.name for source in result.sources]
    sources = [
        f"{source.name}: {source.kind}, {source.model}{f', {source.file}' * bool(source.file)}"
        for source in result.sources
    ]
    notes = [*result.notes]
    if result.numbers or result.effects:
        notes.append(
            f"'differs': at {100 * result.level:g} % false alarms over all rows of a table;"
            " by chi-square of the scatter between the sources"
        )
    right = range(1, 2 + len(names))
    numbers = _numbers_table(result.numbers, names, "parameter")
    sizes = _numbers_table([*map(_in_words, result.effects)], names, "effect")
    judging = [source for source in result.sources if source.kind in _JUDGING]
    standing = [("effect", *(source.name for source in judging))]
    for effect in _named(result):
        label = f"{name_of(effect)} ({effect})" if name_of(effect) != effect else effect
        standing.append((label, *(source.standing.get(effect, "not found") for source in judging)))
    return [
        Section("Parameters", (), numbers, right=right),
        Section("Effects", (), standing),
        Section("Sizes of effects", (), sizes, right=right),
        Section("Compared", sources),
        Section("Notes", notes),
    ]


def _ranking(result: Comparison) -> Section:
    """Models of the same rows, the lowest AICc first."""
    first, least = result.models[0], min(model.bic for model in result.models)
    force = result.sources[0].content["forces"][0]
    head = ("model", "k", f"RMSE [{FORCE_UNIT[force]}]", "AICc", "Δ AICc", "Δ BIC", "n_eff")
    rows: list[Sequence[str]] = [(*head, "verdict")]
    notes = []
    for model in result.models:
        off = f"{model.aicc:.1f}", f"{model.aicc - first.aicc:.1f}", f"{model.bic - least:.1f}"
        size = str(model.unknowns), format_number(model.rmse)
        name = _fits(result)[model.name]
        rows.append((name, *size, *off, f"{model.n_effective:.0f}", model.status))
        numbers = next(x for x in result.sources if x.name == model.name).numbers.items()
        values = (
            f"{key} = {'not identified' if x.std is None else format_estimate(x.value, x.std)}"
            + f" {x.unit}" * (x.unit != "-")
            for key, x in numbers
        )
        notes.append(f"{name}: {', '.join(values)}")
    notes.append("AICc and BIC count the rows as the effective number of the closest fit")
    return Section("", notes, rows, right=range(1, len(rows[0]) - 1))


def _title(result: Comparison) -> str:
    return "COMPARISON of " + ", ".join(source.name for source in result.sources)


def comparison_text(result: Comparison) -> str:
    """The answer, then the tables."""
    if result.models:
        return report_text([_ranking(result)])
    first = Section("Answer", answer(result))
    return f"{_title(result)}\n{report_text([first, *sections_of(result)])}"


def _force_panel(gap: ForceDifference) -> Panel:
    label, unit, _ = FORCE_LABEL[gap.force]
    axis, middle = slip_axis(gap.slip, gap.slips), len(gap.loads) // 2

    def draw(axes: Any) -> None:
        for (name, at), color in zip(gap.curves.items(), colors_of(len(gap.curves)), strict=True):
            x, force = axis.shown(gap.slips), at.force[middle]
            if at.std is not None:
                ends = force - 1.96 * at.std[middle], force + 1.96 * at.std[middle]
                axes.fill_between(x, *ends, color=color, alpha=0.25, lw=0)
            axes.plot(x, force, color=color, lw=1.6, label=plain_text(name))

    title = f"{gap.force} at F_z = {gap.loads[middle]:.4g} N, 95 % bands"
    return axes_panel(draw, title, axis.label + bracketed(axis.unit), f"{label} [{unit}]")


def plot_comparison(result: Comparison) -> Picture:
    """Forces with their bands; numbers are in the tables."""
    if not result.forces:
        raise UsageError("no figure: no forces to compare")
    panels = [_force_panel(force) for force in result.forces]
    return together(panels, _title(result), "; ".join(answer(result)), "braking positive, SI")


def comparison_page(result: Comparison, form: str = "page.html") -> str:
    """The comparison as one HTML document with its pictures."""
    pictures = images_of(map(_force_panel, result.forces))
    sections = [Section("", pictures=pictures), *sections_of(result)]
    first, *more = answer(result)
    record = result.to_json() if form == "page.html" else ""
    return page(_title(result), sections, verdict_of(first, more, True), "", record, form)


def comparison_fragment(result: Comparison) -> str:
    """The tables, with the figures, for notebooks."""
    if result.models:
        return fragment("", sections_of(result))
    return comparison_page(result, "fragment.html")
