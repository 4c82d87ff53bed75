# Everything from a bare machine: `make run`, `make test`. Needs Python 3.11+, git and make.
#
#   make run       install what `run` needs, then run the main job
#   make test      install the rest, then run every test  (PYTEST_ARGS="-k camera" chooses some)
#   make test-fast     what a developer runs again and again: without the tests that are marked slow or
#                  cluster (COSTS=30 prints the CPU seconds of the 30 most expensive modules)
#   make coverage  every test with coverage, which has a floor: half as long again (every night)
#   make test-warp     every task on MuJoCo Warp (`make test` tries two)
#   make docs      the documentation site, into build/site; DOCS_NOTEBOOKS=0 leaves out their execution
#   make lint types imports     the other checks; `make check` is all of them
#   make lerobot   LeRobot loads a data set of ours, trains on it, evaluates in a task (8 GB: CUDA's torch)
#   make dist      build wheel, sdist, bill of materials and SHA256SUMS of the commit  (TAG=v0.1.0
#                  insists on the tag)
#   make smoke     the same, then try the wheel alone on every Python from 3.11 to 3.13 that is found
#   make test-oldest, make test-newest     a part of the tests with the lowest and highest versions
#                  that pyproject.toml allows
#   make names     write the list of public names that a test compares with
#   make format    sort imports and format the code
#   make impact    what this checkout does to six logs of another commit: BASE=origin/main
#   make pins      write constraints.txt, locked.txt and the list of licences from what .venv holds now
#   make clean     remove the environments and what the tools left; outputs/ stays
#
# PYTHON=python3.13 chooses the interpreter, VENV=DIR the place.

# Python keeps the bytecode of what it imports, whatever the shell sets: tests start hundreds of
# processes, and each would compile the sources of torch and of its like anew, 2 s of CPU time.
unexport PYTHONDONTWRITEBYTECODE

PYTHON ?= python3
VENV ?= .venv
LEROBOT ?= .venv-lerobot
OLDEST ?= .venv-oldest
NEWEST ?= .venv-newest
TAG ?=
PYTEST_ARGS ?=
COSTS ?= 0
WORKERS ?= 3

BIN := $(VENV)/bin
RUNS := $(VENV)/.installed
TESTS := $(VENV)/.installed-dev
PIP := $(BIN)/python -m pip --disable-pip-version-check

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: impact help run venv test test-fast coverage test-warp docs lint types imports lerobot check dist smoke test-oldest test-newest names format pins clean system system-tests

help:
	@sed -n 's/^#   /  /p' Makefile

run: $(RUNS)
	$(BIN)/embodichain run task=random_reach num_envs=4

venv: $(TESTS)

# A stamp is newer than both files: nothing is installed again.
# Dependencies first, each file compared with its hash, torch before the others; then the project
# itself, for pip takes no hashes together with an editable installation. `pip check` says whether it
# misses one. Without build isolation the locked setuptools builds, not the newest.
$(RUNS): pyproject.toml locked.txt | system
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python scripts/locked.py install
	$(PIP) install --no-compile --no-deps --no-build-isolation -e .
	$(PIP) check
	touch $@

$(TESTS): $(RUNS) | system-tests
	$(BIN)/python scripts/locked.py install --extra dev
	$(PIP) check
	touch $@

system:
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed: make PYTHON=..." if sys.version_info < (3, 11) else 0)'
	@sh scripts/system_deps.sh $(PYTHON)

system-tests: system
	@sh scripts/system_deps.sh $(PYTHON) chromium slurmctld slurmd slurm-client munge

# worksteal: neighbours share a worker, so what a module builds once (a wheel, a log) is rarely built
# twice, and no worker is idle while the other has a long module left: tests/helpers/costs.py orders
# the tests so that fast ones are left for the end.
# One more than there are cores: tests of clusters, signals and servers wait.
PYTEST := $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal --costs $(COSTS)

# Bytecode in a place of its own: tests look through folders from which they import. What is left of
# modules that earlier tests wrote goes.
BYTECODE := $(abspath $(VENV))/bytecode
test test-fast coverage test-warp: export PYTHONPYCACHEPREFIX := $(BYTECODE)

test: venv
	rm -rf $(BYTECODE)$(or $(TMPDIR),/tmp)
	$(PYTEST) $(PYTEST_ARGS)

test-fast: venv
	$(PYTEST) -m fast $(PYTEST_ARGS)

# Measuring costs half of a test's CPU time again: once a night, not with every change.
coverage: venv
	$(PYTEST) --cov --cov-report=term $(PYTEST_ARGS)

# Every task on MuJoCo Warp's CPU device. Kernels that are not in Warp's cache are compiled: minutes.
test-warp: venv
	EMBODICHAIN_TEST_WARP=all $(BIN)/python -m pytest -n 2 --dist worksteal --timeout 1800 tests/lab/sim/engine/warp/test_warp_tasks.py

