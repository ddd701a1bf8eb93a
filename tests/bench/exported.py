"""Exported tires: force and Jacobian in C and CasADi, nanoseconds per evaluation."""

import importlib.util
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

TIR = "tests/data/tir/mfeval_julia/MagicFormula61_Parameters.tir"
ROWS, REPEATS = 2048, 40
_LOOP = "-DTIREFIT_LOOP -O3 -march=native -ffast-math"

_DRIVER = """
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <time.h>
#include "tire.h"
enum {{ N = {rows} }};
static double K[N], A[N], Z[N], OUT[4 * {count} * N];
static double now(void)
{{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}}
__attribute__((noinline)) static void all(
    const double *restrict k, const double *restrict a, const double *restrict z,
    double *restrict out)
{{
    for (int i = 0; i < N; i++) {{
        double f[{count}], s[{count}][3];
        tire_jacobian(k[i], a[i], z[i]{more}, f, s);
        {stores}
    }}
}}
int main(void)
{{
    unsigned seed = 1;
    double best = 1e9;
    for (int i = 0; i < N; i++) {{
        double u[3];
        for (int j = 0; j < 3; j++)
            u[j] = ((seed = seed * 1664525u + 1013904223u) >> 8) / 16777216.0;
        K[i] = 0.6 * u[0] - 0.3; A[i] = 0.4 * u[1] - 0.2; Z[i] = 2e3 + 6e3 * u[2];
    }}
    for (int r = 0; r < {repeats}; r++) {{
        double begun = now();
        all(K, A, Z, OUT);
        double taken = 1e9 * (now() - begun) / N;
        best = taken < best ? taken : best;
    }}
    printf("%g", best);
    return OUT[7] == 0;
}}
"""


def _in_c(folder: Path, inputs, outputs, flags: str) -> float:
    count = len(outputs)
    stores = [f"out[{j} * N + i] = f[{j}];" for j in range(count)]
    stores += [
        f"out[{count + 3 * j + k} * N + i] = s[{j}][{k}];" for j in range(count) for k in range(3)
    ]
    known = {"v": "16.0", "gamma": "0.01", "pressure": "0.0"}
    more = "".join(f", {known[name]}" for name in inputs[3:])
    code = _DRIVER.format(
        rows=ROWS, repeats=REPEATS, count=count, more=more, stores=" ".join(stores)
    )
    (folder / "drive.c").write_text(code)
    command = ["cc", "-std=c99", *flags.split(), "-o", "drive", "drive.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    runs = (subprocess.run([folder / "drive"], capture_output=True, check=True) for _ in range(3))
    return min(float(run.stdout) for run in runs)


def _in_casadi(path: Path, count: int) -> tuple[float, float]:
    """Forces, and their Jacobian."""
    spec = importlib.util.spec_from_file_location("tire", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    random = np.random.default_rng(0)
    rows = np.array([[-0.3, 0.3], [-0.2, 0.2], [2e3, 8e3], [16, 16], [0, 0], [0, 0]])
    given = [random.uniform(*ends, (1, ROWS)) for ends in rows[:count]]
    found = []
    for function in (module.tire, module.tire_jacobian):
        each, times = function.map(ROWS), []
        for _ in range(REPEATS):
            begun = time.thread_time()
            each(*given)
            times.append(1e9 * (time.thread_time() - begun) / ROWS)
        found.append(min(times))
    return found[0], found[1]


def exported_tire() -> None:
    """A MF 6.1 tire: all five outputs, then F_x and F_y alone."""
    import tirefit

    for forces in ("fx,fy,mz,mx,my", "fx,fy"):
        names = tuple(forces.split(","))
        with tempfile.TemporaryDirectory() as directory:
            folder = Path(directory)
            tirefit.export(TIR, "c", folder / "tire.h", forces=forces)
            tirefit.export(TIR, "casadi", folder / "tire.py", forces=forces)
            head = (folder / "tire.h").read_text().split("void tire(")[1].split(")")[0]
            inputs = [one.split()[-1] for one in head.split(", ")[:-1]]
            for flags in ("-O2", "-O3 -march=native", _LOOP):
                taken = _in_c(folder, inputs, names, flags)
                print(f"{forces}, C {flags}: force and Jacobian {taken:.0f} ns")
            force, slopes = _in_casadi(folder / "tire.py", len(inputs))
            print(f"{forces}, CasADi: force {force:.0f} ns, Jacobian {slopes:.0f} ns")
