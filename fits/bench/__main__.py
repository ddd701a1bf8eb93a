"""Speed against the peers, as ratios measured in the same run: ``make bench``.

``python -m fits.bench`` runs all, and says how long each took; with the names of
entries (``brush_with_gradient posterior``), those.

Every comparison alternates the two sides and quotes medians, so that a drifting
machine hits both. Nothing here passes or fails.
"""

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np

from fits.bench.magic_formula_fit import whole_magic_formula

HERE = Path(__file__).parent
ROWS = 400
FZ, NOISE = 4000.0, 40.0
MILLION = 1_000_000


def brush(slip, cpa2, mu, fz=FZ):
    """The brush model as one writes it in NumPy."""
    rho = np.minimum(cpa2 * slip / (mu * fz), 1.5)
    u = 4 / 3 * rho
    return mu * fz * u**2 * (3 - u) / 4 + cpa2 * slip * (2 - u) ** 2 / 2


def measured(fits: int, seed: int = 0):
    generator = np.random.default_rng(seed)
    slip = np.sort(generator.uniform(0, 0.2, (fits, ROWS)), axis=1)
    noise = NOISE * generator.standard_normal((fits, ROWS))
    return slip, brush(slip, 5e4, 1.0) + noise


def seconds(function, *arguments) -> float:
    start = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - start


def say(name: str, ours: float, peer: float, unit: str, better: str) -> None:
    ratio = peer / ours if better == "higher" else ours / peer
    text = f"{ours / peer:.2f} x" if better == "higher" else f"{ratio:.3f} x the time"
    print(f"{name:46s} {ours:10.4g} {peer:10.4g} {unit:14s} {text}", flush=True)


def cold_fit(pairs: int = 5) -> None:
    """Whole processes: one fit with its figures, processor time, caches warm."""
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "data.csv"
        slip, force = measured(1)
        table = np.c_[slip[0], force[0], np.full(ROWS, FZ)]
        np.savetxt(file, table, delimiter=",", header="sigma_x,fx,fz", comments="")
        out = Path(directory) / "out"
        ours = [sys.executable, "-m", "tirefit", "fit", str(file), "--no-posterior"]
        ours += ["--out", str(out)]
        peer = [sys.executable, str(HERE / "scipy_peer.py"), str(file), str(out)]
        start(ours), start(peer)
        times = [(start(ours), start(peer)) for _ in range(pairs)]
    say("fit, cold process, with figures", *medians(times), "s", "lower")


def start(command: list[str]) -> float:
    """Processor time [s] of a process as a user starts it: with bytecode of what it
    imports, and one thread of OpenBLAS."""
    usual = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    usual.pop("PYTHONDONTWRITEBYTECODE", None)
    return process(command, usual).processor


def medians(times) -> tuple[float, float]:
    return median(t[0] for t in times), median(t[1] for t in times)


def help_text(runs: int = 5) -> None:
    command = [sys.executable, "-m", "tirefit", "--help"]
    bare = [sys.executable, "-c", "pass"]
    start(command)
    times = [(start(command), start(bare)) for _ in range(runs)]
    say("tirefit --help (peer: bare Python)", *medians(times), "s", "lower")


def batch(fits: int = 10_000, peers: int = 500) -> None:
    """Least squares of many data sets of 400 points, time per fit."""
    from scipy.optimize import curve_fit

    from tirefit.fitting.solve.batch import fit_many

    slip, force = measured(fits)

    def ours():
        fit_many({"sigma_x": slip, "fx": force, "fz": FZ}, "brush")

    def peer():
        for i in range(peers):
            curve_fit(brush, slip[i], force[i], p0=[4e4, 0.9])

    ours()
    times = [(seconds(ours) / fits, seconds(peer) / peers) for _ in range(3)]
    mine, other = medians(times)
    say(f"{fits} fits of {ROWS} points, per fit", mine * 1e6, other * 1e6, "us", "lower")
    share_of_limit(mine)


