"""Whole commands, each with one damaged file and otherwise sound ones."""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from tirefit.diagnosis.effects import EFFECTS

from .kinds import KINDS, Kind, log_toml, short_log, sweep

__all__ = ["COMMANDS"]

_SHORT = """model = "brush"
starts = 2
[noise]
fx = 20.0
[posterior]
walkers = 8
max_steps = 50
"""
# A small library compiles and searches in a fraction of the time.
_KEPT = ("slip_offset", "force_offset")
_WITHOUT = [word for e in EFFECTS if e.id not in _KEPT for word in ("--without", e.id)]

_QUICK = "--controller none --speed 3 --vehicle quarter --time-limit 1 --out o"

LINES = {
    "inspect": ("data.csv", "inspect INPUT"),
    "fit": ("data.csv", "fit INPUT --no-posterior --out o"),
    "sample": ("data.csv", "fit INPUT --config short.toml --out o"),
    "configure": ("fit.toml", "fit rig.csv --config INPUT --no-posterior --out o"),
    "predict": ("data.csv", "predict brush INPUT --out p.csv --beside"),
    "predict of a fit": ("fit.json", "predict INPUT rig.csv --out p.csv"),
    "predict of a .tir": ("tire.tir", "predict INPUT rig.csv --out p.csv"),
    "derive": ("log.csv", "derive INPUT --vehicle vehicle.toml --out p.csv"),
    "derive by": ("vehicle.toml", "derive log.csv --vehicle INPUT --out p.csv"),
    "estimate": ("data.csv", "estimate INPUT --method rls,slip-slope --out o"),
    "convert": ("tire.tir", "convert INPUT --out o"),
    "brake": ("tire.tir", f"brake --tire INPUT {_QUICK}"),
    "brake of a fit": ("fit.json", f"brake --tire INPUT {_QUICK}"),
    "export": ("tire.tir", "export INPUT --to c --out tire.h"),
    "export with a diagnosis": (
        "run.json",
        "export brush --diagnosis INPUT --to numpy --out tire.py",
    ),
    "explore": ("fit.json", "explore INPUT --data rig.csv --out page.html"),
    "compare": ("fit.json", "compare INPUT INPUT --out o"),
    "diagnose": ("data.csv", "diagnose INPUT --out o WITHOUT"),
    "diagnose a fit": ("fit.json", "diagnose rig.csv --model INPUT --out o WITHOUT"),
    "diagnose a rig": ("rig.toml", "diagnose rig.csv --rig INPUT --out o WITHOUT"),
}
"""Kind of the damaged file, and the command."""


class Unclean(Exception):
    """A command that ended neither with a result nor with a clean error."""


@contextmanager
def _folder() -> Iterator[Path]:
    """The working folder of a command, with sound files."""
    before = Path.cwd()
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "rig.csv").write_bytes(sweep())
        (folder / "log.csv").write_bytes(short_log())
        (folder / "vehicle.toml").write_bytes(log_toml())
        (folder / "short.toml").write_text(_SHORT)
        os.chdir(folder)
        try:
            yield folder
        finally:
            os.chdir(before)


def _arguments(line: str, path: Path) -> list[str]:
    words: list[str] = []
    for word in line.split():
        words += _WITHOUT if word == "WITHOUT" else [word]
    return [str(path) if word == "INPUT" else word for word in words]


def _run(line: str, path: Path) -> None:
    """Raises Unclean, or the exception of the command."""
    from typer.testing import CliRunner

    from tirefit.cli.commands import app

    path = path.absolute()
    with _folder() as folder:
        result = CliRunner().invoke(app, _arguments(line, path))
        left = [p.name for p in folder.rglob("*") if re.match(r"\..", p.name)]
        made = list(folder.rglob("fit.json"))
    if not isinstance(result.exception, SystemExit | None):
        raise result.exception
    said = result.stderr
    if left:
        raise Unclean(f"left behind: {left}")
    if result.exit_code not in (0, 2, 3, 4, 5) or "Traceback" in said:
        raise Unclean(f"exit code {result.exit_code}: {said[-2000:]}")
    if result.exit_code in (2, 3) and not re.search(r"rror:\s*\S", said):
        raise Unclean(f"exit code {result.exit_code} without an error: {said!r}")
    if re.search(r"\x1b|\x00", said + result.stdout):
        raise Unclean("control characters of the input reach the terminal")
    if line.startswith("fit ") and result.exit_code == 0 and not made:
        raise Unclean("no result")


def _command(of: str, line: str) -> Kind:
    return KINDS[of]._replace(read=partial(_run, line))


COMMANDS = {f"{name}: {of}": _command(of, line) for name, (of, line) in LINES.items()}
