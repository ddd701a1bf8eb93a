"""The density that fits/posterior_peers gives NumPyro is tirefit's own posterior."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fits.posterior_peers.cases import CASES, NOISE, synthetic
from fits.posterior_peers.page import summary
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.problem.likelihood import Rule
from tirefit.fitting.solve.inference import deviance


@pytest.mark.parametrize("name", ["brush-low", "magic-formula"])
def test_the_joint_density_agrees_with_numpyro(name):
    pytest.importorskip("numpyro")
    from fits.posterior_peers.variational import given, log_joint

    case = CASES[name]
    config = parse_config({"noise": {"fx_relative": NOISE, "loss": "squares"}})
    problem = build(synthetic(case, 3), case.model, config).problem
    problem = problem.with_rules({"fx": Rule(inflation=1.3)})
    data = given(problem, case.truth)
    generator = np.random.default_rng(0)
    about = problem.layout.unconstrained(case.truth)
    points = about + 0.05 * generator.standard_normal((4, len(about)))
    ours = [-float(deviance(problem, z)) / 2 for z in points]  # flat in the values
    natural = problem.layout.natural
    joint = jax.jit(jax.vmap(lambda z: log_joint(problem, data, natural(z))))
    theirs = np.asarray(joint(jnp.asarray(points)))
    assert np.ptp(ours) > 100
    # Up to the constants of the prior and of the normal distribution.
    np.testing.assert_allclose(np.diff(theirs), np.diff(ours), rtol=1e-9)
    width = np.log([p.spec.upper - p.spec.lower for p in problem.layout.free]).sum()
    normal = np.log(np.sqrt(2 * np.pi) * np.asarray(data.noise)).sum()
    assert theirs[0] == pytest.approx(ours[0] - width - normal)


def test_the_summary_counts_and_compares():
    def line(method, k, low, high):
        return {
            "method": method,
            "set": str(k),
            "parameter": "mu",
            "truth": "1.0",
            "low": str(low),
            "high": str(high),
            "said": "",
        }

    lines = [line("emcee", k, 0.5, 1.5) for k in range(2)]
    lines += [line("mean-field", 0, 0.9, 1.1), line("mean-field", 1, 1.1, 1.3)]
    lines += [line("mean-field", 2, 0.9, 9.0)]  # emcee did not run on this one
    emcee, field = summary(lines)
    assert emcee["coverage"] == 1 and emcee["width"] == 1
    assert field["coverage"] == pytest.approx(2 / 3)
    spread = np.sqrt(2.5 * 1.5 / (4**2 * 5))  # of Beta(2.5, 1.5)
    assert field["error"] == pytest.approx(spread) and emcee["error"] > 0
    assert field["width"] == pytest.approx(0.2)