def share_of_limit(per_fit: float) -> None:
    """The arithmetic of one fit compared with the measured double-precision peak.

    One evaluation with two tangents is about 60 operations a point, the normal
    equations 12 more; a fit takes about 7 evaluations.
    """
    peak = flops_peak()
    operations = 7 * ROWS * 72
    share = operations / per_fit / peak
    limit = f"{peak / 1e9:.0f} Gflop/s (matrix product on all cores)"
    print(f"  {operations / 1e3:.0f} k operations a fit, {share:.1%} of {limit}")


def flops_peak(precision=float) -> float:
    """Operations a second of a large matrix product."""
    a = np.random.default_rng(0).random((1500, 1500)).astype(precision)
    return 2 * 1500**3 / min(seconds(np.matmul, a, a) for _ in range(5))


def bandwidth() -> float:
    """Bytes a second that a large copy reads and writes."""
    source = np.ones(1 << 25)
    target = np.zeros_like(source)
    best = min(seconds(np.copyto, target, source) for _ in range(5))
    return 2 * source.nbytes / best


TRANSCENDENTAL = 20
"""Operations that a sine, arctangent or root stands for."""


def evaluations(name: str, compiled, arrays, peer, cost=None, pairs: int = 7) -> None:
    """A million evaluations: compiled program and NumPy, whose results agree.

    ``cost`` is that of a program without a loop, of which the compiler counts one pass.

    Then the share of what the machine allows: of the bandwidth by the bytes of inputs
    and results, each touched once; of the arithmetic by what the compiler counts.
    """
    import jax

    def ours():
        return jax.block_until_ready(compiled(*arrays))

    found, expected = ours(), peer()
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-6)
    mine, other = medians([(seconds(ours), seconds(peer)) for _ in range(pairs)])
    say(name, mine * 1e3, other * 1e3, "ms", "lower")
    moved = sum(part.nbytes for part in (*arrays, *found)) / mine
    cost = cost or compiled.cost_analysis()
    count = cost["flops"] + TRANSCENDENTAL * cost.get("transcendentals", 0)
    limit, peak = bandwidth(), flops_peak()
    print(
        f"  {moved / limit:.1%} of the bandwidth ({limit / 1e9:.1f} GB/s, a copy),"
        f" {count / mine / peak:.1%} of the arithmetic ({peak / 1e9:.0f} Gflop/s,"
        f" matrix product; {count / MILLION:.0f} operations each)"
    )


def magic_formula() -> None:
    """Combined slip of a MF 6.1 tire: F_x, F_y and M_z."""
    import jax

    from fits.bench.magic_formula_peer import Coefficients
    from fits.bench.magic_formula_peer import magic_formula as in_numpy
    from tirefit.data.tir.tir import read_tir
    from tirefit.fitting.tir import tire_of
    from tirefit.models import TireInputs

    folder = HERE.parents[1] / "tests/data" / "tir" / "mfeval_julia"
    tir = read_tir(folder / "MagicFormula61_Parameters.tir")
    tire, coefficients = tire_of(tir), Coefficients(tir.numbers)
    generator = np.random.default_rng(0)
    limits = ((-0.3, 0.3), (-0.3, 0.3), (2e3, 1e4), (-0.05, 0.05), (2e5, 2.6e5))
    kappa, alpha, fz, gamma, pressure = (generator.uniform(*ends, MILLION) for ends in limits)

    def one(sigma_x, alpha, fz, gamma, pressure):
        found = tire(TireInputs(sigma_x, alpha, fz, 0.0, gamma, pressure))
        return -found.fx, -found.fy, -found.mz  # as the peer, in ISO-W axes

    arrays = [jax.numpy.asarray(part) for part in (-kappa / (1 + kappa), alpha, fz)]
    arrays += [jax.numpy.asarray(part) for part in (gamma, pressure)]
    compiled = jax.jit(jax.vmap(one)).lower(*arrays).compile()

    def peer():
        return in_numpy(coefficients, kappa, alpha, gamma, fz, pressure)

    evaluations("10^6 MF 6.1, combined slip", compiled, arrays, peer)


