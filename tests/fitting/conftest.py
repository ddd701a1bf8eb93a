"""Fits shared by several files: few models and one size, to compile little."""

import warnings

import pytest
from recipes import ESTIMATED, GIVEN, SAMPLING, STD, VAGUE_NOISE, curve

from tirefit.fitting.estimate import fit
from tirefit.fitting.uncertainty import posterior
from tirefit.fitting.uncertainty.posterior import sample


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


@pytest.fixture(scope="session")
def arviz(tmp_path_factory):
    """ArviZ, imported when the first test asks for it.

    Version 0.23, the last one for Python 3.11, warns once a day and stores the date in
    the user's cache folder, which fails where two workers do so at the same time: each
    worker imports it with a cache folder of its own.
    """
    cache = tmp_path_factory.mktemp("arviz")
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        patch.setattr("platformdirs.user_cache_dir", lambda *names: str(cache))
        warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
        import arviz
    return arviz
