# Everything runs inside .venv, which is made from requirements.lock on first use.
# Needs only Python 3.11 or newer (with venv and pip) and make.

PYTHON ?= $(shell for python in python3.11 python3; do \
	$$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	&& echo $$python && break; done)
UV ?= uv
# One more than there are cores: many tests of the loop wait for a clock.
WORKERS ?= $(shell expr $$(getconf _NPROCESSORS_ONLN) + 1)

BIN := .venv/bin
INSTALLED := .venv/installed-from-lock

.PHONY: help venv demo test check bench lock docs clean
.DEFAULT_GOAL := help

help: ## Show the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-6s %s\n", $$1, $$2}' Makefile

venv: $(INSTALLED) ## Make .venv from the lock

$(INSTALLED): requirements.lock pyproject.toml
	@test -n "$(PYTHON)" || { echo "make: drftjax needs Python 3.11 or newer and found none: name one with 'make PYTHON=/path/to/python3.11'." >&2; exit 2; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "make: PYTHON=$(PYTHON) is not a Python 3.11 or newer." >&2; exit 2; }
	test -x $(BIN)/python || "$(PYTHON)" -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

demo: $(INSTALLED) ## Simulate the paper's run, fit the example runs, diagnose a rig; into out/demo
	@mkdir -p out/demo
	$(BIN)/drft simulate data/paper.toml -o out/demo/paper.h5 --plot out/demo/paper.png
	$(BIN)/drft fit data/runs/*.h5 -o out/demo/fit
	$(BIN)/drft diagnose data/blind/demo -o out/demo/diagnosis

test: check ## Check, then run the tests
	$(BIN)/python -m pytest -n $(WORKERS) --maxprocesses 4 --dist loadfile --no-loadscope-reorder

check: $(INSTALLED) ## Lint, formatting, types and layers
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	PYRIGHT_PYTHON_IGNORE_WARNINGS=1 $(BIN)/pyright
	$(BIN)/lint-imports

bench: $(INSTALLED) ## Measure the speed
	$(BIN)/python -m pytest tests/benchmarks -s

docs: $(INSTALLED) ## Build the documentation into site/
	$(BIN)/zensical build --strict --clean

lock: ## Choose the newest versions again and write requirements.lock (needs uv)
	@command -v "$(UV)" >/dev/null || { echo "make: writing the lock needs uv: name it with 'make lock UV=/path/to/uv'." >&2; exit 2; }
	"$(UV)" pip compile pyproject.toml --all-extras --universal --python-version 3.11 \
		--fork-strategy fewest --upgrade --generate-hashes --no-config --no-emit-index-url \
		--no-emit-find-links --custom-compile-command "make lock" --quiet -o requirements.lock

clean: ## Remove what was built, .venv included
	rm -rf .venv out build dist site .cache .pytest_cache .ruff_cache .import_linter_cache .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
