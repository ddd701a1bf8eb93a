"""Diagnose the cases: ``python -m fits.measured_changes [--case NAME] --out DIR``.

Writes ``DIR/NAME.json`` (the diagnosis), ``DIR/table.json`` and ``DIR/table.md``. Cases
that are done in ``DIR`` stay in the table; those asked for are diagnosed again.
"""

import argparse
import json
import multiprocessing
import re
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import jax
import numpy as np

import tirefit
from fits.measured_changes import by_hand
from fits.measured_changes.cases import CASES, Case
from fits.measured_changes.logs import Table, data, table

HAND = Path(__file__).with_name("by_hand.json")
SAME = {
    "friction_ellipse": "drive_share",
    "friction_speed_exponential": "friction_ln_speed",
}
"""Effect of tirefit -> the one by hand that is closest, where the names differ."""
HEAD = (
    "| case | use | what is known | nothing | by hand | tool | of by hand | named |"
    " status | right | s |\n|---|---|---|---|---|---|---|---|---|---|---|\n"
)


def left_out(found, case: Case, rows: Table) -> tuple[float | None, float | None, str]:
    """rms [N] with nothing and with what is named, and on what: the tool's own ladder;
    without one what is named by hand on rows left out; else the rows diagnosed."""
    named = tuple(found.verdict.effects)
    ladder = getattr(found, "ladder", None)
    if ladder is not None and ladder.steps:
        steps = {frozenset(s.effects): s.rms_left_out for s in ladder.steps[:-2]}
        first = ladder.steps[0].rms_left_out
        own = steps.get(frozenset(named))
        if own is None:  # names that are no step of it: the longest step within them
            inside = [effects for effects in steps if effects <= set(named)]
            own = steps[max(inside, key=len)] if inside else first
        return first, own, "ladder"
    known = tuple(SAME.get(name, name) for name in named if name != "unknown")
    if case.fitted_on is None and all(n in by_hand.EFFECTS for n in known):
        parts = by_hand.folds(rows, case.in_time)[1]
        rms = [by_hand.rms_left_out(names, rows, parts) for names in ((), known)]
        return rms[0], rms[1], "by hand"
    measured, moved = rows["fy"], found.rows["extended"]["fy"]
    use = np.isfinite(moved)
    rms = [
        float(np.sqrt(np.mean((measured - found.rows[kind]["fy"])[use] ** 2)))
        for kind in ("base", "extended")
    ]
    return rms[0], rms[1], "rows diagnosed"


def judged(found, case: Case, hand: dict) -> tuple[str, list[str]]:
    """Right, said (not named, but a twin or also possible) or wrong; and why."""
    verdict, why, only_said = found.verdict, [], False
    each = getattr(verdict, "each", {})
    said = {*verdict.also_possible, *(t for e in each.values() for t in e.twins)}
    for pattern in case.named:
        if any(re.fullmatch(pattern, name) for name in verdict.effects):
            continue
        why.append(f"not named: {pattern}")
        only_said |= any(re.fullmatch(pattern, name) for name in said)
    if case.never:
        false = [n for n in verdict.effects if re.fullmatch(case.never, n)]
        why += [f"false: {name}" for name in false]
    for name, changed in case.change.items():
        tool = verdict.parameters.get(name)
        truth = hand["change"][name][1]
        if tool is None:
            why.append(f"no word on {name}")
        elif changed and abs(tool.measured - truth) > 1.96 * tool.std:
            why.append(f"{name} {tool.measured:.3g} ± {tool.std:.2g}, not {truth:.3g}")
        elif not changed and tool.differs:
            why.append(f"false: {name} differs")
    if not why:
        return "right", why
    return "said" if only_said and len(why) == 1 else "wrong", why


