# Everything goes into .venv; nothing else on the machine is changed. `make` shows the targets.

SHELL = /bin/bash
BIN = .venv/bin
# Set up for this lock and this pyproject; made again when one of them changes.
READY = .venv/ready
# Threads of linear algebra that wait for work take a core from the other process of the tests.
export OPENBLAS_NUM_THREADS = 1

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-17s %s\n", $$1, $$2 }' Makefile

demo: $(READY) ## run the paper's experiment into runs/demo
	$(BIN)/softbot demo --out runs/demo

test: $(READY) ## the default tests, with their coverage (at least 90 % of the lines)
	$(BIN)/python -m pytest -n 2 --cov --cov-report=term:skip-covered --cov-fail-under=90

coverage-protocol: $(READY) ## every line and branch of firmware_protocol is tested
	$(BIN)/python -m pytest -n 2 tests/firmware_protocol --cov --cov-config=.ci/coverage_protocol.ini \
	  --cov-report=term-missing:skip-covered --cov-fail-under=100

mutants: $(READY) ## change the safety and end-to-end modules one place at a time; the tests must notice (long)
	$(BIN)/python tests/firmware_protocol/mutants.py

check: $(READY) ## format, lint, types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

slow: $(READY) ## end-to-end and accuracy tests of minutes
	$(BIN)/python -m pytest -n 2 -m slow --durations=5

# What they run is compiled beforehand: in a kernel of their own the one processor would be at it for minutes.
test-vcan: $(READY) ## hardware in the loop on a real vcan, in a kernel of its own where this one has none
	$(BIN)/python tests/hil/compile_beforehand.py
	.ci/vcan.sh $(BIN)/python -m pytest tests/hil/test_rolling.py -m vcan -p no:cacheprovider --durations=5

# Limits in milliseconds hold on a machine that has nothing else to do.
test-vcan-timing: $(READY) ## on vcan, on a quiet machine: a minute against lock-step, and the losses of either side
	$(BIN)/python tests/hil/compile_beforehand.py
	.ci/vcan.sh -t 3600 $(BIN)/python -m pytest tests/hil -m vcan -p no:cacheprovider --durations=5

soak: $(READY) ## both ends on vcan for an hour of wall-clock time (SOFTBOT_SOAK_S): memory, files, commands
	$(BIN)/python tests/hil/compile_beforehand.py
	.ci/vcan.sh -t 14400 $(BIN)/python -m pytest tests/hil -m soak -k wall_clock -p no:cacheprovider -s

soak-simulated: $(READY) ## the same for an hour of simulated time, as fast as it goes
	$(BIN)/python tests/hil/compile_beforehand.py
	.ci/vcan.sh -t 14400 $(BIN)/python -m pytest tests/hil -m soak -k simulated -p no:cacheprovider -s

stress: $(READY) ## long campaigns
	$(BIN)/python -m pytest -n 2 -m stress

bench: $(READY) ## run time against error
	$(BIN)/softbot bench

c-reference: $(READY) ## write the C reference for firmware into build/c-reference
	$(BIN)/python -m firmware_protocol.c_reference build/c-reference

c-coverage: $(READY) ## lines and branches of the C reference that its tests run: all, or it fails (needs gcc)
	rm -rf build/c-coverage && mkdir -p build/c-coverage
	C_REFERENCE_OPTIONS='-O0 --coverage' C_REFERENCE_FOLDER=$(CURDIR)/build/c-coverage CC=gcc \
	  $(BIN)/python -m pytest tests/firmware_protocol/c
	$(BIN)/python .ci/c_coverage.py build/c-coverage

lock: ## write requirements.lock anew from pyproject.toml (needs uv)
	@PATH="$(BIN):$$PATH"; command -v uv >/dev/null || { echo 'make lock needs uv: $(BIN)/pip install uv' >&2; exit 1; }
	PATH="$(BIN):$$PATH" uv pip compile pyproject.toml --output-file requirements.lock --extra dev --universal \
	  --python-version 3.11 --generate-hashes --no-emit-index-url --no-emit-find-links \
	  --custom-compile-command "make lock" --quiet

clean: ## remove what make made: .venv, caches, coverage (runs/ stays)
	rm -rf .venv .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage .coverage.* build dist *.egg-info
	find . -name __pycache__ -prune -exec rm -rf {} +

$(READY): requirements.lock pyproject.toml .ci/set_up.sh
	@.ci/set_up.sh $(READY)

.PHONY: help demo test test-vcan coverage-protocol mutants check slow stress soak soak-simulated bench c-reference c-coverage lock clean
