"""The findings of diagnoses of trials, without their fits: what ``decide`` reads."""

import json
import os
import pickle
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from unittest.mock import patch

from fits.withheld.run import end_with_parent

__all__ = ["collect", "loaded"]


class _Stopped(Exception):
    """Ends a diagnosis after the verdict."""


def _findings(path: Path, without: Sequence[str], sim: bool) -> dict:
    """Findings of a file, and the effects on its noise."""
    import tirefit
    from tirefit.diagnosis import diagnose
    from tirefit.diagnosis.effects import NOISE_EFFECTS
    from tirefit.diagnosis.summary import case as verdicts

    kept: list = []

    def keep(search, weighed, out):
        kept.append(findings_of(search, weighed, out))
        return kept[-1]

    def stop(case, *rest):
        kept.append(case)
        raise _Stopped

    findings_of = verdicts.findings_of
    with patch.object(verdicts, "findings_of", keep), patch.object(diagnose, "document_of", stop):
        try:
            tirefit.diagnose(
                tirefit.read(str(path)),
                model="brush",
                rig=path.parent / "rig.toml",
                without=without,
                sim=True if sim else None,
            )
        except _Stopped:
            found, case = kept[-2:]
    flags = {e.flag: e.id for e in NOISE_EFFECTS if e.flag}
    noise = tuple(flags[flag] for flag in case.noise_flags if flag in flags)
    return {"findings": replace(found, weighed=replace(found.weighed, best_of={})), "noise": noise}


def _begin(compiled: str) -> None:
    end_with_parent()
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", compiled)
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import jax

    jax.config.update("jax_enable_x64", True)


def _trial(folder: Path, name: str, label: dict, without, sim: bool, at: Path) -> None:
    record = _findings(folder / "trials" / label["file"], without, sim)
    part = at.with_suffix(f".{os.getpid()}")
    part.write_bytes(pickle.dumps(record | {"name": f"{folder.name}/{name}", "label": label}))
    part.rename(at)


def collect(folders: Sequence[Path], out: Path, jobs: int) -> None:
    """Write ``OUT/FOLDER/NAME.pickle`` for each trial of the folders that has none."""
    compiled = str((out / "compiled").absolute())
    with ProcessPoolExecutor(jobs, get_context("spawn"), _begin, (compiled,)) as pool:
        waiting = []
        for folder in folders:
            (out / folder.name).mkdir(parents=True, exist_ok=True)
            labels, left_out, sims = (
                json.loads((folder / f"{name}.json").read_text())
                for name in ("labels", "leave_out", "simulators")
            )
            # Files of equal length and force use the same compiled programs.
            for name in sorted(labels, key=lambda n: (labels[n]["n"], labels[n]["force"], n)):
                label, at = labels[name], out / folder.name / f"{name}.pickle"
                group = label["file"].split("/")[0]
                if not at.exists():
                    given = folder, name, label, left_out[group], bool(sims.get(group)), at
                    waiting.append((at, pool.submit(_trial, *given)))
        for number, (at, done) in enumerate(waiting, 1):
            if error := done.exception():  # an error in one file must not stop the others
                print(f"{at}: {error!r}", flush=True)
            if number % 40 == 0:
                print(f"{number} of {len(waiting)}", flush=True)


def loaded(folder: Path) -> list[dict]:
    """The records of a folder."""
    return [pickle.loads(path.read_bytes()) for path in sorted(folder.glob("*.pickle"))]
