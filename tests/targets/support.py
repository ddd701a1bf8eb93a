"""Common parts of the tests of parameter files."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tirefit.cli.commands import app
from tirefit.models import TireInputs, forces
from tirefit.slip import sigma_from_kappa
from tirefit.targets.tire import tire_of

LOAD = 4000.0
MISS = re.compile(r"(F_x of pure|F_y of pure|combined) slip [^;]*largest error ([\d.]+) %")
KINDS = {"F_x of pure": "fx", "F_y of pure": "fy", "combined": "both"}
SLIPS = np.linspace(-0.2, 0.2, 401)


def grids():
    """ISO-W kappa, alpha (n,) by kind of slip, finer than those of the export."""
    zero, some = np.zeros_like(SLIPS), np.linspace(-0.2, 0.2, 41)
    both = [one.ravel() for one in np.meshgrid(some, some)]
    return {"fx": (SLIPS, zero), "fy": (zero, SLIPS), "both": both}


def own(source, kappa, alpha, load=LOAD):
    """Our forces over load (2, n), in the signs of ISO-W."""
    given = TireInputs(sigma_from_kappa(-kappa), alpha, np.full_like(alpha, load), 10.0)
    model = tire_of(source).model
    return -np.stack([forces(model, given).fx, forces(model, given).fy]) / load


def largest(miss, kind):
    """Largest length of an error (2, n) of the forces that a kind of slip compares."""
    rows = {"fx": [0], "fy": [1], "both": [0, 1]}[kind]
    return np.max(np.linalg.norm(miss[rows], axis=0))


def stated(notes):
    """The errors over load that an export states, by kind of slip."""
    text = "; ".join(notes)
    return {KINDS[kind]: float(miss) / 100 for kind, miss in MISS.findall(text)}


def held(misses, notes, exact=()):
    """Asserts that the true errors are the stated ones, rounded up to two digits; a
    finer grid may find slightly more."""
    told = stated(notes)
    assert set(told) == set(misses) - set(exact)
    for kind, miss in misses.items():
        if kind in exact:
            assert miss < 1e-9
        else:
            assert miss < 1.02 * told[kind] and told[kind] < 1.2 * miss


CAR = "mass = 3.5\nl_f = 0.16\nl_r = 0.17\nyaw_inertia = 0.05\n"
WHOLE = CAR + "h_cg = 0.07\nwheel_radius = 0.05\n"
SMALL = {"cpa2": 130.0}
"""A brush for the load of a car of 1:10."""


def commonroad(path):
    """CommonRoad's reader on our file next to its own first vehicle."""
    models = pytest.importorskip("vehiclemodels.vehicle_parameters")
    own_files = Path(models.__file__).parent / "parameters"
    shutil.copy(own_files / "parameters_vehicle1.yaml", path.parent)
    return models.setup_vehicle_parameters(vehicle_id=1, dir_params=path.parent)


def ran(*arguments):
    return CliRunner().invoke(app, ["export", *map(str, arguments)])
