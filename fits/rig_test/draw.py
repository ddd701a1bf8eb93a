"""Draw the figures of the whole chain: ``python -m fits.rig_test.draw``."""

import tempfile
from functools import cache
from pathlib import Path

import jax
import numpy as np

import tirefit
from fits.rig_test.check import FORCES, band, fit_of, residuals, rig_rows, rms
from fits.rig_test.generate import SMALL
from fits.rig_test.peer import staged_fit
from tirefit.data.tir.tir import read_tir
from tirefit.models import forces
from tirefit.models.mf import mf_tire
from tirefit.report.fit.mf_figures import ellipse_curves, force_curves, stacked

__all__ = ["chain", "properties"]

HERE = Path(__file__).parent
SEED = 1


@cache
def chain():
    """Generate, read, prepare and fit the small test: (rows, fit)."""
    with tempfile.TemporaryDirectory() as folder:
        rows = rig_rows(Path(folder), SEED, SMALL)
    return rows, fit_of(rows)


def properties() -> dict[str, float]:
    """The numbers that expected.toml limits."""
    rows, fit = chain()
    given = [band(fit, one) for one in rows]
    found = {}
    for force, (of_rows, of_truth) in residuals(rows, given).items():
        found[f"{force}: rms of the rows"] = of_rows
        found[f"{force}: rms of the truth"] = of_truth
        inside = [
            np.abs(one.data.usable(force) - g[force]) <= 1.96 * g[f"{force}_std"]
            for one, g in zip(rows, given, strict=True)
        ]
        found[f"{force}: rows in the band"] = float(np.mean(np.concatenate(inside)))
        found[f"{force}: settings"] = float(len(fit.binned[force]))
    for force in (*FORCES, "mx"):
        shares = [part.within for part in fit.left_out if part.force == force]
        for load, share in zip(("smallest", "middle", "largest"), shares, strict=True):
            found[f"{force}: {load} load left out, rows in the band"] = share
    peer = staged_fit([(one.inputs, one.data) for one in rows])
    for force, (of_rows, _) in residuals(rows, [peer(o.inputs) for o in rows]).items():
        found[f"{force}: rms of the rows by SciPy"] = of_rows
    with tempfile.TemporaryDirectory() as folder:
        fit.save(Path(folder))
        tir = read_tir(Path(folder) / "fit.tir")
        again = tirefit.load_fit(Path(folder) / "fit.json")
    one, whole = rows[1], given[1]
    of_tir = forces(mf_tire(tir.version, tir.numbers), one.inputs)._asdict()
    for force in FORCES:
        off = np.asarray(of_tir[force]) - whole[force]
        found[f"{force}: fit.tir against the fit"] = rms(off) / rms(whole[force])
        off = band(again, one)[force] - whole[force]
        found[f"{force}: fit.json against the fit"] = rms(off) / rms(whole[force])
    return found


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    _, fit = chain()
    stacked(force_curves(fit, "fy")[:1]).savefig(HERE / "by_load.png", dpi=90)
    stacked(force_curves(fit, "fx")[-1:]).savefig(HERE / "combined.png", dpi=90)
    stacked(ellipse_curves(fit)).savefig(HERE / "ellipse.png", dpi=90)
    for name, value in properties().items():
        print(f"{name:<36} {value:.6g}")


if __name__ == "__main__":
    main()
