# Two commands: make demo, make test. Needs python3 (3.11+) and make.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/ready

.PHONY: install demo test slow check bench baseline lock picture clean
install: $(READY)

demo: $(READY)
	$(BIN)/testrange run configs/campaigns/quickstart.toml --out out/demo --replace

test: $(READY)
	$(BIN)/pytest -q -n 2 --dist loadfile

slow: $(READY)
	$(BIN)/pytest -q -m slow

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/deptry .
	$(BIN)/mypy

bench: $(READY)
	$(BIN)/pytest -q benchmarks

# What later runs of `make bench` are compared with; on a machine that does nothing else.
baseline: $(READY)
	$(BIN)/pytest -q benchmarks --baseline

# uv itself comes out of the lock, with its hashes; it then installs the rest from the lock alone.
$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "testrange needs Python 3.11 or newer, found " + sys.version.split()[0])'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@awk '/^uv==/{p=1} p{print} p&&!/\\$$/{exit}' requirements.lock > $(VENV)/uv.lock
	$(BIN)/python -m pip install -q --require-hashes --no-deps -r $(VENV)/uv.lock
	VIRTUAL_ENV=$(abspath $(VENV)) $(BIN)/uv pip install -q --compile-bytecode --require-hashes -r requirements.lock
	VIRTUAL_ENV=$(abspath $(VENV)) $(BIN)/uv pip install -q --no-build-isolation --no-deps -e .
	@touch $@

# The picture of the README, from the last demo run.
picture: $(READY)
	$(BIN)/testrange picture out/demo --out docs/first_flight.jpg

lock: $(READY)
	$(BIN)/uv pip compile -q --universal --generate-hashes --no-emit-index-url --no-header --group dev -o requirements.lock pyproject.toml

clean:
	rm -rf $(VENV) out
