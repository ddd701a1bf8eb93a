"""The manual builds strictly, needs no network, and describes what exists."""

import doctest
import inspect
import os
import re
import subprocess
import sys
import threading
import tomllib
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
import yaml

import tirefit
from tests.report.pages import browse, in_browser
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.diagnosis.rows.rig import load_rig
from tirefit.display import Record
from tirefit.fitting.problem.config import load_config
from tirefit.names import effect_names
from tirefit.results import Outcome, exit_code
from tirefit.sim.brake_result import UNITS
from tirefit.vehicle.effects import CAR_EFFECTS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS))

import effect_pages  # noqa: E402  the programs of the manual
import gallery  # noqa: E402
import notebooks  # noqa: E402

PAGES = sorted(DOCS.rglob("*.md"))
CODE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LOADED = re.compile(r"<(?:link|script|img|iframe)\b[^>]*?(?:href|src)=\"?(https?:)?//")


def build(config, site):
    """The build as `make docs` runs it; with --quiet, mkdocs counts no warnings."""
    pytest.importorskip("mkdocs", reason="it is not in the environment of `make lowest`")
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "-f", config, "-d", site],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )


# The whole manual takes 30 s; a manual of one page is built below.
@pytest.fixture(scope="module")
def site(tmp_path_factory):
    site, pages = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("pages")
    subprocess.run([sys.executable, DOCS / "manual.py", pages], check=True)
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    text = yaml.safe_dump(settings | {"docs_dir": str(pages)})
    (site.parent / "mkdocs.yml").write_text(text, encoding="utf-8")
    done = build(site.parent / "mkdocs.yml", site)
    assert done.returncode == 0, done.stderr
    return site


@pytest.mark.long
def test_the_manual_builds_without_a_warning(site):
    for page in ("index.html", "docs/getting-started/index.html", "fits/index.html"):
        assert (site / page).exists()


@pytest.mark.long
def test_nothing_is_loaded_from_the_network(site):
    for page in site.rglob("*.html"):
        assert not LOADED.search(page.read_text(encoding="utf-8")), page


@pytest.mark.long
def test_every_effect_has_a_page_and_a_figure(site):
    names = [*effect_names(), *(f"car/{effect.id}" for effect in CAR_EFFECTS)]
    for name in names:
        page = (site / "docs" / "effects" / name / "index.html").read_text(encoding="utf-8")
        assert f"{name.rpartition('/')[2]}.png" in page
        assert (site / "docs" / "effects" / f"{name}.png").read_bytes()[:4] == b"\x89PNG"


def test_the_catalogue_has_every_effect_in_one_group():
    page = (DOCS / "effects" / "README.md").read_text(encoding="utf-8")
    groups = re.findall(r"^## (\w+)$", page, re.MULTILINE)
    assert re.findall(r"^<!-- generated: effects (\w+) -->$", page, re.MULTILINE) == groups
    text = "\n".join(effect_pages.table(group) for group in groups)
    listed = re.findall(r"\]\(([\w/]+)\.md\)", text)
    assert sorted(listed) == sorted([*effect_names(), *(f"car/{e.id}" for e in CAR_EFFECTS)])
    assert all(f"(car/{effect.id}.md) | {effect.means} |" in text for effect in CAR_EFFECTS)


def test_the_pages_of_notebooks_have_their_text_code_and_pictures():
    pages = notebooks.pages()
    for path in (ROOT / "fits" / "notebooks").glob("*.ipynb"):
        name = path.stem
        page, stored = pages[f"fits/notebooks/{name}.md"], path.read_text(encoding="utf-8")
        assert page.startswith("# ") and f"]({name}.ipynb)" in page
        assert "$" not in CODE.sub("", page) and "base64" not in page
        assert page.count("```python\n") == stored.count('"cell_type": "code"')
        shown = re.findall(rf"{name}_\d+\.png", page)
        assert sorted(f"fits/notebooks/{one}" for one in shown) == sorted(
            one for one in pages if re.fullmatch(rf".*/{name}_\d+\.png", one)
        )
        assert len(shown) == len(re.findall(r'image/png": "iV|png;base64,iV', stored)) > 0


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (r"F_y > 0", "<i>F<sub>y</sub> &gt; 0</i>"),
        (r"2 c_p a^2", "<i>2 c<sub>p</sub> a<sup>2</sup></i>"),
        (r"v_{sx}/(\Omega R_e)", "<i>v<sub>sx</sub>/(Ω R<sub>e</sub>)</i>"),
    ],
)
def test_a_formula_of_a_notebook_becomes_html(text, shown):
    assert notebooks.formula(text) == shown


