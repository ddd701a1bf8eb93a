"""Sound files of every readable kind, and their readers."""

import gzip
import json
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

__all__ = ["KINDS", "Kind", "fit_json", "log_toml", "short_log", "sweep"]


class Kind(NamedTuple):
    """Sound files of one kind and their reader: (path) -> anything."""

    suffix: str
    sound: Callable[[], list[bytes]]
    read: Callable[[Path], object]


ROOT = Path(__file__).parents[2]
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
loss = "squares"
[data]
convention = "sae"
[data.constants]
fz = 4000.0
[parameters.mu]
lower = 0.1
upper = 2.0
[parameters.mu.prior]
mean = 0.9
std = 0.1
[posterior]
sampler = "importance"
max_steps = 100
"""
    return [*_files("fits/*/fit.toml"), whole]


def _rigs() -> list[bytes]:
    return [
        b'rolling_radius = 0.3\nwheel_inertia = 1.1\nrun_order = "random"\n'
        b"[noise]\nfx_relative = 0.01\nsigma_x = 0.001\n[vehicle]\nposition = 0.001\n"
    ]


@cache
def short_log() -> bytes:
    """20 s of a measured log, of the car of :func:`log_toml`."""
    path = next(_LOG.glob("free*/*10_02_28.csv.gz"))
    lines = gzip.decompress(path.read_bytes()).splitlines(keepends=True)
    return b"".join([lines[0], *lines[2000:2600]])


def _tables() -> list[bytes]:
    rows = b"".join(b"%g,%g,4000\n" % (s / 100, 3e3 * s / 20) for s in range(-9, 20))
    head = _files("fits/dart_rear_axle/free_driving.csv")[0].splitlines(keepends=True)
    return [b"kappa,Fx [N],Fz\n" + rows, b"".join(head[:200]), short_log()]


def _vbo() -> bytes:
    head = "File created on 07/12/2014 at 09:02:23\n\n[header]\nsatellites\ntime\nvelocity kmh\n"
    head += (
        "\n[channel units]\n%\nkN\nN\n\n[column names]\nsats time velocity kappa fx fz\n\n[data]\n"
    )
    rows = (f"012 0902{k:05.2f} 072.00 {k - 9} {np.tanh(k / 9):.4f} 4000\n" for k in range(20))
    return (head + "".join(rows)).encode()


def _infofile() -> bytes:
    text = (ROOT / "tests/data/tir/mfeval_julia/MagicFormula52_Parameters.tir").read_text()
    pairs = re.findall(r"(?m)^([A-Z]\w+)\s*=\s*([-+.\deE]+)", text)
    lines = (f"Lat.{key} = {value}" for key, value in pairs)
    return "\n".join(["#INFOFILE1.1", "FileIdent = CarMaker-Tire-MF 2", *lines]).encode()


def _aim() -> bytes:
    """An export of AiM's RaceStudio, with units and numbers of the channels."""
    head = b'"Format","AiM CSV File"\n"Comment","a, b"\n"Time","10:00 AM"\n\n'
    names = b'"Time","Kappa","Fx","Fz"\n"s","%","kN","N"\n"1","2","3","4"\n\n'
    rows = b"".join(b'"%g","%g","%g","4000"\n' % (k, k - 9, k / 9) for k in range(30))
    return head + names + rows


def _tydex() -> bytes:
    """A TYDEX file with constants of the tire."""
    lines = [
        b"**HEADER",
        b"RELEASE   Release                                 1.3",
        b"**CONSTANTS",
        b"OVALLDIA  Overall diameter              mm        634",
        b"FNOMIN    Nominal load                  kN        4",
        b"TYRESIZE  Nominal size                  -         205/60 R15",
        b"INCLANGL  Inclination angle             deg       2",
        b"**MEASURCHANNELS",
        b"LONGSLIP  Slip                          -         0.01",
        b"FX        Longitudinal force            N         1         0         0",
        b"FZW       Vertical force                N         1",
        b"**MEASURDATA",
        *(b"%-10g%-10g%-10g" % (k - 9, 100 * (k - 9), 4000) for k in range(30)),
        b"**END",
    ]
    return b"\n".join(lines) + b"\n"


def _sweep() -> dict[str, np.ndarray]:
    slip = np.linspace(-0.1, 0.2, 40)
    share = np.clip(slip * 5e4 / 6000, -1, 1)
    force = 4000 * (3 * share - 3 * share * np.abs(share) + share**3)
    noisy = force + np.random.default_rng(0).normal(0, 20, 40)
    return {"sigma_x": slip, "fx": noisy, "fz": np.full(40, 4000.0)}


