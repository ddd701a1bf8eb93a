"""A diagnosis as one page that needs nothing else, and as a fragment for notebooks."""

from collections.abc import Mapping

from tirefit.diagnosis.summary.result import SCHEMA, Diagnosis
from tirefit.files import write_text_atomic
from tirefit.report.diagnosis_budget import budget_lines
from tirefit.report.diagnosis_draw import diagnosis_figure, panel_names, panel_pictures
from tirefit.report.diagnosis_outlook import confused_lines, smallest_lines, step_lines
from tirefit.report.diagnosis_text import (
    gap_lines,
    rows_line,
    spot_lines,
    stand_in,
    subject,
    verdict_lines,
    verdict_sentence,
)
from tirefit.report.diagnosis_words import (
    UNLISTED,
    closed_text,
    covariate_text,
    listed_candidates,
    nothing,
    p_text,
    parameter_text,
    range_text,
    said_effects,
    share_text,
    slip_check_line,
    untestable_groups,
)
from tirefit.report.html import GOOD, OPEN, image_of, rendered
from tirefit.report.numbers import format_number

_ALTERNATIVES = {
    "where": "Map of measured minus fitted force over slip and another quantity",
    "which": "Probability of each explanation as bars",
    "before and after": "Force over slip and residuals, of the base fit and after it",
    "what is left": "What the verdict leaves: change of a parameter over what it"
    " depends on, and the fitted shape",
    "budget": "Waterfall from the simulator's error, part by part, to the noise",
    "how far": "Size of the gap before and after, on the rows and on held-out data",
}


def _alternative(name: str) -> str:
    """Of a panel by name; that of a channel goes by what comes before ``of``."""
    kind, of_channel, channel = name.partition(" of ")
    return _ALTERNATIVES[kind] + (f", of {channel}" if of_channel else "")


def _verdict(result: Diagnosis) -> Mapping:
    is_open = result.verdict.status in ("incomplete", "unknown", "cannot_tell")
    return {
        "sentence": verdict_sentence(result),
        "lines": verdict_lines(result),
        "color": OPEN if is_open else GOOD,
    }


def _where(result: Diagnosis) -> list[tuple[str, ...]]:
    return [
        ("quantity", "range", "share of the gap's energy", "p, corrected"),
        *(
            (
                covariate_text(region.covariate), range_text(region),
                share_text(region.share), p_text(region.p_value),
            )
            for region in result.where
        ),
    ]  # fmt: skip


def _map(result: Diagnosis, most: int = 10) -> list[tuple[str, ...]]:
    return [
        ("parameter", "varies with", "log evidence", "explains, at most"),
        *(
            (
                cell.parameter, covariate_text(cell.covariate),
                format_number(cell.log_evidence, 3), share_text(cell.explains),
            )
            for cell in result.map[:most]
            if cell.log_evidence > 0
        ),
    ]  # fmt: skip


def _candidates(result: Diagnosis) -> list[tuple[str, ...]]:
    none = nothing(result)
    return [
        ("effects", "family", "probability", "amplitude", "z", "z beside rivals",
         "closed"),
        *(
            (
                " + ".join(said_effects(one, result.verdict)), one.family,
                _chance(one.probability),
                parameter_text(one), format_number(one.z, 3),
                format_number(one.z_given_rivals, 3),
                closed_text(one.closed, one.closed_ci),
            )
            for one in listed_candidates(result.candidates)
        ),
        (UNLISTED, "", _chance(result.verdict.unlisted), "", "-", "-", "-"),
        *([(none[0], "", _chance(none[1]), "", "-", "-", "-")] if none else []),
    ]  # fmt: skip


def _chance(probability: float) -> str:
    return f"{probability:.3f}" if probability >= 5e-4 else "< 0.001"


def _base(result: Diagnosis) -> str:
    parts = (f"{k} = {format_number(v)}" for k, v in result.base_parameters.items())
    what = "simulator as given" if result.simulator else "base fit"
    return f"{what}, {result.model}: {', '.join(parts)}"


def _settings(result: Diagnosis) -> list[str]:
    data, settings = result.data, result.settings
    rig = {k: v for k, v in vars(settings.rig).items() if v}
    noise = rig.pop("noise", {})
    rig |= {f"noise.{k}": v for k, v in noise.items()}
    known = ", ".join(f"{k} = {v}" for k, v in rig.items() if k != "notes")
    return [
        f"data: {data.path or data.name}, sha256 {data.sha256 or '-'}",
        f"convention of the file: {data.convention}; this page is braking positive,"
        " in SI units",
        _base(result),
        f"known of the rig: {known or 'nothing'}",
        f"effects looked for: {', '.join(settings.effects)}",
        f"held-out files: {len(settings.holdout) or 'none'}",
        f"seed {result.seed}, tirefit {result.version}, {SCHEMA}",
        *(f"set aside: {said}" for said in data.set_aside),
        *data.motion,
        *data.together,
        *data.assumptions,
    ]


def diagnosis_page(result: Diagnosis) -> str:
    """The whole diagnosis as one HTML document: pictures and figures inside, no script,
    nothing to fetch."""
    needs = untestable_groups(result)
    return rendered(
        "diagnosis_page.html",
        title=subject(result),
        stand_in=stand_in(result),
        verdict=_verdict(result),
        budget=budget_lines(result),
        gap=gap_lines(result),
        pictures=[
            image_of(picture, _alternative(name))
            for name, picture in panel_pictures(result).items()
        ],
        where=_where(result),
        spots=spot_lines(result),
        map=_map(result),
        candidates=_candidates(result),
        confused=confused_lines(result, most=25),
        steps=step_lines(result),
        smallest=smallest_lines(result),
        untestable=[("effects", "need"), *(pair[::-1] for pair in needs)],
        rows=rows_line(result),
        slip_check=slip_check_line(result),
        settings=_settings(result),
        record=result.to_json(),
    )


def write_page(result: Diagnosis, path) -> None:
    """Write the page of a diagnosis, whole or not at all.

    Raises:
        OSError: the file cannot be written.
    """
    write_text_atomic(path, diagnosis_page(result))


def diagnosis_fragment(result: Diagnosis) -> str:
    """Verdict, gap, candidates and the figure for a notebook."""
    picture = diagnosis_figure(result)
    picture.set_dpi(90)
    return rendered(
        "diagnosis_fragment.html",
        title=f"{subject(result)}, {result.n} rows",
        verdict=_verdict(result),
        gap=[*budget_lines(result), *gap_lines(result)],
        candidates=_candidates(result) if result.verdict.names_an_effect else [],
        picture=image_of(picture, "; ".join(map(_alternative, panel_names(result)))),
    )
