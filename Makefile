# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
PYTHON ?= python3
ROS ?=
DURATION ?=
SOIL ?=
SCENARIO ?=
VEHICLE ?=
OUTPUT ?=
LIVE ?=
RUNS ?=
FILES ?=
BAGS ?=
SPEED ?=
SEEDS ?=
ARGS ?=
VENV := .venv/bin
ENTER := . .venv/trackslip.sh;

.DEFAULT_GOAL := help
.PHONY: help setup checks demo bars drives cases sweep test slow faults soak units lint ament bench fuzz bags wheel numbers figures docs clean

help:
	@awk -F ':.*## ' '/^[a-z]+:.*## / { \
		line = sprintf("make %-7s", $$1); n = split($$2, words, " "); \
		for (k = 1; k <= n; k++) { \
			if (length(line) + length(words[k]) >= 80) { print line; line = sprintf("%12s", "") } \
			line = line " " words[k] } \
		print line }' $(MAKEFILE_LIST)

setup: ## make .venv and build ros2_ws; nothing where nothing changed (ROS=jazzy|kilted, PYTHON=python3)
	@$(PYTHON) scripts/setup_workspace.py --ros '$(ROS)'

checks: # setup, with what lint and tests take
	@$(PYTHON) scripts/setup_workspace.py --ros '$(ROS)' --checks

demo: setup ## drive the emulated excavator, record, replay, score; results in out/demo (DURATION=40 SOIL=sand SCENARIO=thesis VEHICLE=pc05; LIVE=0: without its page)
	@$(ENTER) exec $(VENV)/python -m trackslip_sim.demo.main $(if $(DURATION),--duration '$(DURATION)') $(if $(SOIL),--soil '$(SOIL)') $(if $(VEHICLE),--vehicle '$(VEHICLE)') \
		$(if $(SCENARIO),--scenario '$(SCENARIO)') $(if $(OUTPUT),--output '$(OUTPUT)') $(if $(filter 0,$(LIVE)),--no-live)

bars: setup ## errors on drives like the demo's on four soils, with and without laser and gyro, beside their limits
	@$(ENTER) cd tests && exec ../$(VENV)/python -m fixtures.demo_bars

drives: setup ## forty random drives of random machines, in and out of the laser's sight, against their bars (SEEDS=40)
	@$(ENTER) cd tests && exec ../$(VENV)/python -m fixtures.random_drives.main $(if $(SEEDS),--seeds '$(SEEDS)')

cases: setup ## drives with injected faults, scored beside those of a baseline, and their bars (ARGS='--only marmotte --json FILE')
	@$(ENTER) exec $(VENV)/python tests/fixtures/fault_cases/main.py $(ARGS)

sweep: setup ## each fault of the cases at many times of real logs, a quarter of an hour (ARGS='--only encoder')
	@$(ENTER) exec $(VENV)/python tests/fixtures/fault_cases/sweep.py $(ARGS)

# A module's tests run in one worker, and those with whole graphs (group graph) one by one: two more workers than
# cores use what these wait for. A failed one of tests/graph is tried again and reported: a busy machine can stall
# a process for seconds. The interrupt at the end of two hours, for what hangs, leaves the names of what had failed.
test: checks ## all tests but the slow ones
	@$(ENTER) exec timeout --foreground --signal=INT --kill-after=60 7200 \
		$(VENV)/python -m pytest -n 4 --dist loadgroup --no-loadscope-reorder -m 'not slow and not soak' -rR

lint: checks ## ruff and mypy
	$(VENV)/python -m ruff check .
	$(VENV)/python -m ruff format --check .
	$(VENV)/python -m mypy

ament: setup ## ROS's own linters, with the agreed configuration
	@$(VENV)/python -m pip install -q -r requirements/ament.txt
	@$(ENTER) $(VENV)/ament_flake8 --config .flake8 src
	@$(ENTER) exec $(VENV)/ament_pep257 --convention google --add-ignore D100 D102 D105 D107 D402 D403 -- src

