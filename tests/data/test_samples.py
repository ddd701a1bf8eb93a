"""The sample files of the manual can be read and contain the same sweep."""

from pathlib import Path

import numpy as np
import pytest
from rig_file import truth

from tirefit.data.read import read

SAMPLES = Path(__file__).parents[2] / "docs" / "samples"
PAGE = (SAMPLES.parent / "how-to" / "input-formats.md").read_text(encoding="utf-8")
FILES = sorted(path for path in SAMPLES.iterdir() if path.suffix not in (".py", ""))
TOPICS = {name: f"/{name}.data" for name in ("alpha", "fy", "fz")}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_sample_gives_its_sweep(path):
    data = read(path, columns=TOPICS if path.suffix == ".mcap" else None)
    right = truth(80)
    # Text has six digits; a TYDEX file has fewer of a force in kN with an offset.
    for name, digit in (("alpha", 1e-6), ("fy", 0.05), ("fz", 0.01), ("time", 1e-6)):
        np.testing.assert_allclose(data[name], right[name], rtol=2e-5, atol=digit)


def test_the_manual_links_to_every_sample():
    assert len(FILES) == 9
    assert [path.name for path in FILES if f"../samples/{path.name})" not in PAGE] == []