def brush_with_gradient(block: int = 8_000) -> None:
    """Force of the brush and its derivatives by c_p a^2 and mu, in blocks of rows.

    Whole, the derivatives keep six intermediates of every row, 48 MB. Nearly all of
    the time (26 of 31 ms) the kernel then spends on handing out those pages anew at
    each call; a block's stay in the cache.
    """
    import jax

    from tirefit.models import Brush, TireInputs

    generator = np.random.default_rng(0)
    slip, fz = generator.uniform(0, 0.2, MILLION), generator.uniform(2e3, 6e3, MILLION)

    def one(slip, fz):
        def force(values):
            return Brush(cpa2=values[0], mu=values[1])(TireInputs(slip, 0.0, fz)).fx

        values = jax.numpy.array([5e4, 1.0])
        slope = jax.jacfwd(force)(values)
        return force(values), slope[0], slope[1]

    def in_blocks(*rows):
        blocks = tuple(row.reshape(-1, block) for row in rows)
        found = jax.lax.map(lambda part: jax.vmap(one)(*part), blocks)
        return tuple(part.reshape(-1) for part in found)

    arrays = [jax.numpy.asarray(slip), jax.numpy.asarray(fz)]
    compiled = jax.jit(in_blocks).lower(*arrays).compile()
    whole = jax.jit(jax.vmap(one)).lower(*arrays).compile()

    def peer(cpa2=5e4, mu=1.0):
        """S(12) and its derivatives by hand."""
        x = np.minimum(cpa2 * slip / (1.5 * mu * fz), 1.0)
        force = mu * fz * x * (3 - x * (3 - x))
        return force, 2 * slip * (1 - x) ** 2, fz * x**2 * (3 - 2 * x)

    cost = whole.cost_analysis()
    evaluations("10^6 brush with gradients", compiled, arrays, peer, cost)


def posterior() -> None:
    """Smallest effective samples per second over the parameters, by sampler."""
    import emcee

    from tirefit.data.read import read_frame
    from tirefit.fitting.estimate import fit
    from tirefit.fitting.uncertainty.posterior import sample

    slip, force = measured(1)
    frame = {"sigma_x": slip[0], "fx": force[0], "fz": np.full(ROWS, FZ)}
    result = fit(read_frame(frame), "brush", config={"noise": {"fx": NOISE}})

    def log_density(theta):
        cpa2, mu = theta
        if not (0 < mu < 5 and cpa2 > 0):
            return -np.inf
        return -0.5 * np.sum(((force[0] - brush(slip[0], cpa2, mu)) / NOISE) ** 2)

    def peer(steps=1500):
        start = time.perf_counter()
        generator = np.random.default_rng(0)
        walkers = np.array([5e4, 1.0]) * (1 + 0.002 * generator.normal(size=(32, 2)))
        sampler = emcee.EnsembleSampler(32, 2, log_density)
        sampler.run_mcmc(walkers, steps)
        chain = sampler.get_chain(discard=150)
        tau = emcee.autocorr.integrated_time(chain, quiet=True)
        return chain.shape[0] * 32 / tau.max() / (time.perf_counter() - start)

    def ours(name):
        start = time.perf_counter()
        drawn = sample(result, sampler=name, effective_samples=20_000).posterior
        assert drawn.sampler == name, drawn.note
        ess = min(drawn.ess.values())
        return ess / (time.perf_counter() - start)

    for name in ("importance", "emcee"):
        ours(name)
        pairs = [(ours(name), peer()) for _ in range(3)]
        label = f"posterior, {name} (peer: emcee on NumPy)"
        say(label, *medians(pairs), "ESS/s", "higher")


def trials_of(directory: str, asked: str) -> list[Path]:
    """Files of withheld trials written for this, with one rig.toml."""
    from fits.withheld.generate import main as generate

    with contextlib.redirect_stdout(None):
        generate([*asked.split(), "--out", directory])
    return sorted(Path(directory).glob("trials/*/*.csv"))


def by_plain_bic(files: list[Path]) -> None:
    """The peer of a diagnosis: single effects, by BIC over refits with SciPy."""
    import tomllib

    from fits.withheld.baselines import by_bic, read_trial

    for file in files:
        rig = tomllib.loads((file.parent / "rig.toml").read_text())
        by_bic(*read_trial(file, rig))


