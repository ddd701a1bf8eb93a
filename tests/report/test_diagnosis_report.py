"""The report of a diagnosis: arrays compared with known truth, the text, the page."""

import html
import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from pages import PHONE, Page, browse, in_browser, width_on_phone, without_pictures

from tirefit.data.table import Source, TireData
from tirefit.diagnosis.effects import EFFECTS, NOISE_EFFECTS, Effect
from tirefit.diagnosis.engine.decide import Each, Status
from tirefit.diagnosis.engine.left_out import AS_GIVEN, Ladder, SizeByGroup, Step
from tirefit.diagnosis.extended import Extension
from tirefit.diagnosis.rows.rig import Rig, SlipCheck
from tirefit.diagnosis.summary.case import Untestable
from tirefit.diagnosis.summary.result import (
    Amplitude,
    Candidate,
    Change,
    Diagnosis,
    Gap,
    HeldOut,
    Left,
    NextMeasurement,
    NoiseSummary,
    Part,
    Settings,
    SimulatorSummary,
    Surrogate,
    VerdictSummary,
)
from tirefit.diagnosis.summary.views import DataSummary, Region, Shape, compared
from tirefit.models import MODELS
from tirefit.report.canvas import alone
from tirefit.report.diagnosis import words
from tirefit.report.diagnosis.answer import answer, change_texts
from tirefit.report.diagnosis.figures import (
    after_label,
    draw_comparison,
    ladder_bars,
    panels_of,
    where_bars,
)
from tirefit.report.diagnosis.report import diagnosis_page, diagnosis_text
from tirefit.report.diagnosis.sections import (
    first_screen,
    gap_line,
    missing_lines,
    stand_in_line,
    step_label,
    step_lines,
)
from tirefit.report.diagnosis.words import (
    _NEEDS,
    amount_text,
    listing,
    name_of,
    p_text,
    range_text,
    readable_unit,
    set_name,
    share_text,
    words_on,
)
from tirefit.report.numbers import format_number
from tirefit.results import UsageError

LOADS, SPEEDS, NOISE = (2000.0, 4000.0, 6000.0), (5.0, 20.0), 20.0
NAME = 'drum <b>$1 & "x"'


def panel_pictures(result):
    return {name: alone(panel) for name, panel in panels_of(result).items()}


def rows_of(loads=LOADS, sweeps=60):
    """Sweeps of both signs over loads and speeds, each twice: (n,) columns."""
    # The quarter step keeps growing from shrinking slips apart.
    phase = 2 * np.pi * (np.arange(sweeps) + 0.25) / sweeps
    cases = [(fz, v) for fz in loads for v in SPEEDS] * 2
    slip = np.tile(0.4 * np.sin(phase), len(cases))
    fz, v = np.repeat(cases, sweeps, axis=0).T
    return SimpleNamespace(slip=slip, fz=fz, v=v, time=0.05 * np.arange(len(slip)))


def base_force(rows):
    return 0.9 * rows.fz * np.tanh(rows.slip * 6e4 / (0.9 * rows.fz))


def growing(rows):
    return np.sign(np.gradient(np.abs(rows.slip)))


GAPS = {
    "fz": lambda r: -0.1 * base_force(r) * (r.fz == 6000),
    "time": lambda r: 0.1 * base_force(r) * (r.time / r.time[-1] * 2 - 1),
    "v": lambda r: 0.05 * base_force(r) * np.where(r.v > 10, 1, -1),
    "direction": lambda r: 0.05 * base_force(r) * growing(r),
    "offset": lambda r: np.full(len(r.slip), 100.0),
}


def candidate(effects, probability):
    return Candidate(
        effects=tuple(effects),
        family="friction x load",
        probability=probability,
        parameters={f"{effect}: amplitude": Amplitude(0.1234, 0.0056, "-") for effect in effects},
    )


HELD = HeldOut(
    rms=151.0,
    resolvable=True,
    closed=0.7,
    closed_ci=(0.6, 0.75),
    remaining_rms=45.3,
    on="highest fz, left out of both fits",
)
GAP = Gap(
    rms=125.0,
    resolvable=True,
    closed=0.8,
    closed_ci=(0.7, 0.85),
    remaining_rms=25.0,
    channels={},
    holdout=HELD,
)
LEFT = Left(rms=25.0, share=0.04, unlisted=0.13)
LADDER = Ladder(
    "6 runs, each left out in turn",
    (
        Step((), 500.0, 0.0, 0.0, 0.0, 0.0),
        Step(("slip_offset",), 300.0, 0.8, 0.05, 160000.0, 9000.0),
        Step(("load_friction", "slip_offset"), 250.0, 0.94, 0.03, 27500.0, 5000.0),
        Step(("load_friction", "slip_offset", "force_offset"), 240.0, 0.962, 0.02, 4900.0, 2400.0),
        Step(("anything smooth",), 230.0, 0.984, 0.02, 4700.0, 2300.0),
        Step(("noise",), 223.6, 1.0, 0.0, 7600.0, 2500.0),
    ),
)
CANDIDATES = (
    candidate(["load_friction"], 0.87),
    candidate(["friction_drift", "load_friction"], 0.061),
    candidate(["slip_offset"], 0.022),
)
UNTESTABLE = (
    Untestable("friction_temperature", ("temperature",)),
    Untestable("stiffness_temperature", ("temperature",)),
    Untestable("camber_thrust", ("gamma", "fy")),
)


def noise_of(channel, inflation=1.25):
    return NoiseSummary(
        forces={channel: 19.7},
        slip_name="sigma_x",
        slip=0.00123,
        slip_source="given",
        source="given",
        flags=("outliers",),
        inflation=inflation,
        outliers=2,
    )