def diagnosed(case: Case, out: Path) -> dict:
    """One line of the table; writes the document of the diagnosis."""
    jax.config.update("jax_enable_x64", True)
    hand = json.loads(HAND.read_text())[case.name]
    rows, held = table(case.logs), case.held_out
    sim = None
    if case.fitted_on is not None:
        sim = tirefit.fit(data(table(case.fitted_on), "fitted"), "brush")
    others = [data(table(held), "held_out")] if held is not None else []
    began = time.perf_counter()
    found = tirefit.diagnose(data(rows, case.name), sim=sim, holdout=others)
    seconds = time.perf_counter() - began
    (out / f"{case.name}.json").write_text(found.to_json())
    nothing, tool, on = left_out(found, case, rows)
    right, why = judged(found, case, hand)
    by_nothing, best = hand["rms"][""], hand["rms"][hand["best"]]
    closed = None
    if nothing and tool is not None and best < 0.97 * by_nothing:
        closed = (1 - tool / nothing) / (1 - best / by_nothing)
    held_gap = found.gap.holdout
    return {
        "case": case.name, "letter": case.letter, "use": case.use, "truth": case.truth,
        "on": hand["on"], "nothing": by_nothing, "by_hand": best, "best": hand["best"],
        "tool_nothing": nothing, "tool": tool, "tool_on": on, "of_possible": closed,
        "named": list(found.verdict.effects), "status": str(found.verdict.status),
        "probability": found.verdict.probability, "right": right, "why": why,
        "also_possible": list(found.verdict.also_possible),
        "parameters": {k: p._asdict() for k, p in found.verdict.parameters.items()},
        "held_out": held_gap and [held_gap.rms, held_gap.remaining_rms],
        "held_out_by_hand": hand.get("held_out"), "seconds": round(seconds, 1),
    }  # fmt: skip


def markdown(lines: list[dict]) -> str:
    """The table; rms in N, on rows left out but where the tool's has a *."""

    def number(value, digits=3):
        return "-" if value is None else f"{value:.{digits}f}"

    text = HEAD
    for line in lines:
        star = "*" if line["tool_on"] == "rows diagnosed" else ""
        share = line["of_possible"]
        why = f": {'; '.join(line['why'])}" if line["why"] else ""
        cells = (
            line["case"], line["use"], line["truth"], number(line["nothing"]),
            f"{number(line['by_hand'])} {line['best'].replace('+', ' + ')}",
            f"{number(line['tool_nothing'])} → {number(line['tool'])}{star}",
            "-" if share is None else f"{100 * share:.0f} %",
            ", ".join(line["named"]) or "nothing",
            f"{line['status']} {number(line['probability'], 2)}",
            (line["right"] + why).replace("|", " or "), f"{line['seconds']:.0f}",
        )  # fmt: skip
        text += f"| {' | '.join(cells)} |\n"
    right = Counter(line["right"] for line in lines)
    shares = [x["of_possible"] for x in lines if x["of_possible"] is not None]
    mean = f"; closed {100 * np.mean(shares):.0f} % of by hand (mean)" if shares else ""
    return f"{text}\n{len(lines)} cases: {dict(right)}{mean}\n"


def main() -> None:
    """Run the cases asked for, and write the table after each."""
    parser = argparse.ArgumentParser(prog="python -m fits.measured_changes")
    parser.add_argument("--case", action="append", choices=[c.name for c in CASES])
    parser.add_argument("--use", choices=["choosing", "judging"])
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    at = asked.out / "table.json"
    lines = {x["case"]: x for x in json.loads(at.read_text())} if at.exists() else {}
    cases = [c for c in CASES if asked.case is None or c.name in asked.case]
    cases = [c for c in cases if asked.use in (None, c.use)]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(asked.jobs, context) as pool:
        for done in as_completed(pool.submit(diagnosed, c, asked.out) for c in cases):
            lines[done.result()["case"]] = done.result()
            ordered = [lines[c.name] for c in CASES if c.name in lines]
            at.write_text(json.dumps(by_hand.rounded(ordered), indent=1) + "\n")
            (asked.out / "table.md").write_text(markdown(ordered))
            print(markdown([done.result()]).removeprefix(HEAD).split("\n")[0])
