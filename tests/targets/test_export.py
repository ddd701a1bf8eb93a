"""Exported files, loaded by their target software, compared with our own forces."""

import ctypes
import functools
import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
from typer.testing import CliRunner

import tirefit
from tirefit.cli.commands import app
from tirefit.data.tir.tir import read_tir
from tirefit.fitting.tir import own_tire
from tirefit.models import MODELS, TireInputs, forces
from tirefit.results import UsageError
from tirefit.slip import sigma_from_kappa
from tirefit.targets.code import Draft, c_source
from tirefit.targets.program import traced
from tirefit.targets.shape import shape_of
from tirefit.targets.tire import tire_of

MF61 = "tests/data/tir/mfeval_julia/MagicFormula61_Parameters.tir"
TRUCK = "tests/data/tir/chrono/335_65R22_5_G275MSA_40psi.tir"
SOURCES = ["brush", "brush-dmh", "brush-d", "lugre", "liu-peng", MF61]

KAPPA, ALPHA, LOAD = (
    axis.ravel()
    for axis in np.meshgrid(
        [-0.95, -0.2, -0.03, 0.0, 0.01, 0.1, 2.0],
        [-0.4, -0.05, 0.0, 0.02, 0.3],
        [500.0, 4000.0, 9000.0],
        indexing="ij",
    )
)
"""Grid of slip, angle and load in the signs of ISO-W."""
SPEED, CAMBER, PRESSURE = 12.0, 0.03, 2.1e5


def model_of(source):
    return own_tire(read_tir(source)) if source.endswith(".tir") else MODELS[source]


@functools.cache
def own(source):
    """Our forces (n, 2) on the grid, in the signs of ISO-W."""
    given = TireInputs(sigma_from_kappa(-KAPPA), ALPHA, LOAD, SPEED, CAMBER, PRESSURE, 0.0)
    found = forces(model_of(source), given)
    return -np.stack([found.fx, found.fy], axis=1)


SOME = [10, 40, 77]
"""Rows of the grid at which slopes are compared."""


@eqx.filter_jit
def _slopes(tire, kappa, alpha, load):
    def fy(alpha, kappa, load):
        return -tire(TireInputs(sigma_from_kappa(-kappa), alpha, load, SPEED, CAMBER, PRESSURE)).fy

    return jax.vmap(jax.grad(fy, (1, 0)))(alpha, kappa, load)


@functools.cache
def own_slopes(source):
    """Our derivatives (n, 2) of F_y by slip and angle, in the signs of ISO-W."""
    return np.stack(_slopes(model_of(source), KAPPA[SOME], ALPHA[SOME], LOAD[SOME]), axis=1)


@functools.cache
def inputs_of(source):
    """The grid's arguments of an exported function."""
    known = {
        "kappa": KAPPA,
        "alpha": ALPHA,
        "fz": LOAD,
        "v": np.full_like(LOAD, SPEED),
        "gamma": np.full_like(LOAD, CAMBER),
        "pressure": np.full_like(LOAD, PRESSURE),
    }
    return [known[name] for name in tire_of(source).program("iso-w").inputs]


