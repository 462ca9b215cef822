# Needs git, make and Python 3.11 or later; everything else is installed into virtual environments.

PYTHON ?= python3
WORKERS ?= auto
ARGS ?=

DEMO_VENV := .venv-demo
TEST_VENV := .venv-test
LOWEST_VENV := .venv-lowest
LOWEST_EXTRAS := bags cluster live pandas parquet
SOURCES := $(wildcard relmap/*.py relmap/*/*.py relmap/*/*/*.py relmap/*/*/*/*.py)
LINTED := $(wildcard relmap tests examples benchmarks)

export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: help demo test lowest bench lint types format clean
.DEFAULT_GOAL := help

help:
	@echo 'make demo     install relmap into $(DEMO_VENV) and run its demo, which fills the folder relmap-demo'
	@echo 'make test     ruff, mypy and every test, in $(TEST_VENV) (ARGS="-k name" goes to pytest)'
	@echo 'make lowest   every test with the lowest versions that pyproject.toml allows, in $(LOWEST_VENV)'
	@echo 'make bench    accuracy and time as ratios, compared with benchmarks/gate_baseline.json'
	@echo 'make lint     ruff check and ruff format --check'
	@echo 'make types    mypy --strict'
	@echo 'make format   let ruff fix and format'
	@echo 'make clean    remove what the other targets made'
	@echo 'PYTHON=/path/to/python chooses the interpreter (3.11 or later; now: $(PYTHON))'

demo: $(DEMO_VENV)/.ready
	@$(DEMO_VENV)/bin/relmap demo

# Compiling takes one core as long as mypy the other. pytest comes last, so that its closing line is
# the last one printed.
test: $(TEST_VENV)/.ready
	@$(MAKE) --no-print-directory -j lint types $(TEST_VENV)/.compiled
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(TEST_VENV)/bin/python -m pytest \
		-n $(WORKERS) --maxprocesses 4 --dist worksteal $(ARGS)

# Deprecation warnings of old versions are expected. The old compiler keeps its code by itself: it
# cannot read what a newer one, in another environment, writes beside the sources meanwhile.
lowest: $(LOWEST_VENV)/.ready
	@NUMBA_CACHE_DIR='$(CURDIR)/$(LOWEST_VENV)/numba' OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(LOWEST_VENV)/bin/python -m pytest \
		-W ignore::DeprecationWarning -n $(WORKERS) --maxprocesses 4 --dist worksteal $(ARGS)

# Takes some minutes and a quiet machine; never part of the tests.
bench: $(TEST_VENV)/.ready
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(TEST_VENV)/bin/python benchmarks/gate.py $(ARGS)

lint: $(TEST_VENV)/.ready
	@$(TEST_VENV)/bin/python -m ruff check $(LINTED)
	@$(TEST_VENV)/bin/python -m ruff format --check $(LINTED)

types: $(TEST_VENV)/.ready
	@$(TEST_VENV)/bin/python -m mypy
	@MYPYPATH=benchmarks $(TEST_VENV)/bin/python -m mypy $(wildcard benchmarks/*.py benchmarks/*/*.py examples/*.py)

$(TEST_VENV)/.compiled: $(TEST_VENV)/.ready $(SOURCES)
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(TEST_VENV)/bin/python -m tests.compiling
	@touch $@

format: $(TEST_VENV)/.ready
	@$(TEST_VENV)/bin/python -m ruff check --fix $(LINTED)
	@$(TEST_VENV)/bin/python -m ruff format $(LINTED)

clean:
	@rm -rf $(DEMO_VENV) $(TEST_VENV) $(LOWEST_VENV) relmap-demo build dist relmap.egg-info \
		.mypy_cache .ruff_cache .pytest_cache .hypothesis

# A copy as a user installs it; build/ is removed so that no deleted module stays in it.
$(DEMO_VENV)/.ready: pyproject.toml README.md LICENSE MANIFEST.in relmap/py.typed $(SOURCES)
	$(call new_venv,$(DEMO_VENV))
	@echo 'installing relmap into $(DEMO_VENV)'
	@rm -rf build
	@$(DEMO_VENV)/bin/python -m pip install --quiet .
	@touch $@

$(TEST_VENV)/.ready: pyproject.toml
	$(call new_venv,$(TEST_VENV))
	@echo 'installing relmap and its development tools into $(TEST_VENV)'
	@$(TEST_VENV)/bin/python -m pip install --quiet --editable '.[dev]'
	@touch $@

$(LOWEST_VENV)/.ready: pyproject.toml
	$(call new_venv,$(LOWEST_VENV))
	@echo 'installing relmap with the lowest versions it allows into $(LOWEST_VENV)'
	@$(LOWEST_VENV)/bin/python -m pip install --quiet uv
	@$(LOWEST_VENV)/bin/python -m uv pip compile --quiet --python $(LOWEST_VENV)/bin/python \
		--resolution lowest-direct --only-binary :all: pyproject.toml \
		$(LOWEST_EXTRAS:%=--extra %) -o $(LOWEST_VENV)/lowest.txt
	@$(LOWEST_VENV)/bin/python -m uv pip install --quiet --python $(LOWEST_VENV)/bin/python \
		--editable '.[dev]' -c $(LOWEST_VENV)/lowest.txt
	@touch $@

# new_venv DIR: make DIR a virtual environment with pip, or say what is missing. Where this
# Python has no ensurepip (some systems package it apart), its own pip fills the environment.
define new_venv
@command -v '$(PYTHON)' >/dev/null || { \
	echo "relmap: no '$(PYTHON)' on this machine; name a Python 3.11 or later: make PYTHON=/path/to/python" >&2; \
	exit 1; }
@'$(PYTHON)' -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	echo "relmap: '$(PYTHON)' is $$('$(PYTHON)' -V 2>&1); name a Python 3.11 or later: make PYTHON=/path/to/python" >&2; \
	exit 1; }
@if '$(PYTHON)' -c 'import venv, ensurepip' 2>/dev/null; then \
	'$(PYTHON)' -m venv --clear $(1); \
elif '$(PYTHON)' -c 'import venv, pip' 2>/dev/null; then \
	'$(PYTHON)' -m venv --clear --without-pip $(1) && \
	'$(PYTHON)' -m pip --python $(1)/bin/python install --quiet pip; \
else \
	echo "relmap: '$(PYTHON)' lacks the standard modules venv and ensurepip, and has no pip to do without them;" \
		"install your system's package for them (on Debian and Ubuntu: python3-venv), then run make again" >&2; \
	exit 1; \
fi
endef
