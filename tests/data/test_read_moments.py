"""The columns of the overturning and the rolling resistance moment."""

import numpy as np
import pytest
from rig_file import truth, ttc, tydex

from tirefit.data.read import read, read_frame
from tirefit.data.write import to_convention


def columns():
    known = truth()
    angle = known["alpha"]
    return {
        "alpha": angle,
        "fz": known["fz"],
        "fy": -known["fy"],
        "MX [N m]": -0.02 * known["fy"],
        "rolling resistance [Nm]": -9 + 0 * angle,
    }


def test_moments_follow_the_axes_of_the_file():
    data = read_frame(columns(), convention="iso-w")
    np.testing.assert_allclose(data["mx"], 0.02 * truth()["fy"])
    np.testing.assert_allclose(data["my"], 9.0)
    back = to_convention(data, {"mx": data["mx"], "my": data["my"]})
    np.testing.assert_allclose(back["MX [N m]"], columns()["MX [N m]"])
    sae = columns() | {"alpha": -columns()["alpha"], "fz": -columns()["fz"]}
    sae["fy"] = -sae["fy"]
    turned = read_frame(sae, convention="sae")
    np.testing.assert_allclose(turned["mx"], data["mx"])
    np.testing.assert_allclose(turned["my"], -data["my"])


@pytest.mark.parametrize("imperial", [False, True])
def test_the_tire_test_consortium_has_the_overturning_moment(imperial):
    known = truth()
    frame = ttc(known, imperial) | {"MX": 0.02 * known["fy"]}
    unit = 1.3558179483314004 if imperial else 1.0
    np.testing.assert_allclose(read_frame(frame)["mx"], -0.02 * known["fy"] * unit)


def test_tydex_moments_are_in_axes_w(tmp_path):
    known = truth()
    for name, there in (("MXW", True), ("MXH", False)):
        text = "\n".join(tydex(known)).replace("MZW", name)
        (tmp_path / "test.tdx").write_text(text)
        data = read(tmp_path / "test.tdx")
        assert "mz" not in data and ("mx" in data) == there
    text = "\n".join(tydex(known)).replace("MZW", "MYW")
    (tmp_path / "test.tdx").write_text(text)
    np.testing.assert_allclose(read(tmp_path / "test.tdx")["my"], known["mz"], atol=1e-3)
