# make demo   generate, train, evaluate and report, from a bare Python 3.11
# make test   lint, types and tests
# make help   the rest
PYTHON ?= $(shell command -v python3.11 || echo python3)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
PEERS := $(VENV)/.peers
# Recordings that are not part of the project; without them what needs them is left out, by name.
LBGC_REAL_LOGS ?= $(abspath $(wildcard ../shared/real-logs))
ifneq ($(LBGC_REAL_LOGS),)
export LBGC_REAL_LOGS
endif

# SENSOR-PROTOCOL; what a learner can have of each: see lbgc/learning/pretrained.py
PRETRAINED := sdc500-static sdc500-two_position sdc500-carousel stim300-two_position kvh1775-two_position

.PHONY: help install demo test check format golden keys bench study picture pretrained clean

help:
	@echo "make demo      generate, train, evaluate, report (after the install: two minutes)"
	@echo "make test      check, then the tests"
	@echo "make check     lint, formatting and types"
	@echo "make format    put the code into the house style"
	@echo "make golden    record anew what must not change, tests/golden/ (and say why in the CHANGELOG)"
	@echo "make keys      write docs/keys.md, every key of imu, scene and protocol, anew"
	@echo "make picture   draw the README's pictures, docs/turntable.png and slew.gif, anew"
	@echo "make pretrained  train the small models that come with the package, lbgc/pretrained/, anew"
	@echo "make bench     speed against the machine's limits, to outputs/bench/"
	@echo "make study     every study, to outputs/studies/; make study-NAME: one ($(STUDIES))"
	@echo "make install   only the environment, in $(VENV)"

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,onnx]'
	@touch $@

# Public tools to compare with, and dask to try; nothing else needs them.
$(PEERS): $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[bench,dask]'
	@touch $@

demo: $(STAMP)
	@echo "== a training set: 3000 recordings of one sensor, as 5 s means"
	$(BIN)/python sim/generate.py experiment=demo_train
	@echo "== a test set: 72 other recordings of the same sensor, every sample"
	$(BIN)/python sim/generate.py experiment=demo_test
	@echo "== training"
	$(BIN)/python lbgc/train.py data=outputs/demo/train.zarr experiment=demo
	@echo "== evaluation on the test set"
	$(BIN)/python lbgc/evaluate.py data=outputs/demo/test.zarr run=outputs/train/latest
	@if [ -f "$(LBGC_REAL_LOGS)/lasergyro.imu" ]; then \
	  echo "== evaluation on a real log (the model knows another sensor: see what that costs)"; \
	  $(BIN)/python lbgc/evaluate.py log=lasergyro run=outputs/train/latest; \
	else echo "== no real log here: set LBGC_REAL_LOGS to the directory of lasergyro.imu"; fi
	@echo "== open the reports above in a browser"

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy --strict -p lbgc.sensor -p lbgc.estimators -p lbgc.data

test: check
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

golden: $(STAMP)
	PYTHONPATH=tests OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python tests/recording.py

keys: $(STAMP)
	PYTHONPATH=tests $(BIN)/python tests/keys.py

# One core is what most figures are for.
bench: $(PEERS)
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=tests:tests/studies $(BIN)/python tests/bench/bench.py

STUDIES := $(filter-out common scoring swaying transactional_% vehicle_likeness,$(basename $(notdir $(wildcard tests/studies/*.py))))

study: $(addprefix study-,$(STUDIES))

study-%: $(PEERS)
	PYTHONPATH=tests:tests/studies $(BIN)/python tests/studies/$*.py

picture: $(STAMP)
	$(BIN)/python sim/scene.py out=docs/turntable.png
	$(BIN)/python sim/scene.py out=docs/slew.gif width=640 height=400

pretrained: $(addprefix pretrained-,$(PRETRAINED))

pretrained-%: $(STAMP)
	$(BIN)/python sim/generate.py imu=$(word 1,$(subst -, ,$*)) protocol=$(word 2,$(subst -, ,$*)) \
	  recordings=3000 units=3000 split_by=unit split=[90,10,0] output=means out=outputs/pretrained/$*.zarr
	$(BIN)/python lbgc/train.py data=outputs/pretrained/$*.zarr experiment=pretrained \
	  windows_s=$(if $(findstring static,$*),[10$(comma)20$(comma)30$(comma)60$(comma)240],[240])
	mkdir -p lbgc/pretrained/$*
	cp outputs/train/latest/model.json outputs/train/latest/model.safetensors lbgc/pretrained/$*/

comma := ,

clean:
	rm -rf outputs/* .mypy_cache .pytest_cache .ruff_cache
