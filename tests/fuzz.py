"""Damaged inputs of every kind that is read: an error with a remedy or a result.

``make fuzz`` tries 100,000 (``python -m tests.fuzz --inputs 100000 --seed 1``), the
suite 500. Sound files are damaged at random, by a seed: bits flip, spans vanish or
repeat, tokens are replaced by such as no reader expects; records of our own are changed
under a new checksum as well. Never a traceback, never more than 60 s or 2 GiB; what
fails is written beside its traceback.
"""

import argparse
import gzip
import json
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tirefit.door import sealed
from tirefit.results import TirefitError

__all__ = ["KINDS", "Failure", "failures"]

SECONDS, GIGABYTES = 60, 2.0

_TOKENS = (
    b"1e308", b"-1e308", b"1e-308", b"1e9", b"1e10", b"10000000000", b"9" * 400,
    b"9" * 5000, b"-0.0", b"0", b"-1", b"nan", b"inf", b"-inf", b"true", b"null",
    b"''", b'""', b"[]", b"{}", b"[[1], [1, 2]]", b"[" * 3000, b"{" * 3000,
    b"a." * 3000, b"\x00", b"\x1b[2J", b"\x07", b"\x7f", b"\xff\xfe", b"\xc3",
    "\u202e\u0660".encode(), b"\r", b"\n\n", b"=", b"#", b"$", b",", b";", b'"',
    b"'", b"1_000", b"0x1F", b"1e", b"2026-01-01",
)  # fmt: skip
"""What no reader expects where a number or a name stands."""


class Kind(NamedTuple):
    """Sound files of one kind and what reads them: (path) -> anything."""

    suffix: str
    sound: Callable[[], list[bytes]]
    read: Callable[[Path], object]


class Failure(NamedTuple):
    """An input that neither gave a result nor a clean error."""

    kind: str
    number: int
    content: bytes
    text: str


# --- damage ---------------------------------------------------------------------


def _number_or_word(content: bytes, random) -> tuple[int, int]:
    """Ends of a token of a text: letters, digits, points, signs."""
    place = int(random.integers(0, max(len(content), 1)))
    word = b"0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ.+-_"
    start = end = place
    while start > 0 and content[start - 1] in word:
        start -= 1
    while end < len(content) and content[end] in word:
        end += 1
    return start, end


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """The content with one to four faults."""
    for _ in range(int(random.integers(1, 5))):
        n = len(content)
        a, b = sorted(int(x) for x in random.integers(0, n + 1, 2))
        b = min(b, a + int(random.choice([1, 8, 200, n + 1])))
        token = _TOKENS[int(random.integers(len(_TOKENS)))]
        match int(random.integers(0, 7)):
            case 0 if n:  # one bit
                changed = bytearray(content)
                changed[a % n] ^= 1 << int(random.integers(8))
                content = bytes(changed)
            case 1:  # a span is lost
                content = content[:a] + content[b:]
            case 2:  # a span comes twice
                content = content[:b] + content[a:b] + content[b:]
            case 3:  # the end is lost
                content = content[:a]
            case 4:  # something in between
                content = content[:a] + token + content[a:]
            case _:  # another token; twice as often as the others
                start, end = _number_or_word(content, random)
                content = content[:start] + token + content[end:]
    return content


_VALUES = (
    None, True, "", "x", -1, 0, 1e308, 10**400, [], [[1.0], [1.0, 2.0]], {}, {"a": 1},
    [None], ["fx"], "magic-formula", [1.0, "1.0"],
)  # fmt: skip


def changed_record(content: bytes, random: np.random.Generator) -> bytes:
    """A JSON record with one to three values of another kind, and a right checksum."""
    record = json.loads(content)
    record.pop("checksum", None)
    for _ in range(int(random.integers(1, 4))):
        place = record
        while True:
            keys = list(place) if isinstance(place, dict) else range(len(place))
            if not len(keys):
                break
            key = keys[int(random.integers(len(keys)))]
            inner = place[key]
            if isinstance(inner, dict | list) and random.random() < 0.8:
                place = inner
                continue
            value = _VALUES[int(random.integers(len(_VALUES)))]
            place[key] = deepcopy(value)  # a place for the next change
            break
    return json.dumps(sealed(record)).encode()


