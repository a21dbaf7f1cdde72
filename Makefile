# Needs python3 (3.9 or newer), gcc and make; the rest goes below BUILD_DIR.
#
#   make test     prepare the hosts, lint, run the tests: some minutes
#   make test-rest  the cases that make test leaves out; make test-each: both,
#                 each case on one host
#   make test-all  every case on every host: an hour or two
#   make one T=tests/modules/test_x.py::test_y  one test, with what to read
#                 when it fails
#   make quick    lint, what needs no host, each command on one: a minute
#   make demo     watch a calibration on a simulated printer
#   make printer  a simulated printer to play with, in any web interface
#   make faults   break something at every operation of every command
#   make walks    any order of commands on any printer, the world as the judge
#   make planted  single faults in the modules, and which tests find them
#   make noop     which tests pass although no command of ours does anything
#   make shape    how many functions and files each command runs through
#   make test-firmware  the same commands on micro-controller programs of yours
#   make hosts    prepare and list the klippy hosts, and Moonraker
#   make bench    time, error and cost of calibrations, as text and as a chart
#   make docs     the documents as a site, build/site/index.html
#   make lint     style and syntax only
#   make format   bring the sources into shape
#   make update-pins  newer versions of what is downloaded
#   make clean    remove all that was built
#
# KLIPPER_PATH         Klipper or Kalico checkouts to test on, a:b:c
#                      (default ~/klipper where it exists; empty for none)
# FIRMWARE             programs that you have built, for make test-firmware:
#                      a/klipper.elf:b/klipper.elf
# ALLOW_MISSING_HOSTS  1: do without hosts, or Moonraker, that cannot be
#                      downloaded
# ONE_HOST             1: all tests on one host, the first checkout or package
# T                    the test of make one, a file or with ::, also with [ ]
# PYTEST_WORKERS       tests run at the same time (default 3)
# PYTEST_ARGS          further arguments for pytest, such as -k or a file
# BENCH_ARGS           arguments for make bench, such as --seeds 10
# DEMO_ARGS            arguments for make demo, such as --scene cartesian
# PRINTER_ARGS         arguments for make printer, such as --scene extra_probe
# NOOP_ARGS            arguments for make noop, tests (default tests/modules)
# SHAPE_ARGS           arguments for make shape, modules to set beside ours, such
#                      as z_calibration=~/other/z_calibration.py
# WALKS_ARGS           arguments for make walks, such as --count 1000 --seed 5
# PLANTED_ARGS         arguments for make planted, such as --count 300 --seed 5
# FAULTS_ARGS          arguments for make faults, such as --seed 7 or --pairs 2000

PYTHON ?= python3
BUILD_DIR ?= build
PYTEST_WORKERS ?= 3
PYTEST_ARGS ?=
BENCH_ARGS ?=
DEMO_ARGS ?=
PRINTER_ARGS ?=
FAULTS_ARGS ?=
WALKS_ARGS ?=
PLANTED_ARGS ?=
SHAPE_ARGS ?=
NOOP_ARGS ?= tests/modules
export BUILD_DIR

TOOLS = $(BUILD_DIR)/venv/bin
# These tell an old Python that it is too old
DOORS = $(wildcard *.py)

# vermin takes any variable called file for that of Python 2.
# Python 2.7 refuses what vermin allows, such as a comma behind *args
COMPILE = import sys; [compile(open(f).read(), f, 'exec') for f in sys.argv[1:]]

# Test files import each other as tests.*, from the root of the repository.
.PHONY: test test-rest test-each test-all one test-firmware quick noop demo
.PHONY: printer bench shape faults walks planted hosts prepared checked
.PHONY: docs lint format tools update-pins clean

test test-rest test-each test-all: checked
	$(TOOLS)/python -m pytest --cases $(@:test-%=%) -n $(PYTEST_WORKERS) \
		--dist loadfile --no-loadscope-reorder $(PYTEST_ARGS)

one: prepared
	@test -n "$(T)" || { echo "make one T=tests/modules/test_x.py::test_y" >&2; \
		exit 2; }
	$(TOOLS)/python -m pytest --cases one "$(T)" $(PYTEST_ARGS)