def test_an_unknown_command_in_a_formula_is_refused():
    with pytest.raises(ValueError, match=r"frac\{a\}.*LETTERS"):
        notebooks.formula(r"\frac{a}{b}")


def test_every_figure_of_the_gallery_is_there_and_its_page_states_the_command():
    pages = notebooks.pages()
    for _, figure, page, command in gallery.FIGURES:
        made = figure in pages or figure.startswith("docs/effects/")
        assert made or (ROOT / figure).read_bytes()[:4] == b"\x89PNG", figure
        text = pages.get(page) or (ROOT / page).read_text(encoding="utf-8")
        assert command in text, (page, command)


@pytest.mark.long
def test_a_name_is_once_in_the_api_without_markup(site):
    page = (site / "docs" / "reference" / "api" / "index.html").read_text(encoding="utf-8")
    names = ["Record", *tirefit.__all__]
    assert [n for n in names if page.count(f'id="{n.lower()}"') != 1] == []
    text = re.sub(r"<(code|pre)\b.*?</\1>", "", page, flags=re.DOTALL)
    assert [mark for mark in (":::", "``", ":func:", "&gt;&gt;&gt;") if mark in text] == []


WATCH = """<img src="/searched" hidden><script>
const wait = setInterval(() => {
  const found = document.querySelector(".md-search-result__link");
  if (found) { clearInterval(wait); fetch("/found?" + found.getAttribute("href")); }
}, 50);
</script>"""
"""Delays the end of loading, which Chromium waits for, until the search has shown a result."""


class Searched(SimpleHTTPRequestHandler):
    """A server of the site that stores the first result of a search."""

    def do_GET(self):
        if self.path.startswith("/found?"):
            self.server.first = self.path.partition("?")[2]
            self.server.came.set()
        elif self.path == "/searched":
            self.server.came.wait(60)
        else:
            return super().do_GET()
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_):
        """Print nothing."""


@in_browser
@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "page"),
    [
        ("relaxation length", "docs/effects/"),
        ("gallery", "docs/gallery/"),
        ("fit_trajectory", "docs/reference/api/"),
        ("vehicle.toml", "VEHICLE/"),
    ],
)
def test_the_search_finds_a_page(words, page, site, tmp_path):
    start = site / "search.html"
    text = (site / "index.html").read_text(encoding="utf-8")
    start.write_text(text.replace("</body>", f"{WATCH}</body>"), encoding="utf-8")
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Searched, directory=site)) as server:
        server.came, server.first = threading.Event(), ""
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/search.html?q={words.replace(' ', '+')}"
        browse(address, tmp_path, "--dump-dom")
        server.shutdown()
    assert page in server.first