def said(status, effects, probability=0.6, rivals=(), twins=(), like=(), left=LEFT, **others):
    """A verdict whose first effect has equivalent ones."""
    unclaimed = {"unknown", *(effect.id for effect in NOISE_EFFECTS)}
    first, *more = [e for e in effects if e not in unclaimed] or [None]
    each = {e: Each(0.2, 0.1, 0.05, ()) for e in (*more, *like)}
    each |= {} if first is None else {first: Each(0.91, 0.8, 0.05, tuple(twins))}
    return VerdictSummary(
        status=Status(status),
        effects=tuple(effects),
        probability=probability,
        each=each,
        acts_like=tuple(like),
        also_possible=tuple(rivals),
        unlisted=left.unlisted,
        left=left,
        **others,
    )


def records(channel):
    """Records of a diagnosis; the numbers are arbitrary, and all different."""
    return {
        "data": DataSummary(
            name=NAME, path=f"runs/{NAME}.csv", sha256="ab12", convention="iso-w",
            channels=(channel,), assumptions=("column 'F<x>' read as fx in N",),
        ),
        "model": "brush", "simulator": None, "n": 360, "n_effective": 287.0,
        "noise": noise_of(channel),
        "gap": GAP, "budget": (), "meanings": {},
        "where": (
            Region("fz", 6000.0, 6000.0, 0.81, 1e-30),
            Region("fz", 2000.0, 2000.0, 0.19, 0.21),
            Region("direction", -1.0, -1.0, 0.53, 0.013),
            Region("direction", 1.0, 1.0, 0.47, 0.013),
            Region("slip_fraction", 1e-5, 1.17, 0.97, 0.27),
        ),
        "verdict": said("named", ["load_friction"], 0.87),
        "ladder": LADDER,
        "candidates": CANDIDATES, "untestable": UNTESTABLE,
        "resolution": 6.3,
        "next_measurement": (
            NextMeasurement(
                "small slips (a tenth)", ("load_friction", "d"), 0.71, 0.96
            ),
        ),
        "slip_check": None,
        "base_parameters": {"cpa2": 51234.0, "mu": 0.912},
        "extended_parameters": {"cpa2": 51235.0, "mu": 0.913},
        "extension": Extension(
            "x", {"load_friction": 0}, 4000.0, (4000.0, 12.0), 0.4, 7.5,
            12.0, 0.04, 0.97, 0.91, (0.0, 0.0),
        ),
        "settings": Settings(
            rig=Rig(noise={"fx_relative": 0.01}),
            effects=("load_friction", "slip_offset"), holdout=(),
        ),
        "seed": 3, "version": "0.1.0", "library": EFFECTS,
    }  # fmt: skip


def diagnosis(missing="fz", scatter=NOISE, rows=None, channel="fx", **changes):
    """A diagnosis whose gap is known; the last row of the file is masked."""
    rows = rows or rows_of()
    generator = np.random.default_rng(1)
    base, gap = base_force(rows), GAPS[missing](rows)
    n = len(base)
    observed = base + gap + scatter * generator.standard_normal(n)
    told = records(channel) | changes
    named = told["verdict"].names_an_effect
    parts = {
        "base": base,
        "extended": base + gap if named else base,
        "gap": gap,
        "gap_std": 0 * base,
    }
    columns = {
        "sigma_x": np.append(rows.slip, 9.0),
        "fz": np.append(rows.fz, 9e9),
        "fx": np.append(observed, np.nan),
    }
    used = np.arange(n + 1) < n
    shown = SimpleNamespace(
        slip_fraction=rows.slip * 3e4 / (1.35 * rows.fz),
        rows=SimpleNamespace(
            channels=(channel,), slip=rows.slip, mode=channel[1], observed={channel: observed},
            inputs=SimpleNamespace(fz=rows.fz),
        ),
    )  # fmt: skip
    return Diagnosis(
        **told,
        rows={channel: {k: np.append(v, np.nan) for k, v in parts.items()}},
        table=TireData(NAME, columns, used, np.zeros(n + 1, int), ("",), Source()),
        comparison=compared(shown, parts, named),
    )


def judged(status, effects, probability=0.6, rivals=(), twins=(), like=(), **changes):
    verdict = said(status, effects, probability, rivals, twins, like)
    return diagnosis(verdict=verdict, **changes)


def words_page(result):
    return without_pictures(lambda: diagnosis_page(result))


@pytest.fixture(scope="module")
def page_text():
    return diagnosis_page(diagnosis())


def flat(text):
    """Text without its line breaks."""
    return re.sub(r"\s+", " ", str(text))


def test_regions_beyond_the_noise_are_drawn_with_their_shares():
    bars = where_bars(diagnosis())
    assert [(bar.label, bar.length) for bar in bars] == [
        ("load F_z 6000 N", pytest.approx(81.0)),
        ("size of the slip shrinking", pytest.approx(53.0)),
        ("size of the slip growing", pytest.approx(47.0)),
    ]
    many = tuple(Region("fz", k, k, 0.1, 0.05) for k in (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0))
    assert len(where_bars(diagnosis(where=many))) == 6
    assert "where" not in panels_of(diagnosis(where=()))


def test_residuals_show_the_gap_before_and_nothing_after():
    panel = diagnosis("offset", scatter=0.0).comparison
    np.testing.assert_allclose(panel.before, 100.0)
    np.testing.assert_allclose(panel.after, 0.0, atol=1e-9)
    assert panel.named and after_label(diagnosis()) == "load friction"


