"""Diagnoses development trials and records the inputs of the decision.

    python -m fits.ablation.collect out/421 out/422 --out out/records --jobs 2

``OUT/FOLDER/tNNNN.pickle`` holds plain numbers (see :func:`record_of`), which load
without tirefit. ``--measured`` adds the measured cases (``fits/measured_changes``).
Existing records are kept: a second run continues an interrupted one.
"""

import argparse
import json
import os
import pickle
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from fits.withheld.run import end_with_parent

__all__ = ["diagnosed", "main", "record_of"]

EVERYTHING = 2.0
"""An unreachable probability: as ``Policy.likely`` it lets ``findings_of`` evaluate the
most probable set in any case."""


def _without_tests(findings, base, weighed, out, key, policy):
    """Figures of one set, without the slow tests of its residual, which are not needed."""
    from tirefit.diagnosis.decide.verdict import Tests

    alone = replace(weighed, log_weight={(): 0.0, key: 1.0})
    with patch.object(findings, "remainder_tests", return_value=Tests()):
        found = findings.findings_of(base, alone, out, np.random.default_rng(0), policy)
    return found.sets[key]


def record_of(base, search, weighed, out, found, verdict) -> dict:
    """Inputs of :func:`fits.ablation.variants.decided` for one file.

    ``hypotheses`` lists every set of atoms: its effects, log evidence, log prior, the part
    of the evidence due to slip uncertainty, whether it was refitted. ``weighed`` is the
    posterior over sets; ``out`` the predictions of data left out by each leading set;
    ``fitted`` its amplitudes over their errors and each effect's gain there;
    ``family`` the family of each effect; ``found`` and ``verdict`` the results as shipped.
    """
    from tirefit.diagnosis.decide import findings
    from tirefit.diagnosis.decide.verdict import Policy

    wanted = [k for k in dict.fromkeys(out.effects) if k in weighed.log_weight and k]
    wanted += [k for k in found.sets if k not in wanted]
    policy, fitted = Policy(likely=EVERYTHING), {}
    for key in wanted:
        one = _without_tests(findings, base, weighed, out, key, policy)
        gains = {effect: tuple(gain) for effect, gain in one.gains.items()}
        fitted[key] = dict(one.errors), gains
    return {
        "hypotheses": [
            (tuple(sorted(h.effects)), h.log_evidence, h.log_prior, h.due_to_doubt,
             h.refitted)
            for h in search.hypotheses
        ],
        "family": {atom.effect.id: atom.effect.family for atom in base.atoms},
        "weighed": {
            "log_weight": dict(weighed.log_weight),
            "log_beside": dict(weighed.log_beside),
            "evidence": dict(weighed.evidence),
            "other_form": sorted(weighed.other_form),
            "gains": {key: dict(gains) for key, gains in weighed.gains.items()},
            "log_total": weighed.log_total,
            "hidden": weighed.hidden,
        },
        "out": {
            "on": out.on, "across_runs": out.across_runs, "effects": out.effects,
            "loss": out.loss, "whitened": out.whitened, "rows": out.rows,
            "smooth": out.smooth, "climbed": out.climbed,
            "floor": findings.floor_of(base, out),
        },
        "fitted": fitted,
        "found": {"sets": list(found.sets), "unlisted": found.unlisted,
                  "tests": found.tests._asdict()},
        "verdict": {
            "status": str(verdict.status), "effects": verdict.effects,
            "probability": verdict.probability, "also": verdict.also_possible,
        },
        "flags": sorted({f for noise in base.noise.values() for f in noise.flags}),
    }  # fmt: skip


class _Stopped(Exception):
    """Ends a diagnosis after the verdict."""

    def __init__(self, case):
        super().__init__()
        self.case = case


def _stopped(case, *rest):
    raise _Stopped(case)


