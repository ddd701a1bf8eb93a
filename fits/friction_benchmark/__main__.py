"""Runs the benchmark of friction estimators.

    python -m fits.friction_benchmark logs  --out out/friction_benchmark
    python -m fits.friction_benchmark run   --out out/friction_benchmark
    python -m fits.friction_benchmark table --out out/friction_benchmark

``run --traces FOLDER`` also scores other estimators: FOLDER/NAME/LOG.csv of each log
with columns time, mu, mu_std, supported, alarm. See README.md.
"""

import argparse
import csv
import os
from pathlib import Path

HERE = Path(__file__).parent


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser("python -m fits.friction_benchmark")
    parser.add_argument("what", choices=("logs", "run", "table", "all"))
    parser.add_argument("--out", type=Path, default=Path("out/friction_benchmark"))
    parser.add_argument("--hours", type=float, default=0.5, help="hours without a drop, per use")
    parser.add_argument("--drops", type=int, default=10, help="drops of each size, per use")
    parser.add_argument("--method", default="", help="only these methods, separated by commas")
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--traces", type=Path, help="folder of estimates by other programs")
    parser.add_argument("--into", type=Path, help="folder of the table", default=None)
    asked = parser.parse_args(argv)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import jax

    jax.config.update("jax_enable_x64", True)
    logs = asked.out / "logs"
    if asked.what in ("logs", "all"):
        from fits.friction_benchmark.scenarios import scenarios, write_logs

        write_logs(logs, scenarios(asked.hours, asked.drops))
    if asked.what in ("run", "all"):
        from fits.friction_benchmark.run import run_all

        names = [name for name in asked.method.split(",") if name]
        tables = run_all(logs, names=names, peers=not asked.no_peers, foreign=asked.traces)
        for name, lines in tables.items():
            _write(asked.out / f"{name}.csv", lines)
    if asked.what in ("table", "all"):
        from fits.friction_benchmark.tables import publish

        print(publish(asked.out, asked.into or asked.out))


def _write(path: Path, lines) -> None:
    with open(path, "w", newline="") as file:
        rows = csv.DictWriter(file, list(lines[0]), restval="", lineterminator="\n")
        rows.writeheader()
        rows.writerows(lines)


if __name__ == "__main__":
    main()