def test_curves_of_both_fits_are_drawn_at_three_loads():
    loads = (1000.0, 2000.0, 3000.0, 4000.0, 5000.0)
    panel = diagnosis("offset", rows=rows_of(loads)).comparison
    assert [c.load for c in panel.curves] == [(fz, fz) for fz in (1000.0, 3000.0, 5000.0)]
    for curve, fz in zip(panel.curves, (1000, 3000, 5000), strict=True):
        expected = 0.9 * fz * np.tanh(curve.center * 6e4 / (0.9 * fz))
        # Where it is steep, a mean over a bin is not the force at the mean slip.
        flat = np.abs(curve.center) > 0.05
        assert flat.sum() >= 20
        np.testing.assert_allclose(curve.base[flat], expected[flat], atol=0.01 * fz)
        np.testing.assert_allclose(curve.extended - curve.base, 100.0)
        np.testing.assert_allclose(curve.high - curve.low, 0.0, atol=1e-9)
        assert len(curve.slip) == len(curve.force) == 240


def test_dependence_on_other_inputs_is_drawn_as_a_band():
    curve = diagnosis("direction", scatter=0.0).comparison.curves[2]
    wide = np.abs(curve.center) > 0.15
    # 5 % of 0.9 x 6000 N to both sides.
    assert np.median((curve.high - curve.low)[wide]) == pytest.approx(540, rel=0.1)


def test_an_unexplained_gap_is_drawn_in_its_region():
    found = judged("unknown", [])
    panel = found.comparison
    assert after_label(found) == "base + located gap"
    assert np.max(panel.before) > 200 > 3 * NOISE > np.max(panel.after)


def test_a_locking_wheel_is_drawn_over_its_slip_ratio():
    rows = rows_of()
    rows.slip = np.where(rows.slip > 0.35, 50.0, rows.slip)
    curve = diagnosis("offset", rows=rows).comparison.curves[0]
    # The mean of slips without bound would lie far from every other point.
    assert np.max(curve.center) == pytest.approx(50.0, rel=0.1)
    assert np.all(np.diff(curve.center) > 0)


def test_steps_of_the_ladder_are_ordered_by_what_they_change():
    found = diagnosis()
    assert [step_label(found, k) for k in range(6)] == [
        "brush, no effect",
        "+ slip offset",
        "+ load friction",
        "+ force offset",
        "anything smooth",
        "noise floor",
    ]
    as_given = LADDER.steps[0]._replace(effects=AS_GIVEN, rms_left_out=700.0)
    sim = simulated(ladder=LADDER._replace(steps=(as_given, *LADDER.steps)))
    labels = [step_label(sim, k) for k in range(3)]
    assert labels == ["the simulator", "+ its parameters", "+ slip offset"]
    bars = ladder_bars(found)
    assert [bar.kind for bar in bars] == ["base", "effect", "effect", "effect", "smooth", "noise"]
    assert bars[0].error == 0.0
    # A share of 0.94 +- 0.03 of the gap is closed: the rms at either end.
    gap = 500.0**2 - 223.6**2
    ends = [np.sqrt(223.6**2 + gap * (1 - share) ** 2) for share in (0.91, 0.97)]
    assert bars[2].error == pytest.approx((ends[0] - ends[1]) / 2, rel=0.15)
    assert bars[2].text == "250 N, 94 % closed"


def test_no_bar_or_line_of_a_figure_crosses_a_label():
    step = LADDER.steps[1]
    ladder = LADDER._replace(steps=(*LADDER.steps[:2], *4 * (step,), *LADDER.steps[2:]))
    for result in (diagnosis(), diagnosis(ladder=ladder)):
        for name in ("ladder", "where"):
            figure = panel_pictures(result)[name]
            figure.canvas.draw()
            (axes,) = figure.axes
            labels = [text.get_window_extent() for text in axes.texts if ":" in text.get_text()]
            drawn = [bar.get_window_extent() for bar in axes.patches]
            drawn += [line.get_window_extent() for line in axes.lines if line.get_visible()]
            drawn += [
                path.get_extents(lines.get_transform())
                for lines in axes.collections
                for path in lines.get_paths()
            ]
            assert len(labels) >= 3
            assert not [label for label in labels for x in drawn if label.overlaps(x)], name


def test_the_figure_shows_the_whole_answer():
    names = ["load_friction", "slip_offset", "force_offset", "conicity", "toe"]
    found = judged("incomplete", names, rivals=["friction_drift"], like=["camber_thrust"])
    assert len(answer(found)) > 420
    assert answer(found) in flat(" ".join(texts_of(found.plot())))


def test_the_ladder_is_in_table_and_document():
    ladder = next(one for one in first_screen(diagnosis()) if one.title.startswith("How far"))
    assert ladder.title.endswith("(6 runs, each left out in turn; 360 rows)")
    assert ladder.table[0][1] == "rms left out [N]"
    assert ladder.table[1] == ("brush, no effect", "500", "-")
    assert ladder.table[2] == ("+ slip offset", "300", "80.0 ± 5.0 %")
    document = json.loads(diagnosis().to_json())
    assert document["ladder_on"] == "6 runs, each left out in turn"
    assert document["ladder"][1]["effects"] == ["slip_offset"]
    assert document["ladder"][2]["gain"] == 27500.0


def held_out(rms, closed):
    """A diagnosis whose first steps have these errors on files held out."""
    steps = [
        step._replace(rms_held_out=r, closed_held_out=c)
        for step, r, c in zip(LADDER.steps, rms, closed, strict=False)
    ]
    ladder = LADDER._replace(steps=(*steps, *LADDER.steps[3:]))
    return diagnosis(ladder=ladder, settings=replace(diagnosis().settings, holdout=("sha",)))