def sweep() -> bytes:
    """A sweep at one load, of a brush with noise."""
    frame = _sweep()
    rows = [b"%.6g,%.6g,%g" % row for row in zip(*frame.values(), strict=True)]
    return b"\n".join([",".join(frame).encode(), *rows, b""])


@cache
def fit_json() -> bytes:
    from tirefit.data.read import read_frame
    from tirefit.fitting.estimate import fit

    frame = _sweep()
    return fit(read_frame(frame, convention="braking")).to_json().encode()


def _diagnosis() -> bytes:
    """The part of a diagnosis that an export reads, with a named effect."""
    values, id = {"cpa2": 5e4, "mu": 0.9}, "load_friction"
    size = {"value": -0.1, "std": 0.01, "unit": "-", "formula": "a power of the load"}
    content = {
        "schema": "tirefit.diagnosis/4", "data": {"name": "run", "sha256": "ab" * 32},
        "model": "brush", "simulator": None,
        "verdict": {
            "status": "named", "effects": [id], "probability": 0.9,
            "acts_like": [], "also_possible": [],
        },
        "candidates": [{"effects": [id], "parameters": {f"{id}: power": size}}],
        "base_parameters": values, "extended_parameters": values,
        "extension": {
            "mode": "x", "variants": {id: 0},
            "load": 4e3, "at": [4e3, 12.0], "slowest": 0.4, "brisk": 5.0,
            "cruise": 12.0, "rise": 0.04, "peak": 0.9, "used": 0.9,
            "pressure": [2e5, 4e4],
        },
    }  # fmt: skip
    return json.dumps(content, indent=1).encode()


def _read_diagnosis(path: Path):
    from tirefit.diagnosis.extended import extend, read_document
    from tirefit.models import MODELS

    return extend(MODELS["brush"], "brush", read_document(path), lambda tire: tire)


def _read_fit_toml(path: Path):
    from tirefit.fitting.problem.config import load_config

    return load_config(path)


def log_toml() -> bytes:
    """The vehicle of :func:`short_log`."""
    return (_LOG / "vehicle.toml").read_bytes()


def _read_vehicle(path: Path):
    """The vehicle, and a short log derived with it."""
    from tirefit.data.vehicle.derive import derive
    from tirefit.data.vehicle.vehicle import load_vehicle

    vehicle = load_vehicle(path)
    log = path.with_suffix(".csv")
    if not log.exists():
        log.write_bytes(short_log())
    return derive(log, vehicle)


def _read_log(path: Path):
    from tirefit.data.vehicle.derive import derive
    from tirefit.data.vehicle.vehicle import load_vehicle

    return derive(path, load_vehicle(_LOG / "vehicle.toml"))


def _read_rig(path: Path):
    from tirefit.diagnosis.rows.rig import load_rig

    return load_rig(path).force_noise("fx", np.full(3, 4000.0))


def _read_tir(path: Path):
    from tirefit.data.tir.tir import notes_on, read_tir
    from tirefit.models.mf import mf_tire

    tir = read_tir(path)
    return notes_on(tir), mf_tire(tir.version, tir.numbers)


def _read_table(path: Path):
    from tirefit.data.inspect import inspect
    from tirefit.data.read import read

    return inspect(read(path, convention="braking")).summary()


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


KINDS = {
    "fit.toml": Kind(".toml", _fit_tomls, _read_fit_toml),
    "vehicle.toml": Kind(".toml", lambda: _files("fits/*/vehicle.toml"), _read_vehicle),
    "rig.toml": Kind(".toml", _rigs, _read_rig),
    "tire.tir": Kind(".tir", lambda: _files("tests/data/tir/*/*.tir"), _read_tir),
    "data.csv": Kind(".csv", _tables, _read_table),
    "aim.csv": Kind(".csv", lambda: [_aim()], _read_table),
    "motec.csv": Kind(".csv", lambda: [_aim().replace(b"AiM", b"MoTeC")], _read_table),
    "log.vbo": Kind(".vbo", lambda: [_vbo()], _read_table),
    "infofile": Kind("", lambda: [_infofile()], _read_tir),
    "rig.tdx": Kind(".tdx", lambda: [_tydex()], _read_table),
    "rig.xls": Kind(".xls", lambda: _files("tests/data/xls/*.xls"), _read_table),
    "log.csv": Kind(".csv", lambda: [short_log()], _read_log),
    "fit.json": Kind(".json", lambda: [fit_json()], _read_fit),
    "run.json": Kind(".json", lambda: [_diagnosis()], _read_diagnosis),
}
