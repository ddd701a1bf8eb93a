"""The manual builds strictly, needs no network, and describes what exists."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

import tirefit
from tirefit.data.vehicle import load_vehicle
from tirefit.diagnosis.rows.rig import load_rig
from tirefit.fitting.config import load_config
from tirefit.names import EFFECT_NAMES
from tirefit.sim.brake_summary import UNITS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
LOADED = re.compile(r"<(?:link|script|img|iframe)\b[^>]*?(?:href|src)=\"?(https?:)?//")


def build(config, site):
    """The build as `make docs` runs it; with --quiet, mkdocs counts no warnings."""
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "-f", config, "-d", site],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    site = tmp_path_factory.mktemp("site")
    done = build(ROOT / "mkdocs.yml", site)
    assert done.returncode == 0, done.stderr
    return site


def test_the_manual_builds_without_a_warning(site):
    for page in ("index.html", "getting-started/index.html", "fits/index.html"):
        assert (site / page).exists()


def test_nothing_is_loaded_from_the_network(site):
    for page in site.rglob("*.html"):
        assert not LOADED.search(page.read_text(encoding="utf-8")), page


def test_every_effect_has_a_page_and_a_figure(site):
    for effect in EFFECT_NAMES:
        page = (site / "effects" / effect / "index.html").read_text(encoding="utf-8")
        assert f"{effect}.png" in page
        assert (site / "effects" / f"{effect}.png").read_bytes()[:4] == b"\x89PNG"


def test_every_public_name_and_command_is_in_the_reference(site):
    api = (site / "reference" / "api" / "index.html").read_text(encoding="utf-8")
    assert [name for name in tirefit.__all__ if f'id="{name.lower()}"' not in api] == []
    commands = (site / "reference" / "commands" / "index.html").read_text("utf-8")
    for command in ("tirefit-fit", "tirefit-diagnose", "tirefit-simulate-rig"):
        assert f'id="{command}"' in commands


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("[fine](index.md#here)", ""),
        ("[nothing](nowhere.md)", "nowhere.md"),
        ("[no section](index.md#there)", "#there"),
        ("::: tirefit.nothing", "tirefit.nothing"),
        ("[name][tirefit.nothing]", "tirefit.nothing"),
    ],
)
def test_a_broken_link_or_reference_fails(tmp_path, text, fault):
    """With the settings of the manual, for a manual of one page."""
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    del settings["hooks"], settings["nav"]
    (tmp_path / "docs").mkdir()
    shutil.copy(DOCS / "rst_roles.py", tmp_path / "docs")
    page = f"# Page\n\n## Here\n\n{text}\n"
    (tmp_path / "docs" / "index.md").write_text(page, encoding="utf-8")
    (tmp_path / "mkdocs.yml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    done = build(tmp_path / "mkdocs.yml", tmp_path / "site")
    assert (done.returncode != 0) == bool(fault), done.stderr
    assert fault in done.stderr


def test_links_work_in_the_markdown():
    """Without a build: no link points to a generated page."""
    for page in (*PAGES, *ROOT.glob("*.md")):
        text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.M | re.S)
        links = re.findall(r"\]\((?!\w+:)([^)# ]+)[^)]*\)", text)
        assert [x for x in links if not (page.parent / x).exists()] == [], page


def test_every_page_is_in_the_navigation_with_an_introduction():
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    listed = " ".join(map(str, settings["nav"]))
    for page in PAGES:
        assert str(page.relative_to(ROOT)) in listed
        head, _, text = page.read_text(encoding="utf-8").partition("\n\n")
        assert head.startswith("# ") and re.match(r"[A-Z`]", text), page


SETTINGS = re.compile(r'^```toml title="(.*?)"\n(.*?)^```', re.MULTILINE | re.DOTALL)
READERS = {"fit.toml": load_config, "rig.toml": load_rig, "vehicle.toml": load_vehicle}


@pytest.mark.parametrize(
    ("name", "text"),
    [found for page in PAGES for found in SETTINGS.findall(page.read_text("utf-8"))],
)
def test_the_settings_in_the_manual_are_valid(name, text, tmp_path):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    READERS[name](path)


def test_every_number_of_a_braking_is_described():
    text = (DOCS / "reference" / "files.md").read_text(encoding="utf-8")
    assert [name for name in UNITS if f"`{name}`" not in text] == []


CASES = ROOT / "fits"
SCORES = {
    "listed, strong: exact": "named exactly in {:.0%} of strong cases ({}",
    "listed, weak: exact": "{:.0%} of weak ones ({}",
    "pairs: exact": "both named in {:.0%} ({}",
    "strangers: strong": "flagged in {:.0%} of strong cases ({}",
    "false names beside something unlisted": "{:.2f} false names a case on trials ({}",
    "false alarms": "a false alarm in {:.0%} ({}",
}
"""Row of the sealed trials -> what the limits say of its first score."""


@pytest.mark.parametrize("row", SCORES)
def test_the_documented_limits_agree_with_the_sealed_trials(row):
    trials = (CASES / "withheld" / "README.md").read_text(encoding="utf-8")
    limits = (DOCS / "how-it-works" / "limits.md").read_text(encoding="utf-8")
    line = next(x for x in trials.splitlines() if x.startswith(f"| {row}"))
    newest = line.split("|")[3]
    score, count = re.search(r"(\.\d+).*?\((\d+)\)", newest).groups()
    said = " ".join(limits.split()).replace(" %", "%")
    assert SCORES[row].format(float(score), count) in said


SWITCHED_OFF = {
    "none: as shipped": "the product",
    "other formulas of an effect": "other forms off",
    "each effect likelier than not": "each effect likelier than not: off",
    "data left out": "gain: no data left out",
    "climb (adding effects one by one to the best sets)": "climb off",
    "discrepancy: patterns": "discrepancy: patterns off",
    "discrepancy: waves": "discrepancy: waves off",
    "tests of the remainder": "tests of the remainder off",
    "uncertainty of the slips": "doubt of the slips off",
}
"""Row of the manual -> row of the ablation."""


def _cells(text, row):
    line = next(x for x in text.splitlines() if x.startswith(f"| {row} |"))
    return [cell.strip().partition(" of ")[0] for cell in line.split("|")[2:-1]]


@pytest.mark.parametrize("row", SWITCHED_OFF)
def test_the_documented_gain_of_each_step_agrees_with_the_ablation(row):
    page = (DOCS / "how-it-works" / "diagnosis.md").read_text(encoding="utf-8")
    ablation = (CASES / "withheld" / "README.md").read_text(encoding="utf-8")
    every = _cells(ablation, SWITCHED_OFF[row])
    # Strong and weak effects, strong strangers, false names, measured cases.
    assert _cells(page, row) == [every[k] for k in (0, 2, 6, 12, 16)]


def test_the_version_is_the_same_everywhere():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == tirefit.__version__
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^## (\S+)", changes, re.MULTILINE)[1] == tirefit.__version__


def test_the_site_is_pinned():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8").lower()
    for need in project["dependency-groups"]["docs"]:
        assert f"\n{re.split('[><=]', need)[0]}==" in lock
