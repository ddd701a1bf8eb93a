"""A diagnosis as one page that needs nothing else, and as a fragment for notebooks."""

import base64
import html
from collections.abc import Mapping, Sequence

from tirefit.diagnosis.result import Diagnosis
from tirefit.files import write_text_atomic
from tirefit.report.canvas import Picture
from tirefit.report.diagnosis_draw import diagnosis_figure, panel_pictures
from tirefit.report.diagnosis_text import (
    chosen_candidate,
    confused_lines,
    gap_lines,
    noise_line,
    smallest_lines,
    step_text,
    verdict_sentence,
)
from tirefit.report.diagnosis_words import (
    covariate_text,
    names_an_effect,
    p_text,
    parameter_text,
    range_text,
    share_text,
    untestable_groups,
    words_on,
)
from tirefit.report.html import html_table
from tirefit.report.numbers import format_number

__all__ = ["diagnosis_fragment", "diagnosis_page", "write_page"]

# Nothing may be fetched, whatever a file name or column header holds.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_STYLE = """
body{font:16px/1.45 system-ui,sans-serif;color:#222;background:#fff;
max-width:76rem;margin:0 auto;padding:.8rem}
h1{font-size:1.35rem;margin:.2rem 0}h2{font-size:1.08rem;margin:1.4rem 0 .3rem}
p,ul{margin:.3rem 0}li{overflow-wrap:anywhere}
.pictures{display:grid;gap:.8rem;
grid-template-columns:repeat(auto-fit,minmax(min(100%,30rem),1fr))}
.pictures img{width:100%;height:auto}
.wide{overflow-x:auto}table{font-size:.9rem}
pre{overflow-x:auto;font-size:.75rem;background:#f4f4f4;padding:.6rem}
"""
_SURE, _OPEN = "#009E73", "#D55E00"
_ALTERNATIVES = {
    "where": "Map of measured minus fitted force over slip and another quantity",
    "which": "Probability of each explanation as bars",
    "before and after": "Force over slip and residuals, of the base fit and after it",
    "how far": "Size of the gap before and after, on the rows and on held-out data",
}


def _image(picture: Picture, alternative: str) -> str:
    text = base64.b64encode(picture._repr_png_()).decode("ascii")
    return (
        f'<img alt="{html.escape(alternative)}" style="max-width:100%"'
        f' src="data:image/png;base64,{text}">'
    )


def _items(lines: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{html.escape(line)}</li>' for line in lines)}</ul>"


def _table(rows: Sequence[Sequence[str]]) -> str:
    return f'<div class="wide" style="overflow-x:auto">{html_table(rows)}</div>'


def _verdict(content: Mapping) -> str:
    verdict, chosen = content["verdict"], chosen_candidate(content)
    lines = [parameter_text(chosen)] if chosen else []
    for effect in (*verdict["effects"], *verdict["also_possible"]):
        means, remedy = words_on(effect)
        if means:
            lines.append(f"{effect}: {means}; {remedy}")
    open_question = verdict["status"] in ("incomplete", "unknown", "cannot_tell")
    color = _OPEN if open_question else _SURE
    return (
        f'<div style="border-left:5px solid {color};padding:2px 10px;margin:6px 0">'
        f"<b>Verdict: {html.escape(verdict_sentence(content))}</b>"
        f"{_items(lines) if lines else ''}</div>"
    )


def _where(content: Mapping) -> str:
    rows = [("quantity", "range", "share of the gap's energy", "p, corrected")]
    for region in content["where"]:
        rows.append(
            (
                covariate_text(region["covariate"]), range_text(region),
                share_text(region["share"]), p_text(region["p_value"]),
            )
        )  # fmt: skip
    return _table(rows) if len(rows) > 1 else "<p>no region has rows enough</p>"


def _map(content: Mapping, most: int = 10) -> str:
    rows = [("parameter", "varies with", "log evidence", "explains, at most")]
    rows += [
        (
            cell["parameter"], covariate_text(cell["covariate"]),
            format_number(cell["log_evidence"], 3), share_text(cell["explains"]),
        )
        for cell in content["map"][:most]
        if cell["log_evidence"] > 0
    ]  # fmt: skip
    return _table(rows) if len(rows) > 1 else "<p>none would explain anything</p>"


def _candidates(content: Mapping) -> str:
    rows = [
        ("effects", "family", "probability", "amplitude", "z", "z beside rivals",
         "closed")
    ]  # fmt: skip
    for one in content["candidates"]:
        probability = one["probability"]
        rows.append(
            (
                " + ".join(one["effects"]), one["family"],
                f"{probability:.3f}" if probability >= 5e-4 else "< 0.001",
                parameter_text(one), format_number(one["z"], 3),
                format_number(one["z_given_rivals"], 3),
                share_text(one["closed"], one["closed_ci"]),
            )
        )  # fmt: skip
    return _table(rows) if len(rows) > 1 else "<p>none</p>"


def _base(content: Mapping) -> str:
    parts = (f"{k} = {format_number(v)}" for k, v in content["base_parameters"].items())
    return f"base fit, {content['model']}: {', '.join(parts)}"


def _settings(content: Mapping) -> list[str]:
    data, settings = content["data"], content["settings"]
    rig = {k: v for k, v in settings["rig"].items() if v}
    noise = rig.pop("noise", {})
    rig |= {f"noise.{k}": v for k, v in noise.items()}
    known = ", ".join(f"{k} = {v}" for k, v in rig.items() if k != "notes")
    return [
        f"data: {data['path'] or data['name']}, sha256 {data['sha256'] or '-'}",
        f"convention of the file: {data['convention']}; this page is braking positive,"
        " in SI units",
        _base(content),
        f"known of the rig: {known or 'nothing'}",
        f"effects looked for: {', '.join(settings['effects'])}",
        f"held-out files: {len(settings['holdout']) or 'none'}",
        f"seed {content['seed']}, tirefit {content['version']}, {content['schema']}",
        *data["assumptions"],
    ]


def _sections(result: Diagnosis) -> list[tuple[str, str]]:
    """(heading, body) of the page, what one can act on first."""
    content = result.content
    pictures = "".join(
        _image(picture, _ALTERNATIVES[name])
        for name, picture in panel_pictures(result).items()
    )
    rows = (
        f"{content['n']} rows, {content['n_effective']:.0f} of them independent;"
        f" {noise_line(content)}"
    )
    found = [
        ("Gap", _items(gap_lines(result))),
        ("", f'<div class="pictures">{pictures}</div>'),
        ("Where", _where(content)),
        ("Which parameter would have to vary, freely", _map(content)),
        ("Candidates", _candidates(content)),
    ]
    if confused := confused_lines(content, most=25):
        found.append(("Hard to tell on this data (forecast)", _items(confused)))
    if content["next_measurement"]:
        steps = [step_text(step) for step in content["next_measurement"]]
        found.append(("Next measurement", _items(steps)))
    found.append(("What would have been seen", _items(smallest_lines(content))))
    if content["untestable"]:
        groups = untestable_groups(content["untestable"])
        table = [("effects", "need"), *((effects, needs) for needs, effects in groups)]
        found.append(("Not testable on this data", _table(table)))
    return [
        *found,
        ("Rows and noise", f"<p>{html.escape(rows)}</p>"),
        ("Settings", _items(_settings(content))),
    ]


def diagnosis_page(result: Diagnosis) -> str:
    """The whole diagnosis as one HTML document: pictures and figures inside, no script,
    nothing to fetch."""
    content = result.content
    title = f"{content['data']['name']} against {content['model']}"
    body = "".join(
        (f"<h2>{heading}</h2>" if heading else "") + text
        for heading, text in _sections(result)
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}: {html.escape(verdict_sentence(content))}</title>"
        f"<style>{_STYLE}</style></head>\n<body><h1>{html.escape(title)}</h1>"
        f"{_verdict(content)}{body}"
        "<details><summary>The whole record, as JSON</summary>"
        f"<pre>{html.escape(result.to_json())}</pre></details></body></html>\n"
    )


def write_page(result: Diagnosis, path) -> None:
    """Write the page of a diagnosis, whole or not at all.

    Raises:
        OSError: the file cannot be written.
    """
    write_text_atomic(path, diagnosis_page(result))


def diagnosis_fragment(result: Diagnosis) -> str:
    """Verdict, gap, candidates and the figure for a notebook."""
    content = result.content
    title = f"{content['data']['name']} against {content['model']}, {content['n']} rows"
    picture = diagnosis_figure(result)
    picture.set_dpi(90)
    parts = [
        f"<b>{html.escape(title)}</b>",
        _verdict(content),
        _items(gap_lines(result)),
        _candidates(content) if names_an_effect(content["verdict"]) else "",
        _image(picture, "; ".join(_ALTERNATIVES.values())),
    ]
    return f"<div>{''.join(parts)}</div>"
