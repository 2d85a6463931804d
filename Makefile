# fl3d: `make help` lists what there is. Everything runs in .venv, which is made at first use.
# Options: DATA=simulated|simulated_people|kitti_sample|kitti (else the sweep's own, most often simulated)  KITTI=folder  PROFILE=quick|tiny|standard|paper  SEEDS=5  ARGS="any Hydra overrides"
# PIP_ARGS goes to pip, such as --find-links FOLDER for a torch wheel of your own (the usual one brings CUDA along).

PYTHON ?= python3
PROFILE ?= quick
DATA ?=
KITTI ?=
FRAMES ?=
SEEDS ?=
SWEEP ?= gamma
ARGS ?=
PIP_ARGS ?=
BIN := .venv/bin
OVERRIDES = $(if $(DATA),data=$(DATA)) profile=$(PROFILE) $(if $(KITTI),data.root=$(KITTI)) $(if $(SEEDS),seeds=$(SEEDS)) $(ARGS)

export OMP_NUM_THREADS := 1

.PHONY: help install sweep-% sweep-pointrcnn sweep-frustum sweep-report plan tables gains figures report publish ui docs check format test test-slow test-slurm test-ray test-postgres bench clean

help:  ## list the targets
	@echo "Targets (options: DATA=simulated|simulated_people|kitti_sample|kitti KITTI=folder PROFILE=quick|tiny|standard|paper SEEDS=5 ARGS='...'):"
	@grep -hE '^[a-z%-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/; s/%/NAME/' | expand -t 16 | sed 's/^/  /'
	@echo "Sweeps (make sweep-NAME):" $(basename $(notdir $(wildcard sweeps/*.yaml)))

install: .venv/installed  ## make .venv with the pinned packages

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "fl3d needs Python 3.11 or newer")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt $(PIP_ARGS) --editable '.[dev]'
	touch $@

sweep-%: .venv/installed  ## train, score and tabulate sweeps/NAME.yaml; again: resumes, or says that all is done
	@test -f sweeps/$*.yaml || { echo "no sweeps/$*.yaml; there are: $(basename $(notdir $(wildcard sweeps/*.yaml)))" >&2; exit 2; }
	$(BIN)/python -m fl3d -m +sweep=$* $(OVERRIDES)

POINTRCNN := default batch alpha bins rcnn

sweep-pointrcnn: .venv/installed  ## the report's sweeps of PointRCNN, each keeping the winner before: Tables R1 to R5
	for name in $(POINTRCNN); do $(MAKE) --no-print-directory sweep-pointrcnn_$$name || exit 1; done

FRUSTUM := batch slabs alpha weights final resolutions

sweep-frustum: .venv/installed  ## the report's sweeps of Frustum ConvNet: Table R6, Figure 5, and with PointRCNN's R7
	for name in $(FRUSTUM); do $(MAKE) --no-print-directory sweep-frustum_$$name || exit 1; done

sweep-report: sweep-pointrcnn sweep-frustum  ## everything of the report

plan: .venv/installed  ## show what a sweep would do: stages, what is done, time, FLOPs, disk (SWEEP=gamma)
	$(BIN)/python -m fl3d plan +sweep=$(SWEEP) $(OVERRIDES)

tables: .venv/installed  ## make all tables again from what is stored, beside the published ones and with intervals
	$(BIN)/python -m fl3d tables $(OVERRIDES)

gains: .venv/installed  ## gains of a sweep over its baseline, with intervals (SWEEP=gamma)
	$(BIN)/python -m fl3d gains +sweep=$(SWEEP) $(OVERRIDES)

figures: .venv/installed  ## draw the figures of a sweep from what is stored (SWEEP=gamma)
	$(BIN)/python -m fl3d figures +sweep=$(SWEEP) $(OVERRIDES)

report: .venv/installed  ## tables, figures, claims and one page of them: out/DATA-PROFILE/report_gamma.html
	$(BIN)/python -m fl3d report $(OVERRIDES)

publish: .venv/installed  ## make results/DATA-PROFILE anew, which the project commits; everybody's own runs write to out/
	$(BIN)/python -m fl3d publish $(OVERRIDES)

ui: .venv/installed  ## browse every checkpoint in MLflow, on this machine alone
	$(BIN)/python -m fl3d ui

docs: .venv/docs  ## build the site, which needs no network: site/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "Written to site/index.html; with its search: python3 -m http.server --directory site"

# What builds the site is installed when it is asked for, so that nothing else waits for it.
.venv/docs: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt $(PIP_ARGS) --editable '.[docs]'
	touch $@

check: .venv/installed  ## lint, types, and that imports only go down
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/pytest -q tests/test_structure.py

format: .venv/installed  ## mend layout and what the linter can
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

test: check  ## everything but the slow campaigns, on two cores
	$(BIN)/pytest -q -m "not slow" -n 2 --dist loadfile

test-slow: check  ## the slow campaigns too
	$(BIN)/pytest -q

test-slurm: .venv/installed  ## the launchers' contract on a real one-node SLURM, which is installed (as root) and started
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt $(PIP_ARGS) --editable '.[dev,slurm]'
	folder=$$(mktemp -d) && tests/services/slurm.sh start $$folder && \
	{ SLURM_CONF=$$folder/slurm.conf $(BIN)/pytest -q tests/sweep/test_launchers.py -k slurm; code=$$?; \
	  tests/services/slurm.sh stop $$folder; rm -rf $$folder; exit $$code; }

test-ray: .venv/installed  ## the launchers' contract on a Ray cluster of three nodes, one of which is killed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt $(PIP_ARGS) --editable '.[dev,ray]'
	$(BIN)/pytest -q tests/sweep/test_launchers.py -k ray

test-postgres: .venv/installed  ## the store on a real PostgreSQL and an MLflow server: eight writers, and outages
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt $(PIP_ARGS) --editable '.[dev,postgres]'
	folder=$$(mktemp -d) && FL3D_TEST_POSTGRES=$$folder $(BIN)/pytest -q tests/test_store_server.py

bench: .venv/installed  ## benchmarks that end within ten minutes; their table in benchmarks/README.md (KITTI=folder FRAMES=list of ids)
	$(BIN)/python benchmarks/all.py $(if $(KITTI),--kitti $(KITTI)) $(if $(FRAMES),--frames $(FRAMES))

clean:  ## remove .venv and caches; runs/, data/ and out/ stay
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +
