"""The numbers in the figure of a prepared test."""

import sys
from pathlib import Path

import numpy as np
import pytest

from tirefit.data.read import read_frame
from tirefit.data.rig.prepare import prepare
from tirefit.report.prepared import panels_of, prepared_figure, strips_of, title_of

sys.path.insert(0, str(Path(__file__).parents[1] / "data"))
from rig_script import cornering, measured


@pytest.fixture(scope="module")
def prepared():
    script, rng = cornering(7201, rate=50, loads=3, cambers=1, pressures=1)
    seen, _ = measured(script, rng)
    return prepare(read_frame(seen, "rig", curve=False, mask_bad_rows=True))


def test_the_view_reports_kept_rows_and_draws_varying_channels(prepared):
    panels, strips, title = panels_of(prepared), strips_of(prepared), title_of(prepared)
    sweeps = sum(part.kind == "sweep" for part in prepared.segments)
    assert title.startswith(f"rig: {sweeps} sweeps and")
    assert f"in 3 bins, {prepared.kept.mean():.0%} of the rows kept" in title
    # Camber and pressure were set to one value each.
    names = [panel.name for panel in panels]
    assert names == ["alpha", "fz", "v", "temperature", "fy"]
    assert "[deg]" in panels[0].label
    load = panels[1]
    factor = 1e-3 if "[kN]" in load.label else 1.0
    np.testing.assert_allclose(load.settings, factor * prepared.settings["fz"].center, rtol=1e-12)
    assert load.value.max() == pytest.approx(factor * prepared.columns["fz"].max())
    assert sum(strip.rows for strip in strips) == len(prepared.data)
    spans = sorted(span for strip in strips for span in strip.spans)
    for (begin, width), (after, _) in zip(spans[:-1], spans[1:], strict=True):
        assert begin + width == pytest.approx(after)
    kept = {strip.kind for strip in strips if strip.is_kept}
    strengths = {strip.is_kept: strip.style["alpha"] for strip in strips}
    assert strengths[True] > strengths[False]
    assert kept == {"sweep up", "sweep down", "steady"}


def test_the_figure_has_a_panel_per_channel_and_a_colour_per_kind(prepared):
    picture = prepared_figure(prepared)
    assert len(picture.axes) == len(panels_of(prepared))
    (legend,) = picture.subfigs[0].legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert [text.rsplit(" ", 1)[0] for text in texts] == [s.kind for s in strips_of(prepared)]
    assert picture.axes[-1].get_xlabel() == "time [s]"
