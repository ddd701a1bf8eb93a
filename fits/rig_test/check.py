"""Run the simulated rig test through the whole chain and compare with its truth.

``python -m fits.rig_test.check`` prints, for the test of a seed: the root mean square
residual of each force against the rows and against the noise-free truth; the same of an
independent least-squares fit; by kind of sweep the share of rows within the 95 % band,
for a load inside the range that is left out and for 1.3 times the largest load;
processor time and peak memory. ``--full`` takes the 100 Hz recordings, ``--leave-out``
another load.
"""

import argparse
import resource
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

import tirefit
from fits.rig_test.generate import DEG, LOADS, SMALL, Recording, recordings, write
from fits.rig_test.peer import staged_fit
from fits.rig_test.tire import true_forces
from tirefit.data.rig.prepare import prepare
from tirefit.data.table import TireData
from tirefit.fitting.problem.config import load_config
from tirefit.models import TireInputs

__all__ = ["BEYOND", "FORCES", "RigRows", "band", "fit_of", "main", "rig_rows"]

FORCES = ("fx", "fy", "mz")
BEYOND = round(1.3 * max(LOADS), 1)
"""Load [N] that no fit uses, to check the band in extrapolation."""
_IN_95 = 1.96
_SETTING = 0.15
"""Largest relative deviation from a load of the rows of its setting."""


class RigRows(NamedTuple):
    """The prepared rows of one recording, and the state of the tire at each row."""

    data: TireData
    friction: np.ndarray
    stiffness: np.ndarray

    def chosen(self, rows: np.ndarray) -> "RigRows":
        """The chosen rows, (n,) bool."""
        used = self.data.used.copy()
        used[used] = rows
        data = replace(self.data, used=used)
        return RigRows(data, self.friction[rows], self.stiffness[rows])

    @property
    def inputs(self) -> TireInputs:
        """The inputs as measured, arrays (n,)."""
        zero = np.zeros(self.data.n)
        names = TireInputs._fields
        return TireInputs(*(self.data.usable(k) if k in self.data else zero for k in names))

    def truth(self) -> dict[str, np.ndarray]:
        """Noise-free forces (n,) at the measured inputs, in the state of each row."""
        return true_forces(self.inputs, self.friction, self.stiffness)


def rig_rows(folder: Path, seed: int, thin: int, loads: Sequence[float] = LOADS) -> list[RigRows]:
    """Write both recordings as files, read and prepare them."""
    made = recordings(seed, thin, loads)
    paths = write(folder, seed, thin, loads=loads)
    return [_prepared(path, one) for path, one in zip(paths, made, strict=False)]


def _prepared(path: Path, recording: Recording) -> RigRows:
    data = tirefit.read(path, curve=False, mask_bad_rows=True)
    rows = prepare(data, {"warm_up": _warm_up(recording)}).to_data()
    time_of_row = recording.measured["time"]
    step = time_of_row[1] - time_of_row[0]
    at = np.rint((rows.usable("time") - time_of_row[0]) / step).astype(int)
    return RigRows(rows, recording.friction[at], recording.stiffness[at])


def _warm_up(recording: Recording) -> float:
    """Time [s] until the first setting of the test protocol."""
    started = recording.measured["time"][np.argmax(recording.warm)]
    return float(started - recording.measured["time"][0])


def fit_of(rows: Sequence[RigRows]):
    """Fit a Magic Formula to these rows, with the settings of ``fit.toml``."""
    config = load_config(Path(__file__).with_name("fit.toml"))
    return tirefit.fit_magic_formula([one.data for one in rows], "mf61", config=config)


def band(fit, rows: RigRows) -> dict[str, np.ndarray]:
    """Predicted forces of the rows, and their standard deviations."""
    columns = {name: column for name, column in rows.inputs._asdict().items() if name != "time"}
    return tirefit.predict(fit, columns)