def test_each_step_of_the_ladder_shows_the_error_on_held_out_files():
    rms = (520.0, 310.0, 410.0)
    found = held_out(rms, (0.0, 0.75, 0.4))
    text = flat(found)
    assert "closed held out [N]" in text
    assert "+ slip offset 300 80.0 ± 5.0 % 310 (75%)" in text
    assert "load friction: predicts the files held out worse (310 to 410 N" in text
    assert "slip offset: predicts the files held out worse" not in text
    assert [bar.mark for bar in ladder_bars(found)] == [*rms, None, None, None]
    assert "does not help" not in answer(found)
    contradicted = answer(held_out((520.0, 310.0, 540.0), (0.0, 0.75, -0.1)))
    assert "On the files held out it does not help (520 to 540 N rms)" in contradicted


def test_without_held_out_rows_the_fitted_rows_are_shown():
    found = diagnosis(ladder=Ladder())
    assert "no part of these rows can be left out" in flat(found)
    assert "the rows fitted: gap of 125 N (3.1 % of mean F_z) rms" in flat(found)
    base, noise = ladder_bars(found)
    assert base.length == pytest.approx(np.hypot(125.0, 19.7)) and noise.length == 19.7
    (axes,) = panel_pictures(found)["ladder"].axes
    assert axes.get_xlabel() == "rms on the rows fitted [N]"


def test_the_closure_of_a_gap_is_a_number_a_bound_or_not_told():
    worst = replace(HELD, closed=-1.0, closed_ci=(-1.0, 0.2), remaining_rms=302.0)
    line = gap_line(diagnosis(), worst, "held out")
    assert "302 N (7.5 % of mean F_z) or more with the answer" in line
    closed = "-100 % or worse [-100 % or worse, 20 %]"
    assert line.endswith(f"closed [90 % interval]: {closed}")
    line = gap_line(diagnosis(), replace(GAP, resolvable=False, closed=None), "here")
    assert line.endswith("too uncertain to say how much of it closes")
    line = gap_line(judged("unknown", []), HELD, "wet")
    assert line == "wet: gap of 151 N (3.8 % of mean F_z) rms beyond the noise"
    settings = replace(diagnosis().settings, holdout=("ab12",))
    assert "files held out (highest fz" in flat(diagnosis(settings=settings))
    assert "files held out (" not in flat(diagnosis())


def test_axes_contain_the_arrays():
    found = diagnosis()
    both, curves = Figure(), found.comparison
    draw_comparison(both, curves, after_label(found))
    top, bottom = both.axes
    np.testing.assert_array_equal(bottom.lines[1].get_ydata(), curves.after)
    drawn = [line.get_ydata() for line in top.lines]
    assert any(np.array_equal(y, curves.curves[0].extended) for y in drawn)
    (axes,) = panel_pictures(found)["ladder"].axes
    widths = [patch.get_width() for patch in axes.patches]
    assert widths == [step.rms_left_out for step in found.ladder.steps]
    assert axes.get_xlabel() == "rms on data left out [N]"
    texts = [text.get_text() for text in axes.texts]
    assert texts[2] == "+ load friction: 250 N, 94 % closed"
    ends = [x for lines in axes.collections for part in lines.get_segments() for x in part]
    assert {x for x, _ in ends} >= {230.0, 223.6}


def test_covariates_have_words_and_units():
    units = {"fz": "N", "v": "m/s", "gamma": "rad", "slip_rate": "1/s", "distance": "m"}
    units |= {"slip": "", "front slip": "rad", "sigma_x": "", "a_y": "m/s2", "something": ""}
    assert {name: words.covariate_unit(name) for name in units} == units
    shown = [words.covariate_text(name) for name in ("slip_rate", "yaw rate", "something")]
    assert shown == ["rate of the slip", "yaw rate", "something"]


def test_the_ladder_is_legible_on_a_phone():
    """Letters of 10 pixels and more at a width of 400."""
    picture = panel_pictures(diagnosis())["ladder"]
    pixels = 400 / picture.get_figwidth() / 72
    (axes,) = picture.axes
    small = [text.get_fontsize() for text in (*axes.texts[:-1], axes.xaxis.label)]
    assert min(small) * pixels > 10
    picture.draw_without_rendering()
    for text in axes.texts:
        assert text.get_window_extent().x1 <= picture.bbox.x1


@pytest.mark.parametrize(
    ("amount", "said"),
    [
        ((2.7, 0.3, "1e-3 mean F_z"), "0.270 ± 0.030 % of the mean F_z"),
        ((2.7, None, "1e-3 F_z"), "0.27 % of F_z"),
        ((-2.0, None, "1e-3 mean F_z per record"), "-0.2 % of the mean F_z per record"),
        ((0.01, None, "- per record"), "0.01 per record"),
        ((0.01, 0.001, "-"), "0.0100 ± 0.0010"),
        ((0.2, None, "1 / g^2"), "0.2 / g^2"),
        ((0.2, None, "s/m"), "0.2 s/m"),
        ((0.2, None, ""), "0.2"),
    ],
)
def test_an_amplitude_is_written_with_a_readable_unit(amount, said):
    assert amount_text(*amount) == said


def test_no_unit_is_written_with_a_power_of_ten_or_a_dash():
    for effect in EFFECTS:
        _, unit = readable_unit(effect.unit)
        assert "1e-3" not in unit and not unit.startswith(("-", "1"))


