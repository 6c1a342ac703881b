# stillpoint: `make demo` shows what it does, `make test` checks it. Both are complete on a fresh machine
# with Python 3.11-3.13 and make: they create .venv, install what constraints.txt pins, and run.

PYTHON ?= python3
BIN := .venv/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
COMPILE := echo "compiling all estimators, once (about a minute)" && $(BIN)/python -m stillpoint.scripts.kernels
PYTEST := $(BIN)/python -m pytest
# The tests of a file share its fixtures: a file goes to one worker, in the order in which pytest found it.
PARALLEL := -n auto --dist loadfile --no-loadscope-reorder

# Without bytecode, every process that a test starts would compile the whole package again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test quick kernels wheel fuzz faults soak properties test-data test-wheel lint types format docs clean release-check

demo: .venv/.run
	$(BIN)/stillpoint demo -o demo

test: .venv/.dev
	$(PYTEST) -q $(PARALLEL)

# All but the tests marked slow, for every change: a minute on two idle cores once the estimators are compiled.
quick: .venv/.dev
	$(PYTEST) -q $(PARALLEL) -m 'not wheel and not slow'

# Damaged inputs of every kind: a recording or one line of error each, within 10 s and 512 MB. New ones at every run,
# unless FUZZ_SEED is given; it is printed, to repeat a run.
FUZZ_MINUTES ?= 10
fuzz: .venv/.dev
	$(BIN)/python tests/support/formats/fuzz.py --minutes $(FUZZ_MINUTES) $(if $(FUZZ_SEED),--seed $(FUZZ_SEED))

# Kill every command that writes, take away what it needs, and write docs/faults.md about it: on an idle machine under
# ten minutes. On a busy one give the kills more time (FAULTS_SECONDS=2600), and compile beforehand (make kernels).
FAULTS_SECONDS ?= 540
faults: .venv/.dev
	$(BIN)/python tests/support/faults/faults.py --longest-s $(FAULTS_SECONDS)

# An hour of `stillpoint stream` at 1 kHz: nothing lost, no growth, latency stated. For every night.
SOAK_MINUTES ?= 60
soak: .venv/.dev
	$(BIN)/python tests/support/faults/soak.py --minutes $(SOAK_MINUTES)

# The property tests with new examples at every run, twenty times as many; `make test` repeats the same ones.
properties: .venv/.dev
	STILLPOINT_HYPOTHESIS=draw $(PYTEST) -q $(PARALLEL) -m hypothesis

test-data: .venv/.dev
	$(PYTEST) -q -n auto -m real_data

# Compile all estimators and the reference again, for any processor of this platform, after a change of their sources:
# what is compiled beforehand does not make its first user wait. An installation by make does it too.
kernels: .venv/.run
	@$(COMPILE)

# A wheel that carries them: its first estimate does not compile, with the Python and numba it was built with.
wheel: kernels
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .

test-wheel: .venv/.dev
	$(PYTEST) -q -m wheel

lint: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(PYTEST) -q tests/scripts/test_layers.py

format: .venv/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The documentation site in site/. The API pages read the package as users get it, from a wheel that is unpacked.
docs: .venv/.docs
	rm -rf build/package
	$(INSTALL) --no-deps --target build/package .
	$(BIN)/python -m stillpoint.scripts.pages.site.commands_page
	$(BIN)/zensical build --strict --clean

# The types of the package as users get it: a wheel, unpacked, seen from outside the checkout.
types: .venv/.dev
	rm -rf build/types
	$(INSTALL) --no-deps --target build/types .
	MYPYPATH=build/types $(BIN)/mypy -p stillpoint

# What a release needs: a reproducible wheel, a bill of materials, licences, vulnerabilities, lowest and newest versions
# on every Python that is there. It says what it could not check. Half an hour and more.
release-check: .venv/.release
	$(BIN)/python -m stillpoint.scripts.release_check

.venv/.python:
	$(PYTHON) -c 'import sys; sys.exit(0 if (3, 11) <= sys.version_info < (3, 14) else "stillpoint needs Python 3.11-3.13, and $(PYTHON) is " + sys.version.split()[0] + "; run: make PYTHON=python3.12 $(MAKECMDGOALS)")'
	$(PYTHON) -m venv .venv
	touch $@

.venv/.run: .venv/.python pyproject.toml constraints.txt
	$(INSTALL) --editable '.[peers]'
	-@$(COMPILE)
	touch $@

.venv/.dev: .venv/.python pyproject.toml constraints.txt
	$(INSTALL) --editable '.[all,dev]'
	-@$(COMPILE)
	touch $@ .venv/.run

.venv/.release: .venv/.dev
	$(INSTALL) --editable '.[release]'
	touch $@

.venv/.docs: .venv/.dev
	$(INSTALL) --editable '.[docs]'
	touch $@

clean:
	rm -rf .venv build demo site *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