def processor_seconds(function, *arguments) -> float:
    """Of all threads; other processes affect it less than wall time."""
    start = time.process_time()
    function(*arguments)
    return time.process_time() - start


def diagnosis(cases: int = 8) -> None:
    """A case of 900 rows, all effects with pairs and triples, warm."""
    import tirefit

    with tempfile.TemporaryDirectory() as directory:
        asked = f"--seed 1 --trials {cases} --set singles --design G --noise rig"
        files = trials_of(directory, f"{asked} --rows 900")

        def ours():
            for file in files:
                rig = tirefit.load_rig(file.parent / "rig.toml")
                tirefit.diagnose(tirefit.read(file), rig=rig)

        ours()
        times = [
            (processor_seconds(ours) / cases, processor_seconds(by_plain_bic, files) / cases)
            for _ in range(3)
        ]
    name = "diagnose, 900 rows, processor (BIC, singles)"
    say(name, *medians(times), "s", "lower")


class Process(NamedTuple):
    """Wall and processor time [s] of a process and its children, and the most memory
    that one of them held [GiB]."""

    wall: float
    processor: float
    peak: float


def diagnose_process(files, out: Path, *more: str) -> Process:
    """One cold process over files, without any cached compilation."""
    line = [sys.executable, "-m", "tirefit", "diagnose", *map(str, files)]
    line += ["--rig", str(files[0].parent / "rig.toml"), "--out", str(out), *more]
    with tempfile.TemporaryDirectory() as cache:
        apart = os.environ | {"XDG_CACHE_HOME": cache}
        apart.pop("JAX_COMPILATION_CACHE_DIR", None)
        return process(line, apart)


def process(line: list[str], environment) -> Process:
    """Runs one process and returns what it used."""
    begun = time.perf_counter()
    running = subprocess.Popen(line, stdout=subprocess.DEVNULL, env=environment)
    _, status, used = os.wait4(running.pid, 0)
    wall = time.perf_counter() - begun
    running.returncode = os.waitstatus_to_exitcode(status)
    if running.returncode:
        raise subprocess.CalledProcessError(running.returncode, line)
    return Process(wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 2**20)


def diagnosis_of_many(cases: int = 120) -> None:
    """Whole process, cold: files of 1,000 rows, all effects with pairs and triples."""
    with tempfile.TemporaryDirectory() as directory:
        asked = f"--seed 1 --trials {cases} --set singles --design E,G --noise rig"
        files = trials_of(directory, f"{asked} --rows 1000")
        alone = diagnose_process(files, Path(directory) / "one")
        peer = seconds(by_plain_bic, files)
        both = diagnose_process(files, Path(directory) / "two", "--jobs", "2")
    name = f"diagnose, {cases} x 1,000 rows, cold (BIC, singles)"
    say(name, alone.wall, peer, "s", "lower")
    print(
        f"  {alone.processor:.0f} s of processor, {alone.peak:.1f} GiB;"
        f" with --jobs 2 {both.wall:.0f} s, {both.processor:.0f} s of processor"
    )


def fleet(files: int = 1000) -> None:
    """Whole processes: a fit of each file with its figures, by the loop, by one worker
    and by two of a cluster on this machine; caches warm. See README.md beside this."""
    slip, force = measured(files)
    with tempfile.TemporaryDirectory() as directory:
        names = []
        for k in range(files):
            names.append(Path(directory) / f"run{k:04d}.csv")
            table = np.c_[slip[k], force[k], np.full(ROWS, FZ)]
            np.savetxt(names[-1], table, delimiter=",", header="sigma_x,fx,fz", comments="")
        begin = [sys.executable, "-m", "tirefit", "fit", "--no-posterior"]
        begin += ["--convention", "braking"]

        def run(number: int, *how: str) -> Process:
            out = Path(directory) / "out"
            line = [*begin, *map(str, names[:number]), "--out", str(out), *how]
            return process(line, os.environ)

        run(min(2, files))  # compiles
        loop, one, two = (run(files, *how) for how in ((), ("--jobs", "1"), ("--jobs", "2")))
    print(
        f"fit, {files} files: loop {loop.wall:.0f} s ({loop.processor:.0f} s of"
        f" processor), one worker {one.wall:.0f} s ({one.processor:.0f} s), two"
        f" {two.wall:.0f} s ({two.processor:.0f} s): overhead of one"
        f" {one.wall / loop.wall - 1:+.1%} ({one.processor / loop.processor - 1:+.1%}),"
        f" efficiency of two {loop.wall / two.wall / 2:.2f}"
        f" ({loop.processor / two.processor:.2f} by processor time), load"
        f" {os.getloadavg()[0]:.1f}",
        flush=True,
    )


