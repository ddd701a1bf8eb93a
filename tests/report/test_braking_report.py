"""The numbers shown by the figures of a stop, and that they can be drawn."""

import re
from dataclasses import replace

import jax
import numpy as np
import pytest
from matplotlib.figure import Figure

from fits.braking.slip_control import SlipControl
from tirefit.models import MODELS
from tirefit.online.braking.controllers import controller_of
from tirefit.params import with_values
from tirefit.report.braking import braking_text, draw_series, path_of, paths_figure, stop_figure
from tirefit.sim.brake_request import Request, known_to_controllers, tire_curve
from tirefit.sim.brake_vehicle import four_wheels
from tirefit.sim.manoeuvre import braked


@pytest.fixture(scope="module")
def result():
    tire = with_values(MODELS["brush-m"], {"cpa2": 4e4, "m": 0.5})
    # As long as the stops of tests/sim, with which it shares its programs.
    how = {"speed": 7.0, "road": "mu=0.3:0.7@4", "time_limit": 12.0}
    request = Request(tire, "brush-m", vehicle="quarter", **how)
    car = known_to_controllers(request)
    kinds = {"abs": "abs", "slip": SlipControl}
    controllers = {name: controller_of(kind, car) for name, kind in kinds.items()}
    controllers["none"] = controller_of("abs", car, {"off": 10.0})  # open valves
    found = braked(request, controllers, seed=1)
    # Drawn as a car whose wheels all move as the one that was simulated.
    stops = {
        name: replace(stop, log=jax.tree.map(four, stop.log), wheels=four_wheels().wheels)
        for name, stop in found.stops.items()
    }
    return replace(found, request=replace(request, vehicle="car"), stops=stops)


def four(leaf):
    return np.repeat(leaf, 4, axis=1) if leaf.ndim == 2 else leaf


def test_the_text_gives_numbers_and_reasons(result):
    text = braking_text(result)
    assert "brush-m from 7 m/s on mu=0.3:0.7@4, car" in text
    assert "slip: stopped: slower than 0.1 m/s" in text and "recovery [s]" in text
    assert max(map(len, text.splitlines())) <= 88
    assert "BRAKING brush-m" in result._repr_html_()
    for name, stop in result.stops.items():
        row = re.search(rf"^  {name} +([\d.].*)", text, re.M)[1].split()
        shown = [float("nan" if cell == "-" else cell) for cell in row[:4]]
        s = stop.summary
        expected = [s.stopping_distance, s.mean_friction_used, s.locked_time]
        expected.append(s.pressure_rms_fluctuation / 1e6)  # MPa
        np.testing.assert_allclose(shown, expected, rtol=1e-3)


def test_slip_control_uses_more_friction_than_abs(result):
    used = {k: float(s.summary.mean_friction_used) for k, s in result.stops.items()}
    assert used["slip"] > used["abs"] and used["slip"] > used["none"]


def test_the_curve_has_the_peaks_of_the_road(result):
    curves = tire_curve(result.request, 0.4, points=2000)
    assert list(curves) == pytest.approx([0.3, 0.7])
    for mu, (kappa, force) in curves.items():
        assert force.max() == pytest.approx(mu, rel=1e-4) and kappa[0] == 0.0


def test_a_path_lies_on_the_curve(result):
    """The first road, first wheel of slip control: its points are on the tire's."""
    stop = result.stops["slip"]
    path = path_of(stop)
    assert np.all(np.isfinite(path.kappa)) and path.mean[1] == path.force.mean()
    early = stop.log.motion.distance[: len(path.kappa)] < 3.0
    kappa, force = tire_curve(result.request, 0.5, points=4000)[0.3]
    expected = np.interp(path.kappa[early], kappa, force)
    # The load moves with the pitch, and with it the slip of the same share.
    np.testing.assert_allclose(path.force[early], expected, atol=0.03)


def test_the_panels_of_a_stop_show_the_log(result):
    """Of the slip: a line for each wheel and the peak, dashed; up to that of the fast car."""
    axes = Figure().subplots()
    draw_series(axes, result, "Slip κ; dashed: of the peak")
    lines = iter(axes.lines)
    highest = 0.0
    for stop in result.stops.values():
        log = stop.log
        fast = log.motion.v_x > 0.3 * log.motion.v_x[0]
        for wheel in range(4):
            line = next(lines)
            np.testing.assert_array_equal(line.get_xdata(), log.reading.time)
            np.testing.assert_array_equal(line.get_ydata(), log.contacts.slips.kappa[:, wheel])
            assert line.get_linestyle() == "-"
        peak = next(lines)
        np.testing.assert_array_equal(peak.get_ydata(), log.reading.truth.peak[:, 0])
        assert peak.get_linestyle() == "--"
        highest = max(highest, np.percentile(log.contacts.slips.kappa[fast], 97))
    assert next(lines, None) is None
    assert highest < axes.get_ylim()[1] < 2 * highest


def test_dots_of_a_narrow_range_lie_over_those_of_a_wide_one(result):
    """Whatever the order of the controllers: they would be hidden below."""
    for names in (list(result.stops), list(result.stops)[::-1]):
        stops = {name: result.stops[name] for name in names}
        picture = paths_figure(replace(result, stops=stops))
        (axes,) = picture.axes
        used = re.findall(r"(\d+) % of", " ".join(picture.texts[1].get_text().split()))
        expected = [100 * stop.summary.mean_friction_used for stop in stops.values()]
        np.testing.assert_allclose(np.array(used, float), expected, atol=0.51)
        widths = [np.ptp(x.get_xdata()) for x in axes.lines if x.get_rasterized()]
        assert len(widths) == 3 and widths == sorted(widths, reverse=True)
        legend = [text.get_text() for text in axes.get_legend().get_texts()]
        assert [text.partition(":")[0] for text in legend] == names


@pytest.mark.long
def test_figures_are_drawn_for_one_and_for_all_stops(result):
    pictures = [draw(result) for draw in (stop_figure, paths_figure)]
    for picture in pictures:
        picture.draw_without_rendering()
    # No controller of these estimates the stiffness.
    assert len(pictures[0].axes) == 4 and len(pictures[1].axes) == 1
