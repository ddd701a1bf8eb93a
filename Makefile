# Everything needs only Python 3.11+, make and git.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
RUNS   := $(VENV)/.runs
STAMP  := $(VENV)/.installed
LOWEST := .venv-lowest

.PHONY: install demo docs dist test test-long lowest statistics notebooks bench withheld withheld-full measured calibration friction-benchmark fuzz braking posterior-peers lint types clean

install: $(STAMP)

# Modules are compiled when they are first imported: compiling all of them takes half a minute.
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile

# tirefit and the libraries that it runs on: all that the demo needs.
$(RUNS): requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "tirefit needs Python 3.11 or later")'
	@echo "making an environment in $(VENV)"
	$(PYTHON) -m venv $(VENV)
	@echo "installing tirefit and the libraries that it runs on: about 20 seconds"
	$(PIP_INSTALL) --constraint requirements.lock -e .
	touch $@

$(STAMP): $(RUNS)
	@echo "installing the libraries of tests, manual and all files: about half a minute"
	$(PIP_INSTALL) -r requirements.lock
	touch $@

# The main job on measured data: a report in the terminal, figures in out/demo.
demo: $(RUNS)
	$(BIN)/tirefit fit fits/dart_rear_axle/free_driving.csv --config fits/dart_rear_axle/fit.toml --out out/demo
	@echo "figures: out/demo/fit.png out/demo/residuals.png out/demo/profile.png out/demo/corner.png out/demo/trace.png"

# One thread of linear algebra: beside another worker a second one only spins, and sums in
# another order move the last digits, which can choose another way of a search.
test test-long lowest statistics notebooks measured: export OPENBLAS_NUM_THREADS = 1

test: install
	$(BIN)/python -m pytest -q -n 2 tests

# The tests that run whole chains of work, which CI runs after the others: with programs
# optimised as usual.
test-long statistics: export XLA_FLAGS = --xla_backend_optimization_level=3
test-long: install
	$(BIN)/python -m pytest -q -n 2 -m long --override-ini addopts="" tests

# The tests with the oldest versions that pyproject.toml allows, in an environment of their
# own. Old versions warn about newer libraries beside them: these warnings are no errors here.
lowest: PIP = $(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check
lowest:
	$(PYTHON) -m venv $(LOWEST)
	$(PIP) uv hatchling
	$(LOWEST)/bin/uv pip compile --quiet --python $(LOWEST)/bin/python --resolution lowest-direct \
	  --all-extras --group test --output-file $(LOWEST)/lowest.txt pyproject.toml
	$(PIP) -r $(LOWEST)/lowest.txt
	$(PIP) --no-deps --no-build-isolation -e .
	$(LOWEST)/bin/python -m pytest -q -n 2 --override-ini filterwarnings="" tests

# The long statistical runs: 1,600 data sets for each model and noise level.
statistics: install
	$(BIN)/python -m pytest -q -n 2 -m statistics --override-ini addopts="" tests

# The manual as a site, in site/; a broken link or reference fails.
# This hides the notice of the end of MkDocs 1; CONTRIBUTING.md names its successor.
docs: export NO_MKDOCS_2_WARNING = 1
docs: install
	$(BIN)/python docs/manual.py
	$(BIN)/python -m mkdocs build

# The wheel and the source archive, in dist/, and whether an index would take them.
dist: install
	rm -rf dist
	$(BIN)/python -m build --no-isolation
	$(BIN)/twine check --strict dist/*

notebooks: install
	$(BIN)/python fits/run_notebooks.py

bench: install
	$(BIN)/python -m fits.bench

# Does diagnose name what it was not told? Sealed trials, scored once; see fits/withheld.
withheld: ASKED = --trials 130 --seed 1015 --rows 200,900
withheld-full: ASKED = --trials 1612 --seed 2010
withheld withheld-full: install
	$(BIN)/python -m fits.withheld.generate --sealed $(ASKED) --out out/$@
	$(BIN)/python -m fits.withheld.run out/$@ --jobs 2
	$(BIN)/python -m fits.withheld.forest --out out/forest.npz
	$(BIN)/python -m fits.withheld.baselines out/$@ --forest out/forest.npz --jobs 2
	$(BIN)/python -m fits.withheld.score out/$@ --bound 60

# The learned numbers of the diagnosis, from development trials; see fits/calibration.
calibration: TRIALS = 561-beside-160 562-unlisted-80 563-procedural-80 564-singles-120 565-pairs-60 566-null-80 567-foreign-24
calibration: install
	for one in $(TRIALS); do \
	  set -- $$(echo $$one | tr - " "); \
	  test -f out/$@/trials/$$1/labels.json || \
	  $(BIN)/python -m fits.withheld.generate --seed $$1 --set $$2 --trials $$3 --rows 200,900 --out out/$@/trials/$$1 \
	  || exit 1; done
	$(BIN)/python -m fits.calibration out/$@/trials/* --records out/$@/records --jobs 2

# What diagnose says of changes that somebody made, in measured data; see
# fits/measured_changes.
measured: install
	$(BIN)/python -m fits.measured_changes --jobs 2 --out out/$@

# Damaged inputs of every kind that is read, some by whole commands, over night; the
# suite tries 500.
fuzz: INPUTS = 100000
fuzz: SEED = 1
fuzz: install
	$(BIN)/python -m fits.fuzz --inputs $(INPUTS) --seed $(SEED) --out out/$@

# Friction estimators on the same logs; see fits/friction_benchmark.
friction-benchmark: install
	$(BIN)/python -m fits.friction_benchmark all --out out/$@ --into fits/friction_benchmark

# Stops under four controllers, 60 seeds; see fits/braking.
braking: install
	$(BIN)/python -m fits.braking --into fits/braking

# Posteriors beside those of NumPyro and lmfit (dependency group `peers`); see
# fits/posterior_peers.
posterior-peers: install
	$(BIN)/python -m fits.posterior_peers --out out/$@ --into fits/posterior_peers

lint: install
	$(BIN)/ruff check . && $(BIN)/ruff format --check .

types: install
	$(BIN)/mypy

clean:
	rm -rf $(VENV) $(LOWEST) out build dist site
