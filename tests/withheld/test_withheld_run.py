"""Processes that answer trials, one group each."""

import os
import subprocess
import sys

POOL = """
import os, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from fits.withheld.run import end_with_parent

if __name__ == "__main__":
    with ProcessPoolExecutor(1, get_context("spawn"), end_with_parent) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        pool.submit(time.sleep, 600).result()
"""


def test_a_pool_ends_with_its_parent_process(tmp_path):
    script = tmp_path / "pool.py"
    script.write_text(POOL)
    parent = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": os.getcwd()},
    )
    assert int(parent.stdout.readline()) != parent.pid
    parent.kill()
    # The pipe is open for as long as the worker lives: read to its end.
    assert parent.communicate(timeout=60) == ("", None)
