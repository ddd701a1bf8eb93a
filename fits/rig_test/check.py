"""The simulated rig test through the whole chain, against what is known of it.

``python -m fits.rig_test.check`` prints, for the test of a seed: root mean square of
the residuals by force, against the rows and against the noise-free truth; the share of
rows within the 95 % band by bin, for a load inside that is left out and for 1.3 times
the largest; processor time and peak memory; and the same residuals of an independent
least-squares fit. ``--full`` takes the 100 Hz recordings, ``--leave-out`` another load.
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
from tirefit.data.prepare.prepare import prepare
from tirefit.data.table import TireData
from tirefit.fitting.config import load_config
from tirefit.models import TireInputs

__all__ = ["BEYOND", "FORCES", "RigRows", "band", "fit_of", "main", "rig_rows"]

FORCES = ("fx", "fy", "mz")
BEYOND = round(1.3 * max(LOADS), 1)
"""Load [N] that no fit sees: its band is an extrapolation."""
_IN_95 = 1.96
_SETTING = 0.15
"""Share of a load by which the rows of its setting may be off."""


class RigRows(NamedTuple):
    """The prepared rows of one recording, and the state of the tire in each."""

    data: TireData
    friction: np.ndarray
    stiffness: np.ndarray

    def chosen(self, rows: np.ndarray) -> "RigRows":
        """Some of the rows, (n,) bool."""
        used = self.data.used.copy()
        used[used] = rows
        data = replace(self.data, used=used)
        return RigRows(data, self.friction[rows], self.stiffness[rows])

    @property
    def inputs(self) -> TireInputs:
        """As measured, (n,) each: what a fit sees."""
        return TireInputs(
            *(
                self.data.usable(name) if name in self.data else np.zeros(self.data.n)
                for name in TireInputs._fields
            )
        )

    def truth(self, mean: bool = False) -> dict[str, np.ndarray]:
        """Forces without noise at the inputs as measured: of the tire in the state that
        it had, or in the mean state of its recording."""
        state = self.friction, self.stiffness
        if mean:
            state = tuple(np.full(len(one), one.mean()) for one in state)
        return true_forces(self.inputs, *state)


def rig_rows(
    folder: Path, seed: int, thin: int, loads: Sequence[float] = LOADS
) -> list[RigRows]:
    """Both recordings, written as files, read, prepared."""
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
    """Time [s] until the first setting, as the test's protocol has it."""
    started = recording.measured["time"][np.argmax(recording.warm)]
    return float(started - recording.measured["time"][0])


def fit_of(rows: Sequence[RigRows]):
    """The Magic Formula of these rows, with the settings of ``fit.toml``."""
    config = load_config(Path(__file__).with_name("fit.toml"))
    return tirefit.fit_magic_formula([one.data for one in rows], "mf61", config=config)


def band(fit, rows: RigRows) -> dict[str, np.ndarray]:
    """What the fit predicts for the rows, with standard deviations."""
    columns = {
        name: column for name, column in rows.inputs._asdict().items() if name != "time"
    }
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
    """The rows of the setting of this load, (n,) bool; it wanders with the slip."""
    return np.abs(rows.data.usable("fz") / load - 1) < _SETTING


def left_out(rows: Sequence[RigRows], load: float) -> list[RigRows]:
    return [one.chosen(~at_load(one, load)) for one in rows]


def coverage(fit, rows: Sequence[RigRows], load: float) -> dict[str, dict[str, float]]:
    """Kind of sweep -> share of the measured rows at this load in the 95 % band, and
    of the truth in the state of each row, by force."""
    shares: dict[str, dict[str, float]] = {}
    for one in (one.chosen(at_load(one, load)) for one in rows):
        given, truth = band(fit, one), one.truth()
        for kind, own in kinds(one).items():
            found = shares.setdefault(kind, {})
            for force in FORCES:
                half = _IN_95 * given[f"{force}_std"]
                for what, seen in (
                    ("rows", one.data.usable(force)),
                    ("truth", truth[force]),
                ):
                    inside = np.abs(seen - given[force]) <= half
                    found[f"{force} {what}"] = float(np.mean(inside[own]))
                found[f"{force} rms"] = rms(
                    (one.data.usable(force) - given[force])[own]
                )
    return shares


def residuals(rows: Sequence[RigRows], given: Sequence[Mapping[str, np.ndarray]]):
    """Force -> root mean square against the rows, the truth in the state of each row,
    and the truth in the mean state."""
    found = {}
    for force in FORCES:
        sets = zip(rows, given, strict=True)
        parts = [
            (
                one.data.usable(force) - g[force],
                one.truth()[force] - g[force],
                one.truth(mean=True)[force] - g[force],
            )
            for one, g in sets
        ]
        found[force] = tuple(
            rms(np.concatenate(each)) for each in zip(*parts, strict=True)
        )
    return found


def _print_residuals(title: str, found) -> None:
    print(f"{title:<26}    rows   truth   truth at mean state")
    for force, values in found.items():
        unit = "N m" if force == "mz" else "N"
        print(
            f"  {force} [{unit:<3}]" + " " * 16 + "".join(f"{v:8.3g}" for v in values)
        )


def _print_coverage(title: str, shares) -> None:
    print(f"{title}: share of rows (of truth) in the 95 % band, rms of rows")
    for kind, found in shares.items():
        print(f"  {kind:<24}", end="")
        for force in FORCES:
            seen, true = (found[f"{force} {what}"] for what in ("rows", "truth"))
            print(
                f"  {force} {seen:.0%} ({true:.0%}) {found[f'{force} rms']:.3g}", end=""
            )
        print()


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
    _print_coverage(
        f"{BEYOND:g} N, 1.3 x the largest load", coverage(fit, everything, BEYOND)
    )
    less = fit_of(left_out(rows, given.leave_out))
    _print_coverage(
        f"{given.leave_out:g} N left out", coverage(less, rows, given.leave_out)
    )


if __name__ == "__main__":
    main()
