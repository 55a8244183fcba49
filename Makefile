PYTHON ?= python3
BIN := .venv/bin
RUN := .venv/.run-installed
STAMP := .venv/.installed
DOCS := .venv/.docs-installed
CORE := .venv/.core-built
LEVELS := .venv/.levels-built
BUILD := src/stickslip/_core/build.py
define COMPILER
@$(BIN)/python $(BUILD) --find >/dev/null 2>&1 || { echo "no C++ compiler works here: installing one from the package index (100 MB)"; \
	  $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-compiler.lock || \
	  $(BIN)/python $(BUILD) --find; }
endef

# uv installs five times faster than pip; pip does where it is set up with an index of its own, and where uv fails
UV = ! $(BIN)/python -m pip config list 2>/dev/null | grep -q '\.index-url' && \
  $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-installer.lock 2>/dev/null && \
  $(BIN)/python -m uv pip install --quiet --python $(BIN)/python
PIP = $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
define INSTALL
{ $(UV) $(1) 2>/dev/null || $(PIP) $(1); }
endef

unexport PYTHONDONTWRITEBYTECODE  # the many processes that tests start would compile the package anew

.PHONY: demo test durations coverage mutants quick slow lint bench numbers docs release platforms wheel lock clean

demo: $(CORE)  ## install, run a quick version of the disk array, print how much is reproduced and the paths of the figures
	$(BIN)/stickslip reproduce disk-array --quick --overwrite --out results/disk-array-quick

test: $(STAMP)  ## run the tests, about five minutes on two cores
	$(BIN)/python -m pytest -n 2 --dist loadfile

durations: $(STAMP)  ## run the tests, store their processor time in tests/durations.json, and print the slowest
	$(BIN)/python -m pytest -n 2 --dist loadfile --store-durations

coverage: $(STAMP)  ## run the tests and print the share of Python lines that they execute; fails below a floor
	$(BIN)/python -m pytest -n 2 --dist loadfile --cov --cov-report= --cov-fail-under=90

quick: $(STAMP)  ## run a fast subset of the tests during development: no slow fixtures, no other processes
	$(BIN)/python -m pytest -n 2 --dist loadfile --quick

test-%: $(STAMP)  ## run the tests of one subpackage, for example test-solve
	@files=$$($(BIN)/python -m tests.rooms $*) && $(BIN)/python -m pytest -n 2 --dist loadfile $$files

mutants: $(STAMP)  ## put stored faults into copies of the tree, and print the share that tests notice; hours (MISSING=1: only those not noticed so far)
	$(BIN)/python -m tests.mutants $(if $(MISSING),--missing)

slow: $(DOCS)  ## run the slow tests, hours, and store their durations; with SHARD=3/8 the third of eight parts
	$(BIN)/python -m pytest -n 2 --dist loadfile -m slow --store-durations $(if $(SHARD),--shard $(SHARD))

lint: $(STAMP)  ## check style, import layers and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy
	$(BIN)/python -m tests.structure.prose

bench: $(STAMP)  ## measure speed relative to other codes and reference kernels; `python -m benchmarks` lists all benchmarks
	$(BIN)/python -m benchmarks all

numbers: $(STAMP)  ## list the numbers in README and docs that are older than the code; RERUN=10m measures as many again
	$(BIN)/python -m benchmarks.records $(if $(RERUN),--rerun $(RERUN))

docs: $(DOCS)  ## build the documentation into docs/_build/html and run the tutorials; warnings are errors
	$(BIN)/python -m sphinx -q -W --keep-going docs docs/_build/html
	@echo "docs/_build/html/index.html"

release: $(STAMP)  ## build the wheel and the sdist into dist/ and check them; uploads nothing
	$(BIN)/python release/release.py $(if $(REPOSITORY),--repository $(REPOSITORY))

platforms: $(STAMP)  ## compile the core for Linux, macOS and Windows, and compare the functions in the libraries; ten minutes
	$(BIN)/python release/platforms.py

wheel: $(RUN)  ## build the wheel for this platform into dist/, and load its compiled core in a new environment
	$(COMPILER)
	rm -rf dist/*.whl .venv/wheel
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation -w dist .
	$(BIN)/python -m venv .venv/wheel
	.venv/wheel/bin/python -m pip install --quiet --disable-pip-version-check --no-deps dist/*.whl
	cd .venv/wheel && bin/python -c "from stickslip._core import build; print('runs', build.best_level())"
	@ls dist/*.whl

lock:  ## regenerate the lock files with uv
	@PATH="$(BIN):$$PATH" command -v uv >/dev/null || { echo "make lock needs uv: $(BIN)/pip install uv"; exit 1; }
	PATH="$(BIN):$$PATH" uv pip compile --universal --generate-hashes --no-strip-extras --no-emit-index-url --python-version 3.11 --extra dev pyproject.toml -o requirements.lock
	printf 'hatchling\neditables\n' | PATH="$(BIN):$$PATH" uv pip compile --universal --generate-hashes --no-strip-extras --no-emit-index-url --python-version 3.11 -c requirements.lock pyproject.toml - -o requirements-run.lock
	PATH="$(BIN):$$PATH" uv pip compile --universal --generate-hashes --no-strip-extras --no-emit-index-url --python-version 3.11 --extra docs -c requirements.lock pyproject.toml -o requirements-docs.lock
	printf 'twine\nhatchling\nauditwheel\nlief\n' | PATH="$(BIN):$$PATH" uv pip compile --universal --generate-hashes --no-strip-extras --no-emit-index-url --python-version 3.11 - -o requirements-release.lock
	echo uv | PATH="$(BIN):$$PATH" uv pip compile --universal --generate-hashes --no-strip-extras --no-emit-index-url --python-version 3.11 - -o requirements-installer.lock
	echo ziglang | PATH="$(BIN):$$PATH" uv pip compile --universal --generate-hashes --no-emit-index-url --python-version 3.11 - -o requirements-compiler.lock

$(RUN): requirements-run.lock pyproject.toml
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'stickslip needs Python 3.11 or later: make PYTHON=python3.12')"
	@echo "installing into .venv and compiling the core (about half a minute, once)"
	@$(PYTHON) $(BUILD) >/dev/null 2>&1 & built=$$!; $(PYTHON) -m venv .venv && \
	  $(call INSTALL,--require-hashes -r requirements-run.lock); \
	  installed=$$?; wait $$built; exit $$installed  # a fault of the compiler is reported below
	$(COMPILER)
	@$(call INSTALL,--no-deps --no-build-isolation -e .)
	@touch $@

$(CORE): $(RUN) $(BUILD) $(wildcard src/stickslip/_core/*.cpp src/stickslip/_core/*.h)
	$(COMPILER)
	$(BIN)/python $(BUILD)
	@touch $@

$(LEVELS): $(CORE)  # tests compare the levels of processors
	$(BIN)/python $(BUILD) --all
	@touch $@

$(STAMP): $(RUN) requirements.lock | $(LEVELS)
	@echo "installing the development tools into .venv (once)"
	@$(call INSTALL,--require-hashes -r requirements.lock)
	@touch $@

$(DOCS): $(STAMP) requirements-docs.lock
	@echo "installing the documentation tools into .venv (once)"
	@$(call INSTALL,--require-hashes -r requirements-docs.lock)
	@touch $@

clean:
	rm -rf .venv results docs/_build docs/api src/stickslip/_core/.objects src/stickslip/_core/core-*
