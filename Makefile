# Two commands do everything, set-up included: `make run` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
JOBS ?= 2

.PHONY: run test check lint types format sweep clean requirements

run: $(READY)
	$(BIN)/vmf train configs/quickstart.yaml

# Everything a fresh machine needs, from pinned and hashed packages; done again only when they change.
$(READY): requirements.txt pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

test: $(READY)
	$(BIN)/python -m pytest -n $(JOBS) --cov=vmf --cov-report=term --cov-fail-under=90

check: test lint types

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# A small batch over noise and tile width, tabulated.
SWEEP_OUT := runs/sweep
sweep: $(READY)
	@for noise in 0 1 3; do for tile in 16 32 64; do \
	  $(BIN)/vmf train configs/quickstart.yaml --quiet --out $(SWEEP_OUT) \
	    name=noise$$noise-tile$$tile noise.pixel_px=$$noise learner.kind=transport approximator.kind=cmac approximator.tile_px=$$tile \
	    evaluate.trials=2 evaluate.checkpoints=null evaluate.curve_points=0 > /dev/null || [ $$? -eq 3 ] || exit 1; \
	done; done
	$(BIN)/vmf table $(foreach n,0 1 3,$(foreach t,16 32 64,$(SWEEP_OUT)/noise$(n)-tile$(t)/latest))

# Only for maintainers: pin anew what pyproject.toml asks for. Needs `uv`.
requirements:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
	  --no-annotate --no-header --extra dev pyproject.toml -o requirements.txt

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .coverage
