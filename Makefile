# Two commands do everything, set-up included: `make run` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
JOBS ?= 2
NODE := $(VENV)/node
NODE_READY := $(NODE)/.ready
# An independent reader of recordings, what it stands on, and a decompressor for it.
NODE_PACKAGES := @mcap/core@2.2.2 @foxglove/crc@0.0.3 heap-js@2.7.1 tslib@2.9.1 fzstd@0.1.1

.PHONY: run test fuzz check lint types format sweep docs pages clean requirements

run: $(READY)
	$(BIN)/vmf train configs/quickstart.yaml

# Everything a fresh machine needs, from pinned and hashed packages; done again only when they change.
$(READY): requirements.txt pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

# Without npm, or without packages for it, the test of recordings by an independent reader is skipped.
$(NODE_READY): $(READY)
	-command -v npm > /dev/null && mkdir -p $(NODE) && timeout 180 npm install --no-save --no-package-lock \
	  --no-audit --no-fund --loglevel=error --prefix $(NODE) $(NODE_PACKAGES) && touch $@

test: $(READY) $(NODE_READY)
	$(BIN)/python -m pytest -n $(JOBS) --cov=vmf --cov-report=term --cov-fail-under=90

check: test lint types

# Ten times as many damaged recordings and sources of them as `make test` looks at.
fuzz: $(READY)
	VMF_FUZZ_CASES=10000 $(BIN)/python -m pytest -n $(JOBS) tests/cli/test_cli_mutations.py \
	  tests/cli/test_cli_import_mutations.py

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# A small batch over noise and tile width, tabulated; made again, it goes on where it was. Exit code 3 says
# that some motions did not converge, which is a result too.
sweep: $(READY)
	$(BIN)/vmf sweep configs/quickstart.yaml name=tiles noise.pixel_px=0,1,3 approximator.tile_px=16,32,64 \
	  learner.kind=transport approximator.kind=cmac evaluate.trials=2 evaluate.checkpoints=null \
	  evaluate.curve_points=0 --quiet > /dev/null || [ $$? -eq 3 ]
	$(BIN)/vmf table runs/tiles-sweep

# The documentation: docs/_build/html/index.html. Runs the tutorial's commands, some minutes, and puts what they print
# and their figures into docs/; `make pages` leaves these as they are, and takes seconds.
docs: $(READY)
	PYTHONPATH=docs $(BIN)/python -m vmf_docs

pages: $(READY)
	PYTHONPATH=docs $(BIN)/python -m vmf_docs --no-run

# Only for maintainers: pin anew what pyproject.toml asks for. Needs `uv`.
requirements:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
	  --no-annotate --no-header --extra dev pyproject.toml -o requirements.txt

clean:
	rm -rf $(VENV) docs/_build .pytest_cache .mypy_cache .ruff_cache .coverage