# Six logs, recorded with the code of another commit, played again with this one: what parts, and where.
BASE ?= origin/main
impact: $(RUNS)
	rm -rf build/base build/golden
	git worktree prune
	git worktree add --detach build/base "$(BASE)"
	cd build/base && PYTHONPATH="$(CURDIR)/build/base" $(abspath $(BIN))/python $(CURDIR)/scripts/golden_logs.py $(CURDIR)/build/golden
	git worktree remove --force build/base
	$(BIN)/embodichain impact build/golden/*/rollout.mcap

# Warnings are errors: a link without a target, a page without a place, a docstring that cannot be read.
# It is a folder of files: `python -m http.server -d build/site` serves it, and then its search works too.
docs: venv
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict -f docs/site/mkdocs.yml -d $(CURDIR)/build/site

lint: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: venv
	$(BIN)/mypy

imports: venv
	$(BIN)/lint-imports

# Not part of `check`: its torch is older than ours, and a CUDA build. It lives in a place of its own.
$(LEROBOT)/.installed: Makefile pyproject.toml plugins/lerobot_env_embodichain/pyproject.toml
	$(PYTHON) -m venv $(LEROBOT)
	$(LEROBOT)/bin/python -m pip --disable-pip-version-check install --no-compile \
	    lerobot==0.4.4 -e '.[lerobot]' -e plugins/lerobot_env_embodichain
	touch $@

lerobot: venv $(LEROBOT)/.installed
	LEROBOT_PYTHON=$(abspath $(LEROBOT))/bin/python \
	    $(BIN)/python -m pytest tests/recording/export/test_lerobot.py \
	    tests/recording/export/test_episodes.py tests/end_to_end/test_lerobot_plugin.py

check: test lint types imports

# From the files of the commit, so that the same commit gives the same bytes.
dist: venv
	rm -rf dist
	$(BIN)/python scripts/release.py build $(if $(TAG),--tag $(TAG))

smoke: dist
	$(BIN)/python scripts/smoke.py dist/embodichain-*.whl

# uv resolves to the lowest versions, which pip cannot; each environment has its own.
# Tests of packages that are in neither (optuna, sb3-contrib) are left out. Test tools are the pinned
# ones; what is resolved anew has no hashes. UV_TORCH_BACKEND=cpu avoids the CUDA build where uv reaches it.
BOUNDS := tests/utils tests/config tests/lab/gym/envs/test_base_env.py tests/lab/gym/test_vector.py \
    tests/lab/gym/test_single.py tests/lab/sim/compiler/geoms tests/recording/read/test_api.py \
    tests/recording/write/test_recorder.py tests/recording/write/test_log_file.py \
    tests/learning/sb3/test_vec_env.py tests/learning/training/test_train.py \
    tests/learning/training/test_resume.py \
    -m "not cluster" -k "not optuna and not recurrent and not with_a_memory"

$(OLDEST)/.installed: RESOLUTION := lowest-direct
$(NEWEST)/.installed: RESOLUTION := highest
$(OLDEST)/.installed $(NEWEST)/.installed: pyproject.toml | system
	$(PYTHON) -m venv $(@D)
	$(@D)/bin/python scripts/locked.py install --only uv
	$(@D)/bin/uv pip install --python $(@D)/bin/python --resolution $(RESOLUTION) \
	    -r pyproject.toml --extra robots --extra gpu --extra video --extra pandas --extra decompose
	$(@D)/bin/uv pip install --python $(@D)/bin/python -c constraints.txt \
	    pytest pytest-cov pytest-timeout pytest-xdist hypothesis packaging setuptools
	$(@D)/bin/uv pip install --python $(@D)/bin/python --no-deps mcap-protobuf-support
	$(@D)/bin/uv pip install --python $(@D)/bin/python --no-deps --no-build-isolation -e .
	touch $@

test-oldest: $(OLDEST)/.installed
	$(PYTHON) scripts/smoke.py --installed $(OLDEST)
	$(OLDEST)/bin/python -m pytest -n 2 $(BOUNDS) $(PYTEST_ARGS)

test-newest: $(NEWEST)/.installed
	$(PYTHON) scripts/smoke.py --installed $(NEWEST)
	$(NEWEST)/bin/python -m pytest -n 2 $(BOUNDS) $(PYTEST_ARGS)

# After adding public names, or removing some that CHANGELOG.md names.
names: venv
	$(BIN)/python scripts/names.py

format: venv
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

pins: venv
	$(BIN)/python -m scripts.pins

clean:
	rm -rf $(VENV) $(LEROBOT) $(OLDEST) $(NEWEST) build dist *.egg-info .coverage .coverage.* htmlcov \
	    .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -not -path './.git/*' -prune -exec rm -rf {} +