BUDGET = (
    # 400, 160, 80 and 120 N in squares of 460 N and a bit: 3-4-5 twice over.
    Part("parameters", 400.0, 160000 / 206400, (0.7, 0.8)),
    Part("slip_offset", 160.0, 25600 / 206400, (0.1, 0.2)),
    Part("unexplained", 80.0, 6400 / 206400, (0.01, 0.05)),
    Part("noise", 120.0, 14400 / 206400, (0.06, 0.08)),
)
CHANGES = {
    "mu": Change(0.981, 0.9, 0.009, True),
    "cpa2": Change(5e4, 5.1e4, 900.0, False),
    "E": Change(-0.5, 0.1, 0.02, True),
}
SIMULATED = {
    "simulator": SimulatorSummary(
        "columns", "columns", None, Surrogate(model="brush", rms=75.0, of_force=0.019, of_gap=0.23)
    ),
    "budget": BUDGET,
    "meanings": {"E": "curvature factor"},
}


def simulated(status="named", effects=("slip_offset",), changes=CHANGES, **others):
    verdict = said(status, effects, 0.9, parameters=changes)
    return diagnosis(verdict=verdict, **SIMULATED | others)


def test_the_parameters_of_a_simulator_are_reported():
    found = simulated()
    line = stand_in_line(found)
    assert line.endswith("by 75 N rms, 2 % of its force and 23 % of the gap")
    off = found.simulator.surrogate._replace(of_gap=0.6)
    summary = found.simulator._replace(surrogate=off)
    assert "the steps are rough" in stand_in_line(simulated(simulator=summary))
    assert stand_in_line(diagnosis()) == ""
    # The surest change first: E is 30 standard errors off, mu nine.
    assert change_texts(found) == [
        "curvature factor 0.600 ± 0.020 too low (set E to 0.1)",
        "friction 9.0 ± 1.1 % too high (set mu to 0.9)",
    ]
    # s / m: its error is s / m^2 times that of m.
    far = CHANGES["cpa2"]._replace(simulated=5e4, measured=2.5e4, std=500.0)
    many = far._replace(measured=50.0, std=2.0, differs=True)
    far = far._replace(differs=True)
    assert change_texts(simulated(changes={"cpa2": far})) == [
        "stiffness 100.0 ± 4.0 % too high (set cpa2 to 25000)"
    ]
    # A factor above three says only that the rows hardly determine it.
    more = ["stiffness more than 3 times too high (set cpa2 to 50)"]
    assert change_texts(simulated(changes={"cpa2": many})) == more
    slides_never = simulated(changes={"mu": many})
    used = np.nanmax(np.abs(slides_never.rows["fx"]["base"]) / slides_never.table["fz"])
    size = format_number(float(used), 2)
    words = [f"no friction limit below {size} F_z in these rows (set mu to 50)"]
    assert change_texts(slides_never) == words
    slow = far._replace(simulated=4e4 / 57.3, measured=4e4, std=400.0)
    (text,) = change_texts(simulated(changes={"cpa2": slow}))
    assert text == "stiffness 57 times too low, as if it were per degree (set cpa2 to 40000)"
    # A simulator that is known by its forces has no scaling factors.
    half, tir = far._replace(simulated=1.0, measured=0.5, std=0.01), found.simulator
    for kind, todo in (("columns", "multiply it by 0.5"), ("tir", "set LKY to 0.5")):
        given = simulated(changes={"LKY": half}, simulator=tir._replace(kind=kind))
        assert change_texts(given) == [f"LKY 100.0 ± 4.0 % too high ({todo})"]
    details = flat(diagnosis_text(found, full=True))
    assert "cpa2 [N] 50000 51000 ± 900 no" in details and "mu [-] 0.981" in details


@pytest.mark.parametrize(
    ("status", "effects", "sentence"),
    [
        ("none", (), "There is no gap beyond its parameters and the noise. Probability"),
        (
            "named",
            ("slip_offset",),
            "The gap comes from slip offset of 0.1234 ± 0.0056 (0.91), 12 % of the error's mean"
            " square: add it to the slip.",
        ),
    ],
)
def test_the_answer_on_a_simulator_begins_with_its_parameters(status, effects, sentence):
    found = simulated(status, effects, {"mu": CHANGES["mu"]})
    first = "The simulator has friction 9.0 ± 1.1 % too high (set mu to 0.9), 78 % of its error. "
    assert answer(found).startswith(first + sentence)
    assert after_label(simulated()) == "parameters + slip offset"


def test_the_largest_part_comes_first_and_what_does_not_carry_over_is_left_out():
    """The second effect has the larger share; a third predicts held-out files worse."""
    parts = [Part(e, 9.0, share, (0.0, 1.0)) for e, share in
             (("slip_offset", 0.2), ("load_friction", 0.7), ("unexplained", 0.1))]  # fmt: skip
    names = ["slip_offset", "load_friction", "conicity"]
    steps = [
        Step(tuple(names[:k]), 9.0 - k, 0.1 * k, 0.0, 1.0, 0.1, rms, None)
        for k, rms in enumerate((9.0, 8.0, 7.0, 7.5))
    ]
    found = judged("named", names, budget=tuple(parts), ladder=Ladder("runs", tuple(steps)))
    text = answer(found)
    assert text.startswith("The gap comes from load friction (0.20), 70 %")
    assert "; then from slip offset (0.91), 20 %" in text and "conicity" not in text
    # No step predicts those files better than no effect: a later one does not stand for all.
    steps = [s._replace(rms_held_out=x) for s, x in zip(steps, (9.0, 9.5, 9.3, 9.4), strict=True)]
    text = answer(replace(found, ladder=Ladder("runs", tuple(steps))))
    assert "conicity" in text and "slip offset" in text and "load friction" in text
    simulator = simulated(changes={"mu": CHANGES["mu"]}, budget=tuple(parts))
    assert answer(simulator).startswith("The gap comes from slip offset")


