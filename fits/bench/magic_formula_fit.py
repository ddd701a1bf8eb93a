"""A whole Magic Formula against ``scipy.optimize.least_squares``, from the same starts.

The residuals are the same, compiled, with the priors as further rows. SciPy takes
their slopes by differences, as an engineer's script does, or takes ours.
"""

import resource
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import numpy as np

HERE = Path(__file__).parent


def rig_test(rows: int):
    """Columns of F_x and F_y of approximately this many rows of MF 6.1."""
    sys.path.insert(0, str(HERE.parents[1] / "tests" / "fitting"))
    from rig import MF61, measured

    from tirefit.data.read import read_frame

    # 30 pure and 20 combined sweeps a load, fewer and longer ones for fewer rows.
    table = measured(MF61, n=max(rows // 150, 10), loads=5)
    return read_frame({k: v for k, v in table.items() if k != "mz"})


def problems(rows: int):
    """(name, problem, starts): pure F_y from the first values of its stage; all
    coefficients of F_x and F_y from near the end of the stages."""
    from tirefit.fitting.mf.bins import rig_settings
    from tirefit.fitting.mf.fit import nominal_of, problem_from
    from tirefit.fitting.mf.parts import coefficients_of
    from tirefit.fitting.mf.rows import groups_of, rows_of_forces
    from tirefit.fitting.mf.stages import Search, first_values, problem_of, search
    from tirefit.fitting.problem.config import FitConfig

    config = FitConfig()
    parts = rows_of_forces(rig_test(rows), ("fx", "fy"))
    tire, _ = nominal_of("mf61", parts, config)
    empty, _ = problem_from(tire, config)
    parts = {force: replace(of, setting=rig_settings(of)[1]) for force, of in parts.items()}
    groups = groups_of(parts)
    lateral = [n for n, part in coefficients_of("6.1").items() if part == "fy"]
    zero = np.zeros(len(empty.names))
    starts = [empty.started(zero, values) for values in first_values(groups["fy"][0])]
    work = Search(empty, groups, starts[0], np.diag(empty.free.astype(float)))
    pure = problem_of(work, groups["fy"][:1], lateral)
    # SciPy has no limits of the curvature factors, so that ours has none here either.
    yield (
        "F_y",
        replace(pure, blocks=tuple(block for block in pure.blocks if not block.is_limit)),
        starts,
    )
    done = search(empty, groups)
    each = [problem_of(done, done.groups[force], done.moved) for force in parts]
    blocks = [one for problem in each for one in problem.blocks if not one.is_limit]
    both = replace(each[0], blocks=tuple(blocks))
    generator = np.random.default_rng(0)
    beside = 0.05 * both.free * generator.standard_normal(len(done.u))
    yield "F_x, F_y", both, [done.u + beside]


def values_alone(problem):
    """u -> residuals of the rows, by a program without slopes."""
    from tirefit.models import TireInputs
    from tirefit.params import with_values

    @partial(jax.jit, static_argnames="name")
    def force(values, inputs, name):
        tire = with_values(problem.tire, values)
        return jax.vmap(lambda sample: getattr(tire(sample), name))(inputs)

    of_force: dict[str, list] = {}
    for block in problem.blocks:
        of_force.setdefault(block.force, []).append(
            np.stack([*block.inputs, block.observed, block.weight])
        )
    rows = {name: np.concatenate(parts, axis=1) for name, parts in of_force.items()}

    def residuals(u):
        values, each = problem.values(u), []
        for name, columns in rows.items():
            *inputs, observed, weight = columns
            value = np.asarray(force(values, TireInputs(*inputs), name))
            each.append(((value - observed) * weight)[weight > 0])
        return np.concatenate(each)

    return residuals


def compared(name: str, problem, start) -> None:
    """Prints time and sum of squares of the three from one start."""
    from scipy.optimize import least_squares

    from tirefit.fitting.mf.solve import minimise, row_gradients

    free, alone = np.flatnonzero(problem.free), values_alone(problem)

    def whole(x):
        u = start.copy()
        u[free] = x
        return u

    def residual(x):
        return np.concatenate([alone(whole(x)), x])

    def slopes(x):
        slope = row_gradients(problem, whole(x))[1][:, free]
        return np.concatenate([slope, np.eye(len(free))])

    def timed(function, *arguments):
        # Of the processor: others may have it while we wait.
        began = time.process_time()
        ended = function(*arguments)
        return time.process_time() - began, ended

    residual(start[free]), slopes(start[free])  # compiled before
    fixed = float(start @ start - start[free] @ start[free])
    ours, end = timed(minimise, problem, start)
    rows = sum(int(np.count_nonzero(block.weight)) for block in problem.blocks)
    print(f"{name}: {rows} values, {len(free)} coefficients")
    print(f"  ours            {ours:7.2f} s  {end.cost - fixed:14.6f}", flush=True)
    for what, jacobian in (("differences", "2-point"), ("our slopes", slopes)):
        took, peer = timed(least_squares, residual, start[free], jacobian)
        print(
            f"  SciPy, {what:11s}{took:7.2f} s  {2 * peer.cost:14.6f}"
            f"  {took / ours:.1f} x our time",
            flush=True,
        )


def whole_magic_formula(rows: int = 30_000) -> None:
    """One whole fit of F_x and F_y, and its searches against SciPy's."""
    from tirefit.fitting.mf.fit import fit_magic_formula

    data = rig_test(rows)
    fit_magic_formula(data, "mf61")
    began, used = time.perf_counter(), time.process_time()
    fit = fit_magic_formula(data, "mf61")
    wall, processor = time.perf_counter() - began, time.process_time() - used
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    moved = sum(c.origin in ("fitted", "prior") for c in fit.coefficients.values())
    print(
        f"whole fit, {data.n} rows, {moved} coefficients, warm: {wall:.1f} s,"
        f" {processor:.1f} s of processor, {peak:.2f} GiB",
        flush=True,
    )
    for name, problem, starts in problems(rows):
        for start in starts:
            compared(name, problem, start)