# --- kinds ----------------------------------------------------------------------

ROOT = Path(__file__).parents[1]
_LOG = ROOT / "fits/dart_jetracer"


def _files(*patterns: str) -> list[bytes]:
    found = sorted(path for pattern in patterns for path in ROOT.glob(pattern))
    assert found, patterns
    return [path.read_bytes() for path in found]


def _fit_tomls() -> list[bytes]:
    whole = b"""model = "brush-d"
force = ["fx"]
starts = 4
seed = 1
[noise]
fx = 20.0
loss = "huber"
[data]
convention = "sae"
slip_min = -0.2
[data.constants]
fz = 4000.0
[parameters.mu]
lower = 0.1
upper = 2.0
[parameters.mu.prior]
mean = 0.9
std = 0.1
[posterior]
sampler = "nuts"
max_steps = 100
"""
    return [*_files("fits/*/fit.toml"), whole]


def _rigs() -> list[bytes]:
    return [
        b'rolling_radius = 0.3\nwheel_inertia = 1.1\nrun_order = "random"\n'
        b"[noise]\nfx_relative = 0.01\nsigma_x = 0.001\n[vehicle]\nposition = 0.001\n"
    ]


@cache
def _short_log() -> bytes:
    """20 s of a measured log."""
    path = next(_LOG.glob("free*/*10_02_28.csv.gz"))
    lines = gzip.decompress(path.read_bytes()).splitlines(keepends=True)
    return b"".join([lines[0], *lines[2000:2600]])


def _tables() -> list[bytes]:
    rows = b"".join(b"%g,%g,4000\n" % (s / 100, 3e3 * s / 20) for s in range(-9, 20))
    head = _files("fits/dart_rear_axle/free_driving.csv")[0].splitlines(keepends=True)
    return [b"kappa,Fx [N],Fz\n" + rows, b"".join(head[:200]), _short_log()]


@cache
def _fit_json() -> bytes:
    from tirefit.data.read import read_frame
    from tirefit.fitting.estimate import fit

    slip = np.linspace(-0.1, 0.2, 40)
    share = np.clip(slip * 5e4 / 6000, -1, 1)
    force = 4000 * (3 * share - 3 * share * np.abs(share) + share**3)
    noisy = force + np.random.default_rng(0).normal(0, 20, 40)
    frame = {"sigma_x": slip, "fx": noisy, "fz": np.full(40, 4000.0)}
    return fit(read_frame(frame, convention="braking")).to_json().encode()


@cache
def _chain() -> bytes:
    from tirefit.fitting.chains import Chain, save_chain

    random = np.random.default_rng(0)
    samples = random.normal(size=(4, 30, 8, 2))
    state = {"key": np.arange(4), "z": samples[:, -1]}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "chain.npz")
        save_chain(path, Chain(samples, samples[..., 0], 0.4, state), "identity")
        return path.read_bytes()


def _read_fit_toml(path: Path):
    from tirefit.fitting.config import load_config

    return load_config(path)


def _read_vehicle(path: Path):
    """The vehicle, and a short log by it."""
    from tirefit.data.derive import derive
    from tirefit.data.vehicle import load_vehicle

    vehicle = load_vehicle(path)
    log = path.with_suffix(".csv")
    if not log.exists():
        log.write_bytes(_short_log())
    return derive(log, vehicle)


def _read_log(path: Path):
    from tirefit.data.derive import derive
    from tirefit.data.vehicle import load_vehicle

    return derive(path, load_vehicle(_LOG / "vehicle.toml"))


def _read_rig(path: Path):
    from tirefit.diagnosis.rig import load_rig

    return load_rig(path).force_noise("fx", np.full(3, 4000.0))


def _read_tir(path: Path):
    from tirefit.data.tir import brush_of, notes_on, read_tir
    from tirefit.models.mf import mf_tire

    tir = read_tir(path)
    return notes_on(tir), brush_of(tir), mf_tire(tir.version, tir.numbers)


def _read_table(path: Path):
    from tirefit.data.inspect import inspect
    from tirefit.data.read import read

    return inspect(read(path, convention="braking")).text()


