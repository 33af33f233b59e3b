# make demo   reproduces the paper on a fresh machine
# make test   checks style, types and behaviour; COVERAGE=--cov measures coverage too
# make slow   runs the slow tail of the tests; TAIL="slow and not search" leaves random searches out
# make fuzz   looks for inputs that break it, for an hour or two; FUZZ="systems --seed 7" for some
# make hunt   gives the property tests other random examples than every other run had, and many more
# make docs   measures the figures of its comparison of laws, and builds the site, in build/site
# make site   builds the site alone
# make bench  measures speed, as ratios within one run
# make bench-compare BASE=main compares the speed of this tree with that of a commit
# make mutants changes the source a little, and sees which changes no test notices
# make keys   writes what docs and starter file say of each key of a system file
PYTHON ?= python3
BIN := .venv/bin
# Each worker keeps to files of its own as long as it has some: what a file prepares is made once.
TAIL ?= slow
WORKERS := $(BIN)/pytest -n 2 --dist worksteal
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

# Hundreds of processes load certrack here: from its sources alone that takes each twice as long.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test slow bench mutants keys clean

demo: .venv/installed
	$(BIN)/certrack reproduce --out reproduction

# Each of the two workers has a core, and the matrices are small.
test slow: export OMP_NUM_THREADS = 1

test: .venv/tested
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(WORKERS) -m "not slow" $(COVERAGE)

slow: .venv/tested
	$(WORKERS) -m "$(TAIL)"

.PHONY: fuzz
fuzz: .venv/tested
	cd tests && ../$(BIN)/python -m fuzz $(FUZZ) --keep ../build/fuzz

.PHONY: hunt
hunt: .venv/tested
	nice -n 10 $(BIN)/pytest -n 2 -m "hypothesis or search" --hypothesis-profile=hunt

.PHONY: docs
docs: .venv/documented
	$(BIN)/python tools/laws_page.py
	$(MAKE) site

.PHONY: site
site: .venv/documented
	$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet -c docs -d build/doctrees . build/site

bench: .venv/benched
	$(BIN)/pytest bench

.PHONY: bench-compare
bench-compare: .venv/installed
	$(BIN)/python bench/compare.py $(BASE)

mutants: .venv/tested
	nice -n 10 $(BIN)/python tools/mutants.py $(GROUPS)

keys: .venv/installed
	$(BIN)/python -m certrack.systems.documentation docs/system-file.md src/certrack/systems/starter.toml

.venv/installed: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(INSTALL) --editable .
	touch $@

.venv/tested: .venv/installed
	$(INSTALL) --editable '.[test]'
	touch $@

.venv/documented: .venv/installed
	$(INSTALL) --editable '.[docs]'
	touch $@

.venv/benched: .venv/tested
	$(INSTALL) --editable '.[test,bench]'
	touch $@

clean:
	rm -rf .venv build docs/api reproduction
