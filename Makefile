# Everything stands in .venv inside the project; nothing needs to be installed by hand but
# Python 3.11 or newer and make.
PYTHON ?= python3
BIN := .venv/bin
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
ROOMS := polemap stereo localize tools vehicle electric drivelog evaluate simulate benchmarks
NATIVE := $(wildcard stereo/native/*.?pp localize/particle_filter/native/*.?pp simulate/native/*.?pp polemap/detect/native/*.?pp vehicle/native/*.?pp)

.PHONY: setup demo test check check-docs lint bench city campaign figures docs site lock clean

setup: .venv/.ready

.venv/.ready: pyproject.toml setup.py requirements.lock $(NATIVE)
	$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("polemap needs Python 3.11 or newer, this is " + sys.version.split()[0] + ": set PYTHON=python3.11")'
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps --no-compile -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps --no-compile -e .
	@# on all cores, and here: where nobody may write bytecode later, every start would compile it anew;
	@# packages hold templates and tests that are no Python, which is no error
	$(BIN)/python -m compileall -qq -j 0 .venv/lib $(ROOMS) || true
	touch $@

demo: setup
	$(BIN)/polemap demo --out demo

test: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

check: lint test

# what the docs name and CI has no time for
check-docs: setup
	$(BIN)/python -m pytest -m docs tests/test_docs_commands.py

# Tables I to III and Figures 5 to 8 of the source paper, and the worlds that are set aside
figures: setup
	$(BIN)/python -m benchmarks.figures --out figures
	$(BIN)/python -m benchmarks.localize.set_aside --rows figures/set_aside.jsonl

bench: setup
	$(BIN)/python -m benchmarks

city: setup
	$(BIN)/python -m benchmarks.localize.city_growth --poles 1000 10000 100000 1000000

campaign: setup
	$(BIN)/python -m benchmarks.campaign
	$(BIN)/python -m benchmarks.campaign.readers --seconds 7200
	$(BIN)/python -m benchmarks.campaign.kills --kills 200

docs: setup
	$(BIN)/python -m docs.make_settings
	$(BIN)/python -m docs.make_third_party

site: setup
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/site

lock:
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile pyproject.toml --extra all --extra dev --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header -o requirements.lock

clean:
	rm -rf .venv build *.egg-info demo
