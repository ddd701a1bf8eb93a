"""Diagnose the cases: ``python -m fits.measured_changes [--case NAME] --out DIR``.

Writes ``DIR/NAME.json`` (the diagnosis), ``DIR/table.json`` and ``DIR/table.md``. Earlier
results in ``DIR`` stay in the table; the chosen cases are diagnosed again.
"""

import argparse
import json
import multiprocessing
import re
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

import tirefit
from fits.measured_changes import by_hand
from fits.measured_changes.cases import CASES, Case
from fits.measured_changes.logs import Table, data, table

SAME = {"friction_ellipse": "drive_share"}  # effect of tirefit -> effect by hand
PARAMETERS = {"cpa2": (0, "stiffness"), "mu": (1, "friction")}
"""Parameter -> its index in SciPy's values, and the word in the names of effects on it."""
COLUMNS = (
    "case", "use", "known change", "no effect", "by hand", "tool", "of by hand",
    "named", "acts like", "status", "right", "s",
)  # fmt: skip


def of_ladder(found) -> tuple[float, float] | None:
    """rms [N] left out without effects and with those that help, from the tool's ladder; if
    their set is no step of it, from its longest step within that set."""
    ladder, helping = found.ladder, set(found.verdict.helping)
    if not ladder.steps:
        return None
    inside = [s for s in ladder.steps[:-2] if set(s.effects) <= helping]
    own = max(inside, key=lambda step: len(step.effects))
    base = next(step for step in ladder.steps if not step.effects)
    return base.rms_left_out, own.rms_left_out


def closes(found, case: Case, rows: Table) -> tuple[float, float, str]:
    """rms [N] without effects and with those that help, and its source: the tool's ladder;
    without one, a fit by hand on rows left out; else the diagnosed rows."""
    if (own := of_ladder(found)) is not None:
        return *own, "ladder"
    known = [SAME.get(n, n) for n in found.verdict.helping]
    if case.fitted_on is None and set(known) <= set(by_hand.EFFECTS):
        parts = by_hand.folds(rows, case.in_time)[1]
        some = (by_hand.rms_left_out(names, rows, parts) for names in ((), known))
        return *some, "by hand"
    missed = (rows["fy"] - found.rows["fy"][kind] for kind in ("base", "extended"))
    return *(float(np.sqrt(np.nanmean(m**2))) for m in missed), "rows diagnosed"


def judged(line: dict, case: Case, hand: dict) -> tuple[str, list[str]]:
    """Right, said (not named, but acts like it, a twin or also possible) or wrong; and the
    reasons."""

    def one_of(names, pattern):
        return [name for name in names if re.fullmatch(pattern, name)]

    missing = [p for p in case.named if not one_of(line["named"], p)]
    why = [f"not named: {pattern}" for pattern in missing]
    why += [f"false: {name}" for name in one_of(line["named"], case.never)]
    for name, changed in case.change.items():
        tool, (k, field) = line["parameters"][name], PARAMETERS[name]
        truth = [hand["plain"][k], *([hand["values"][k]] * (field not in hand["best"]))]
        at, std = tool["measured"], tool["std"]
        if changed and not tool["differs"]:
            why.append(f"{name} {at:.3g} ± {std:.2g}: no change found")
        elif changed and max(min(truth) - at, at - max(truth)) > 1.96 * std:
            why.append(f"{name} {at:.3g} ± {std:.2g}, by hand {truth[0]:.3g}")
        elif not changed and tool["differs"]:
            why.append(f"false: {name} differs")
    only_said = len(why) == len(missing) and all(one_of(line["said"], p) for p in missing)
    return ("said" if only_said else "wrong") if why else "right", why


def diagnosed(case: Case, out: Path) -> dict:
    """Diagnoses a case, writes the document, and returns the row of the table."""
    jax.config.update("jax_enable_x64", True)
    rows, sim = table(case.logs), None
    if case.fitted_on is not None:
        sim = tirefit.fit(data(table(case.fitted_on), "fitted"), "brush")
    held = [data(table(case.held_out), "held_out")] if case.held_out else []
    began = time.perf_counter()
    found = tirefit.diagnose(data(rows, case.name), sim=sim, holdout=held)
    seconds = time.perf_counter() - began
    (out / f"{case.name}.json").write_text(found.to_json())
    nothing, tool, on = closes(found, case, rows)
    verdict, gap = found.verdict, found.gap.holdout if held else None
    twins = [t for each in verdict.each.values() for t in each.twins]
    return by_hand.rounded(
        {
            "case": case.name,
            "named": list(verdict.effects),
            "acts_like": list(verdict.acts_like),
            "each": {k: one.probability for k, one in verdict.each.items()},
            "status": str(verdict.status),
            "probability": verdict.probability,
            "said": [*verdict.acts_like, *verdict.also_possible, *twins],
            "parameters": {k: p._asdict() for k, p in verdict.parameters.items()},
            "tool_nothing": nothing,
            "tool": tool,
            "tool_on": on,
            "held_out": gap and [gap.rms, gap.remaining_rms],
            "seconds": seconds,
        }
    )


def halves_of(case: Case) -> tuple[Case, Case]:
    """The case on the even and on the odd tenths of its runs, which share no rows."""
    even, odd = (replace(case, logs=replace(case.logs, part=part)) for part in ("even", "odd"))
    return even, odd


