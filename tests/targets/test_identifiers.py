"""Names of functions in exported files, tried by a C compiler, Python and CasADi."""

import builtins
import keyword
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import tirefit
from tirefit.targets.export import reserved

needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")

MATH = "#include <math.h>\n"


def cc(standard, text, *options):
    command = ["cc", f"-std={standard}", "-x", "c", *options, "-"]
    return subprocess.run(command, input=text, capture_output=True, text=True)


@needs_cc
@pytest.mark.parametrize("standard", ["c99", "c11", "c2x", "gnu17"])
def test_every_name_of_the_math_library_is_refused_or_compiles(standard):
    """All names that the header of this system declares or defines, as functions before
    and after it is included."""
    found = cc(standard, MATH, "-E", "-P").stdout + cc(standard, MATH, "-E", "-dM").stdout
    names = set(re.findall(r"\b[A-Za-z_]\w*\b", found))
    assert len(names) > 200 and {"logb", "double", "NAN", "fabsf"} <= names
    free = sorted(name for name in names if not reserved(name))
    assert len(free) < len(names) / 2
    functions = "".join(f"static inline void {n}(double k) {{ (void)k; }}\n" for n in free)
    for source in (MATH + functions, functions + MATH):
        done = cc(standard, source, "-fsyntax-only")
        assert done.returncode == 0, done.stderr[:2000]


GOOD = "tire front_left Tire2 brush toyo street stribeck island memo gp2 t0 fz kappa force slope"


@needs_cc
@pytest.mark.parametrize("name", GOOD.split())
def test_a_usual_name_is_accepted_and_compiles(name, tmp_path):
    path = tmp_path / f"{name}.h"
    tirefit.export("brush", "c", path)
    main = f'#include "{path.name}"\n#include <stdio.h>\n#include <stdlib.h>\n#include <string.h>\n'
    main += f"int main(void) {{ double out[3]; {name}(0.1, 0.1, 4000.0, out);\n"
    main += 'return printf("%.17g %.17g %.17g\\n", out[0], out[1], out[2]) < 0; }\n'
    (tmp_path / "main.c").write_text(main)
    options = ["-std=c99", "-Wall", "-Werror", "main.c", "-lm", "-o", "main"]
    done = subprocess.run(["cc", *options], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = subprocess.run([tmp_path / "main"], capture_output=True, text=True).stdout
    scope: dict = {}
    tirefit.export("brush", "numpy", tmp_path / "tire.py")
    exec((tmp_path / "tire.py").read_text(), scope)
    expected = [float(one) for one in scope["tire"](0.1, 0.1, 4000.0)]
    np.testing.assert_allclose([float(x) for x in found.split()], expected, rtol=1e-12)


@needs_cc
def test_headers_whose_names_differ_in_case_only_are_both_included(tmp_path):
    """Their guards were the same: the second was left out."""
    for name in ("tire", "Tire"):
        tirefit.export("brush", "c", tmp_path / f"{name}_x.h", name=name)
    main = '#include "tire_x.h"\n#include "Tire_x.h"\nint main(void) { double f[3];\n'
    main += "tire(0.1, 0.1, 1.0, f); Tire(0.1, 0.1, 1.0, f); return 0; }\n"
    (tmp_path / "main.c").write_text(main)
    options = ["-Werror", "-Wall", "main.c", "-lm", "-o", "main"]
    assert subprocess.run(["cc", *options], cwd=tmp_path).returncode == 0


BAD = "logb y0 true NAN double lambda np lgammaf_r class M_PI a__b _a a_ sinf64x jac print"
BAD += " signbit static_assert INFINITY 1x été math_errhandling x.y"


@pytest.mark.parametrize("target", ["c", "numpy", "casadi", "jax"])
def test_a_reserved_name_is_refused_with_a_reason(target, tmp_path):
    assert [name for name in BAD.split() if not reserved(name)] == []
    path = tmp_path / f"tire{'.h' if target == 'c' else '.py'}"
    with pytest.raises(tirefit.UsageError, match="not valid as a name of a function: ") as caught:
        tirefit.export("brush", target, path, name="logb")
    assert "--name my_tire" in caught.value.problems[0].remedy and not path.exists()


def test_every_name_of_python_is_refused():
    names = [*dir(builtins), *keyword.kwlist, "np", "ca", "jax", "jnp", "base64"]
    assert [name for name in names if not reserved(name)] == []


def test_casadi_takes_every_name_that_is_accepted():
    casadi = pytest.importorskip("casadi")
    x = casadi.SX.sym("x")
    for name in (*GOOD.split(), "null_", "a__b", "jac", "hess", "null", "Jac1"):
        if not reserved(name):
            casadi.Function(name, [x], [x])
            casadi.Function(f"{name}_jacobian", [x], [x])
    assert all(reserved(name) for name in ("null", "jac", "hess", "a__b"))


CHANGES = {
    "a line more": lambda text: text + "\n",
    "a number": lambda text: text.replace("0.1", "0.2", 1),
    "notes that quote the head": lambda text: "notes on written by tirefit export\n",
    "the head of another": lambda text: text[:300] + "my own table\n",
    "no checksum": lambda text: re.sub("checksum [0-9a-f]{16}", "checksum", text),
    "nothing": lambda text: "",
}


@pytest.mark.parametrize("target", ["c", "numpy", "tir", "commonroad"])
@pytest.mark.parametrize("how", CHANGES)
def test_only_an_unchanged_export_is_replaced(how, target, tmp_path):
    ends = {"c": ".h", "numpy": ".py", "tir": ".tir", "commonroad": ".yaml"}
    path = tmp_path / f"tire{ends[target]}"
    given = {"wheel": {"radius": 0.3}, "force": True} if target == "tir" else {}
    again = {**given, "values": {"mu": 0.8}}
    tirefit.export("brush", target, path, **given)
    first = path.read_text()
    given.pop("force", None)
    path.write_text(changed := CHANGES[how](first))
    assert changed != first
    with pytest.raises(tirefit.UsageError, match="is not an export, or was changed since"):
        tirefit.export("brush", target, path, **given)
    assert path.read_text() == changed
    path.write_text(first)
    tirefit.export("brush", target, path, **{**again, "force": target == "tir"})
    assert path.read_text() != first and Path(path).exists()
