"""Compares posteriors of tirefit and other programs on the same synthetic data.

    python -m fits.posterior_peers --into fits/posterior_peers         # all
    python -m fits.posterior_peers --only brush --sets 20 --chains 4   # quicker

All intervals go to ``--out``, table and figure to ``--into``. The other programs need the
dependency group ``peers``. See README.md.
"""

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from fits.posterior_peers.cases import CASES, Case

SETS, CHAINED = 100, 12
"""Data sets per case, and the number on which the chains run."""
CONVERGENCE = 8
"""Data sets on which the guides also run three times as many steps."""
TIMED = 3


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser("python -m fits.posterior_peers")
    parser.add_argument("--only", default=",".join(CASES))
    parser.add_argument("--sets", type=int, default=SETS)
    parser.add_argument("--chains", type=int, default=CHAINED)
    parser.add_argument("--time", help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, default=Path("out/posterior_peers"))
    parser.add_argument("--into", type=Path, help="folder of table.md; by default --out")
    asked = parser.parse_args(argv)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import jax

    jax.config.update("jax_enable_x64", True)
    if asked.time:
        print(json.dumps(timed(asked.time)))
        return
    asked.out.mkdir(parents=True, exist_ok=True)
    for name in asked.only.split(","):
        intervals_to(asked.out, name, asked.sets, asked.chains)
    write(asked.out / "times.csv", [_in_a_process(method) for method in METHODS_TIMED])
    from fits.posterior_peers.page import write_page

    write_page(asked.out, asked.into or asked.out)


def write(path: Path, rows: list[dict]) -> None:
    with open(path, "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    print(path, flush=True)


def intervals_to(out: Path, name: str, sets: int, chains: int) -> None:
    """Writes all intervals of a case, one line each, after every method."""
    from fits.posterior_peers.methods import CHAINS, METHODS, fits_of, intervals_of

    case, rows = CASES[name], []
    results = fits_of(case, range(sets))
    for method in METHODS:
        used = results[:chains] if method in CHAINS else results
        begun = time.process_time()
        rows += _lines(method, case, used, *intervals_of(method, case, used))
        print(name, method, f"{time.process_time() - begun:.0f} s", flush=True)
        if method in ("mean-field", "full-rank"):
            rows += _longer(method, case, results[:CONVERGENCE])
        write(out / f"{name}.csv", rows)


def _longer(method: str, case: Case, results) -> list[dict]:
    """The same with three times the steps, to check that the ELBO has converged."""
    from fits.posterior_peers.methods import intervals_of
    from fits.posterior_peers.variational import STEPS

    ends = intervals_of(method, case, results, steps=3 * STEPS[method])
    return _lines(f"{method}, 3 x", case, results, *ends)


def _lines(method: str, case: Case, results, intervals, notes) -> list[dict]:
    return [
        {
            "method": method,
            "set": k,
            "parameter": label,
            "truth": case.truth[label],
            "low": f"{low:.7g}",
            "high": f"{high:.7g}",
            "said": notes[k],
        }
        for k, result in enumerate(results)
        for label, (low, high) in zip(result.labels, intervals[k], strict=True)
    ]


METHODS_TIMED = ("fit", "importance", "emcee", "mean-field", "full-rank", "lmfit")


def timed(method: str, name: str = "magic-formula") -> dict:
    """Processor seconds of a method on one data set, without the fit before it: the first
    time, with compilation, and the median of the next times."""
    from fits.posterior_peers.methods import fits_of, intervals_of

    def run(k):
        if method == "fit":
            return lambda: fits_of(CASES[name], [k])
        results = fits_of(CASES[name], [k])
        return lambda: intervals_of(method, CASES[name], results)

    spent = []
    for k in range(TIMED + 1):
        call = run(k)
        begun = time.process_time()
        call()
        spent.append(time.process_time() - begun)
    warm = float(np.median(spent[1:]))
    return {"method": method, "cold_s": f"{spent[0]:.2f}", "warm_s": f"{warm:.3f}"}


def _in_a_process(method: str) -> dict:
    """:func:`timed` in a new process with an empty cache of compiled programs."""
    with tempfile.TemporaryDirectory() as cache:
        apart = os.environ | {"XDG_CACHE_HOME": cache, "OPENBLAS_NUM_THREADS": "1"}
        apart.pop("JAX_COMPILATION_CACHE_DIR", None)
        line = [sys.executable, "-m", "fits.posterior_peers", "--time", method]
        done = subprocess.run(line, env=apart, check=True, capture_output=True)
    print(method, flush=True)
    return json.loads(done.stdout.splitlines()[-1])


if __name__ == "__main__":
    main()