def kinds(rows: RigRows) -> dict[str, np.ndarray]:
    """Kind of sweep -> its rows (n,) bool."""
    if rows.data.name.startswith("cornering"):
        return {"cornering": np.full(rows.data.n, True)}
    angle = np.round(rows.data.usable("alpha") / DEG)
    return {f"brake and drive at {a:g} deg": angle == a for a in (0, 3, 6)}


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def at_load(rows: RigRows, load: float) -> np.ndarray:
    """The rows of the setting of this load, (n,) bool."""
    return np.abs(rows.data.usable("fz") / load - 1) < _SETTING


def left_out(rows: Sequence[RigRows], load: float) -> list[RigRows]:
    return [one.chosen(~at_load(one, load)) for one in rows]


def coverage(fit, rows: Sequence[RigRows], load: float) -> dict[str, list[str]]:
    """Kind of sweep -> by force, the share of the rows at this load in the 95 % band
    and their root mean square residual."""
    found: dict[str, list[str]] = {}
    for one in (one.chosen(at_load(one, load)) for one in rows):
        given = band(fit, one)
        for kind, own in kinds(one).items():
            for force in FORCES:
                off = (one.data.usable(force) - given[force])[own]
                inside = np.abs(off) <= _IN_95 * given[f"{force}_std"][own]
                text = f"{force} {np.mean(inside):.0%} {rms(off):.3g}"
                found.setdefault(kind, []).append(text)
    return found


def residuals(rows: Sequence[RigRows], given: Sequence[Mapping[str, np.ndarray]]):
    """Force -> root mean square difference of the given forces from the rows, and from
    the truth in the state of each row."""
    found = {}
    for force in FORCES:
        of_rows, of_truth = [], []
        for one, predicted in zip(rows, given, strict=True):
            of_rows.append(one.data.usable(force) - predicted[force])
            of_truth.append(one.truth()[force] - predicted[force])
        found[force] = tuple(rms(np.concatenate(off)) for off in (of_rows, of_truth))
    return found


def _print_residuals(title: str, found) -> None:
    print(f"{title:<26}    rows   truth")
    for force, values in found.items():
        unit = "N m" if force == "mz" else "N"
        print(f"  {force} [{unit:<3}]{'':16}" + "".join(f"{v:8.3g}" for v in values))


def _print_coverage(title: str, found) -> None:
    print(f"{title}: share of rows in the 95 % band, rms residual of the rows")
    for kind, texts in found.items():
        print(f"  {kind:<24}  {'  '.join(texts)}")


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--full", action="store_true", help="rows of 100 Hz")
    parser.add_argument("--leave-out", type=float, default=667.2, help="load [N]")
    parser.add_argument("--no-peer", action="store_true", help="skip the SciPy fit")
    given = parser.parse_args()
    thin = 1 if given.full else SMALL
    with tempfile.TemporaryDirectory() as folder:
        everything = rig_rows(Path(folder), given.seed, thin, (*LOADS, BEYOND))
    rows = left_out(everything, BEYOND)
    begin = time.process_time()
    fit = fit_of(rows)
    spent = time.process_time() - begin
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    count = sum(one.data.n for one in rows)
    print(f"{count} rows fitted in {spent:.0f} s of processor, peak {peak:.2f} GiB")
    _print_residuals("tirefit", residuals(rows, [band(fit, one) for one in rows]))
    if not given.no_peer:
        begin = time.process_time()
        peer = staged_fit([(one.inputs, one.data) for one in rows])
        spent = time.process_time() - begin
        print(f"SciPy: {spent:.0f} s of processor, no error bars")
        _print_residuals(
            "SciPy, stage by stage", residuals(rows, [peer(one.inputs) for one in rows])
        )
    _print_coverage(f"{BEYOND:g} N, 1.3 x the largest load", coverage(fit, everything, BEYOND))
    less = fit_of(left_out(rows, given.leave_out))
    _print_coverage(f"{given.leave_out:g} N left out", coverage(less, rows, given.leave_out))


if __name__ == "__main__":
    main()