def test_the_answer_on_a_derived_slip_and_on_a_small_gap():
    found = judged("named", ["slip_offset"])
    derived = replace(found, data=replace(found.data, motion=("yaw rate of the pose",)))
    # The remedy of a derived slip is in the vehicle's file.
    assert "(0.91): subtract it from yaw_offset of vehicle.toml" in answer(derived)
    small = replace(found, gap=replace(found.gap, rms=7.5, resolvable=False))
    assert "The gap is small: 7.5 N (rms) beside 20 N of noise." in answer(small)
    assert "small" not in answer(found) and "(0.91): add it to the slip." in answer(found)


def texts_of(figure):
    """All texts of a figure, at any depth."""
    return [text.get_text() for text in figure.findobj(Text)]


STEP = Shape("friction", "fz", 6000.0, -0.049, 0.97, 0.8)
SHAPES = {
    "setting": (STEP, "friction changes with load F_z, by -4.9 % at 6000 N"),
    "smooth": (
        Shape("stiffness", "v", 12.0, 0.2, 1.0, 1.0),
        "stiffness changes with speed v, by 20 % at 12 m/s",
    ),
    "slip": (
        Shape("slip", "slip_fraction", 1.2, 2e-3, 1.0, 1.0),
        "slip changes with slip / slip of full sliding, by 0.002 at 1.2",
    ),
}


@pytest.mark.parametrize(("shape", "sentence"), SHAPES.values(), ids=SHAPES)
def test_the_remainder_is_described_by_its_shape(shape, sentence):
    left = LEFT._replace(unlisted=0.8, looks_like=(shape,))
    text = flat(diagnosis(verdict=said("unknown", (), 0.8, left=left)))
    share = f"{100 * shape.explains:.0f} % of its mean square"
    assert f"it resembles this: {sentence} (probability {shape.probability:.2f} among" in text
    assert f"explains {share}" in text


FZ = SizeByGroup("fz", (2000.0, 4000.0, 6000.0), (0.05, 0.12, 0.18), (0.01, 0.02, 0.5), 0.4)
SLIP = SizeByGroup("signed_slip", (-0.123, 0.123), (0.10, 0.14), (0.01, 0.01), 0.2)


def sized(**others):
    """A diagnosis with sizes by groups: an effect that helps, beside a cause."""
    sizes = {"load_friction": (FZ, SLIP), "slip_offset": (SLIP,)}
    verdict = said("named", ["slip_offset"], like=["load_friction"], sizes=sizes)
    both = candidate(["load_friction", "slip_offset"], 0.9)
    return diagnosis(verdict=verdict, candidates=(both,), **others)


def test_an_effect_that_acts_like_the_cause_is_in_text_and_document():
    found = sized()
    assert answer(found).startswith(
        "The gap comes in part from slip offset of 0.1234 ± 0.0056 (0.91): add it to the slip."
        " In the model, the error acts like load friction of 0.1234 ± 0.0056 (0.20 that this is"
        " the cause; it removes 10 % on data left out)."
    )
    size = "size by load F_z: 0.050 ± 0.010, 0.120 ± 0.020, 0.18 ± 0.50; beyond their errors"
    assert f"{size} they spread by 40 % of the whole" in flat(found)
    assert after_label(found) == "slip offset + load friction"
    verdict = json.loads(found.to_json())["verdict"]
    assert verdict["effects"] == ["slip_offset"] and verdict["acts_like"] == ["load_friction"]
    assert verdict["sizes"]["load_friction"][0] == json.loads(json.dumps(FZ._asdict()))
    alone = judged("unknown", ["unknown"], like=["load_friction"])
    assert answer(alone).startswith(
        "There is a gap beyond the noise, and no listed effect is its likely cause. Probability"
        " 0.13 of an unlisted effect. In the model, it acts like load friction of 0.1234 ±"
        " 0.0056 (0.20 that this is the cause; it removes 10 % on data left out). This takes the"
        " gap from 125 to 25 N (rms)."
    )


STATUSES = {
    "named": (
        ("named", ["load_friction"]),
        "The gap comes from load friction of 0.1234 ± 0.0056 (0.91): fit brush-load. This takes the"
        " gap from 125 to 25 N (rms).",
    ),
    "noise": (
        ("named", ["outliers"]),
        "There is no gap beyond the noise. Probability 0.60 of no effect, listed or"
        " unlisted. The noise shows outliers.",
    ),
    "none": (
        ("none", []),
        "There is no gap beyond the noise. Probability 0.60 of no effect, listed or unlisted.",
    ),
    "incomplete": (
        ("incomplete", ["load_friction", "slip_offset"]),
        "The gap comes in part from load friction (0.91): fit brush-load; then from slip offset"
        " (0.20): add it to the slip; an unlisted effect is likely as well (0.13). These take the"
        " gap from 125 to 25 N (rms).",
    ),
    "unknown": (
        ("unknown", [], 0.6, ["friction_drift"]),
        "There is a gap beyond the noise, and no listed effect is its likely cause."
        " Probability 0.13 of an unlisted effect.",
    ),
    "cannot_tell": (
        ("cannot_tell", ["load_friction"], 0.6, ["friction_drift"], ["friction_drift"]),
        "The gap comes from load friction of 0.1234 ± 0.0056 or friction drift, which this data"
        " cannot tell apart (0.91). This takes the gap from 125 to 25 N (rms).",
    ),
}


