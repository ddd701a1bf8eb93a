"""The page with sliders: what Chromium draws, against the prediction of the same tire."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from pages import PHONE, browse, in_browser, width_on_phone

import tirefit
from tirefit.fitting.uncertainty.bands import force_band
from tirefit.models import TireInputs
from tirefit.results import DataError

FOLDER = Path(__file__).parents[1] / "data" / "tir"
MF61 = FOLDER / "mfeval_julia/MagicFormula61_Parameters.tir"
LOADS = (2000.0, 4000.0, 6000.0)
READ = """<script>
// Without a screen there may be no frames.
requestAnimationFrame = action => setTimeout(action, 1);
cancelAnimationFrame = clearTimeout;
const wait = () => new Promise(done => setTimeout(done, 50));
const move = async (name, value) => {
  const input = document.getElementById("set-" + name);
  input.step = "any";
  input.value = value;
  input.dispatchEvent(new Event("input", {bubbles: true}));
  await wait();
};
const drawn = id => ({
  traces: document.getElementById(id).data.map(
    t => ({x: [...t.x], y: [...t.y], mode: t.mode, half: t.customdata})),
  shapes: document.getElementById(id).layout.shapes.map(s => [s.xref, s.x0, s.x1]),
  note: document.getElementById(id + "-note").textContent,
});
const finish = said => {
  const place = document.createElement("pre");
  place.id = "said";
  place.textContent = JSON.stringify(said);
  document.body.append(place);
};
(async () => { %s })().catch(error => finish({error: `${error.stack}`}));
</script></body>"""


def driven(text: str, script: str, folder: Path):
    """What a script of the page hands to ``finish``; the page fetches nothing."""
    page = folder / "page.html"
    page.write_text(text.replace("</body>", READ % script))
    document, asked = browse(
        page, folder, "--dump-dom", "--virtual-time-budget=60000", "--window-size=1200,3000"
    )
    assert asked == []
    said = json.loads(re.search(r'<pre id="said">(.*?)</pre>', document, re.S)[1])
    assert "error" not in said, said["error"]
    return said


@pytest.fixture(scope="module")
def table():
    """Sweeps of the slip angle at three loads and two speeds, in ISO-W signs."""
    rng = np.random.default_rng(4)
    alpha, fz, v = (
        a.ravel() for a in np.meshgrid(np.linspace(-0.1, 0.15, 41), LOADS, [10.0, 25.0])
    )
    rows = {"alpha": alpha, "fz": fz * (1 + 0.05 * rng.uniform(-1, 1, len(fz))), "v": v}
    truth = tirefit.predict("brush-n", rows, {"cpa2": 6e4, "mu": 1.0, "n": 0.1})
    rows["fy"] = -truth["fy"] + 30 * rng.standard_normal(len(fz))
    return tirefit.read_frame(rows, convention="iso-w")


@pytest.fixture(scope="module")
def fit(table):
    return tirefit.fit(table, "brush-n", seed=1)


@pytest.fixture(scope="module")
def shown(fit, table, tmp_path_factory):
    pytest.importorskip("plotly")
    return tirefit.explore(fit.save(tmp_path_factory.mktemp("fit"))[0], table)


@pytest.fixture(scope="module")
def text(shown, tmp_path_factory):
    return shown.save(tmp_path_factory.mktemp("page") / "tire.html")[0].read_text()


def test_the_page_is_small_and_names_no_address_of_its_own(text, shown):
    assert len(text.encode()) <= 6e6
    scripts = re.findall(r"<script>.*?</script>", text, re.S)
    library = max(scripts, key=len)
    assert "://" not in text.replace(library, "") and "default-src 'none'" in text
    head = re.sub(r"<[^>]*>", "", text.partition('<div id="sliders">')[0].partition("<body>")[2])
    for part in ("brush-n", "iso-w", "loads of the data 1908 to 6299 N", tirefit.__version__):
        assert part in head, part
    assert "fx was not fitted" in shown.summary()


@in_browser
def test_chromium_draws_what_the_fit_predicts(text, shown, fit, table, tmp_path):
    load, speed = 3000.0, 20.0
    said = driven(
        text,
        f"await move('fz', {load}); await move('v', {speed}); finish(Object.fromEntries("
        "Object.keys(PANELS).map(id => [id, drawn(id)])))",
        tmp_path,
    )
    curve = said["fy"]["traces"][-1]
    alpha = np.radians(curve["x"])

    def predicted(name, alpha, fz=load, kappa=0.0):
        rows = {"alpha": alpha, "fz": fz, "v": speed, "sigma_x": -kappa / (1 + kappa)}
        rows = dict(zip(rows, np.broadcast_arrays(*rows.values()), strict=True))
        # ISO-W turns the forces; the forces that were not fitted are those of the tire.
        values = {k: one.value for k, one in fit.parameters.items()}
        return -tirefit.predict("brush-n", rows, values)[name]

    # Equal to rounding, at a tenth of a millinewton.
    np.testing.assert_allclose(curve["y"], predicted("fy", alpha), atol=1e-4)
    moment = said["mz"]["traces"][-1]
    np.testing.assert_allclose(moment["y"], predicted("mz", np.radians(moment["x"])), atol=1e-4)
    force = said["fx"]["traces"][-1]
    zero = 0 * np.array(force["x"])
    expected = predicted("fx", zero, kappa=np.array(force["x"]))
    np.testing.assert_allclose(force["y"], expected, atol=1e-4)
    # The lines between the points: at most 1 % of the peak, here 0.4 %.
    middle = (alpha[1:] + alpha[:-1]) / 2
    off = np.interp(middle, alpha, curve["y"]) - predicted("fy", middle)
    assert np.max(np.abs(off)) < 0.01 * np.max(np.abs(curve["y"]))
    # The bands as in the figure of a fit, which differences the compiled model.
    inputs = TireInputs(*(np.full(len(alpha), x) for x in (0.0, 0.0, load, speed, 0.0, 0.0, 0.0)))
    inputs = inputs._replace(alpha=alpha)
    band = force_band(fit, "fy", inputs, np.zeros(len(alpha), int), np.ones(len(alpha)))
    half = (band.high - band.low) / 2
    np.testing.assert_allclose(curve["half"], half, rtol=1e-3, atol=1e-3)
    # Outside the range of the slip angle it is grey, of the longitudinal slip everywhere.
    low, high = (np.degrees(end) for end in (-0.1, 0.15))
    edges = [x for _, *ends in said["fy"]["shapes"] for x in ends]
    assert edges[1] == pytest.approx(low) and edges[2] == pytest.approx(high)
    assert said["fx"]["shapes"] == [["paper", 0, 1]] and "have only slip 0" in said["fx"]["note"]
    # Stiffness and peak over the load.
    stiff, peak = said["stiffness"]["traces"][-1], said["peak"]["traces"][-1]
    loads, step = np.array(stiff["x"]), 1e-5
    slope = (predicted("fy", step, loads) - predicted("fy", -step, loads)) / (2 * step)
    np.testing.assert_allclose(stiff["y"], np.abs(slope), rtol=1e-6)
    grid = np.linspace(0, 0.18, 2001)
    largest = [np.max(np.abs(predicted("fy", grid, fz))) / fz for fz in loads]
    np.testing.assert_allclose(peak["y"], largest, rtol=2e-3)  # of the coarser slips


@in_browser
def test_points_are_the_rows_near_the_sliders(text, fit, table, tmp_path):
    said = driven(
        text,
        "await move('fz', 4000); await move('v', 25); const a = drawn('fy'), b = drawn('ellipse');"
        "await move('fz', 7000); finish([a, drawn('fy'), b])",
        tmp_path,
    )
    points = said[0]["traces"][0]
    near = (np.abs(table["fz"] - 4000) <= 400) & (np.abs(table["v"] - 25) <= 5)
    assert points["mode"] == "markers" and near.sum() == len(points["x"]) == 41
    # To five digits, as they are stored.
    np.testing.assert_allclose(points["x"], np.degrees(table["alpha"][near]), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(points["half"], -table["fy"][near], rtol=1e-4)
    # A row keeps its residual.
    curve = said[0]["traces"][-1]
    off = np.array(points["y"]) - np.interp(points["x"], curve["x"], curve["y"])
    rows = {k: table[k][near] for k in ("alpha", "fz", "v")}
    expected = -table["fy"][near] + fit.predict(rows)["fy"]
    np.testing.assert_allclose(off, expected, atol=8.0)  # N, of interpolating the curve
    assert said[0]["note"] == "" and len(said[0]["shapes"]) == 2
    assert said[1]["shapes"] == [["paper", 0, 1]]
    assert "load 7000 N is outside the data" in said[1]["note"]
    assert said[1]["traces"][0]["x"] == []
    assert said[2]["note"]  # of the ellipse: no longitudinal slip was measured


@in_browser
def test_other_tires_are_drawn_over_each_other(tmp_path):
    pytest.importorskip("plotly")
    names = [MF61, "brush-dh", "lugre", "carcass-parabola", "magic-formula-combined", "quartic-mn"]
    page = tirefit.explore(names)
    rng = np.random.default_rng(0)
    at = {
        "kappa": rng.uniform(-0.3, 0.3, 9), "alpha": rng.uniform(-0.2, 0.2, 9),
        "fz": rng.uniform(2e3, 8e3, 9), "v": rng.uniform(5, 40, 9),
        "gamma": rng.uniform(-0.1, 0.1, 9), "pressure": rng.uniform(2e5, 3e5, 9),
    }  # fmt: skip
    points = [dict(zip(at, values, strict=True)) for values in zip(*at.values(), strict=True)]
    script = f"const points = {json.dumps([{k: float(v) for k, v in p.items()} for p in points])};"
    script += "finish(E.tires.map(t => Object.fromEntries(t.outputs.map("
    script += "name => [name, points.map(p => force(t, name, p))]))))"
    said = driven(page.save(tmp_path / "all.html")[0].read_text(), script, tmp_path)
    rows = {**at, "sigma_x": -at["kappa"] / (1 + at["kappa"])}
    rows.pop("kappa")
    assert [set(one) for one in said[:3]] == [{"fx", "fy", "mz"}, {"fx", "fy", "mz"}, {"fx", "fy"}]
    for name, forces in zip(names, said, strict=True):
        expected = tirefit.predict(name, rows)
        for force, values in forces.items():
            off = np.max(np.abs(values + expected[force]))  # ISO-W turns them
            assert off < 1e-6 * np.max(np.abs(expected[force])), (name, force)


@in_browser
def test_a_phone_shows_the_page(text, tmp_path):
    assert width_on_phone(text, tmp_path) <= PHONE
    script = "finish([...document.querySelectorAll('#sliders input')].map("
    script += "e => e.getBoundingClientRect().height))"
    assert min(driven(text, script, tmp_path)) >= 40  # pixels that a thumb can hit


def test_tires_of_a_folder(tmp_path, fit):
    for name in ("a", "b"):
        fit.save(tmp_path / name)
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "other.tir").write_bytes(MF61.read_bytes())
    (tmp_path / "b" / "fit.tir").write_bytes(MF61.read_bytes())  # written beside a fit.json
    found = tirefit.explore(tmp_path)
    assert [one.label for one in found.tires] == ["brush-n, a", "brush-n, b", "MF 6.1, other"]
    assert found.convention == "iso-w" and len(found.to_dict()["tires"]) == 3
    with pytest.raises(DataError, match="neither a fit.json nor a .tir"):
        (tmp_path / "none").mkdir()
        tirefit.explore(tmp_path / "none")
    with pytest.raises(DataError, match="7 tires: a page shows 1 to 6"):
        tirefit.explore(["brush"] * 7)


def test_without_plotly_the_remedy_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "plotly.offline", None)
    with pytest.raises(DataError, match=r"(?s)needs plotly.*pip install 'tirefit\[explore\]'"):
        tirefit.explore("brush").save(tmp_path / "tire.html")
    assert not list(tmp_path.iterdir())


def test_it_has_no_figure():
    with pytest.raises(tirefit.UsageError, match="no figure"):
        tirefit.explore("brush").plot()
