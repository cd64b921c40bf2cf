# Needs Python 3.10 or newer with its venv module, make and, for the first run, a package index that pip reaches.
# `make demo` and `make test` install by themselves what they need, into .venv; a second run finds it there.
# Another interpreter: make PYTHON=python3.12 test

PYTHON = python3
VENV = .venv
BIN = $(VENV)/bin
NUMPY1 = .venv-numpy1
PEERS = .venv-peers
PEERS_PYTHON = python3.11

# Every pinned version exists as a wheel but that of EmPy, which is pure Python; so nothing needs a compiler. Without
# build isolation it is the pinned setuptools that builds EmPy and this package. Byte code is written when a module is
# first imported, which is much less than all of it at installation.
INSTALL = -m pip install --quiet --disable-pip-version-check --prefer-binary --no-compile --no-build-isolation --use-pep517
export PYTHONDONTWRITEBYTECODE =

METADATA = setup.py setup.cfg pyproject.toml constraints.txt

.PHONY: demo test lint format test-numpy1 peers clean

demo: $(VENV)/ros.done
	@echo "==> demo: the T-shirt on the young woman, by a node and a client in processes of their own"
	@$(BIN)/python -m cloth_sim_ros.demo --output demo

test: $(VENV)/test.done
	@echo "==> tests, in two processes"
	@$(BIN)/python -m pytest --numprocesses 2 --dist loadgroup

lint: $(VENV)/test.done
	@echo "==> format (ruff)"
	@$(BIN)/ruff format --check .
	@echo "==> lint (ruff)"
	@$(BIN)/ruff check .
	@echo "==> types (mypy)"
	@$(BIN)/mypy

format: $(VENV)/test.done
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

# The core with the NumPy of Ubuntu 24.04 and without ROS. Needs Python 3.12 or older.
test-numpy1: $(NUMPY1)/core.done
	@echo "==> tests of the core with NumPy 1.26, without ROS"
	@$(NUMPY1)/bin/python -m pytest tests/core

# Other simulators to compare with (1 GB); only `python benchmarks/speed.py` uses them.
peers: $(PEERS)/peers.done

clean:
	rm -rf $(VENV) $(NUMPY1) $(PEERS) build install log demo *.egg-info .pytest_cache .hypothesis .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/made.done: constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	    { echo "$(PYTHON) is older than Python 3.10; choose another one: make PYTHON=python3.12"; exit 1; }
	@echo "==> making the environment $(VENV) with `$(PYTHON) --version`"
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python $(INSTALL) --constraint constraints.txt setuptools
	@touch $@

$(VENV)/core.done: $(VENV)/made.done $(METADATA)
	@echo "==> installing the simulator as wheels (200 MB to download the first time)"
	@$(BIN)/python $(INSTALL) --constraint constraints.txt --editable .
	@touch $@

# A run that ends at once makes numba compile, and keep, what every other one will need, while pip downloads.
COMPILE = $(BIN)/cloth-sim drape tshirt --body young --quality draft --max-time 0.001 > $(VENV)/compile.log 2>&1

$(VENV)/ros.done: $(VENV)/core.done
	@echo "==> installing ROS 2 as wheels (50 MB to download the first time), compiling the simulator meanwhile"
	@$(COMPILE) & $(BIN)/python $(INSTALL) --constraint constraints.txt --editable '.[ros]' && wait
	@touch $@

$(VENV)/test.done: $(VENV)/core.done
	@echo "==> installing ROS 2 and what tests and checks need as wheels, compiling the simulator meanwhile"
	@$(COMPILE) & $(BIN)/python $(INSTALL) --constraint constraints.txt --editable '.[ros,test,lint]' && wait
	@touch $(VENV)/ros.done $@

$(NUMPY1)/core.done: $(METADATA)
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info < (3, 13))' || \
	    { echo "NumPy 1.26 needs Python 3.10 to 3.12; choose one: make PYTHON=python3.12 test-numpy1"; exit 1; }
	@echo "==> making the environment $(NUMPY1) with `$(PYTHON) --version` and NumPy 1.26"
	@$(PYTHON) -m venv $(NUMPY1)
	@grep -v -E '^(numpy|scipy|numba|llvmlite)==' constraints.txt > $(NUMPY1)/constraints.txt
	@$(NUMPY1)/bin/python $(INSTALL) --constraint $(NUMPY1)/constraints.txt setuptools
	@$(NUMPY1)/bin/python $(INSTALL) --constraint $(NUMPY1)/constraints.txt 'numpy==1.26.*' --editable '.[test]'
	@touch $@

$(PEERS)/peers.done: benchmarks/peers/requirements.txt
	@echo "==> installing other simulators as wheels into $(PEERS)"
	@$(PEERS_PYTHON) -m venv $(PEERS)
	@$(PEERS)/bin/python -m pip install --quiet --disable-pip-version-check --prefer-binary -r $<
	@touch $@
