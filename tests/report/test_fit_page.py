"""The page of a fit: what it says, what it needs, and how it looks on a phone."""

import base64
import html
import json
import re
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from pages import PHONE, Page, browse, in_browser, width_on_phone

import tirefit
from tirefit.data.table import Source, TireData
from tirefit.fitting.estimate import fit
from tirefit.fitting.result import Estimate, PosteriorSummary
from tirefit.models import MODELS, TireInputs, forces
from tirefit.params import with_values
from tirefit.report.fit_html import fit_page
from tirefit.report.numbers import format_estimate, format_interval
from tirefit.results import InputProblem, Outcome

NAME = 'sweep <b>$1 & "x".csv'


def sweep(name=NAME, mu=1.0, seed=5) -> TireData:
    generator = np.random.default_rng(seed)
    slip = generator.uniform(0, 0.2, 80)
    model = with_values(MODELS["brush"], {"cpa2": 5e4, "mu": mu})
    inputs = TireInputs(sigma_x=slip, fz=4000.0, v=20.0)
    columns = {
        "sigma_x": slip, "fz": np.full(80, 4000.0), "v": np.full(80, 20.0),
        "fx": np.asarray(forces(model, inputs).fx) + 30 * generator.normal(size=80),
    }  # fmt: skip
    used = np.ones(80, bool)
    used[3] = False
    source = Source(
        path=f"data/{name}", sha256="ab12", columns={"fx": "Fx <N>"},
        units={"fx": "N"}, assumptions=("speed 20 m/s: constant, given",),
        masked=(InputProblem("load is not finite", row=5),),
    )  # fmt: skip
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


def test_the_page_stands_alone(text):
    page = Page(text)
    assert not {"script", "link", "iframe", "object"} & set(page.seen)
    assert "://" not in text and "url(" not in text and "@import" not in text
    assert len(page.links) == page.seen.count("img") >= 7 and all(page.alternatives)
    pictures = [
        base64.b64decode(link.removeprefix("data:image/png;base64,"))
        for link in page.links
    ]
    assert all(one.startswith(b"\x89PNG") for one in pictures)
    assert len(set(pictures)) == len(pictures)
    assert "<b>$1" not in text and NAME in "".join(page.texts)
    assert "Fx &lt;N&gt;" in text and 'name="viewport"' in text


def test_the_page_holds_the_numbers_of_the_record(text, sampled):
    record = html.unescape(text.split("<pre>")[1].split("</pre>")[0])
    assert json.loads(record) == json.loads(sampled.to_json())
    shown = " ".join(re.sub(r"<[^>]*>", " ", text.split("<pre>")[0]).split())
    for estimate in (*sampled.parameters.values(), *sampled.derived.values()):
        assert format_estimate(estimate.value, estimate.std) in shown
        assert format_interval(estimate.ci95, estimate.std) in shown
    for part in (
        "79 of 80 rows used", "ab12", "braking", "braking positive, SI", "seed 3",
        f"tirefit {sampled.version}", "speed 20 m/s: constant, given", "gauss-newton",
        "load is not finite", "cpa2 free in [0.01, 1e+09] N", "emcee: 4 ensembles",
        f"fx {sampled.noise['fx']['median_std']:.3g} N (estimated)",
        "at F_z = 4000 N, v = 20 m/s", "posterior median", "jax 0.",
        "every parameter and derived quantity is identified", "RMSE", "AICc", "1.0012",
    ):  # fmt: skip
        assert part in shown, part


def test_the_page_says_what_the_data_do_not_tell(plain):
    free = Estimate(0.4, None, "-", (0.1, 2.0), identified=False)
    nowhere = Estimate(np.nan, None, "-", (None, None), identified=False)
    correlation = np.array([[1.0, -0.97], [-0.97, 1.0]])
    sentences = ["mu is not identified by these data", "a second sentence"]
    result = replace(
        plain, parameters=plain.parameters | {"mu": free},
        derived=plain.derived | {"slip_at_peak": nowhere}, correlation=correlation,
        outcomes=(Outcome.NOT_IDENTIFIED,),
        verdict={"status": "not identified", "sentences": sentences},
    )  # fmt: skip
    shown = re.sub(r"<[^>]*>", " ", fit_page(result).split("<pre>")[0])
    assert "Verdict: not identified: mu is not identified by these data" in shown
    assert "a second sentence" in shown
    assert "mu: anything in [0.1, 2] fits as well (95 %); best 0.4" in shown
    assert "slip_at_peak: not defined for this model and estimate" in shown
    assert "cpa2 and mu: -0.970" in shown
    assert "every parameter and derived quantity is identified" not in shown
    # Without a posterior there is none to show.
    assert "Posterior" not in shown and "ensembles" not in shown


@in_browser
def test_chromium_shows_the_page_of_a_fit(sampled, text, tmp_path):
    page = tmp_path / "fit.html"
    tirefit.write_fit_page(sampled, page)
    assert page.read_text() == text and list(tmp_path.iterdir()) == [page]
    shot = tmp_path / "shot.png"
    _, asked = browse(page, tmp_path, f"--screenshot={shot}")
    assert asked == []
    assert matplotlib.image.imread(shot)[:, :, :3].std() > 0.05
    # Tables and pictures that are wider scroll in boxes of their own.
    assert width_on_phone(text, tmp_path) <= PHONE