def diagnosis_of_a_log(rows: int = 100_000) -> None:
    """Whole process, cold: braking pulses at 100 Hz, friction that drifts by 10 %."""
    from fits.withheld.designs import DESIGNS, make_world

    generator = np.random.default_rng(0)
    world = make_world(DESIGNS["V"], rows, 5e4, 0.9, generator)
    mu = 0.9 * (1 + 0.1 * (np.arange(rows) / rows - 0.5))
    noise = 0.01 * world.fz * generator.standard_normal(rows)
    force = brush(world.slip, 5e4, mu, world.fz) + noise
    slip = world.slip + 0.001 * generator.standard_normal(rows)
    with tempfile.TemporaryDirectory() as directory:
        file, rig = Path(directory) / "log.csv", Path(directory) / "rig.toml"
        np.savetxt(
            file,
            np.c_[world.time, slip, force, world.fz, world.v],
            delimiter=",",
            header="time,sigma_x,fx,fz,v",
            comments="",
            fmt="%.8g",
        )
        rig.write_text("[noise]\nsigma_x = 0.001\nfx_relative = 0.01\n")
        found = diagnose_process([file], Path(directory) / "out")
    print(
        f"diagnose, {rows} rows, cold: {found.wall:.0f} s, {found.processor:.0f} s of"
        f" processor, {found.peak:.1f} GiB",
        flush=True,
    )


def online(rows: int = 200_000) -> None:
    """Recursive least squares over a log, one core, and one streamed step; the peer is
    the same regression with forgetting as a loop in NumPy, without guard or flags."""
    from tirefit.online.methods import estimator_of
    from tirefit.online.run import Stream, run

    generator = np.random.default_rng(0)
    clock = np.arange(rows) / 100
    slip = 0.04 * (clock % 2) / 2
    force = brush(slip, 2.5e5, 0.9, 27e3) + 800 * generator.standard_normal(rows)
    log = {"time": clock, "sigma_x": slip, "fx": force, "fz": np.full(rows, 27e3)}
    estimator = estimator_of("rls", 27e3)
    few = rows // 20

    def peer():
        theta, p = np.array([0.8, 0.8]), np.diag([80.0, 320.0])
        for k in range(few):
            u0 = 5e5 * slip[k] / 27e3
            u = np.array([u0, -u0 * u0 / 2.94])
            y = force[k] / 27e3 - theta[1] ** 2 / theta[0] * u0**3 / 25.93
            gain = p @ u / (0.999 + u @ p @ u)
            theta = theta + gain * (y - u @ theta)
            p = (p - np.outer(gain, u @ p)) / 0.999

    run(estimator, log)
    before = time.process_time()
    run(estimator, log)
    spent = time.process_time() - before
    pairs = [(seconds(run, estimator, log), seconds(peer)) for _ in range(5)]
    times = [(rows / ours, few / other) for ours, other in pairs]
    say("rls in a scan (peer: loop in NumPy)", *medians(times), "samples/s", "higher")
    print(f"  {rows / spent:.3g} samples a second of processor time")
    stream = Stream(estimator)
    sample = {name: column[5] for name, column in log.items()}
    stream.push(sample)
    ours = median(seconds(stream.push, sample) for _ in range(2000))
    other = median(pair[1] for pair in pairs) / few
    say("rls, one streamed step", ours * 1e6, other * 1e6, "us", "lower")