faults: checks ## a hundred faults of all sensors, of the GNSS receiver, and a hundred kills, in a row against the real nodes; half an hour
	@$(ENTER) exec $(VENV)/python -m pytest -s -m soak

slow: checks ## tests that take more than some seconds, and a few hours together (ARGS='-k tune')
	@$(ENTER) exec $(VENV)/python -m pytest -n 2 --dist loadgroup --timeout=7200 -m slow $(ARGS)

units: checks ## the command of each systemd unit for half a minute in the read-only file system of its service
	@$(ENTER) exec $(VENV)/python -m pytest -m slow tests/graph/test_units.py

soak: setup ## the graph at ten times its speed, and what grows meanwhile; page in out/soak (DURATION=300, SPEED=10)
	@$(ENTER) exec $(VENV)/python tests/soak/soak.py $(if $(DURATION),--duration '$(DURATION)') $(if $(SPEED),--speed '$(SPEED)')

bench: setup ## speed of filters and drivers on this machine
	@$(VENV)/python -m pip install -q -r requirements/bench.txt
	@$(ENTER) exec env PYTHONPATH="tests:$$PYTHONPATH" $(VENV)/python tests/bench/bench.py

fuzz: checks ## random measurements and messages for the estimators, hostile files for every reader (FILES=500 each), hostile bags for every command (BAGS=246), then random bytes into every decoder (RUNS=10000 each, by hypothesis)
	@$(ENTER) $(VENV)/python tests/fuzz/random_steps.py
	@$(ENTER) $(VENV)/python tests/fuzz/fuzz_messages.py
	@$(ENTER) env PYTHONPATH="tests:$$PYTHONPATH" $(VENV)/python tests/fuzz/hostile_files.py $(if $(FILES),--files '$(FILES)')
	@$(ENTER) env PYTHONPATH="tests:$$PYTHONPATH" $(VENV)/python tests/fuzz/hostile_recordings.py $(if $(BAGS),--bags '$(BAGS)')
	@$(ENTER) RUNS='$(RUNS)' exec $(VENV)/python -m pytest -n auto --timeout=0 tests/fuzz --hypothesis-profile=fuzz

bags: setup ## record the runs of bags/ again, with their manifest (ARGS=--numbers: only what replays of them give)
	@$(ENTER) exec $(VENV)/python scripts/make_bags.py $(ARGS)

wheel: setup ## the Python package of all desk commands, in dist/; no ROS in it (ARGS=--pure: without machine code)
	@$(VENV)/python -m pip install -q -r requirements/wheel.txt
	@$(ENTER) exec $(VENV)/python scripts/make_wheel.py $(ARGS)

numbers: setup ## the measured figures of docs/, written again (ARGS='slopes swing': of these pages)
	@$(ENTER) exec $(VENV)/python scripts/make_numbers.py $(ARGS)

figures: setup ## the pictures of docs/figures (ARGS=--demo: that of the README alone)
	@$(ENTER) exec $(VENV)/python scripts/figures.py $(ARGS)

docs: setup ## the documents as a site with offline search in out/docs, its links checked; words a sentence by page
	@$(VENV)/python -m pip install -q -c requirements/constraints.txt -r requirements/docs.txt
	@$(ENTER) exec $(VENV)/python scripts/make_docs.py

clean: ## remove what make set up: .venv, the build, caches; results in out/ stay
	@if ls .venv/trackslip* > /dev/null 2>&1; then \
		find .venv -mindepth 1 -maxdepth 1 ! -name 'trackslip*' -exec rm -rf {} + && rm -rf .venv; \
	elif [ -e .venv ]; then echo "make clean: .venv was not made by make setup, and stays"; fi
	rm -rf ros2_ws/build ros2_ws/install ros2_ws/log ros2_ws/setup.log .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
	@if [ -e out ]; then echo "make clean: out/, with results and recordings, stays"; fi
