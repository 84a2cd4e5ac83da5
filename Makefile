# Every target does its own set-up: a fresh clone and a Python >= 3.11 are enough.
PYTHON ?= python3
BIN := .venv/bin
RUNTIME := build/.installed
TOOLS := build/.installed-test
PAGES := build/.installed-docs
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e
# A worker gets whole files, because the tests of a file share compiled programs and fixtures; tests/conftest.py orders them.
PYTEST := $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

.PHONY: demo test fast all-tests lint types docs bench dist dist-check pythons release clean

demo: $(RUNTIME)
	rm -rf build/demo
	$(BIN)/bcfj calibrate examples/chung_ooi_fit.toml --out build/demo
	$(BIN)/python examples/compare_with_hertz.py build/demo

# Three tiers by marker (tests/conftest.py): fast is what the README promises and what is cheap; test, which CI runs,
# adds the tests marked full; all-tests adds those marked slow, and more examples of each property.
fast: $(TOOLS)
	$(PYTEST) -m "not full and not slow" --hypothesis-profile fast

# Types and documents are tests, too (tests/test_types_and_pages.py): a worker makes them while the other one tests.
# Assertions that show their values cost each worker 7 s; only tests that fail run again with them.
test: $(TOOLS) $(PAGES) lint
	$(PYTEST) --assert=plain -m "not slow" --hypothesis-profile fast --durations 25 \
		|| { $(PYTEST) --last-failed --last-failed-no-failures none -m "not slow" --hypothesis-profile fast; exit 1; }

all-tests: $(TOOLS) $(PAGES)
	$(PYTEST)

lint: $(TOOLS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(TOOLS)
	$(BIN)/pyright

# A warning, such as a broken link or a page that no list names, is an error.
docs: $(PAGES)
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going --nitpicky --builder html docs build/site
	@echo "open build/site/index.html"

bench: $(RUNTIME)
	$(BIN)/python -m benchmarks.calibration.demo
	$(BIN)/python -m benchmarks.solve.times
	$(BIN)/python -m benchmarks.solve.accuracy

# What others install (docs/packaging.md): wheel and sdist; each tried in a fresh environment; every Python; a tag.
dist: $(TOOLS)
	rm -rf build/dist
	$(BIN)/python -m build --outdir build/dist

dist-check: dist
	$(BIN)/python -m scripts.dist_check build/dist

PYTHONS ?= python3.11 python3.12 python3.13
VERSIONS ?= pinned,lowest,newest
pythons:
	$(PYTHON) -m scripts.pythons $(PYTHONS) --versions $(VERSIONS) --out build/pythons.json

release: $(TOOLS)
	$(BIN)/python -m scripts.release

clean:
	rm -rf .venv build

.venv:
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'bcfj-jax needs Python 3.11 or newer: make PYTHON=python3.12')"
	$(PYTHON) -m venv .venv

$(RUNTIME): pyproject.toml constraints.txt | .venv
	$(INSTALL) .
	mkdir -p build && touch $@

$(TOOLS): pyproject.toml constraints.txt | .venv
	$(INSTALL) ".[test,docs]"
	mkdir -p build && touch $(RUNTIME) $(PAGES) $@

$(PAGES): pyproject.toml constraints.txt | .venv
	$(INSTALL) ".[docs]"
	mkdir -p build && touch $(RUNTIME) $@