def agreement(case: Case) -> dict:
    """The names of two halves of the logs of a case, and whether they agree: every cause that
    one half names is named by the other one or acts like a cause there."""
    jax.config.update("jax_enable_x64", True)
    sim = tirefit.fit(data(table(case.fitted_on), "fitted"), "brush") if case.fitted_on else None
    found = [tirefit.diagnose(data(table(c.logs), c.name), sim=sim) for c in halves_of(case)]
    named = [{*f.verdict.effects} - {"unknown"} for f in found]
    helps = [{*f.verdict.helping} for f in found]
    each = [{k: round(one.probability, 2) for k, one in f.verdict.each.items()} for f in found]
    return {
        "case": case.name,
        "named": [sorted(one) for one in named],
        "each": each,
        "same": named[0] == named[1],
        "agree": named[0] <= helps[1] and named[1] <= helps[0],
    }


def scored(line: dict, case: Case, hand: dict) -> dict:
    """The row with the known change, the result by hand, and whether it is right."""
    right, why = judged(line, case, hand)
    before, best = hand["rms"][""], hand["rms"][hand["best"]]
    closed = 1 - line["tool"] / line["tool_nothing"]
    return line | {
        "letter": case.letter,
        "use": case.use,
        "truth": case.truth,
        "on": hand["on"],
        "nothing": before,
        "by_hand": best,
        "best": hand["best"],
        "of_possible": closed / (1 - best / before) if best < 0.97 * before else None,
        "held_out_by_hand": hand.get("held_out"),
        "right": right,
        "why": why,
    }


def _stated(line: dict, effects: list[str]) -> str:
    """Effects with the probability that they are the cause."""
    return ", ".join(f"{e} ({line['each'][e]:.2f})" if e in line["each"] else e for e in effects)


def markdown(lines: list[dict]) -> str:
    """The table; rms in N on rows left out, except where the tool's has a star."""
    text = f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|\n"
    for line in lines:
        share, star = line["of_possible"], "*" * (line["tool_on"] == "rows diagnosed")
        cells = (
            line["case"],
            line["use"],
            line["truth"],
            f"{line['nothing']:.3f}",
            f"{line['by_hand']:.3f} {line['best'].replace('+', ' + ')}",
            f"{line['tool_nothing']:.3f} → {line['tool']:.3f}{star}",
            "-" if share is None else f"{100 * share:.0f} %",
            _stated(line, line["named"]) or "none",
            _stated(line, line["acts_like"]),
            f"{line['status']} {line['probability']:.2f}",
            ": ".join(filter(None, (line["right"], "; ".join(line["why"])))),
            f"{line['seconds']:.0f}",
        )
        text += f"| {' | '.join(cell.replace('|', ' or ') for cell in cells)} |\n"
    counts = [f"{name} {n}" for name, n in Counter(x["right"] for x in lines).items()]
    shares = [x["of_possible"] for x in lines if x["of_possible"] is not None]
    mean = f"{100 * np.mean(shares):.0f} %" if shares else "-"
    return f"{text}\n{len(lines)} cases: {', '.join(counts)}; of by hand {mean}\n"


def compare_halves(cases: list[Case], asked, context) -> None:
    """Write ``halves.json``; print each case, and how many agree."""
    found = []
    with ProcessPoolExecutor(asked.jobs, context) as pool:
        for done in as_completed(pool.submit(agreement, case) for case in cases):
            found.append(done.result())
            (asked.out / "halves.json").write_text(json.dumps(found, indent=1) + "\n")
            print(found[-1], flush=True)
    for kind in ("same", "agree"):
        print(f"{kind}: {sum(one[kind] for one in found)} of {len(found)} cases")


def main() -> None:
    """Diagnose the cases, and write the table after each."""
    parser = argparse.ArgumentParser(prog="python -m fits.measured_changes")
    parser.add_argument("--case", action="append", choices=[c.name for c in CASES])
    parser.add_argument("--use", choices=["choosing", "judging"])
    parser.add_argument(
        "--halves", action="store_true", help="do the names of halves of one log agree? no truth"
    )
    parser.add_argument("--table", action="store_true", help="only score again and write the table")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    at = asked.out / "table.json"
    lines = {x["case"]: x for x in json.loads(at.read_text())} if at.exists() else {}

    def write(new: dict) -> None:
        lines.update(new)
        hand = json.loads(by_hand.FILE.read_text())
        done = [scored(lines[c.name], c, hand[c.name]) for c in CASES if c.name in lines]
        at.write_text(json.dumps(done, indent=1) + "\n")
        (asked.out / "table.md").write_text(markdown(done))
        for line in done:
            if line["case"] in new:
                print(markdown([line]).split("\n")[2], flush=True)

    write({})
    cases = [c for c in CASES if c.name in (asked.case or [c.name])]
    cases = [c for c in cases if c.use == (asked.use or c.use) and not asked.table]
    context = multiprocessing.get_context("spawn")
    if asked.halves:
        compare_halves([c for c in cases if c.logs.part == "all"], asked, context)
        return
    with ProcessPoolExecutor(asked.jobs, context) as pool:
        for done in as_completed(pool.submit(diagnosed, c, asked.out) for c in cases):
            write({done.result()["case"]: done.result()})
