# Every target makes the virtual environment it needs; nothing has to be installed by hand but Python 3.11 to 3.14, make and g++.
# Folders bear some of these names too: without .PHONY `make reports` would say "up to date" and do nothing.
.PHONY: reports results test test-all check bench bench-device validate worth docs wheel wheel-test view view-demo clean

PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3.14 python3; do \
	$$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 15))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
READY := .venv/.ready
FOLDERS := pipelines baselines metrics reports contrib
OUT ?= out/demo

# The evaluation: of DATA=<capture> under PROTOCOL=<name or file>, or of the demo capture.
reports: $(READY)
	$(BIN)/ggvs-eval run $(OUT) $(if $(DATA),--capture $(DATA)) $(if $(PROTOCOL),--protocol $(PROTOCOL))

# Every table and figure of README and docs, as far as it is older than the code: hours, in pieces. ONLY=name,name chooses, PLAN=1 tells
# states and minutes, DATA= and WEIGHTS= are folders of captures and checkpoints that do not ship. Killed, it goes on where it was.
results: $(READY)
	$(BIN)/python tools/docs/make_results.py $(if $(ONLY),--only $(ONLY)) $(if $(PLAN),--plan) $(if $(DATA),--data $(DATA)) \
		$(if $(WEIGHTS),--weights $(WEIGHTS))

# One process per core. Neighbours stay together, as the tests of a file share what takes long to make; who is done early helps.
# The order is shuffled, by the same seed for everybody: `make test SEED=$RANDOM` looks for tests that depend on their order.
# `make test ROOM=online` runs the tests of a room of the package and of the rooms that import it.
SEED ?= 1
ROOM ?=
# Tests start processes, each of which would compile the package again.
test test-all validate wheel-test: export PYTHONDONTWRITEBYTECODE :=
PYTEST := -m pytest -n auto --dist worksteal --randomly-seed=$(SEED) $(ROOM:%=--room %)

# Every test has one home (tests/conftest.py): what takes up to a second of a core is here,
test: $(READY)
	$(BIN)/python $(PYTEST) -m "not slow and not proof and not wheel"

# what takes seconds here, to be run once before a change lands, and what takes longer in `validate`.
test-all: $(READY)
	$(BIN)/python $(PYTEST) -m "slow and not proof"

check: $(READY) view
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	cd build/view && ../../$(BIN)/python -m mypy --config-file ../../setup.cfg ggvs_eval

# The live viewer on DATA=<capture or run folder>, or on a small demo capture: opens a port, not a browser.
VIEWED := out/view-demo/capture
view-demo: .venv/.view
	$(if $(DATA),,$(BIN)/ggvs-eval film $(VIEWED) --width 640 --n-frames 8 --cameras-per-row 6 --path-poses 0)
	$(BIN)/ggvs-eval view $(or $(DATA),$(VIEWED)) --out out/view-demo

.venv/.view: $(READY)
	$(BIN)/pip install --disable-pip-version-check -q -e '.[view]'
	touch $@

# Heavier proofs: whole runs, films and trainings; speed against peers (out/bench.json), quality on real captures (out/validate.json), by
# domains of captures (out/validate_domains.json) and by calibrations (out/validate_refinement.json).
bench: $(READY)
	$(BIN)/python -m benchmarks

# Where there is a GPU, by a Python that has CUDA's torch: the online step on it, checked against the CPU and timed part by part.
# It asks no network: Warp is installed already, or its wheel lies in WHEELS=<folder>.
bench-device: view
	$(if $(WHEELS),$(PYTHON) -m pip install -q --no-index --no-deps --upgrade --target build/wheels $(WHEELS)/*.whl)
	$(PYTHON) setup.py -q build_ext --inplace
	PYTHONPATH=build/view:.:build/wheels $(PYTHON) -P -m benchmarks.bench_device_step $(BENCH_OPTIONS)

validate: $(READY) wheel
	$(BIN)/python $(PYTEST) -m proof
	cd build/wheel && venv/bin/python $(PYTEST) $(OF_WHEEL) -m "not proof" tests
	$(BIN)/python -m benchmarks.worth_of_tests
	$(BIN)/python -m benchmarks.validate $(if $(DATA),--data $(DATA))
	$(BIN)/python -m benchmarks.domain_validation $(if $(DATA),--data $(DATA))
	$(BIN)/python -m benchmarks.refinement_validation

# Which of the faults in benchmarks/worth_of_tests.toml `make test` would find; ONLY=name,name chooses.
worth: $(READY)
	$(BIN)/python -m benchmarks.worth_of_tests $(if $(ONLY),--only $(ONLY))

# The site in build/site: the pages of docs/ and the docstrings of the public interface; a warning is an error.
docs: .venv/.docs view
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --clean
	@echo $(CURDIR)/build/site/index.html

.venv/.docs: $(READY)
	$(BIN)/pip install --disable-pip-version-check -q -e '.[docs]'
	touch $@

# What users get: the wheel, built from the source distribution, with no checkout in sight; its dependencies are those of .venv, and
# kernels of the same sources are not compiled again. The whole suite runs against it in `make validate`.
OF_WHEEL := -q -c /dev/null --rootdir . -p no:cacheprovider
wheel-test: wheel
	cd build/wheel && GGVS_EVAL_CHECKOUT=$(CURDIR) venv/bin/python $(PYTEST) $(OF_WHEEL) -m "not slow and not proof" \
		tests/wheel tests/kernels tests/test_doctests.py

wheel: $(READY)
	rm -rf build/wheel && mkdir -p build/wheel
	GGVS_EVAL_BUILT=$(CURDIR)/ggvs_eval/kernels $(BIN)/python -m build --outdir build/wheel . > build/wheel/build.log 2>&1 || \
		{ tail -20 build/wheel/build.log; exit 1; }
	$(BIN)/python -m venv --without-pip build/wheel/venv && $(BIN)/pip --python build/wheel/venv install -q --no-deps build/wheel/*.whl
	$(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))' \
		> "$$(echo build/wheel/venv/lib/python3*/site-packages)/dependencies.pth"
	cp -r tests build/wheel/tests

# The package as setup.cfg installs it, in links, for the type checker.
view:
	rm -rf build/view && mkdir -p build/view/ggvs_eval
	ln -s $(CURDIR)/ggvs_eval/* $(FOLDERS:%=$(CURDIR)/%) build/view/ggvs_eval/

clean:
	rm -rf .venv build out *.egg-info ggvs_eval/kernels/*.so

$(READY): setup.cfg setup.py pyproject.toml $(wildcard ggvs_eval/kernels/*.cpp ggvs_eval/kernels/*.hpp)
	@test -n "$(PYTHON)" || { echo "ggvs-eval needs Python 3.11, 3.12, 3.13 or 3.14"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/pip install --disable-pip-version-check -q -e '.[dev]'
	$(BIN)/python -m ggvs_eval.install
	touch $@
