"""The Python example of the README runs as printed and prints what it says."""

import re
import shutil
import textwrap
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
# The code, then its output, indented.
EXAMPLE = re.compile(
    r"```python\n(import jax\n.*?)```\n\n((?:    [^\n]*\n)+)", re.DOTALL
)


def test_the_example_runs_and_prints_what_it_says(tmp_path, monkeypatch, capsys):
    code, said = EXAMPLE.search(README).groups()
    case = tmp_path / "fits" / "dart_rear_axle"
    case.mkdir(parents=True)
    shutil.copy(ROOT / "fits" / "dart_rear_axle" / "free_driving.csv", case)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    assert capsys.readouterr().out == textwrap.dedent(said)
    assert (tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG")
