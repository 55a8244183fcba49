PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
DOCS := .venv/.docs-installed

.PHONY: demo test quick slow lint bench docs lock clean

demo: $(STAMP)  ## install, run paper 000 (quick), show how much is reproduced and the figures' paths
	$(BIN)/stickslip reproduce disk-array --quick --overwrite --out results/disk-array-quick

test: $(STAMP)  ## the tests, under ten minutes on two cores
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

quick: $(STAMP)  ## tests for the edit-test loop: no slow fixtures, no other processes
	$(BIN)/python -m pytest -n 2 --dist loadfile --quick

test-%: $(STAMP)  ## tests of one room of the package, such as test-solve
	@files=$$($(BIN)/python -m tests.rooms $*) && $(BIN)/python -m pytest -n 2 --dist loadfile $$files

slow: $(DOCS)  ## the long checks
	$(BIN)/python -m pytest -m slow

lint: $(STAMP)  ## style and the layers of the architecture
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy

bench: $(STAMP)  ## ratios against peers and references, measured in this run; writes bench.json
	$(BIN)/python -m benchmarks

docs: $(DOCS)  ## these pages, tutorials run, into docs/_build/html; warnings are errors
	$(BIN)/python -m sphinx -q -W --keep-going docs docs/_build/html
	@echo "docs/_build/html/index.html"

lock:  ## resolve the pinned dependencies again, with uv
	@PATH="$(BIN):$$PATH" command -v uv >/dev/null || { echo "make lock needs uv: $(BIN)/pip install uv"; exit 1; }
	PATH="$(BIN):$$PATH" uv pip compile --universal --generate-hashes --no-emit-index-url --python-version 3.11 --extra dev pyproject.toml -o requirements.lock
	PATH="$(BIN):$$PATH" uv pip compile --universal --generate-hashes --no-emit-index-url --python-version 3.11 --extra docs -c requirements.lock pyproject.toml -o requirements-docs.lock

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'stickslip needs Python 3.11 or later: make PYTHON=python3.12')"
	@echo "installing into .venv (about half a minute, once)"
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

$(DOCS): $(STAMP) requirements-docs.lock
	@echo "installing what makes the documentation into .venv (once)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-docs.lock
	@touch $@

clean:
	rm -rf .venv results docs/_build docs/api
