# Two commands do everything on a fresh machine, virtual environment included: `make benchmark` and `make test`.
PYTHON ?= python3
BIN := .venv/bin
WORKERS ?= 2
export OMP_NUM_THREADS ?= 1
# Many tests start processes: byte code is kept, whatever the shell says.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: benchmark mixocity mixocity-failures weights pictures test integration integrations rendering site faults browser coverage lint types unit format clean

benchmark: .venv/installed  ## the leaderboard on the bundled recordings
	$(BIN)/mixo benchmark

mixocity: .venv/integrations  ## the bundled recordings anew, from nothing: hours; resumable
	$(BIN)/python -m experiments.mixocity --workers $(WORKERS)

mixocity-failures: .venv/installed  ## the failure suite and its table, from nothing: hours; resumable
	$(BIN)/python -m experiments.failures --workers $(WORKERS) --stages record table sample
	cp results/failures/failures.json mixo_env/leaderboard/
	cp results/failures/failures.png docs/figures/

weights: .venv/installed  ## weights that come with the package, anew; needed after new recordings or another fit; resumable
	$(BIN)/mixo train --all --out mixo_env/policies/weights --workers $(WORKERS)

# The images of the GIF's scene lie where `make mixocity` keeps them.
pictures: .venv/integrations  ## figures of README and the page to play, after new recordings; PPO is trained for one of them
	$(BIN)/python -m docs._pages.play
	$(BIN)/python -m docs._pages.episode_gif --dataroot $$HOME/.cache/mixocity/city
	$(BIN)/python -m docs._pages.fusion_drives
	$(BIN)/python -m docs._pages.metric_drawings
	$(BIN)/python -m experiments.budget
	$(BIN)/mixo benchmark --out results/pictures
	cp results/pictures/trajectories.png docs/figures/

# Pyright keeps one core busy for over a minute, so it runs beside the tests: three processes leave no core idle.
test: lint  ## what every change must pass
	$(MAKE) --jobs=2 types unit

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/installed
	$(BIN)/pyright

unit: .venv/installed
	$(BIN)/python -m pytest -n 2 --dist loadscope -m "not integration"

integration: integrations rendering site faults browser  ## minutes each; peers that are absent are skipped

integrations: .venv/integrations  ## other libraries, programs and virtual environments
	$(BIN)/python -m pytest -n 2 --dist loadscope -m "integration and not rendering and not site and not faults and not browser"

rendering: .venv/integrations  ## what the simulator draws
	$(BIN)/python -m pytest -n 2 --dist loadscope -m rendering

site: .venv/integrations  ## README, pages and notebook, followed word by word
	$(BIN)/python -m pytest -n 2 --dist load --maxschedchunk 1 -m site

faults: .venv/integrations  ## kills and damage at random
	$(BIN)/python -m pytest -n 2 --dist loadscope -m faults

browser: .venv/integrations  ## pages opened in Chromium, found by MIXO_CHROMIUM or on the path
	$(BIN)/python -m pytest -m browser

# Machine code leaves no trace, so the second run takes the kernels as plain Python, on tests with tiny inputs;
# a drive through the image front end is none of these.
TRACED := $(wildcard tests/test_metrics_*.py tests/test_envs_*.py tests/test_recordings_*.py tests/test_policies_*.py)
TRACED += $(wildcard tests/test_faults_*.py tests/test_leaderboard_*.py tests/test_sequences*.py tests/test_pose_lag*.py)
TRACED += tests/test_baselines.py tests/test_baselines_rules.py tests/test_baselines_learning.py tests/test_fusion.py
TRACED += tests/test_fault_contract.py tests/test_cli_export.py tests/test_cli_record.py tests/test_track_unequal.py
LIBRARIES := tests/test_recordings_cluster.py tests/test_envs_integrations.py
KERNELS := tests/test_envs_replay.py tests/test_envs_budget.py

coverage: .venv/integrations  ## branches of the plain Python and of the kernels that tests take, in four packages
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -m "not integration" $(TRACED)
	$(BIN)/coverage run --append -m pytest $(LIBRARIES)
	NUMBA_DISABLE_JIT=1 $(BIN)/coverage run --append -m pytest -m "not integration" -k "not really_switched" $(KERNELS)
	$(BIN)/coverage report
	$(BIN)/coverage json --quiet
	$(BIN)/python .ci/branches coverage.json 95

format: .venv/installed
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

.venv/integrations: .venv/installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev,cluster,integrations,torchrl,learned,browser,view,tensorboard]'
	touch $@

clean:  ## everything made here, machine code kept between runs included
	rm -rf .venv build dist *.egg-info results
	rm -rf "$${XDG_CACHE_HOME:-$$HOME/.cache}/mixo-env/numba" $(if $(NUMBA_CACHE_DIR),$(NUMBA_CACHE_DIR)/mixo_env.*-*)
	find . -name '*.nb[ic]' -delete
