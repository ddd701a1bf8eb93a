"""The report of a comparison: text, figure, page."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from tirefit.diagnosis.summary.compare import Apart, Comparison
from tirefit.diagnosis.summary.forces import ForceCurve, ForceDifference
from tirefit.report.canvas import GREY, Panel, Picture, axes_panel, colors_of, images_of, together
from tirefit.report.curves import FORCE_LABEL, slip_axis
from tirefit.report.fit_tables import FORCE_UNIT
from tirefit.report.numbers import format_estimate, format_number, plain_text
from tirefit.report.page import Rows, Section, fragment, image_of, page, report_text, verdict_of
from tirefit.results import UsageError

_NAMED = 6  # largest number of parameters that do not differ and are named
_JUDGING = "diagnosis", "description"  # kinds of sources that name effects


def answer(found: Comparison) -> list[str]:
    """What differs, and what does not: parameters, forces, effects."""
    lines = [*found.meanings, *_on_numbers(found)]
    for force in found.forces:
        lines += [
            _on_force(force, name, x) for name, x in force.curves.items() if x.slip is not None
        ]
    lines += _on_effects(found)
    lines.sort(key=lambda text: " not differ" in text)  # what differs is told first
    return lines or ["the sources have nothing in common to compare"]


def _by(value: float, std: float, unit: str, errors: float) -> str:
    unit = "" if unit == "-" else f" {unit}"
    return f"{format_estimate(value, std)}{unit} ({errors:.1f} errors)"


def _on_numbers(found: Comparison) -> Iterator[str]:
    tested = [number for number in found.numbers if number.p is not None]
    yield from (f"{one.name} differs: {_difference(one)}" for one in tested if one.differs)
    same = [f"{one.name} ({one.errors:.1f} errors)" for one in tested if not one.differs]
    if same:
        more = f" and {len(same) - _NAMED} more" if len(same) > _NAMED else ""
        verb = "does" if len(same) == 1 else "do"
        yield f"{', '.join(same[:_NAMED])}{more} {verb} not differ beyond the errors"


def _difference(one: Apart) -> str:
    """The difference of the source that is farthest; of two sources, with both values."""
    assert one.difference is not None and one.std is not None and one.errors is not None
    size = _by(one.difference, one.std, one.unit, one.errors)
    known = [name for name, x in one.values.items() if x.std is not None]
    if len(known) > 2:
        return f"{one.farthest} less the mean of the others {size}"
    return f"{', '.join(f'{_cell(one, name)} in {name}' for name in known)}: difference {size}"


def _on_force(one: ForceDifference, name: str, at: ForceCurve) -> str:
    first, unit = next(iter(one.curves)), FORCE_UNIT[one.force]
    axis = slip_axis(one.slip, one.slips)
    place = float(axis.shown(np.array([at.slip]))[0])
    where = f"{one.slip} {place:.3g} {axis.unit}".removesuffix(" -") + f", F_z {at.load:.4g} N"
    share = f"rms {100 * (at.rms_share or 0):.1f} % of the largest force"
    assert at.difference is not None
    if at.error is None:
        size = f"{format_number(at.difference, 3)} {unit}"
        return f"{one.force} of {name} less {first}: up to {size} at {where}; {share}; no errors"
    verb = "differs" if at.differs else "does not differ beyond the errors"
    size = _by(at.difference, at.error, unit, abs(at.difference) / at.error if at.error else 0.0)
    return f"{one.force} {verb}: {name} less {first} up to {size} at {where}; {share}"


def _named(found: Comparison) -> dict[str, list[str]]:
    """Effect -> names of the sources in which it helps."""
    named: dict[str, list[str]] = {}
    for source in found.sources:
        for effect, standing in source.standing.items():
            if standing in ("named", "acts like one"):
                named.setdefault(effect, []).append(source.name)
    return named


def _on_effects(found: Comparison) -> Iterator[str]:
    judging, named = [source for source in found.sources if source.kind in _JUDGING], _named(found)
    if len(judging) > 1 and not named:
        yield "no diagnosis names an effect"
    for effect, where in named.items():
        sizes = [x for x in found.effects if x.name.startswith(f"{effect}: ") and x.p is not None]
        text = "in all" if len(where) == len(judging) > 1 else f"in {', '.join(where)} only"
        for size in sizes:
            same = f"its sizes agree ({size.errors:.1f} errors)"
            of = size.name.removeprefix(f"{effect}: ").replace("amplitude", "its size")
            text += f"; {f'{of} differs: {_difference(size)}' if size.differs else same}"
        yield f"{effect} is named {text}"


def _numbers_table(given: Sequence[Apart], names: Sequence[str], what: str) -> Rows:
    head = (what, *names, "difference ± error", "errors")
    rows: list[Sequence[str]] = [head]
    for one in given:
        cells = ["-"] * 2
        if one.p is not None and one.difference is not None:
            size = format_estimate(one.difference, one.std)
            size += f" ({one.farthest})" * (len(one.values) > 2)
            cells = [size, f"{one.errors:.1f}" + ": differs" * one.differs]
        unit = f" [{one.unit}]" if one.unit not in ("", "-") else ""
        name = f"{one.name.removesuffix(': amplitude')}{unit}"
        rows.append((name, *(_cell(one, name) for name in names), *cells))
    return rows


def _cell(one: Apart, name: str) -> str:
    value = one.values.get(name)
    return "-" if value is None else format_estimate(value.value, value.std)


def sections_of(found: Comparison) -> list[Section]:
    """Parameters, effects, sources, notes."""
    if found.models:
        return [_ranking(found)]
    names = [source.name for source in found.sources]
    sources = [
        f"{one.name}: {one.kind}, {one.model}{f', {one.file}' * bool(one.file)}"
        for one in found.sources
    ]
    notes = [*found.notes]
    if found.numbers or found.effects:
        notes.append(
            f"'differs': at {100 * found.level:g} % false alarms over all rows of a table;"
            " by chi-square of the scatter between the sources"
        )
    right = range(1, 2 + len(names))
    numbers = _numbers_table(found.numbers, names, "parameter")
    sizes = _numbers_table(found.effects, names, "effect")
    judging = [one for one in found.sources if one.kind in _JUDGING]
    standing = [("effect", *(one.name for one in judging))]
    for effect in _named(found):
        standing.append((effect, *(one.standing.get(effect, "not found") for one in judging)))
    return [
        Section("Parameters", (), numbers, right=right),
        Section("Effects", (), standing),
        Section("Sizes of effects", (), sizes, right=right),
        Section("Compared", sources),
        Section("Notes", notes),
    ]


def _ranking(found: Comparison) -> Section:
    """Models of the same rows, the lowest AICc first."""
    first, least = found.models[0], min(one.bic for one in found.models)
    force = found.sources[0].content["forces"][0]
    head = ("model", "k", f"RMSE [{FORCE_UNIT[force]}]", "AICc", "Δ AICc", "Δ BIC", "n_eff")
    rows: list[Sequence[str]] = [(*head, "verdict")]
    for one in found.models:
        off = f"{one.aicc:.1f}", f"{one.aicc - first.aicc:.1f}", f"{one.bic - least:.1f}"
        size = str(one.unknowns), format_number(one.rmse)
        rows.append((one.model, *size, *off, f"{one.n_effective:.0f}", one.status))
    notes = []
    for one in found.models:
        source = next(x for x in found.sources if x.model == one.model)
        values = (
            f"{name} = {'not identified' if x.std is None else format_estimate(x.value, x.std)}"
            + f" {x.unit}" * (x.unit != "-")
            for name, x in source.numbers.items()
        )
        notes.append(f"{one.model}: {', '.join(values)}")
    effective = [model.n_effective for model in found.models]
    if max(effective) > 1.1 * min(effective):
        best = min(found.models, key=lambda one: one.rmse)
        notes.append(
            "AICc and BIC count the rows of every model as"
            f" {best.n_effective:.0f}, the effective number of the closest fit"
        )
    return Section("", notes, rows, right=range(1, len(rows[0]) - 1))


def _title(found: Comparison) -> str:
    return "COMPARISON of " + ", ".join(source.name for source in found.sources)


def comparison_text(found: Comparison) -> str:
    """The answer, then the tables."""
    if found.models:
        return report_text([_ranking(found)])
    first = Section("Answer", answer(found))
    return f"{_title(found)}\n{report_text([first, *sections_of(found)])}"


def _panels(found: Comparison) -> list[Panel]:
    panels, names = [_force_panel(force) for force in found.forces], [x.name for x in found.sources]
    for given, what in ((found.numbers, "Parameters"), (found.effects, "Sizes of effects")):
        if shown := [one for one in given if one.difference is not None]:
            panels.append(_number_panel(shown, names, what))
    return panels


def _force_panel(one: ForceDifference) -> Panel:
    label, unit, _ = FORCE_LABEL[one.force]
    axis, middle = slip_axis(one.slip, one.slips), len(one.loads) // 2

    def draw(axes: Any) -> None:
        for (name, at), color in zip(one.curves.items(), colors_of(len(one.curves)), strict=True):
            x, force = axis.shown(one.slips), at.force[middle]
            if at.std is not None:
                ends = force - 1.96 * at.std[middle], force + 1.96 * at.std[middle]
                axes.fill_between(x, *ends, color=color, alpha=0.25, lw=0)
            axes.plot(x, force, color=color, lw=1.6, label=plain_text(name))

    x_label = axis.label if axis.unit == "-" else f"{axis.label} [{axis.unit}]"
    title = f"{one.force} at F_z = {one.loads[middle]:.4g} N, 95 % bands"
    return axes_panel(draw, title, x_label, f"{label} [{unit}]")


def _number_panel(given: Sequence[Apart], names: Sequence[str], what: str) -> Panel:
    """Each number about its weighted mean, in standard errors of the farthest one."""

    def draw(axes: Any) -> None:
        colors = dict(zip(names, colors_of(len(names)), strict=True))
        axes.axvline(0, color=GREY, lw=0.8)
        for row, one in enumerate(given):
            known = {k: x for k, x in one.values.items() if x.std is not None}
            value = np.array([x.value for x in known.values()])
            std = np.array([x.std for x in known.values()], float)
            weight = np.maximum(std, 1e-12) ** -2
            middle = weight @ value / weight.sum()
            for k, name in enumerate(known):
                place = row + 0.16 * (k - (len(known) - 1) / 2)
                x, bar = (value[k] - middle) / one.std, std[k] / one.std
                label = plain_text(name) if row == 0 else None
                axes.errorbar(x, place, xerr=bar, fmt="o", ms=4, color=colors[name], label=label)
        axes.set_yticks(range(len(given)), [plain_text(one.name) for one in given])
        axes.set_ylim(len(given) - 0.5, -0.4 - 0.35 * len(names))  # room for the legend

    label = "distance from the mean [errors of the difference]"
    panel = axes_panel(draw, f"{what} about their mean, ± 1 standard error", label, "")
    return panel._replace(size=(panel.size[0], 1.3 + 0.45 * len(given)))


def plot_comparison(found: Comparison) -> Picture:
    """Forces with their bands, and parameters and sizes of effects about their means."""
    if not found.drawable:
        raise UsageError("no figure: no forces and no errors to compare")
    return together(_panels(found), _title(found), "; ".join(answer(found)), "braking positive, SI")


def comparison_page(found: Comparison) -> str:
    """The comparison as one HTML document with its pictures."""
    sections = [Section("", pictures=images_of(_panels(found))), *sections_of(found)]
    first, *more = answer(found)
    return page(_title(found), sections, verdict_of(first, more, True), record=found.to_json())


def comparison_fragment(found: Comparison) -> str:
    """The tables, with the figure, for notebooks."""
    if found.models:
        return fragment("", sections_of(found))
    pictures = [image_of(plot_comparison(found), _title(found))] if found.drawable else []
    first, *more = answer(found)
    sections = [Section("", pictures=pictures), *sections_of(found)]
    return fragment(_title(found), sections, verdict_of(first, more, True))