@pytest.mark.parametrize(("verdict", "sentence"), STATUSES.values(), ids=STATUSES)
def test_every_verdict_has_its_sentence(verdict, sentence):
    found = judged(*verdict)
    assert answer(found) == sentence
    text = flat(found)
    # What can be done, for each effect that is named.
    for effect in verdict[1]:
        assert name_of(effect) in text
        assert all(part in text for part in words_on(effect))
    named = verdict[0] != "none" and verdict[1][:1] == ["load_friction"]
    assert ("effect that would be detected: 6.3 N rms" in text) == (not named)
    assert len(str(found).splitlines()) <= 60


def test_an_effect_has_amplitude_probability_closure_and_twins():
    found = judged("cannot_tell", ["load_friction"], 0.6, ["force_offset"], ["toe"])
    assert (
        "load friction (load_friction): 0.1234 ± 0.0056 probability 0.91 that it or"
        " toe is the cause: this data cannot tell them apart; closes 80.0 ± 5.0 % of the"
        " gap on data left out friction is a power of the load; to do: fit brush-load"
    ) in flat(found)
    assert f"(force_offset): not named {words_on('force_offset')[0]}" in flat(found)


def test_a_useless_measurement_is_not_suggested():
    pair = ("load_friction", "d")
    little = NextMeasurement("the same again", pair, 0.71, 0.75)
    more = NextMeasurement("two more loads", pair, 0.71, 0.80)
    much = NextMeasurement("other speeds", pair, 0.71, 0.95)
    (line,) = step_lines(diagnosis(next_measurement=(little, more)))
    assert line == (
        "no single listed measurement would decide it: at best two more loads,"
        " which separates load friction from d with probability 0.80, instead of"
        " 0.71 now"
    )
    (line,) = step_lines(diagnosis(next_measurement=(much, more, little)))
    assert line.startswith("measure other speeds: it separates load friction")
    assert step_lines(diagnosis(next_measurement=())) == []


def test_three_next_measurements_are_suggested():
    pair = ("load_friction", "d")
    steps = [NextMeasurement(add, pair, 0.71, 0.95) for add in ("a", "b", "c", "other speeds")]
    text = flat(diagnosis(next_measurement=tuple(steps[::-1])))
    assert (
        "measure other speeds: it separates load friction from d with probability 0.95, instead of"
        " 0.71 now"
    ) in text
    assert text.count("it separates") == 3
    unknown = flat(diagnosis(next_measurement=(steps[0]._replace(p_after=np.nan),)))
    assert "it separates load friction from d (these rows: with probability 0.71)" in unknown


def test_the_text_fits_one_screen_and_full_lists_all():
    text = str(diagnosis())
    assert len(text.splitlines()) <= 60 and text == diagnosis_text(diagnosis())
    assert "360 rows; noise F_x 19.7 N (standard deviation, given)" in text
    assert "25 N rms beyond the noise, 4 % of the gap's mean square; probability 0.13 of"
    full = diagnosis_text(diagnosis(), full=True)
    assert max(len(line) for line in full.splitlines()) <= 88
    assert full.startswith(text[: text.index("braking positive")])
    full = flat(full)
    assert "the 360 rows fitted: gap of 125 N (3.1 % of mean F_z) rms beyond" in full
    assert "closed [90 % interval]: 80 % [70 %, 85 %]" in full
    assert "load F_z 6000 N 81 % < 1e-12" in full
    assert "size of the slip shrinking 53 % 0.013" in full
    assert "0.061 friction drift + load friction; friction drift 0.1234" in full
    assert "cpa2 [N] 51234 51235" in full and "360 rows count as 287 in a fit" in full


def test_a_slip_that_contradicts_the_wheel_speed_is_reported():
    check = SlipCheck(
        read_as="sigma_x",
        fits="kappa",
        radius=0.305,
        rms=0.0123,
        scatter=0.001,
        offset=0.0041,
        offset_std=0.0002,
        gain=1.0,
        told_apart=True,
    )
    found = diagnosis(slip_check=check)
    sentence = (
        "slip, read as sigma_x, against omega, v and a rolling radius of 0.305 m: 0.012"
        " rms apart, offset 0.00410 ± 0.00020, follows kappa"
    )
    assert sentence in flat(found)
    agrees = diagnosis(slip_check=check._replace(fits="sigma_x"))
    assert "rolling radius of" not in str(agrees)
    assert "rolling radius of" in flat(diagnosis_text(agrees, full=True))


def test_effects_excluded_by_the_caller_are_reported():
    settings = diagnosis().settings
    ids = [effect.id for effect in EFFECTS]

    def lines(looked_for):
        found = diagnosis(settings=replace(settings, effects=tuple(looked_for)))
        text = diagnosis_text(found, full=True).splitlines()
        return [line.strip() for line in text if "not looked for" in line]

    assert lines(ids) == []
    assert lines(set(ids) - {"slip_offset"}) == ["not looked for: slip_offset"]


def test_texts_cover_the_library_and_name_existing_models():
    library = (*EFFECTS, *NOISE_EFFECTS)
    assert all(effect.means and effect.remedy for effect in library)
    named = [
        model
        for words in library
        for model in re.findall(r"\b(?:brush-[\w-]+|magic-formula[\w-]*|quartic)", words.remedy)
    ]
    assert len(named) >= 12
    assert set(named) <= set(MODELS)
    needs = {need for effect in EFFECTS for need in (*effect.needs, *effect.channels)}
    assert needs <= {*_NEEDS, "time", "yaw_rate", "yaw_acceleration", "fx", "fy"}


