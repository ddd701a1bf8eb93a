"""Simulated forces next to the measured ones: ``fx_sim``, ``fy_sim``, ``mz_sim``."""

import numpy as np
import pytest

from tirefit.data.read import read
from tirefit.data.write import to_convention
from tirefit.results import UsageError


def written(tmp_path, header, rows):
    path = tmp_path / "a.csv"
    lines = [header, *(",".join(f"{x:g}" for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


ROWS = [(0.01 * k, 0.4 * k, 0.5 * k, 4000.0) for k in range(1, 12)]


@pytest.mark.parametrize("header", ["fx_sim", "Fx_sim", "sim_fx", "Fx simulated"])
def test_simulated_column_has_unit_and_sign_of_its_force(tmp_path, header):
    # Driving positive: force and slip of braking are negative in the file.
    rows = [(-slip, -fx, -sim, fz) for slip, fx, sim, fz in ROWS]
    path = written(tmp_path, f"kappa,Fx [kN],{header},fz", rows)
    data = read(path, convention="iso-w")
    np.testing.assert_allclose(data["fx"], [400 * k for k in range(1, 12)])
    np.testing.assert_allclose(data["fx_sim"], [500 * k for k in range(1, 12)])
    back = to_convention(data, {"fx_sim": data["fx_sim"]})
    np.testing.assert_allclose(back[header], [row[2] for row in rows])


def test_simulated_column_may_state_its_own_unit(tmp_path):
    path = written(tmp_path, "sigma_x,fx [kN],fx_sim [N],fz", ROWS)
    data = read(path, convention="braking")
    np.testing.assert_allclose(data["fx_sim"], [row[2] for row in ROWS])


def test_only_forces_may_be_simulated(tmp_path):
    path = written(tmp_path, "sigma_x,fx,fz_sim,fz", ROWS)
    assert "fz_sim" not in read(path, convention="braking").columns
    with pytest.raises(UsageError, match="fz_sim"):
        read(path, columns={"fz_sim": "fz_sim"})