def loaded(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("source", SOURCES)
def test_numpy_export_reproduces_the_forces(source, tmp_path):
    path = tmp_path / "tire.py"
    tirefit.export(source, "numpy", path)
    found = np.stack(loaded(path).tire(*inputs_of(source))[:2], axis=1)
    assert np.max(np.abs(found - own(source)) / LOAD[:, None]) < 1e-12


def test_the_numpy_file_does_not_import_tirefit(tmp_path):
    tirefit.export("brush", "numpy", tmp_path / "tire.py")
    code = (
        "import sys, tire; print(tire.tire(0.02, 0.01, 4000.0)[0]);"
        "assert 'tirefit' not in sys.modules and 'jax' not in sys.modules"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    at = TireInputs(sigma_from_kappa(-0.02), 0.01, 4000.0)
    assert float(done.stdout) == pytest.approx(-float(forces(MODELS["brush"], at).fx))


@pytest.mark.parametrize("source", SOURCES)
def test_casadi_export_reproduces_forces_and_slopes(source, tmp_path):
    pytest.importorskip("casadi")
    path = tmp_path / "tire.py"
    tirefit.export(source, "casadi", path)
    module, given = loaded(path), np.array(inputs_of(source))
    found = np.stack([x.full()[0] for x in module.tire.map(len(LOAD))(*given)[:2]], 1)
    assert np.max(np.abs(found - own(source)) / LOAD[:, None]) < 1e-9
    middle, step = given[:, 40], np.zeros(len(given))
    step[1] = 1e-6
    change = [float(module.tire(*(middle + s * step))[1]) for s in (-1, 1)]
    slopes = module.tire_jacobian(*middle).full()
    assert np.all(np.isfinite(slopes))
    wanted = (change[1] - change[0]) / 2e-6
    assert slopes[1, 1] == pytest.approx(wanted, rel=1e-4, abs=1e-2)


@functools.cache
def header_of(source):
    with tempfile.TemporaryDirectory() as folder:
        return tirefit.export(source, "c", Path(folder) / "tire.h").path.read_text()


def built(path, folder, single, *flags):
    """The header's functions in a shared library; the call that its head shows compiles."""
    (call,) = re.findall(r"^ \* call: (.*)$", path.read_text(), re.MULTILINE)
    source = folder / f"use{single}.c"
    args = [
        line.split("(")[1].split(", tirefit_real force")[0]
        for line in path.read_text().splitlines()
        if "INLINE void tire(" in line
    ][0]
    names = [one.split()[-1] for one in args.split(", ")]
    given = ", ".join(names)
    source.write_text(
        f'#include "{path.name}"\n'
        f"void one({args}, tirefit_real *f);\nvoid two({args}, tirefit_real *f);\n"
        f"void one({args}, tirefit_real *f) {{ tire({given}, f); }}\n"
        f"void two({args}, tirefit_real *f) {{ tirefit_real g[16];"
        f" tire_jacobian({given}, g, (tirefit_real (*)[3])f); }}\n"
        f"void three({args});\nvoid three({args}) {{ {call} }}\n"
    )
    library = folder / f"lib{single}.so"
    command = ["cc", "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-shared"]
    command += ["-fPIC", *(["-DTIREFIT_SINGLE"] if single else []), *flags]
    subprocess.run([*command, "-o", library, source, "-lm"], check=True, capture_output=True)
    return ctypes.CDLL(str(library)), len(names)


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
@pytest.mark.parametrize(
    ("single", "flags"),
    [(False, ()), (True, ("-DTIREFIT_LOOP",))],
    ids=["double", "loop in single precision"],
)
@pytest.mark.parametrize(
    "source", [pytest.param("brush-dmh", marks=pytest.mark.long), "brush-d", "lugre", MF61]
)
def test_c_export_reproduces_forces_and_slopes(source, single, flags, tmp_path):
    path = tmp_path / "tire.h"
    path.write_text(header_of(source))
    library, count = built(path, tmp_path, single, *flags)
    kind = ctypes.c_float if single else ctypes.c_double
    found, slopes = [], []
    for row in np.array(inputs_of(source)).T:
        for name, results in (("one", found), ("two", slopes)):
            space = (kind * 16)()
            function = getattr(library, name)
            function.argtypes = [kind] * count + [ctypes.POINTER(kind)]
            function(*map(float, row), space)
            results.append([*space])
    found, slopes = np.array(found)[:, :2], np.array(slopes)
    limit = 1e-4 if single else 1e-9
    assert np.max(np.abs(found - own(source)) / LOAD[:, None]) < limit
    # The second row is that of fy, its first places are the derivatives by kappa and alpha.
    got, rel = slopes[SOME, 3:5], 2e-3 if single else 1e-9
    assert got == pytest.approx(own_slopes(source), rel=rel, abs=0.5)


@pytest.mark.parametrize("convention, turned", [("sae", -1), ("adapted-sae", 1)])
def test_signs_follow_the_convention(convention, turned, tmp_path):
    path = tmp_path / "tire.py"
    tirefit.export("brush", "numpy", path, convention=convention)
    load = -4000.0 if convention == "sae" else 4000.0
    fx, fy, _ = loaded(path).tire(0.02, 0.01, load)
    given = TireInputs(sigma_from_kappa(-0.02), 0.01, 4000.0)
    wanted = forces(MODELS["brush"], given)
    assert fx == pytest.approx(-float(wanted.fx))
    assert fy == pytest.approx(turned * float(wanted.fy))


def test_a_pure_formula_is_exported_with_combined_slip(tmp_path):
    done = tirefit.export("magic-formula", "numpy", tmp_path / "tire.py")
    assert any("combined" in note for note in done.notes)
    function = loaded(tmp_path / "tire.py").tire
    pure = function(0.3, 0.0, 4000.0)[0]
    fx, fy = function(0.3, 0.3, 4000.0)
    assert np.hypot(fx, fy) < 1.03 * pure
    alone = forces(MODELS["magic-formula"], TireInputs(sigma_from_kappa(-0.3), 0, 4e3))
    assert pure == pytest.approx(-float(alone.fx), rel=1e-9)


def test_only_the_requested_forces_are_exported(tmp_path):
    whole, part = tmp_path / "whole.py", tmp_path / "part.py"
    tirefit.export(MF61, "numpy", whole)
    tirefit.export(MF61, "numpy", part, forces="fy,fx")
    found = loaded(part).part(0.02, 0.01, 4000.0, 0.0, 0.0)
    wanted = loaded(whole).whole(0.02, 0.01, 4000.0, 12.0, 0.0, 0.0)
    assert found == pytest.approx((wanted[1], wanted[0]))
    with pytest.raises(UsageError, match="no force 'mx'"):
        tirefit.export("brush", "numpy", part, forces="fx,mx")
    done = ran(MF61, "--to", "tir", "--out", tmp_path / "t.tir", "--forces", "fx")
    assert done.exit_code == 2 and "which does not use it" in done.stderr


def test_the_shape_check_detects_wrong_shapes_and_signs():
    tire = tire_of(TRUCK)
    assert shape_of(tire, tire.program("iso-w"), "iso-w").sound
    apart = replace(tire, model=own_tire(read_tir(TRUCK), combination="none"))
    wrong = shape_of(apart, apart.program("iso-w"), "iso-w")
    assert not wrong.sound and "NOT within 1.05 of it" in wrong.failed[0]
    brush = tire_of("brush")
    good = shape_of(brush, brush.program("iso-w"), "iso-w")
    assert good.sound and len(good.sentences) == 5
    turned = shape_of(brush, brush.program("braking"), "iso-w")
    assert not turned.sound and "AGAINST" in turned.sentences[2]


def test_a_fit_is_exported_with_its_errors_and_its_range_in_the_signs_of_the_file(tmp_path):
    slip = np.linspace(-0.1, 0.25, 60)
    force = np.asarray(forces(MODELS["brush"], TireInputs(slip, 0.0, 4000.0)).fx)
    force = force + 20 * np.random.default_rng(1).standard_normal(60)
    data = {"sigma_x": slip, "fz": np.full(60, 4000.0), "fx": force}
    fit = tirefit.fit(data, "brush")
    fit.save(tmp_path)
    for source in (fit, tmp_path / "fit.json"):
        done = tirefit.export(source, "numpy", tmp_path / "tire.py")
        text = done.path.read_text()
        # Driving positive: braking to kappa 0.25 / 1.25 is -0.2.
        assert "kappa -0.2 to 0.1111;" in text and "mu = " in text
        line = next(x for x in text.splitlines() if "cpa2 = " in x)
        std = fit.least_squares["cpa2"].std
        assert float(line.split("+-")[1].split()[0]) == pytest.approx(std, rel=0.06)
        assert any("fy was not fitted" in note for note in done.notes)
        # Pure numbers have no unit, not "-".
        assert "# kappa: practical slip" in text and "# alpha [rad]: slip angle" in text
        assert "[-]" not in text and not re.search(r" -(,|$)", text, re.MULTILINE)
    path = tmp_path / "tire.h"
    tirefit.export(fit, "c", path, convention="braking")
    assert "kappa -0.1111 to 0.2;" in path.read_text()
    with pytest.raises(UsageError, match="together with a fit"):
        tirefit.export(fit, "c", path, values={"mu": 0.5})


def test_the_head_says_at_which_speed_and_slip_and_without_which_lag(tmp_path):
    head = tirefit.export("lugre", "numpy", tmp_path / "tire.py").path.read_text()
    assert "# parameters:\n#   mu_s = 1.2\n" in head  # no fit, no standard errors
    assert "# steady state: the bristles of LuGre follow the slip at once" in head
    assert "# zero slip at 10 m/s: fx" in head and "to F_z 8000 N" in head  # twice the load
    peak = re.search(r"# peak at 10 m/s: fx ([\d.]+) F_z at kappa ([\d.]+) \(", head)
    given = {"sigma_x": sigma_from_kappa(float(peak[2])), "fz": LOAD[0], "v": 10.0}
    top = forces(MODELS["lugre"], TireInputs(**given)).fx / LOAD[0]
    assert float(peak[1]) == pytest.approx(float(top), abs=2e-3)
    assert re.search(r"fy [\d.]+ F_z at alpha [\d.]+ rad \(", head)


def test_ranges_of_a_tir_file_keep_its_signs():
    tire, numbers = tire_of(MF61), read_tir(MF61).numbers
    low, high = numbers["KPUMIN"], numbers["KPUMAX"]
    assert tire.measured["kappa"] == (-high, -low)
    assert f"kappa {low:.4g} to {high:.4g}, " in tire.ranges("iso-w")


def test_an_exported_program_is_simplified_and_differentiated():
    def cubic(x, y):
        return (x**3 + 2 * y, y / 1.0 + 0.0 * x)

    program = traced(cubic, ("x", "y"), ("a", "b"), (0, 1))
    assert list(program.outputs) == ["a", "b", "a_x", "b_x", "a_y", "b_y"]
    assert program.outputs["a_y"] == 2.0 and program.outputs["b_x"] == 0.0
    assert program.outputs["b_y"] == 1.0
    assert sum(op == "mul" for op, _ in program.operations) <= 5


# --- command line -------------------------------------------------------------------


def ran(*arguments):
    return CliRunner().invoke(app, ["export", *map(str, arguments)])


def test_the_command_writes_and_replaces_only_exports(tmp_path):
    path = tmp_path / "tire.h"
    path.write_text("mine")
    refused = ran("brush", "--to", "c", "--out", path)
    assert refused.exit_code == 2 and path.read_text() == "mine"
    assert ran("brush", "--to", "c", "--out", path, "--force").exit_code == 0
    again = ran("brush", "--to", "c", "--out", path, "--set", "mu=0.8")
    assert again.exit_code == 0 and "mu = 0.8\n" in path.read_text()
    assert len(again.stdout.splitlines()) == 6


def test_all_that_is_wrong_is_reported_at_once(tmp_path):
    done = ran("brush", "--to", "cc", "--out", tmp_path / "no" / "1x.py")
    assert done.exit_code == 2
    for part in ("did you mean 'c'", "there is no folder", "not valid as a name"):
        assert part in done.stderr
    assert ran().exit_code == 2
    done = ran("brsh", "--to", "c", "--out", tmp_path / "tire.h")
    assert done.exit_code == 2 and "brush" in done.stderr
    assert not (tmp_path / "tire.h").exists()


def test_a_wrong_file_ending_or_an_input_file_is_refused(tmp_path):
    assert ran("brush", "--to", "c", "--out", tmp_path / "tire.py").exit_code == 2
    source = tmp_path / "tire.tir"
    source.write_bytes(Path(MF61).read_bytes())
    done = ran(source, "--to", "tir", "--out", source, "--force")
    assert done.exit_code == 3 and "it is an input file (SOURCE)" in done.stderr
    assert source.read_bytes() == Path(MF61).read_bytes()


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_a_file_name_cannot_end_a_comment(tmp_path):
    tire = tire_of("brush")
    odd = replace(tire, origin="fit to rigs/*.csv */ int x;\nint y;")
    draft = Draft(odd, odd.program("iso-w"), "iso-w", [odd.origin], "tire", {})
    assert "/*.csv" not in c_source(draft) and "csv */" not in c_source(draft)
    folder = tmp_path / "a\nimport this"
    folder.mkdir()
    source = folder / "tire.tir"
    source.write_bytes(Path(MF61).read_bytes())
    tirefit.export(source, "numpy", tmp_path / "tire.py")
    lines = (tmp_path / "tire.py").read_text().splitlines()
    assert not any(line.startswith("import this") for line in lines)
