"""A car of 1:10 as a file."""

import pytest

from tests.targets.support import WHOLE


@pytest.fixture
def vehicle(tmp_path):
    path = tmp_path / "vehicle.toml"
    path.write_text(WHOLE)
    return path