@pytest.mark.long
def test_every_public_name_and_command_is_in_the_reference(site):
    api = (site / "docs" / "reference" / "api" / "index.html").read_text(encoding="utf-8")
    assert [name for name in tirefit.__all__ if f'id="{name.lower()}"' not in api] == []
    assert "<strong>Args</strong>" in api and "Args:" not in api and ":func:" not in api
    commands = (site / "docs" / "reference" / "commands" / "index.html").read_text("utf-8")
    for command in ("tirefit-fit", "tirefit-diagnose", "tirefit-simulate-rig"):
        assert f'id="{command}"' in commands


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        (
            "[fine](index.md#here) [nothing](nowhere.md) [no section](index.md#there)",
            ["'nowhere.md'", "#there'"],
        ),
        pytest.param("[fine](index.md#here)", [], marks=pytest.mark.long),
    ],
)
def test_a_broken_link_fails(tmp_path, text, faults):
    """With the settings of the manual, for a manual of one page; each is counted."""
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    del settings["nav"], settings["docs_dir"]
    (tmp_path / "docs").mkdir()
    page = f"# Page\n\n## Here\n\n{text}\n"
    (tmp_path / "docs" / "index.md").write_text(page, encoding="utf-8")
    (tmp_path / "mkdocs.yml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    done = build(tmp_path / "mkdocs.yml", tmp_path / "site")
    assert (done.returncode != 0) == bool(faults), done.stderr
    assert [fault for fault in faults if fault not in done.stderr] == [], done.stderr
    assert len(faults) < 2 or done.stderr.count("WARNING -") == len(faults)


def test_links_work_in_the_markdown():
    """Without a build: no link points to a generated page."""
    for page in (*PAGES, *ROOT.glob("*.md")):
        text = CODE.sub("", page.read_text("utf-8"))
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
    [
        found
        for page in PAGES
        for found in SETTINGS.findall(page.read_text("utf-8"))
        if found[0] in READERS
    ],
)
def test_the_settings_in_the_manual_are_valid(name, text, tmp_path):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    READERS[name](path)


def test_every_number_of_a_braking_is_described():
    text = (DOCS / "reference" / "files.md").read_text(encoding="utf-8")
    assert [name for name in UNITS if f"`{name}`" not in text] == []


def _results():
    """Classes of what the public functions return, and their bases in the package."""
    found = {}
    for name in tirefit.__all__:
        shown = getattr(tirefit, name)
        if inspect.isfunction(shown):
            made = inspect.unwrap(shown).__annotations__.get("return")
            for cls in inspect.getmro(made) if inspect.isclass(made) else ():
                if cls.__module__.startswith("tirefit."):
                    found[cls.__name__] = cls
    return found


PUBLIC = {name: getattr(tirefit, name) for name in tirefit.__all__}
PUBLIC = {name: shown for name, shown in PUBLIC.items() if callable(shown)}
CLASSES = {k: c for k, c in (PUBLIC | _results()).items() if inspect.isclass(c)}
METHODS = {
    f"{name}.{own}": inspect.unwrap(getattr(method, "__func__", method))
    for name, cls in CLASSES.items()
    for own, method in vars(cls).items()
    if own[0] != "_" and inspect.isroutine(method)
    if name in PUBLIC or issubclass(cls, Record)
}
CALLED = {k: inspect.unwrap(f) for k, f in PUBLIC.items() if k not in CLASSES} | METHODS
ARGUMENT = r"^ +\**(?:\w+, )*{name}(?:, \w+)*:"


def _section(text, title):
    """The indented part of a docstring below a title such as ``Args:``."""
    part = re.search(rf"^{title}:\n((?:    .*\n|\n)+)", f"{text}\n", re.MULTILINE)
    return part[1] if part else ""


@pytest.mark.parametrize("name", CALLED)
def test_a_docstring_tells_arguments_and_result(name):
    text, signature = inspect.getdoc(CALLED[name]), inspect.signature(CALLED[name])
    given = [k for k in signature.parameters if k != "self"]
    base = getattr(Record, name.rpartition(".")[2], None)
    if base and name in METHODS and not name.startswith("Record."):
        given = [k for k in given if k not in inspect.signature(base).parameters]
    told = _section(text, "Args")
    assert [k for k in given if not re.search(ARGUMENT.format(name=k), told, re.M)] == []
    if signature.return_annotation is not None and name in PUBLIC:
        assert _section(text, "Returns"), name  # of a method the first line says it
    assert re.match(r"[A-Z`0-9].*[.:]$", text.partition("\n\n")[0].replace("\n", " ")), text


