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

CHROMIUM_READY := $(VENV)/.chromium
# The thesis's experiments, the longest first, and the sweeps over what it leaves open.
THESIS := six_dof $(filter-out six_dof,$(basename $(notdir $(wildcard configs/thesis/*.yaml))))
UNKNOWNS := $(basename $(notdir $(wildcard configs/thesis/unknowns/*.yaml)))
THESIS_OUT ?= runs/thesis
QUICK_OUT ?= runs/thesis-quick

.PHONY: run test fuzz check lint types format sweep thesis thesis-quick docs pages clean requirements

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

# Headless Chromium, for the test of the report's page, which is skipped where there is none: it can be had for
# root on Debian and its relatives. Tried once.
$(CHROMIUM_READY): $(READY)
	-command -v chromium chromium-browser google-chrome > /dev/null || { [ "$$(id -u)" = 0 ] && \
	  command -v apt-get > /dev/null && timeout 60 apt-get -qq update > /dev/null 2>&1; \
	  timeout 180 apt-get -qq install -y --no-install-recommends chromium > /dev/null 2>&1; }
	touch $@

test: $(READY) $(NODE_READY) $(CHROMIUM_READY)
	$(BIN)/python -m pytest -n $(JOBS) --cov=vmf --cov-report=term --cov-fail-under=90

check: test lint types

# Ten times as many damaged recordings and sources of them as `make test` looks at, all of them learned from or tracked:
# about 25 minutes of CPU, as estimated from 500 of them.
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

# Every figure and table of the thesis, beside what it printed: less than half an hour on two cores. Stopped and made
# again, it goes on where it was.
thesis: $(READY)
	$(MAKE) --no-print-directory $(THESIS:%=thesis-of-%) $(UNKNOWNS:%=unknowns-of-%)
	$(BIN)/vmf report $(THESIS_OUT)/*-sweep --output $(THESIS_OUT).html

# The same figures from one trial each, and of shorter training where that is long, within two minutes.
thesis-quick: $(READY)
	$(MAKE) --no-print-directory -j $(JOBS) EFFORT=quick THESIS_JOBS=1 THESIS_OUT=$(QUICK_OUT) \
	  $(THESIS:%=thesis-of-%) $(UNKNOWNS:%=unknowns-of-%)
	$(BIN)/vmf report $(QUICK_OUT)/*-sweep --output $(QUICK_OUT).html

# What makes an experiment, and the sweep over what it leaves open, quick.
quick-trial := evaluate.trials=1 evaluate.bootstrap=200
quick-six_dof := $(quick-trial) data.simulate.frames=150 evaluate.checkpoints=[100,150] evaluate.curve_points=40
quick-six_dof_3d := $(quick-trial) data.simulate.frames=100 evaluate.checkpoints=[50,100] evaluate.beyond=[50] \
  evaluate.queries=20
quick-noise_isolated := $(quick-trial) data.simulate.frames=80 evaluate.checkpoints=[50,80] evaluate.curve_points=10 \
  evaluate.curve_last=0
quick-multires := $(quick-trial) data.simulate.frames=50 evaluate.curve_points=3 evaluate.queries=20
quick-planar_odometry := $(quick-trial) evaluate.curve_points=32
quick-pan_tilt_hand_guided := $(quick-trial) data.simulate.frames=110 evaluate.checkpoints=[80,110] \
  evaluate.beyond=[80] evaluate.curve_points=20
quick-six_dof_hand_guided := $(quick-trial) data.simulate.frames=850 evaluate.checkpoints=[400,850] \
  evaluate.curve_points=20
quick-translation_arm := $(quick-trial) data.simulate.frames=1000 evaluate.checkpoints=[500,1000] \
  evaluate.curve_points=60
quick-approximators := study.codes=[300,3000] study.noise=[0.0] study.tests=100 study.timed=200 study.repeats=1
quick-cmac_parameters := study.other_tilt_deg=null
quick-feedback := study.starts=10 study.gains_per_s=[1.0] study.sources=[analytic,structured]
quick-joint_space := study.frames=[1000] study.questions=40
quick-kaczmarz := study.points=40 study.orders=2 study.rank_overlays=[8]
quick-planar_sift := study.frames=30 study.runs=1
quick-unknowns := evaluate.trials=1 evaluate.bootstrap=20
quick-unknowns-pan_tilt := $(quick-unknowns) data.simulate.frames=300 evaluate.curve_points=15 evaluate.curve_last=0
quick-unknowns-pan_tilt_hand_guided := $(quick-unknowns) data.simulate.frames=450 noise.pixel_px=0.5 \
  data.simulate.workspace.angle_rad=0.15,0.6 evaluate.curve_points=20
quick-unknowns-pan_tilt_disturbed := $(quick-unknowns-pan_tilt) data.simulate.workspace.angle_rad=0.3
quick-unknowns-translation := $(quick-unknowns) data.simulate.frames=60 evaluate.curve_points=20
quick-unknowns-translation_disturbed := $(quick-unknowns-translation)
quick-unknowns-planar_sift := study.frames=12 study.runs=1 study.image_noise=8 study.drift_rad_per_sqrt_m=0.01
quick-unknowns-six_dof := $(quick-unknowns) data.simulate.frames=150 evaluate.curve_points=20 \
  data.simulate.workspace.angle_rad=0.15,0.5
quick-unknowns-six_dof_3d := $(quick-unknowns) data.simulate.workspace.angle_rad=1 evaluate.queries=20 \
  data.simulate.workspace.travel_m=[1,1,1]
quick-unknowns-six_dof_hand_guided := $(quick-unknowns) noise.pixel_px=1 evaluate.curve_points=12 \
  data.simulate.frames=850
quick-unknowns-translation_arm := $(quick-unknowns) noise.pixel_px=1 evaluate.curve_points=15
STUDIES := $(basename $(notdir $(shell grep -ls '^study:' configs/thesis/*.yaml)))
# What has rivals is compared with them.
COMPARED := $(notdir $(basename $(shell grep -ls '^rivals:' configs/thesis/*.yaml)))
QUICK = $(if $(filter $*,$(STUDIES)),$(quick-$*),$(or $(quick-$*),$(quick-trial)))

THESIS_JOBS ?= $(JOBS)
SWEEP = $(BIN)/vmf sweep configs/thesis/$*.yaml $(if $(filter quick,$(EFFORT)),$1) \
  $(if $(filter $*,$(COMPARED)),--command compare-3d) --jobs $(THESIS_JOBS) --out $(THESIS_OUT) --quiet

# Exit code 3 says that some motions did not converge, which is a result too.
thesis-of-%: $(READY)
	$(call SWEEP,$(QUICK)) --plots $(if $(filter quick,$(EFFORT)),--no-pdf) > /dev/null || [ $$? -eq 3 ]

unknowns-of-%: $(READY)
	$(call SWEEP,$(or $(quick-unknowns-$*),$(quick-unknowns))) --grid configs/thesis/unknowns/$*.yaml --no-pdf > /dev/null || [ $$? -eq 3 ]

# Only for maintainers: pin anew what pyproject.toml asks for. Needs `uv`.
requirements:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
	  --no-annotate --no-header --extra dev pyproject.toml -o requirements.txt

clean:
	rm -rf $(VENV) docs/_build .pytest_cache .mypy_cache .ruff_cache .coverage
