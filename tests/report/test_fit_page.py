"""The page of a fit: its content, its resources, and its width on a phone."""

import base64
import html
import json
import re
from dataclasses import replace

import jax.numpy as jnp
import matplotlib.image
import numpy as np
import pytest
from pages import PHONE, Page, browse, in_browser, width_on_phone, without_pictures

from tirefit.data.table import Source, TireData
from tirefit.fitting.estimate import fit
from tirefit.fitting.result import Estimate, PosteriorSummary, Verdict
from tirefit.fitting.solve.far_rows import FarRow
from tirefit.models import MODELS, TireInputs, forces
from tirefit.params import with_values
from tirefit.report.fit.curves import fit_curve
from tirefit.report.fit.report import fit_page
from tirefit.report.many_files import write_fits_page
from tirefit.report.numbers import format_estimate, format_interval
from tirefit.results import InputProblem, Outcome, UsageError

NAME = 'sweep <b>$1 & "x".csv'


def sweep(name=NAME, mu=1.0, seed=5) -> TireData:
    generator = np.random.default_rng(seed)
    slip = generator.uniform(0, 0.2, 80)
    model = with_values(MODELS["brush"], {"cpa2": 5e4, "mu": mu})
    inputs = TireInputs(sigma_x=slip, fz=4000.0, v=20.0)
    columns = {
        "sigma_x": slip,
        "fz": np.full(80, 4000.0),
        "v": np.full(80, 20.0),
        "fx": np.asarray(forces(model, inputs).fx) + 30 * generator.normal(size=80),
    }
    used = np.ones(80, bool)
    used[3] = False
    source = Source(
        path=f"data/{name}",
        sha256="ab12",
        assumptions=("column 'Fx <N>' read as fx in N", "speed 20 m/s: constant, given"),
        masked=(InputProblem("load is not finite", row=5),),
    )
    return TireData("sweep", columns, used, np.zeros(80, int), ("sweep",), source)


@pytest.fixture(scope="module")
def plain():
    return fit(sweep(), "brush", seed=3)


@pytest.fixture(scope="module")
def sampled(plain):
    """As if sampled, with draws about the estimate."""
    labels = plain.labels
    values = np.array([plain.least_squares[k].value for k in labels])
    std = np.array([plain.least_squares[k].std for k in labels])
    draws = values + std * np.random.default_rng(2).standard_normal((4, 300, 2))
    summary = PosteriorSummary(
        "emcee", 3, 4, 32, 800, 100, dict.fromkeys(labels, 4321.0),
        dict.fromkeys(labels, 1.0012), dict.fromkeys(labels, 9.5), 0.36,
        Outcome.CONVERGED,
    )  # fmt: skip
    return replace(plain, chains=draws, posterior=summary)


@pytest.fixture(scope="module")
def text(sampled):
    return fit_page(sampled)


def test_the_page_is_self_contained(text):
    page = Page(text)
    assert not {"script", "link", "iframe", "object"} & set(page.seen)
    assert "://" not in text and "url(" not in text and "@import" not in text
    assert len(page.links) == page.seen.count("img") == 5 and all(page.alternatives)
    pictures = [
        base64.b64decode(link.removeprefix("data:image/png;base64,")) for link in page.links
    ]
    assert all(one.startswith(b"\x89PNG") for one in pictures)
    assert len(set(pictures)) == len(pictures)
    assert "<b>$1" not in text and NAME in "".join(page.texts)
    assert "Fx &lt;N&gt;" in text and 'name="viewport"' in text


def test_the_page_contains_the_numbers_of_the_record(text, sampled):
    record = html.unescape(text.split("<pre>")[1].split("</pre>")[0])
    assert json.loads(record) == json.loads(sampled.to_json())
    shown = " ".join(re.sub(r"<[^>]*>", " ", text.split("<pre>")[0]).split())
    assert "tirefit explore fit.json" in shown
    for estimate in (*sampled.parameters.values(), *sampled.derived.values()):
        assert format_estimate(estimate.value, estimate.std) in shown
        assert format_interval(estimate.ci95, estimate.std) in shown


