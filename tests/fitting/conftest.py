"""Fits shared by several files: few models and one size, to compile little."""

import pytest
from recipes import ESTIMATED, GIVEN, SAMPLING, STD, VAGUE_NOISE, curve

from tirefit.fitting import posterior
from tirefit.fitting.estimate import fit
from tirefit.fitting.posterior import sample


@pytest.fixture(scope="package")
def given():
    """A brush on 400 rows past full sliding, its force noise given."""
    return fit(curve(), config=GIVEN)


@pytest.fixture(scope="package")
def estimated():
    """The same with the noise estimated."""
    return fit(curve(), config=ESTIMATED)


@pytest.fixture(scope="package")
def sampled(given):
    return sample(given, **SAMPLING)


@pytest.fixture
def chunk(monkeypatch):
    """Steps between two checks of convergence, a fifth of the usual ones."""
    monkeypatch.setattr(posterior, "CHUNK", 20)
    return posterior.CHUNK


@pytest.fixture(scope="package")
def vague():
    """Slip to 20 % of full sliding, which does not determine the friction."""
    noise = VAGUE_NOISE * STD
    config = GIVEN | {"noise": {"fx": noise}}
    return fit(curve(reach=0.2, noise=noise), config=config)