def test_a_user_defined_effect_is_shown_by_its_id():
    found = judged("named", ["road_ripple"], candidates=(candidate(["road_ripple"], 1),))
    assert answer(found).startswith("The gap comes from road ripple of 0.1234 ± 0.0056 (0.91).")
    mine = Effect(
        id="road_ripple",
        family="friction x time",
        change=lambda state, *_: state,
        scale=0.1,
        unit="-",
        formula="",
        means="the road has waves",
        remedy="measure elsewhere",
    )
    verdict = found.verdict
    own = Untestable("road_ripple", ("road camera", "omega"))
    known = diagnosis(verdict=verdict, library=(*EFFECTS, mine), untestable=(own,))
    assert "the road has waves; to do: measure elsewhere" in str(known)
    assert missing_lines(known) == ["road camera, wheel speed omega: road ripple"]


def test_what_is_missing_is_listed_once(page_text):
    needs = [f"quantity {number}" for number in range(11)]
    found = diagnosis(untestable=tuple(Untestable("toe", (need,)) for need in needs))
    for text in (flat(diagnosis_text(found, full=True)), words_page(found)):
        assert [text.count(f"{need}: toe") for need in needs] == [1] * 11
        assert text.index("and 3 more in the details") < text.lower().index("also not testable")
    assert "also not testable" not in page_text.lower()


def test_ranges_are_written_with_few_digits():
    def region(name, low, high):
        return Region(name, low, high, 0.5, 0.5)

    assert range_text(region("fz", 6000.0, 6000.0)) == "6000 N"
    assert range_text(region("slip_fraction", 1e-5, 1.17)) == "0 to 1.17"
    assert range_text(region("slip_fraction", 0.5461, 236843.0)) == "0.546 and more"
    assert range_text(region("slip", -9e4, -0.25)) == "-0.25 and less"
    assert range_text(region("slip", -9e4, 9e4)) == "any"
    assert range_text(region("slip_fraction", 1.8e7, 1.8e7)) == "100 and more"
    assert range_text(region("time", 13.4851, 17.98)) == "13.5 to 18 s"
    assert range_text(region("direction", -1.0, -1.0)) == "shrinking"
    assert share_text(0.951) == "95 %"
    assert p_text(0.0) == "< 1e-12" and p_text(0.0134) == "0.013"
    first = missing_lines(diagnosis(untestable=UNTESTABLE))[0]
    assert first.endswith(": friction temperature, stiffness temperature")
    assert listing(["a"]) == "a" and listing(["a", "b", "c"], "or") == "a, b or c"
    assert set_name(()) == "no effect"
    assert set_name(["toe", "slip_offset"]) == "toe + slip offset"


def test_the_page_contains_the_record_and_its_panels(page_text):
    record = html.unescape(page_text.split("<pre>")[1].split("</pre>")[0])
    assert json.loads(record) == json.loads(diagnosis().to_json())
    assert Page(page_text).seen.count("img") == 3
    # The first picture shows the ladder, so its table is folded.
    assert "<details><summary>How far the gap shrinks" in page_text


def test_a_notebook_shows_the_diagnosis():
    fragment = diagnosis()._repr_html_()
    page = Page(fragment)
    assert page.seen.count("img") == 3 and "html" not in page.seen
    assert "The gap comes from load friction of 0.1234 ± 0.0056 (0.91)" in "".join(page.texts)
    assert "style" not in page.seen  # it would restyle the whole notebook


@in_browser
def test_a_page_that_fetches_is_detected(page_text, tmp_path):
    page = tmp_path / "fetching.html"
    page.write_text('<!DOCTYPE html><img src="http://tire.invalid/logo.png">')
    _, asked = browse(page, tmp_path, "--dump-dom")
    assert asked == ["http://tire.invalid/logo.png"]
    # The page's own policy stops even that.
    image = '<img src="http://tire.invalid/a.png">'
    page.write_text(page_text.replace("<h1>", f"{image}<h1>"))
    _, asked = browse(page, tmp_path, "--dump-dom")
    assert asked == []


@in_browser
@pytest.mark.parametrize("wide", [False, True])
def test_the_page_fits_a_phone(page_text, tmp_path, wide):
    extra = '<div style="width:450px">too wide</div>' if wide else ""
    width = width_on_phone(page_text.replace("</body>", f"{extra}</body>"), tmp_path)
    assert (width > PHONE) == wide


def test_a_panel_of_a_diagnosis_is_drawn_for_whoever_saves_it(tmp_path):
    result = diagnosis()
    result.plot("where").savefig(tmp_path / "where.svg")
    assert [path.name for path in tmp_path.iterdir()] == ["where.svg"]
    with pytest.raises(UsageError, match="there is no panel 'were'\n.*'where'"):
        result.plot("were")


def test_an_offset_is_also_given_in_the_signs_of_the_file():
    """ISO-W: driving slip is positive, so an offset of braking slip changes sign."""
    slip = {"slip_offset: amplitude": Amplitude(0.006, 0.001, "- of slip")}
    candidates = (replace(candidate(["slip_offset"], 0.9), parameters=slip),)
    found = judged("named", ["slip_offset"], 0.9, candidates=candidates)
    assert found.data.convention == "iso-w"
    assert "0.0060 ± 0.0010 of slip (-0.006 of slip in the file's signs" in flat(found)
    braking = replace(found.data, convention="braking")
    assert "in the file's signs" not in flat(replace(found, data=braking))


def test_a_model_that_explains_almost_nothing_is_doubted():
    found = diagnosis()
    assert "warning: brush explains" not in str(found)
    none = {name: 0 * values for name, values in found.rows["fx"].items()}
    poor = flat(replace(found, rows={"fx": none}))
    assert "warning: brush explains 0% of the mean square of F_x: check columns" in poor
