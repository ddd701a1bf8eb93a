"""``python -m fits.fuzz``: the requested number of inputs; failures are kept."""

import argparse
import json
import sys
from pathlib import Path

from . import COMMANDS, KINDS, failures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=[*KINDS, *COMMANDS], action="append")
    parser.add_argument("--whole", type=float, default=0.02, help="share of commands")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    given = parser.parse_args()
    import jax

    jax.config.update("jax_enable_x64", True)
    given.out.mkdir(parents=True, exist_ok=True)
    seen: dict[str, int] = {}
    kinds = tuple(given.kind or KINDS)
    whole = 0.0 if given.kind else given.whole
    for failure in failures(given.inputs, given.seed, kinds, whole):
        last = failure.text.strip().splitlines()[-1]
        place = [x for x in failure.text.splitlines() if "tirefit/" in x][-1:]
        key = json.dumps([failure.kind, *place, last[:100]])
        seen[key] = seen.get(key, 0) + 1
        if seen[key] == 1:
            stem = given.out / f"{failure.number}-{failure.kind.replace(': ', '-')}"
            stem.write_bytes(failure.content)
            stem.with_name(f"{stem.name}.txt").write_text(failure.text)
            print(f"{stem}: {key}", flush=True)
    total = sum(seen.values())
    print(f"{total} of {given.inputs} inputs failed, in {len(seen)} ways")
    return 1 if total else 0


if __name__ == "__main__":
    sys.exit(main())