@pytest.mark.parametrize("name", [name for name in PUBLIC if name in CLASSES])
def test_a_class_tells_its_fields(name):
    cls, text = CLASSES[name], inspect.getdoc(CLASSES[name])
    fields = getattr(cls, "_fields", None) or getattr(cls, "__dataclass_fields__", ())
    told = _section(text, "Attributes")
    assert [k for k in fields if not re.search(ARGUMENT.format(name=k), told, re.M)] == []


@pytest.mark.parametrize("name", CLASSES)
def test_a_property_has_a_docstring(name):
    properties = {k: v for k, v in vars(CLASSES[name]).items() if isinstance(v, property)}
    assert [k for k, v in properties.items() if k[0] != "_" and not v.fget.__doc__] == []


@pytest.mark.parametrize("name", CALLED)
def test_no_public_argument_is_of_any_type(name):
    """Content of a JSON document is ``dict[str, Any]``; keywords are of another function."""
    function = CALLED[name]
    kinds = {k: v.kind for k, v in inspect.signature(function).parameters.items()}
    plain = {k for k, kind in kinds.items() if kind is not inspect.Parameter.VAR_KEYWORD}
    untyped = plain - {"self", "what"} - set(function.__annotations__)
    assert untyped == set()
    loose = {k: str(v) for k, v in function.__annotations__.items() if k in {*plain, "return"}}
    loose = {k: re.sub(r"\w+\[str, (typing\.)?Any\]", "", v) for k, v in loose.items()}
    assert [k for k, v in loose.items() if re.search(r"\bAny\b", v)] == []


@pytest.mark.parametrize("name", CLASSES)
def test_no_public_field_is_of_any_type(name):
    fields = CLASSES[name].__dict__.get("__annotations__", {})
    loose = {k: re.sub(r"\w+\[str, (typing\.)?Any\]", "", str(v)) for k, v in fields.items()}
    assert [k for k, v in loose.items() if re.search(r"\bAny\b", v)] == []


EXAMPLES = {"Record": Record} | PUBLIC
BEFORE = re.search(
    r'^```python title="before the examples"\n(.*?)^```',
    (DOCS / "reference" / "api.md").read_text("utf-8"),
    re.MULTILINE | re.DOTALL,
)[1]
"""What the page says is run before each example."""


LONG = dict.fromkeys(("brake", "diagnose_vehicle", "fit_trajectory", "replay"), pytest.mark.long)
"""The dearest examples; other tests run the same programs."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=LONG.get(name, ())) for name in EXAMPLES]
)
def test_the_example_of_a_public_name_prints_what_it_shows(name):
    shown = EXAMPLES[name]
    assert "\nExample:\n    >>> " in inspect.getdoc(shown)
    names: dict = {}
    exec(BEFORE, names)
    tests = doctest.DocTestFinder(recurse=False).find(shown, name, globs=names)
    found = [doctest.DocTestRunner().run(test) for test in tests]
    assert sum(one.attempted for one in found) > 0
    assert [one.failed for one in found] == [0] * len(found)


def test_every_status_is_in_the_reference_with_its_exit_code():
    page = (DOCS / "reference" / "api.md").read_text(encoding="utf-8")
    for outcome in {*Outcome} - {Outcome.CONVERGED}:
        row = next(x for x in page.splitlines() if x.startswith("|") and f"`{outcome}`" in x)
        codes = row.split("|")[3]
        given = [] if outcome is Outcome.OK else [outcome]
        assert codes.strip().startswith(str(int(exit_code(given))))
        assert ("5" in codes) == (exit_code(given, strict=True) == 5)


CASES = ROOT / "fits"
SCORES = {
    "listed, strong: exact": "named exactly in {:.0%} of strong cases ({}",
    "listed, weak: exact": "{:.0%} of weak ones ({}",
    "pairs: exact": "both named in {:.0%} ({}",
    "unlisted effect: strong": "flagged in {:.0%} of strong cases ({}",
    "false names with an unlisted effect": "{:.2f} absent effects are named per trial ({}",
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
