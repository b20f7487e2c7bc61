# Needs only Python 3.11 or newer with venv and pip, and git. Another interpreter:
# `make PYTHON=/path/to/python`.
PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed
# Modules are compiled when they are first imported: all at once takes a third of the set-up.
PIP := $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check \
	-c constraints.txt

.DEFAULT_GOAL := help
.PHONY: help setup check site test test-all coverage mutants demo view bench clean

help:
	@echo "make demo      train a small policy and show it in both engines, into demo/"
	@echo "make view      see a robot move in MuJoCo and PyBullet, and steer it, in a web page"
	@echo "make test      checks, then the fast tests"
	@echo "make test-all  checks, then every test"
	@echo "make coverage  the fast tests, and the share of lines that they run"
	@echo "make mutants   change the code in random places, and see whether tests notice (hours)"
	@echo "make bench     measure speed and memory, times as ratios within one process"
	@echo "make check     lint, format, types, import contract, site"
	@echo "make site      the documentation as web pages, into build/site"
	@echo "make setup     create .venv with the versions in constraints.txt"
	@echo "make clean     remove .venv, caches and build files"

setup: $(INSTALLED)

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed: make PYTHON=/path/to/python3.11"; exit 1; }
	@echo "==> creating .venv"
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@$(PIP) pip
	@echo "==> installing the versions in constraints.txt (downloads on the first run)"
	@$(PIP) -e '.[study,view,onnx,render]' --group dev
	@touch $@

check: setup
	@echo "==> lint"
	@$(BIN)/ruff check .
	@echo "==> format"
	@$(BIN)/ruff format --check .
	@echo "==> types"
	@$(BIN)/pyright
	@echo "==> import contract"
	@$(BIN)/lint-imports
	@$(MAKE) --no-print-directory site

site: setup
	@echo "==> site, into build/site"
	@$(BIN)/python -m sphinx -q -W --keep-going -b html docs build/site

test: check
	@echo "==> fast tests"
	@OMP_NUM_THREADS=1 $(BIN)/pytest -n auto --dist worksteal

test-all: check
	@echo "==> all tests"
	@OMP_NUM_THREADS=1 $(BIN)/pytest -n auto --dist worksteal -m 'slow or not slow'

coverage: setup
	@echo "==> line coverage of the fast tests"
	@OMP_NUM_THREADS=1 $(BIN)/pytest -n auto --dist worksteal --cov \
		--cov-report=term-missing:skip-covered

mutants: setup
	@$(PIP) cosmic-ray
	@$(BIN)/python -m tests.robustness.mutants

demo: setup
	@echo "==> demo"
	@$(BIN)/cdcsr demo --out demo

view: setup
	@$(BIN)/cdcsr view --backend mujoco pybullet

bench: setup
	@echo "==> bench"
	@$(BIN)/cdcsr bench

clean:
	@echo "==> removing .venv, caches and build files"
	@rm -rf .venv .pytest_cache .ruff_cache .hypothesis .import_linter_cache build dist *.egg-info
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +
