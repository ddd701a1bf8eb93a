"""The overturning and the rolling resistance moment of .tir files."""

from functools import cache
from pathlib import Path

import jax
import numpy as np
import pytest

from tirefit.data.tir.tir import read_tir
from tirefit.models import TireInputs, forces
from tirefit.models.mf import Mirrored, mf_tire
from tirefit.params import parameter_values

FOLDER = Path(__file__).parents[1] / "data" / "tir" / "mfeval_julia"
EVERY = pytest.mark.parametrize("number", [52, 61, 62])
N = 300


@cache
def numbers(number):
    return read_tir(FOLDER / f"MagicFormula{number}_Parameters.tir").numbers


def tire_of(number, **changes):
    version = "/".join(str(number)).replace("/", ".")
    return mf_tire(version, numbers(number) | changes)


@cache
def inputs():
    draw = np.random.default_rng(11).uniform
    return TireInputs(
        draw(-0.2, 0.3, N),
        draw(-0.25, 0.25, N),
        draw(800, 9000, N),
        draw(2, 50, N),
        draw(-0.1, 0.1, N),
        draw(1.8e5, 3e5, N),
        np.zeros(N),
    )


def m_x(c, fy, fz, gamma, pressure):
    """The equation of the manual of MF-Tyre 6.1, in ISO-W axes."""
    q = [0.0] + [c.get(f"QSX{i}", 0.0) for i in range(1, 15)]
    f, g, n = fy / c["FNOMIN"], np.abs(gamma), fz / c["FNOMIN"]
    p0 = c.get("NOMPRES", 1.0)
    dp = (pressure - p0) / p0
    camber = q[2] * gamma * (1 + c.get("PPMX1", 0.0) * dp)
    shape = np.cos(q[5] * np.arctan(q[6] ** 2 * n**2))
    turn = np.sin(q[7] * gamma + q[8] * np.arctan(q[9] * f))
    first = q[1] * c.get("LVMX", 1.0) - camber + q[3] * f + q[4] * shape * turn
    first = first + q[10] * np.arctan(q[11] * n) * gamma
    second = fy * (q[13] + q[14] * g) - fz * q[12] * gamma * g
    return c["UNLOADED_RADIUS"] * c.get("LMX", 1.0) * (fz * first + second)


def m_y_52(c, fx, fz, v):
    """The equation of the manual of MF-Tyre 5.2, in ISO-W axes."""
    u = v / c["LONGVL"]
    share = c["QSY1"] + c["QSY2"] * fx / c["FNOMIN"] + c["QSY3"] * u + c["QSY4"] * u**4
    return -c["UNLOADED_RADIUS"] * c.get("LMY", 1.0) * fz * share


def m_y_6(c, fx, fz, v, gamma, pressure):
    """(A48) of Besselink et al. (2010), in ISO-W axes."""
    u, n = v / c["LONGVL"], fz / c["FNOMIN"]
    share = c["QSY1"] + c["QSY2"] * fx / c["FNOMIN"] + c["QSY3"] * u + c["QSY4"] * u**4
    share = share + (c["QSY5"] + c["QSY6"] * n) * gamma**2
    power = n ** c["QSY7"] * (pressure / c["NOMPRES"]) ** c["QSY8"]
    return -c["UNLOADED_RADIUS"] * c["FNOMIN"] * c.get("LMY", 1.0) * share * power


# All terms at work, which the files leave at zero in part.
BUSY = {"QSX12": 0.7, "QSX13": 0.02, "QSX14": -0.4, "LMX": 1.1, "LVMX": 0.8}
BUSY |= {"QSY2": 0.02, "QSY5": 0.6, "QSY6": -0.3, "LMY": 0.9}


@EVERY
@pytest.mark.parametrize("busy", [False, True])
def test_moments_agree_with_the_manuals(number, busy):
    changes = BUSY if busy else {}
    if number == 52:
        changes = {k: v for k, v in changes.items() if k[0] == "L" or k == "QSY2"}
        changes |= {"QSY3": 1e-3, "QSY4": 1e-5} if busy else {}
    c, at = numbers(number) | changes, inputs()
    found = forces(tire_of(number, **changes), at)
    fx, fy = -np.asarray(found.fx), -np.asarray(found.fy)
    # A file without pressure terms has no nominal pressure.
    expected = m_x(c, fy, at.fz, at.gamma, at.pressure)
    np.testing.assert_allclose(found.mx, -expected, rtol=1e-10, atol=1e-7)
    expected = m_y_6(c, fx, at.fz, at.v, at.gamma, at.pressure) if number > 52 else None
    expected = m_y_52(c, fx, at.fz, at.v) if expected is None else expected
    np.testing.assert_allclose(found.my, -expected, rtol=1e-10)


def test_rolling_resistance_depends_on_pressure_and_speed():
    tire, c = tire_of(61), numbers(61)
    # The speed 0 stands for the stated one. Of as many rows as elsewhere.
    v, pressure = (np.resize(x, N) for x in ([10.0, 10.0, c["LONGVL"], 0.0], [2e5, 3e5, 0, 0]))
    soft, hard, stated, still = forces(tire, TireInputs(fz=4e3, v=v, pressure=pressure)).my[:4]
    np.testing.assert_allclose(hard / soft, 1.5 ** c["QSY8"], rtol=1e-9)
    assert still == stated


def test_without_coefficients_there_is_no_moment():
    c = numbers(61)
    for start, name in (("QSX", "mx"), ("QSY", "my")):
        less = {key: value for key, value in c.items() if not key.startswith(start)}
        tire = mf_tire("6.1", less)
        found = jax.eval_shape(forces, tire, inputs())
        assert getattr(found, name) is None
        assert not any(key.startswith(start) for key in parameter_values(tire))
        other = {"mx": "my", "my": "mx"}[name]
        assert getattr(found, other) is not None
        assert getattr(jax.eval_shape(forces, Mirrored(tire), inputs()), name) is None