def _read_fit(path: Path):
    from tirefit.fitting.predict import predict
    from tirefit.fitting.store import load_fit

    return predict(load_fit(path), _points())


@cache
def _points():
    from tirefit.data.read import read_frame

    slip = np.linspace(-0.1, 0.2, 5)
    return read_frame(
        {"sigma_x": slip, "fz": np.full(5, 4000.0)}, convention="braking", forces=False
    )


def _read_chain(path: Path):
    from tirefit.fitting.chains import load_chain

    return load_chain(path, "identity")


KINDS = {
    "fit.toml": Kind(".toml", _fit_tomls, _read_fit_toml),
    "vehicle.toml": Kind(".toml", lambda: _files("fits/*/vehicle.toml"), _read_vehicle),
    "rig.toml": Kind(".toml", _rigs, _read_rig),
    "tire.tir": Kind(".tir", lambda: _files("tests/data/tir/*/*.tir"), _read_tir),
    "data.csv": Kind(".csv", _tables, _read_table),
    "log.csv": Kind(".csv", lambda: [_short_log()], _read_log),
    "fit.json": Kind(".json", lambda: [_fit_json()], _read_fit),
    "chain.npz": Kind(".npz", lambda: [_chain()], _read_chain),
}


# --- running --------------------------------------------------------------------


class TooLong(BaseException):
    """No reader may catch it."""


def _alarm(*_):
    raise TooLong(f"more than {SECONDS} s")


def _tried(kind: Kind, path: Path) -> str:
    """What went wrong while the file was read; empty if nothing did."""
    signal.signal(signal.SIGALRM, _alarm)
    signal.alarm(SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            kind.read(path)
    except TirefitError as error:
        whole = all(p.reason for p in error.problems) and error.problems
        return "" if whole else f"an error without a reason: {error!r}"
    except (Exception, TooLong):
        return traceback.format_exc()
    finally:
        signal.alarm(0)
    return ""


def _forget_peak() -> None:
    """Begins to count the largest memory anew, where the system can."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak() -> float:
    """Largest memory in use since [GiB]."""
    with suppress(OSError):
        status = Path("/proc/self/status").read_text()
        return float(status.partition("VmHWM:")[2].split()[0]) / 2**20
    return 0.0


def failures(inputs: int, seed: int, kinds=tuple(KINDS)) -> Iterator[Failure]:
    """Each of the damaged inputs that failed; kinds take turns."""
    with tempfile.TemporaryDirectory() as folder:
        for number in range(inputs):
            name = kinds[number % len(kinds)]
            kind = KINDS[name]
            random = np.random.default_rng([seed, number])
            sound = kind.sound()
            whole = sound[int(random.integers(len(sound)))]
            forged = name == "fit.json" and random.random() < 0.5
            content = (changed_record if forged else damaged)(whole, random)
            path = Path(folder, f"input{kind.suffix}")
            path.write_bytes(content)
            _forget_peak()
            before = _peak()
            text = _tried(kind, path)
            taken = _peak() - before
            if not text and taken > GIGABYTES:
                text = f"{taken:.1f} GiB taken"
            if text:
                yield Failure(name, number, content, text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=KINDS, action="append")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    given = parser.parse_args()
    import jax

    jax.config.update("jax_enable_x64", True)
    given.out.mkdir(parents=True, exist_ok=True)
    seen: dict[str, int] = {}
    for failure in failures(given.inputs, given.seed, tuple(given.kind or KINDS)):
        last = failure.text.strip().splitlines()[-1]
        place = [x for x in failure.text.splitlines() if "tirefit/" in x][-1:]
        key = json.dumps([failure.kind, *place, last[:100]])
        seen[key] = seen.get(key, 0) + 1
        if seen[key] == 1:
            stem = given.out / f"{failure.number}-{failure.kind}"
            stem.write_bytes(failure.content)
            stem.with_name(f"{stem.name}.txt").write_text(failure.text)
            print(f"{stem}: {key}", flush=True)
    total = sum(seen.values())
    print(f"{total} of {given.inputs} inputs failed, in {len(seen)} ways")
    return 1 if total else 0


if __name__ == "__main__":
    sys.exit(main())