def test_the_page_reports_undetermined_quantities(plain):
    free = Estimate(0.4, None, "-", (0.1, 2.0), identified=False)
    nowhere = Estimate(np.nan, None, "-", (None, None), identified=False)
    correlation = np.array([[1.0, -0.97], [-0.97, 1.0]])
    sentences = ["mu is not identified by these data", "a second sentence"]
    far = FarRow("<x>.csv", 7, "fx", 4e5, "fx", 3900.0, 99.0, True, "99 std away", "")
    result = replace(
        plain,
        parameters=plain.parameters | {"mu": free},
        far_rows=(far,),
        derived=plain.derived | {"slip_at_peak": nowhere},
        correlation=correlation,
        verdict=Verdict((Outcome.NOT_IDENTIFIED,), (*sentences,)),
    )
    page = without_pictures(lambda: fit_page(result))
    shown = re.sub(r"<[^>]*>", " ", page.split("<pre>")[0])
    assert "Verdict: not identified: mu is not identified by these data" in shown
    assert "a second sentence" in shown
    cells = " ".join(shown.split())
    assert "mu not identified - [0.1, 2] best 0.4" in cells and "slip_at_peak not defined" in cells
    assert "cpa2 and mu: -0.970" in shown
    said = html.unescape(shown)
    assert "excluded: <x>.csv, row 7, column 'fx': 99 std away" in said
    # Without a posterior there is none to show.
    assert "Posterior" not in shown and "ensembles" not in shown


def test_a_page_drawn_twice_is_the_same(sampled, text, tmp_path):
    page = tmp_path / "fit.html"
    assert sampled.save(page) == [page]
    assert page.read_text() == text and list(tmp_path.iterdir()) == [page]


@in_browser
def test_chromium_shows_the_page_of_a_fit(text, tmp_path):
    page = tmp_path / "fit.html"
    page.write_text(text)
    shot = tmp_path / "shot.png"
    _, asked = browse(page, tmp_path, f"--screenshot={shot}")
    assert asked == []
    assert matplotlib.image.imread(shot)[:, :, :3].std() > 0.05
    # Wider tables and figures scroll in their own boxes.
    assert width_on_phone(text, tmp_path) <= PHONE


# Several fits


@pytest.fixture(scope="module")
def several():
    """One tire on roads with four frictions."""
    return {
        f"drum_2026-03-12_cold_asphalt_{run}": fit(sweep(f"{run}.csv", mu, seed), "brush", seed=3)
        for seed, (run, mu) in enumerate({"dry": 1.0, "damp": 0.85, "wet": 0.7, "ice": 0.3}.items())
    }


def test_points_at_other_inputs_keep_their_residual(plain):
    problem, rows = plain.problem, plain.problem.rows
    load, aside = np.array(rows.inputs.fz), np.zeros_like(rows.inputs.fz)
    load[:30], aside[30:40] = 5000.0, 0.1
    inputs = rows.inputs._replace(fz=jnp.asarray(load), alpha=jnp.asarray(aside))
    moved = replace(plain, problem=problem.with_rows(inputs=inputs))
    curve = fit_curve(moved, "fx")
    tire = with_values(MODELS["brush"], {k: v.value for k, v in plain.least_squares.items()})
    fitted = problem.used(forces(tire, inputs).fx)
    off = [
        group.force - np.interp(group.slip, fitted_curve.slip, fitted_curve.force)
        for group, fitted_curve in zip(curve.groups, curve.curves, strict=True)
    ]
    expected = problem.used(rows.observed["fx"]) - fitted
    # 2 N of interpolating the curve.
    np.testing.assert_allclose(np.sort(np.concatenate(off)), np.sort(expected), atol=2.0)


def test_the_page_of_several_has_a_row_for_each(several, tmp_path):
    write_fits_page(several, tmp_path / "fits.html")
    text = (tmp_path / "fits.html").read_text("utf-8")
    shown = " ".join(re.sub(r"<[^>]*>", " ", text).split())
    assert "Verdict: of 4 files: 4 ok" in shown
    assert "drum_2026-03-12_cold_asphalt_*" in shown
    for name, result in zip(("dry", "damp", "wet", "ice"), several.values(), strict=True):
        mu = result.parameters["mu"]
        row = re.search(rf"<tr[^>]*><td[^>]*>{name}<.*?</tr>", text)[0]
        assert f">{format_estimate(mu.value, mu.std)}<" in row


def test_a_page_needs_a_fit(tmp_path):
    with pytest.raises(UsageError, match="no fit for the page"):
        write_fits_page({}, tmp_path / "fits.html")


@in_browser
def test_chromium_shows_the_page_of_several(several, tmp_path):
    page = tmp_path / "fits.html"
    write_fits_page(several, page)
    shot = tmp_path / "shot.png"
    _, asked = browse(page, tmp_path, f"--screenshot={shot}")
    assert asked == []
    assert matplotlib.image.imread(shot)[:, :, :3].std() > 0.05
    assert width_on_phone(page.read_text(), tmp_path) <= PHONE
