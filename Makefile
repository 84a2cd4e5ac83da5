# Every target does its own set-up: a fresh clone and a Python >= 3.11 are enough.
PYTHON ?= python3
BIN := .venv/bin
RUNTIME := build/.installed
TOOLS := build/.installed-test
PYTEST := $(BIN)/python -m pytest -n 2 --dist loadgroup --no-loadscope-reorder

.PHONY: demo test fast all-tests lint types bench clean

demo: $(RUNTIME)
	rm -rf build/demo
	$(BIN)/bcfj calibrate examples/chung_ooi_fit.toml --out build/demo
	$(BIN)/python examples/compare_with_hertz.py build/demo

# The fast tier, which holds what the README promises; all-tests runs the slow tier, too.
test: lint types fast

fast: $(TOOLS)
	$(PYTEST) -m "not slow" --hypothesis-profile fast --durations 25

all-tests: $(TOOLS)
	$(PYTEST)

lint: $(TOOLS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(TOOLS)
	$(BIN)/pyright

bench: $(RUNTIME)
	$(BIN)/python -m benchmarks.calibration.demo
	$(BIN)/python -m benchmarks.solve.times
	$(BIN)/python -m benchmarks.solve.accuracy

clean:
	rm -rf .venv build

.venv:
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'bcfj-jax needs Python 3.11 or newer: make PYTHON=python3.12')"
	$(PYTHON) -m venv .venv

$(RUNTIME): pyproject.toml constraints.txt | .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	mkdir -p build && touch $@

$(TOOLS): pyproject.toml constraints.txt | .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test]"
	mkdir -p build && touch $(RUNTIME) $@
