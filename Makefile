# `make demo` and `make test` set up everything in .venv and need nothing but Python 3.10+.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := demo

.PHONY: demo test docs lint bench firmware tables golden clean

demo: $(VENV)/.installed
	@mkdir -p $(DEMO)
	@echo "1. simulate the paper's walk: 35 m in 130 s, MPU-9150 errors"
	@$(BIN)/solenav simulate line35 -o $(DEMO)/walk.solcap
	@echo "2. run the firmware over it, on MicroPython behind a pseudo-terminal"
	@$(BIN)/solenav run-firmware $(DEMO)/walk.solcap -o $(DEMO)/run.solcap
	@echo "3. prove every tick on the host"
	@$(BIN)/solenav verify $(DEMO)/run.solcap
	@echo "4. compare with the truth"
	@$(BIN)/solenav evaluate $(DEMO)/run.solcap
	@echo "5. draw it"
	@$(BIN)/solenav plot $(DEMO)/run.solcap -o $(DEMO)/run.png

test: $(VENV)/.installed lint
	$(BIN)/python -m pytest -n auto --dist loadfile

docs: $(VENV)/.installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo build/site/index.html

lint: $(VENV)/.installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python tools/lint/kernels.py

bench: $(VENV)/.installed
	$(BIN)/python tools/bench
	$(BIN)/python tools/bench/cycles.py

MARCH ?= armv6m
firmware: $(VENV)/.installed
	$(BIN)/python -m solenav_tools.staging build/firmware $(MARCH)
	@echo build/firmware

tables: $(VENV)/.installed
	$(BIN)/python tools/tables/constants.py
	$(BIN)/python tools/tables/lookup.py
	$(BIN)/python tools/tables/defaults.py
	$(BIN)/python tools/tables/selftest.py
	$(BIN)/python tools/tables/protocol.py
	$(BIN)/python tools/tables/ranges.py

# From the environment, so that a reason may hold quotes.
golden: $(VENV)/.installed
	@$(BIN)/python tests/golden/make.py "$$REASON"

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "solenav needs Python 3.10 or newer: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

clean:
	rm -rf $(VENV) $(DEMO) build *.egg-info