def braking_stops(stops: int = 1000, peers: int = 2) -> None:
    """Stops of a quarter car under ABS: ten tires, ten roads, ten seeds in one vmapped
    run; the peer is solve_ivp from sample to sample, with the rules in plain Python."""
    import jax
    import jax.numpy as jnp

    from tests.sim.brake_peer import PlainABS, QuarterCar, Valves, stop
    from tirefit.models import MODELS
    from tirefit.online.braking.abs import ConventionalABS
    from tirefit.params import parameter_values, with_values
    from tirefit.sim.brake import draw_noise
    from tirefit.sim.brake_request import Request, arrays, plant_of
    from tirefit.sim.manoeuvre import many_stops

    speed, rate, samples, edge = 8.0, 200.0, 900, round(stops ** (1 / 3))
    tires = [(4e4 * (1 + 0.05 * k), 0.5 + 0.03 * k) for k in range(edge)]
    roads = np.linspace(0.3, 0.9, edge)

    def asked(cpa2, m, mu):
        tire = with_values(MODELS["brush-m"], {"cpa2": cpa2, "m": m})
        return Request(tire, "brush-m", road=f"mu={mu:.4f}", speed=speed, vehicle="quarter")

    plants = [plant_of(asked(*tire, mu)) for tire in tires for mu in roads]
    kept = [plant for plant in plants for _ in range(edge)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *kept)
    request, controller = asked(*tires[0], roads[0]), arrays(ConventionalABS())
    keys = jax.vmap(jax.random.key)(jnp.arange(len(kept)))
    load = float(plants[0].vehicle.fz[0])
    how = (controller, arrays(request.sensors), jnp.asarray(speed), keys, samples, 2)

    def ours():
        jax.block_until_ready(many_stops(stacked, *how))

    def peer():
        """The same stops, of the tires and roads in the middle and at the end."""
        for k in range(peers):
            (cpa2, m), mu = tires[edge // 2 + k], float(roads[edge // 2 + k])
            drawn = draw_noise(keys[k], request.sensors, samples, 1, rate)
            noise = {
                name: np.asarray(part).reshape(len(part), -1)[:, 0]
                for name, part in drawn._asdict().items()
            }
            hydraulics = request.hydraulics._asdict()
            hydraulics.pop("delay")
            stop(
                QuarterCar(load, 0.3, 1.2, 1.35e-4, cpa2, m, mu),
                Valves(**hydraulics),
                PlainABS(parameter_values(ConventionalABS()), 1 / rate, speed),
                request.sensors._asdict(),
                noise,
                speed,
                rate,
                samples,
                2,
            )

    ours()
    pairs = [(seconds(ours) / len(kept), seconds(peer) / peers) for _ in range(3)]
    mine, other = medians(pairs)
    name = f"{len(kept)} stops in one run, per stop (solve_ivp)"
    say(name, mine * 1e3, other * 1e3, "ms", "lower")


ENTRIES = (
    help_text, cold_fit, batch, magic_formula, brush_with_gradient, posterior, online,
    braking_stops, whole_magic_formula,
)  # fmt: skip

OF_DIAGNOSIS = (diagnosis, diagnosis_of_many, diagnosis_of_a_log, fleet)
"""In a process of their own, with one thread of OpenBLAS, as the command line has: the
other one spins while it waits, and its processor time would be counted. The peak that
other entries are measured against is that of all cores."""


def main(asked: list[str]) -> None:
    """Runs every entry, or the named ones."""
    import jax

    known = {entry.__name__: entry for entry in (*ENTRIES, *OF_DIAGNOSIS)}
    if unknown := [name for name in asked if name not in known]:
        raise SystemExit(f"no entry {', '.join(unknown)}; there are {', '.join(known)}")
    jax.config.update("jax_enable_x64", True)
    print(f"{'':46s} {'tirefit':>10s} {'peer':>10s}", flush=True)
    for name in asked or known:
        if known[name] in OF_DIAGNOSIS and "OPENBLAS_NUM_THREADS" not in os.environ:
            line = [sys.executable, "-m", "fits.bench", name]
            alone = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
            subprocess.run(line, check=True, env=alone)
        else:
            print(f"  ({name}: {seconds(known[name]):.0f} s)", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
