# Every target does its own set-up: a fresh clone needs Python >= 3.11 and nothing else.
#
#   make demo    simulated logs -> three stages -> reports/demo/
#   make test    tests; a few minutes
#   make studies some hundred more whole diagnoses; ten minutes
#   make check   lint, format and types
#   make format  let ruff put the format right
#   make mutants change the code in 400 places and see whether the tests notice
#   make fuzz    a million damaged files for every reader -> reports/fuzz/
#   make docs    the documentation -> build/site/; links are checked
#   make clean   remove everything these targets made, except reports

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed
RUNS := .venv/.runs
# Byte code is kept: workers, and programs that tests start, would compile all again.
# A file stays with one worker, so that what its tests share is made once.
PYTEST := env -u PYTHONDONTWRITEBYTECODE $(BIN)/pytest -n 2 --dist loadfile

# One thread per process: the linear algebra is small, and two test workers would fight.
export OMP_NUM_THREADS = 1
export OPENBLAS_NUM_THREADS = 1

.PHONY: demo test docs studies check format mutants fuzz clean
.DEFAULT_GOAL := demo

demo: $(RUNS)
	$(BIN)/python experiments/demo.py --out reports/demo

test: $(INSTALLED)
	$(PYTEST)

docs: $(INSTALLED)
	$(BIN)/python -m pip install --disable-pip-version-check --quiet \
		-c constraints.txt -e ".[docs]"
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

studies: $(INSTALLED)
	$(PYTEST) -m study

check: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check . || { echo "'make format' puts this right."; exit 1; }
	$(BIN)/mypy

format: $(INSTALLED)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

mutants: $(INSTALLED)
	$(BIN)/python -m pip install --disable-pip-version-check --quiet \
		-c constraints.txt -e ".[mutation]"
	nice $(BIN)/python benchmarks/mutants.py --out reports/mutants

# Minutes of processor time; atheris is for Linux, and without it inputs are random.
fuzz: $(INSTALLED)
	$(BIN)/python -m pip install --disable-pip-version-check -q -e ".[fuzz]" || true
	$(BIN)/python fuzz/run.py --inputs 1000000 --out reports/fuzz

clean:
	rm -rf .venv build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Installed once, and again only when what should be installed changes.
$(RUNS): pyproject.toml constraints.txt | $(BIN)/python
	@echo "Installing into .venv (once; a few minutes on a slow line) ..."
	$(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(INSTALLED): pyproject.toml constraints.txt | $(BIN)/python
	@echo "Installing into .venv (once; a few minutes on a slow line) ..."
	$(BIN)/python -m pip install --disable-pip-version-check \
		-c constraints.txt -e ".[dev]"
	@touch $@ $(RUNS)

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "Python 3.11 or newer is needed; '$(PYTHON)' is not."; \
		echo "Name another one: make PYTHON=python3.12 ..."; exit 1; }
	@$(PYTHON) -m venv .venv || { rm -rf .venv; \
		echo "No virtual environment could be made with '$(PYTHON)'."; \
		echo "On Debian and Ubuntu: apt install python3-venv"; exit 1; }
