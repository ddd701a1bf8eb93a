"""The exported JAX program, loaded in a process without tirefit."""

import json
import subprocess
import sys

import jax
import numpy as np
import pytest

import tirefit
from tirefit.data.tir.tir import read_tir
from tirefit.fitting.tir import own_tire
from tirefit.models import MODELS, TireInputs, forces
from tirefit.slip import sigma_from_kappa

MF61 = "tests/data/tir/mfeval_julia/MagicFormula61_Parameters.tir"
KAPPA, ALPHA, LOAD = [-0.95, -0.03, 0.0, 0.4], [-0.3, 0.0, 0.02, 0.1], 4000.0

_USE = """
import json, sys
import jax
import numpy as np
import tire
kappa, alpha, fz, *more = map(np.array, json.loads(sys.argv[1]))
jax.config.update("jax_enable_x64", True)
found = jax.jit(tire.tire)(kappa[:, None], alpha, fz, *more)

def fy(angle):
    return tire.tire(0.05, angle, fz, *more)[1]

slope = jax.grad(fy)(0.02)
assert np.isfinite(jax.grad(jax.grad(fy))(0.02)) and np.isfinite(jax.grad(fy)(0.0))
assert "tirefit" not in sys.modules
print(json.dumps([[x.tolist() for x in found], float(slope)]))
"""


@pytest.mark.parametrize("source", ["lugre", pytest.param(MF61, marks=pytest.mark.long)])
def test_a_process_without_tirefit_reproduces_forces_and_slopes(source, tmp_path):
    tirefit.export(source, "jax", tmp_path / "tire.py")
    names = (tmp_path / "tire.py").read_text().split("def tire(")[1].split(")")[0]
    known = {"kappa": KAPPA, "alpha": ALPHA, "fz": LOAD, "v": 12.0, "gamma": 0.03}
    at = known | {"pressure": 2.1e5}
    given = json.dumps([at[name] for name in names.split(", ")])
    done = subprocess.run(
        [sys.executable, "-c", _USE, given],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env={"PATH": "", "JAX_PLATFORMS": "cpu"},
    )
    assert done.returncode == 0, done.stderr
    found, slope = json.loads(done.stdout)
    tir = source.endswith(".tir")
    tire = own_tire(read_tir(source)) if tir else MODELS[source]
    kappa, alpha = np.meshgrid(KAPPA, ALPHA, indexing="ij")
    inputs = TireInputs(sigma_from_kappa(-kappa.ravel()), alpha.ravel(), LOAD, 12.0, 0.03, 2.1e5)
    wanted = forces(tire, inputs)
    for ours, theirs in zip((wanted.fx, wanted.fy), found, strict=False):
        assert np.max(np.abs(-np.asarray(ours) - np.ravel(theirs))) < 1e-12 * LOAD

    def fy(angle):
        slip = sigma_from_kappa(-0.05)
        return -tire(TireInputs(slip, angle, LOAD, 12.0, 0.03, 2.1e5)).fy

    assert slope == pytest.approx(float(jax.grad(fy)(0.02)), rel=1e-10)