def diagnosed(data, **given) -> dict:
    """The record of one file, with ``seconds``, the CPU time of its diagnosis up to the
    verdict, total and by stage; arguments as in :func:`tirefit.diagnose`."""
    from tirefit.diagnosis import engine
    from tirefit.diagnosis.decide import findings

    results, spent = [], {}

    def timed(module, name):
        of = getattr(module, name)

        def stage(*arguments):
            began = time.process_time()
            results.append(of(*arguments))
            spent[name] = spent.get(name, 0.0) + time.process_time() - began
            return results[-1]

        return patch.object(module, name, stage)

    began = time.process_time()
    with ExitStack() as patches:
        for name in ("fit_base", "search"):
            patches.enter_context(timed(engine, name))
        for name in ("weigh", "climbed", "predicted", "remainder_tests"):
            patches.enter_context(timed(findings, name))
        patches.enter_context(timed(engine, "findings_of"))
        patches.enter_context(patch.object(engine, "document_of", _stopped))
        try:
            engine.diagnose(data, **given)
        except _Stopped as stopped:
            case = stopped.case
    spent["in all"] = time.process_time() - began
    stages = case.base, case.search, case.weighed, case.predicted
    record = record_of(*stages, results[-1], case.verdict)
    return record | {"seconds": spent}


def _begin(compiled: str) -> None:
    end_with_parent()
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", compiled)
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import jax

    jax.config.update("jax_enable_x64", True)


def _trial(folder: Path, name: str, label: dict, without, sim: bool, at: Path) -> str:
    import tirefit

    path = folder / "trials" / label["file"]
    record = diagnosed(
        tirefit.read(str(path)),
        model="brush",
        rig=path.parent / "rig.toml",
        without=without,
        sim=True if sim else None,
    )
    return _write(at, record | {"name": f"{folder.name}/{name}", "label": label})


def _cases() -> dict[str, Any]:
    cases = import_module("fits.measured_changes.cases")
    return {case.name: case for case in cases.CASES}


def _measured(name: str, at: Path) -> str:
    import tirefit

    logs = import_module("fits.measured_changes.logs")
    case, sim = _cases()[name], None
    data, table = logs.data, logs.table
    if case.fitted_on is not None:
        sim = tirefit.fit(data(table(case.fitted_on), "fitted"), "brush")
    record = diagnosed(data(table(case.logs), case.name), sim=sim)
    label = {
        "set": "measured",
        "named": case.named,
        "never": case.never,
        "effects": [],
        "families": [],
        "kind": case.letter,
    }
    return _write(at, record | {"name": f"measured/{case.name}", "label": label})


def _write(at: Path, record: dict) -> str:
    at.parent.mkdir(parents=True, exist_ok=True)
    part = at.with_suffix(f".{os.getpid()}")
    part.write_bytes(pickle.dumps(record))
    part.rename(at)
    return record["name"]


def _work(folders: list[Path], out: Path, measured: bool) -> list[tuple]:
    """(function, arguments) of the missing records; files of equal length and force are in
    succession, because they use the same compiled programs."""
    found: list[tuple] = []
    for folder in folders:
        labels = json.loads((folder / "labels.json").read_text())
        left_out = json.loads((folder / "leave_out.json").read_text())
        sims = json.loads((folder / "simulators.json").read_text())
        ranked = sorted(labels, key=lambda n: (labels[n]["n"], labels[n]["force"], n))
        for name in ranked:
            label, at = labels[name], out / folder.name / f"{name}.pickle"
            group = label["file"].split("/")[0]
            some = (folder, name, label, left_out[group], bool(sims.get(group)), at)
            if not at.exists():
                found.append((_trial, *some))
    if measured and find_spec("fits.measured_changes"):
        for name, case in _cases().items():
            at = out / "measured" / f"{name}.pickle"
            if case.use == "choosing" and not at.exists():
                found.append((_measured, name, at))
    return found


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--measured", action="store_true", help="also diagnose the measured cases")
    given = parser.parse_args(arguments)
    compiled = str((given.out / "compiled").absolute())
    work = _work(given.folders, given.out, given.measured)
    print(f"{len(work)} files", flush=True)
    with ProcessPoolExecutor(given.jobs, get_context("spawn"), _begin, (compiled,)) as pool:
        waiting = [(one, pool.submit(*one)) for one in work]
        for number, (one, done) in enumerate(waiting):
            try:
                name = done.result()
            except Exception as error:  # an error in one file must not stop the others
                print(f"{one[-1]}: {error!r}", flush=True)
                continue
            if number % 40 == 39:
                print(f"{number + 1} of {len(work)}: {name}", flush=True)


if __name__ == "__main__":
    main()
