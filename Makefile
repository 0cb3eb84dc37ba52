# make            set up: .venv with everything, native modules built
# make stream     start the built-in robot and stream from it
# make test       everything that CI runs
# make bench      the figures of the README's performance table
# Needs Python 3.11+ with venv and headers, gcc and make. PYTHON=python3.12 chooses another interpreter.

PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
STAMP := $(VENV)/.ready
C_FILES := $(wildcard firmware/*/*.[ch] firmware/*/board/*.[ch] sim/emulator/*.[ch] sim/kernel/*.[ch] host/native/*.[ch])
TEST_C_FILES := $(wildcard tests/fuzz/*.c tests/referee/*.[ch] tests/referee/*/*.c)

.PHONY: all stream test fast lint sanitize fuzz wheel bench format clean

all: $(STAMP)

$(VENV)/.dependencies: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON) is older than Python 3.11: run 'make PYTHON=python3.11'"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet --disable-pip-version-check "setuptools>=77" "cffi>=1.16"
	touch $@

$(STAMP): $(VENV)/.dependencies setup.py host/native/build.py $(C_FILES)
	$(PY) -m pip install --quiet --disable-pip-version-check --no-build-isolation --editable ".[dev]"
	@# Another client for the tests (GPL). cflib.cpx needs none of its dependencies.
	@$(PY) -m pip install --quiet --disable-pip-version-check --no-deps "cflib==0.1.34" || \
	  echo "cflib cannot be installed: the tests with it will be skipped"
	touch $@

stream: $(STAMP)
	$(VENV)/bin/host stream --port sim://hover --count 60 --picture "$$(mktemp -d)/last-frame.png"

test: lint fast sanitize fuzz wheel

fast: $(STAMP)
	$(PY) -m pytest -q

lint: $(STAMP)
	@# pytest imports test files by their name alone.
	@! ls tests/test_*.py tests/*/test_*.py | xargs -n1 basename | sort | uniq -d | grep . || \
	  { echo "two test files of this name: pytest takes only one"; exit 1; }
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/clang-format --dry-run --Werror $(filter-out host/native/_%,$(C_FILES)) $(TEST_C_FILES)
	@# A build at a user's only warns; here a warning is an error. The firmware's own check is a test.
	gcc -std=c11 -O1 -Wall -Wextra -Wconversion -Werror -fsyntax-only $(wildcard sim/*/*.c host/native/[a-z]*.c)

# The Python tests once more, against C built with AddressSanitizer and UndefinedBehaviorSanitizer.
sanitize: $(STAMP)
	tests/sanitize.sh $(PY)

fuzz:
	tests/fuzz/run.sh

# sdist -> wheel -> empty environment -> five frames.
wheel: $(STAMP)
	tests/wheel.sh $(PY)

bench: $(STAMP)
	for script in benchmarks/*.py; do $(PY) $$script || exit 1; done

format: $(STAMP)
	$(VENV)/bin/ruff check --fix .
	$(VENV)/bin/ruff format .
	$(VENV)/bin/clang-format -i $(filter-out host/native/_%,$(C_FILES)) $(TEST_C_FILES)

clean:
	rm -rf $(VENV) build dist *.egg-info host/native/_native.*
