# make demo   generate, train, evaluate and report, from a bare Python 3.11
# make test   lint, types and tests
# make help   the rest
PYTHON ?= $(shell command -v python3.11 || echo python3)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
PEERS := $(VENV)/.peers
TOOLS := $(VENV)/tools
# Recordings that are not part of the project; without them what needs them is left out, by name.
LBGC_REAL_LOGS ?= $(abspath $(wildcard ../shared/real-logs))
ifneq ($(LBGC_REAL_LOGS),)
export LBGC_REAL_LOGS
endif

# SENSOR-PROTOCOL; what a learner can have of each: see lbgc/learning/pretrained.py
PRETRAINED := sdc500-static sdc500-two_position sdc500-carousel stim300-two_position kvh1775-two_position

.PHONY: help install demo test check format golden keys bench study picture pretrained lock sbom clean

help:
	@echo "make demo      generate, train, evaluate, report (after the install: two minutes)"
	@echo "make test      check, then the tests"
	@echo "make check     lint, formatting and types"
	@echo "make format    put the code into the house style"
	@echo "make golden    record anew what must not change, tests/golden/ (and say why in the CHANGELOG)"
	@echo "make keys      write docs/keys.md, every key of imu, scene and protocol, anew"
	@echo "make picture   draw the README's pictures, docs/turntable.png, tumble.png and slew.gif, anew"
	@echo "make pretrained  train the small models that come with the package, lbgc/pretrained/, anew"
	@echo "make bench     speed against the machine's limits, to outputs/bench/"
	@echo "make study     every study, to outputs/studies/; make study-NAME: one ($(STUDIES))"
	@echo "make install   only the environment, in $(VENV)"
	@echo "make lock      write requirements*.lock, each file's checksum, anew from constraints.txt"
	@echo "make sbom      write docs/sbom.cdx.json and docs/licences.md, what is installed, anew"

install: $(STAMP)

PIP := -m pip --disable-pip-version-check
# Files whose checksum is in a lock and no others. What must be built is built by the lock's setuptools.
LOCKED := $(PIP) install --quiet --require-hashes --no-deps --no-build-isolation

# $(call locked,DIR): an environment of what requirements.lock says. PyTorch comes in two builds of one
# version, and each has its checksum there: the CPU's is taken wherever pip is offered it.
define locked
	$(PYTHON) -m venv --clear $(1)
	@sed -n '/^setuptools==/,/[^\\]$$/p' requirements.lock > $(1)/setuptools.lock
	$(1)/bin/python $(LOCKED) -r $(1)/setuptools.lock
	@build=$$(sed -n 's/^torch==\([^ ]*\).*/\1+cpu/p' requirements.lock); \
	$(1)/bin/python $(PIP) index versions torch 2>/dev/null | grep -ow "$$build" | head -n 1 \
	  | sed 's/^/torch==/' > $(1)/torch.txt
	$(1)/bin/python $(LOCKED) -r requirements.lock -c $(1)/torch.txt
endef

# PyTorch's other build needs NVIDIA's libraries.
$(STAMP): pyproject.toml requirements.lock requirements-cuda.lock
	$(call locked,$(VENV))
	@if $(BIN)/python $(PIP) show torch | grep triton > /dev/null; then set -x; \
	$(BIN)/python $(LOCKED) -r requirements-cuda.lock; fi
	$(BIN)/python $(PIP) install --quiet --no-deps --no-build-isolation -e .
	$(BIN)/python $(PIP) check
	@touch $@

# Public tools to compare with, and dask to try; nothing else needs them.
$(PEERS): $(STAMP) requirements-bench.lock
	$(BIN)/python $(LOCKED) -r requirements-bench.lock
	$(BIN)/python $(PIP) check
	@touch $@

# Tools that nobody needs but who writes the files: each in an environment of its own.
$(TOOLS)/%:
	$(PYTHON) -m venv --clear $@
	$@/bin/python $(PIP) install --quiet '$*' || { rm -rf $@; exit 1; }

UV := $(TOOLS)/uv==0.13.9
CYCLONEDX := $(TOOLS)/cyclonedx-bom==7.5.0
LICENSES := $(TOOLS)/pip-licenses==5.5.5

# torch-VERSION+cpu-cp311-cp311-manylinux_2_28_x86_64.whl: it is in PyTorch's own index, where uv does not look.
TORCH_CPU := 2.13.0 --hash=sha256:6746dbcbeb526eb61330b76b41ff1b4eb848951103a892eeb080dfa2b264667b
# What the build that PyPI has asks for besides.
CUDA := cuda-bindings cuda-toolkit nvidia-cudnn-cu13 nvidia-cusparselt-cu13 nvidia-nccl-cu13 \
  nvidia-nvshmem-cu13 triton
COMPILE := $(UV)/bin/uv pip compile --quiet --generate-hashes --python-version 3.11 --python-platform linux \
  --custom-compile-command 'make lock' --constraints constraints.txt pyproject.toml

# A file of the extras $(2) without what requirements.lock has; of $(3) nothing is looked at.
beside = $(COMPILE) $(addprefix --extra ,$(2)) $(addprefix --excludes ,$(3)) --output-file $(1) \
  $$(sed -n 's/^\([^ =]*\)==.*/--no-emit-package \1/p' requirements.lock)

lock: $(UV)
	rm -f requirements.lock requirements-cuda.lock requirements-bench.lock
	printf '%s\n' $(CUDA) > $(UV)/cuda.txt
	$(COMPILE) --extra dev --extra logs --extra onnx --excludes $(UV)/cuda.txt --output-file requirements.lock
	sed -i 's/^torch==$(word 1,$(TORCH_CPU)) .*/&\n    $(word 2,$(TORCH_CPU)) \\/' requirements.lock
	$(call beside,requirements-cuda.lock,dev logs onnx)
	$(call beside,requirements-bench.lock,bench dask,$(UV)/cuda.txt)

# With PyTorch's CPU build, as far as pip is offered it.
sbom: $(CYCLONEDX) $(LICENSES)
	$(call locked,$(TOOLS)/locked)
	$(TOOLS)/locked/bin/python $(PIP) uninstall --quiet --yes pip
	$(CYCLONEDX)/bin/cyclonedx-py environment --spec-version 1.6 --output-reproducible --short-PURLs \
	  --pyproject pyproject.toml --output-file docs/sbom.cdx.json $(TOOLS)/locked/bin/python
	$(LICENSES)/bin/pip-licenses --python $(TOOLS)/locked/bin/python --with-system --format json \
	  | $(PYTHON) tests/licences.py > docs/licences.md
	rm -r $(TOOLS)/locked

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

STUDIES := $(filter-out common scoring swaying logs_% transactional_% unit_learners_% vehicle_likeness,$(basename $(notdir $(wildcard tests/studies/*.py))))

study: $(addprefix study-,$(STUDIES))

study-%: $(PEERS)
	PYTHONPATH=tests:tests/studies $(BIN)/python tests/studies/$*.py

picture: $(STAMP)
	$(BIN)/python sim/scene.py out=docs/turntable.png
	$(BIN)/python sim/scene.py protocol=tumble out=docs/tumble.png width=640 height=480
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