test-firmware: prepared
	FIRMWARE="$(FIRMWARE)" $(TOOLS)/python -m pytest --cases all \
		-n $(PYTEST_WORKERS) tests/firmware $(PYTEST_ARGS)

quick: checked
	ONE_HOST=1 $(TOOLS)/python -m pytest -n 2 tests/unit tests/quick

noop: prepared
	ONE_HOST=1 $(TOOLS)/python -m pytest -p tools.noop -q --tb=no -r "" \
		--cases all -n 2 --dist loadfile $(NOOP_ARGS)

# Without the linters and what else the tests need
demo:
	@$(PYTHON) -m simprinter.hosts.environment "$(BUILD_DIR)/demo-venv" demo
	$(BUILD_DIR)/demo-venv/bin/python -m tools.demo $(DEMO_ARGS)

printer: tools
	$(TOOLS)/python -m tools.playground $(PRINTER_ARGS)

bench: prepared
	$(TOOLS)/python -m tools.bench $(BENCH_ARGS)
	$(TOOLS)/python -m tools.bench.automatic

shape: prepared
	$(TOOLS)/python -m tools.shape $(SHAPE_ARGS)

faults: prepared
	$(TOOLS)/python -m tools.campaign faults $(FAULTS_ARGS)

walks: prepared
	$(TOOLS)/python -m tools.campaign walks $(WALKS_ARGS)

planted: prepared
	ONE_HOST=1 $(TOOLS)/python -m tools.planted $(PLANTED_ARGS)

hosts:
	@$(PYTHON) -m simprinter.hosts.prepare

docs:
	@$(PYTHON) -m simprinter.hosts.environment "$(BUILD_DIR)/docs-venv" docs
	$(BUILD_DIR)/docs-venv/bin/python -m tools.site

# At the same time: a tenth to a quarter less time on an empty machine
prepared:
	@$(MAKE) --no-print-directory -j2 tools hosts

# lint needs tools
checked:
	@$(MAKE) --no-print-directory -j2 lint hosts

lint: tools
	$(TOOLS)/ruff check .
	$(TOOLS)/ruff format --check .
	$(TOOLS)/mypy
	$(TOOLS)/vermin --no-tips --violations --target=3.8- --exclude file \
		$(wildcard z_touch/*.py z_touch/*/*.py)
	$(TOOLS)/vermin --no-tips --violations --target=2.7- --target=3.4- $(DOORS)
	$(TOOLS)/vermin --no-tips --violations --target=3.9- --exclude file \
		simprinter simplay tools tests
	@for python in ~/.pyenv/versions/2.7*/bin/python2.7 python2.7; do \
		$$python -c "" 2>/dev/null && exec $$python -c "$(COMPILE)" $(DOORS); \
	done; echo "NOT COMPILED by Python 2.7, which is not to be had: $(DOORS)"
	$(TOOLS)/shellcheck -x install.sh .ci/run tools/kit/services/*

format: tools
	$(TOOLS)/ruff check --fix .
	$(TOOLS)/ruff format .

# Quick when everything is there: it compares a stamp.
tools:
	@$(PYTHON) -m simprinter.hosts.environment "$(BUILD_DIR)/venv" tools

# Other versions of all that is downloaded, with the hashes of their files
update-pins:
	@$(PYTHON) -m simprinter.hosts.environment "$(BUILD_DIR)/pins" pins
	for name in requirements/*.in simprinter/requirements/*.in; do \
		"$(abspath $(BUILD_DIR))/pins/bin/uv" pip compile --quiet --upgrade \
			--universal --generate-hashes --no-header --no-annotate \
			--python-version $$(sed -n 's/^# Python //p' $$name | grep . || echo 3.9) \
			$$(grep -qx '# no-deps' $$name && echo --no-deps) \
			--output-file $${name%.in}.txt $$name; \
	done

# Only a directory that the build made itself is removed.
clean:
	@test ! -e "$(BUILD_DIR)" || test -e "$(BUILD_DIR)/.made-for-this-build" || \
		{ echo "$(BUILD_DIR) was not made by this build: remove what you want" \
		"to be gone by hand" >&2; exit 1; }
	rm -rf -- "$(BUILD_DIR)"
