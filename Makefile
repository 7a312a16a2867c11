# The front end: a thin layer over CMake and the Python tools. `make` lists the targets.
# All results go to build/out/. UPDATE=1 also writes the figures into README and docs/.
# FORMAT=svg,pdf,npz also writes plots in these formats; npz has the data of a plot.

PYTHON ?= python3
BUILD := build
VENV := $(BUILD)/venv
TINYKOOP := $(VENV)/bin/tinykoop
PIP_OPTIONS := --quiet --disable-pip-version-check
JOBS := $(shell getconf _NPROCESSORS_ONLN 2>/dev/null || echo 2)
export TINYKOOP_FORMAT := $(FORMAT)
UPDATED := $(if $(UPDATE),--update)
FLOWN = $(or $(DATA),$(if $(filter quadrotor,$(PLATFORM)),$(wildcard ../shared/data/crazyflie)))
OWN := $(if $(DICTIONARY),--dictionary "$(DICTIONARY)")

# $(call install,ENVIRONMENT,FILES): installs the packages of requirements files; without network it prints one line.
install = $(1)/bin/pip install $(PIP_OPTIONS) --retries 2 $(addprefix -r ,$(2)) 2>$(BUILD)/pip-$(@F).log || { \
	echo "Cannot install the packages of $(2): is there a network? pip's messages are in $(BUILD)/pip-$(@F).log" >&2; exit 2; }

.PHONY: help system build c-tests demo test learn control transfer real flights ledger ablate windup diagnose blind fleet constants study supervisor bench targets settings coverage mutants fuzz static soak flips determinism flags sanitize amalgamate packagers wheel docs clean

help: ## list the targets
	@awk -F':.*## ' '/^[a-z-]+:.*## / { printf "  make %-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

# Checks the required programs, and prints how to install the missing ones.
system:
	@missing=; for tool in gcc cmake $(PYTHON); do \
		command -v $$tool >/dev/null || missing="$$missing $$tool"; done; \
	if [ -n "$$missing" ]; then \
		echo "Missing:$$missing. On Debian: sudo apt-get install gcc cmake make python3 python3-venv" >&2; exit 2; fi
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
		echo "Missing: python3-venv. On Debian: sudo apt-get install python3-venv" >&2; exit 2; }

$(VENV)/packages: tools/requirements.txt | system
	@echo "Python environment: about 85 MB of packages are downloaded once, which takes a minute or so ..."
	@rm -rf $(VENV)
	@$(PYTHON) -m venv $(VENV)
	@$(call install,$(VENV),tools/requirements.txt)
	@touch $@

# The tools themselves, from where they are: without their library, which is in build/host.
$(VENV)/ready: pyproject.toml lib/include/tinykoop.h $(VENV)/packages
	@$(VENV)/bin/pip install $(PIP_OPTIONS) --no-build-isolation --no-deps -e .
	@touch $@

# The packages that tests and comparisons need in addition to the tools.
$(VENV)/test-ready: tools/requirements-test.txt tools/requirements-mcap.txt $(VENV)/ready
	@echo "Packages for tests ..."
	@$(call install,$(VENV),tools/requirements-test.txt tools/requirements-mcap.txt)
	@touch $@

# The peers that both the benchmark and the blind evaluation of the diagnoser have.
$(VENV)/peers-ready: tools/requirements-peers.txt $(VENV)/ready
	@echo "Peers ..."
	@$(call install,$(VENV),tools/requirements-peers.txt)
	@touch $@

# The solvers and learners of the benchmark: large, and needed only here.
$(VENV)/bench-ready: tools/requirements-bench.txt $(VENV)/test-ready $(VENV)/peers-ready
	@echo "Solvers and learners for the benchmarks ..."
	@$(call install,$(VENV),tools/requirements-bench.txt)
	@touch $@

build: $(VENV)/ready ## everything for the host: libraries, simulator, Python environment with the tinykoop command
	@cmake -S . -B $(BUILD)/host >$(BUILD)/host.log || { cat $(BUILD)/host.log >&2; exit 1; }
	@cmake --build $(BUILD)/host -j $(JOBS) >>$(BUILD)/host.log || { cat $(BUILD)/host.log >&2; exit 1; }

demo: build ## the main job: every method learns and controls the DDR, precision study, one gap diagnosis (LOG=x.csv: also replays your log)
	@$(TINYKOOP) demo $(if $(LOG),--log "$(LOG)") $(UPDATED)

test: build c-tests $(VENV)/test-ready ## every test that needs no cross toolchain
	@ctest --test-dir $(BUILD)/test --output-on-failure -j $(JOBS)
	@$(VENV)/bin/python -m pytest -q -rs -n $(JOBS) --dist loadfile --no-loadscope-reorder test/python

c-tests: system
	@cmake -S . -B $(BUILD)/test -DTINYKOOP_TESTS=ON -DTINYKOOP_HOST=OFF
	@cmake --build $(BUILD)/test -j $(JOBS)

learn: build ## one-step learning of the differential drive (DDR), the paper's table (DICTIONARY=own.c:mine beside poly and rbf): learn.json
	@$(TINYKOOP) learn $(OWN) $(UPDATED)

control: build ## DDR Koopman-MPC tracking, the paper's table: control.json
	@$(TINYKOOP) control $(UPDATED)

transfer: build ## flapping wing across flight regimes, the paper's table (DATA=dir of own flights, pitch*.csv and yaw*.csv), or PLATFORM=quadrotor before and after a change (DATA=labelled flights, else ../shared/data/crazyflie if it is there): transfer.json, transfer_quadrotor.json
	@$(TINYKOOP) transfer $(if $(PLATFORM),--platform "$(PLATFORM)") $(if $(FLOWN),--data "$(FLOWN)") $(UPDATED)

real: build ## real logs replayed and, of drives, diagnosed (DATA="logs or folders of logs"): real.json
	@test -n "$(DATA)" || { echo "Which logs? make real DATA=folder" >&2; exit 2; }
	@$(TINYKOOP) real --data $(DATA) $(UPDATED)

flights: build $(VENV)/blind-ready ## labelled real flights of two Crazyflies: what is said of each, beside peers (DATA=folder, else ../shared/data/crazyflie): flights.json
	@$(TINYKOOP) flights --data "$(or $(DATA),../shared/data/crazyflie)" $(UPDATED)

ledger: build ## the paper's claims, our figures and verdicts, after learn, control, ablate, windup and transfer: ledger.json
	@$(TINYKOOP) ledger $(UPDATED)

ablate: build ## dead-zone threshold, 27 constant-trace settings, rollouts (DICTIONARY=): ablate.json
	@$(TINYKOOP) ablate $(OWN)

windup: build ## float32 against float64 for every dictionary, regulator and form (DICTIONARY=): windup.json
	@$(TINYKOOP) windup $(OWN) $(UPDATED)

diagnose: build ## sim-to-real gap of one log (LOG=x.csv, FRESH=y.csv, ROBOT=ddr, fwmav or your own bot.toml): diagnose/report.json, report.html
	@test -n "$(LOG)" || { echo "Which log? make diagnose LOG=drive.csv [FRESH=other.csv] [ROBOT=fwmav]" >&2; exit 2; }
	@$(TINYKOOP) diagnose "$(LOG)" $(if $(FRESH),--fresh "$(FRESH)") $(if $(ROBOT)$(PLATFORM),--robot "$(or $(ROBOT),$(PLATFORM))")

# The packages for the blind evaluation: peers of the diagnoser, and Dask.
$(VENV)/blind-ready: tools/requirements-blind.txt $(VENV)/peers-ready
	@echo "Dask ..."
	@$(call install,$(VENV),tools/requirements-blind.txt)
	@touch $@

# Simulation packages for your own robots.
$(VENV)/simulators-ready: tools/requirements-simulators.txt $(VENV)/ready
	@echo "Simulators of your own robots ..."
	@$(call install,$(VENV),tools/requirements-simulators.txt)
	@touch $@

# The reader of ArduPilot's logs, which most users do not need.
$(VENV)/logs-ready: tools/requirements-logs.txt $(VENV)/ready
	@echo "Reader of ArduPilot's logs ..."
	@$(call install,$(VENV),tools/requirements-logs.txt)
	@touch $@

blind: build $(VENV)/$(if $(or $(ROBOT),$(filter quadrotor,$(PLATFORM))),simulators,blind)-ready ## blind evaluation of the diagnoser on simulated logs with sealed labels (N= logs per tier, SEED=, TIER=, PEERS=no, PLATFORM=fwmav or quadrotor, or ROBOT=car, ..): blind.json
	@$(TINYKOOP) blind $(if $(PLATFORM),--platform "$(PLATFORM)") $(if $(ROBOT),--robot "$(ROBOT)") $(if $(N),--n "$(N)") $(if $(SEED),--seed "$(SEED)") $(if $(filter no,$(PEERS)),--no-peers) $(foreach tier,$(TIER),--tier "$(tier)") $(if $(CLUSTER),--cluster "$(CLUSTER)") $(UPDATED)

fleet: build $(if $(CLUSTER),$(VENV)/blind-ready) ## processor time per diagnosis of many simulated drives, and what 10,000 per hour take (N= drives, SEED=, CLUSTER=): fleet.json
	@$(TINYKOOP) fleet $(if $(N),--n "$(N)") $(if $(SEED),--seed "$(SEED)") $(if $(CLUSTER),--cluster "$(CLUSTER)") $(UPDATED)

constants: build ## the diagnoser's constants: reason of each, and how many answers change when it is halved and doubled (N= logs of each kind, SEED=): constants.json
	@$(TINYKOOP) constants $(if $(N),--n "$(N)") $(if $(SEED),--seed "$(SEED)") $(if $(CLUSTER),--cluster "$(CLUSTER)") $(UPDATED)

study: build $(VENV)/test-ready ## which Poly runs fail under control and why, sensitivities (RUNS= per setting): study.json
	@$(TINYKOOP) study $(if $(RUNS),--runs "$(RUNS)") $(UPDATED)

supervisor: build ## 200 random closed-loop runs with and without the supervisor: supervisor.json
	@$(TINYKOOP) supervisor $(UPDATED)

bench: build $(VENV)/bench-ready ## update against Eigen, NumPy, padasip; solve against DAQP, ProxQP, PIQP, ..; learners in Python against pykoop, pysindy, .. (QUICK=1: one round): bench.json
	@cmake -S . -B $(BUILD)/bench -DTINYKOOP_BENCH=ON -DTINYKOOP_HOST=OFF
	@cmake --build $(BUILD)/bench -j $(JOBS)
	@$(TINYKOOP) bench $(if $(QUICK),--quick) $(UPDATED)

targets: c-tests $(VENV)/test-ready ## cross-build, run on emulated microcontrollers, sizes, instruction counts and estimated cycles: footprint.json
	@$(TINYKOOP) targets $(UPDATED)
	@$(VENV)/bin/python -m pytest -q -rs -n $(JOBS) test/cross

settings: $(VENV)/ready ## compiler settings compared by code, instructions and estimated cycles on emulated microcontrollers: settings.json
	@$(TINYKOOP) settings $(UPDATED)

coverage: $(VENV)/ready ## lines, branches and MC/DC of lib/ that the C tests reach: coverage.json
	@$(TINYKOOP) coverage $(UPDATED)

mutants: $(VENV)/ready ## mutation score: how many small faults in lib/ the C tests detect (N=, SEED=, or all of FILE=lib/src/mpc.c): mutants.json
	@$(TINYKOOP) mutants $(if $(N),--n "$(N)") $(if $(SEED),--seed "$(SEED)") $(if $(FILE),--file "$(FILE)") $(UPDATED)

fuzz: $(VENV)/ready ## libFuzzer on the CSV reader, every public call, sequences of calls (SECONDS= per target): fuzz.json
	@$(TINYKOOP) fuzz $(if $(SECONDS),--seconds "$(SECONDS)") $(UPDATED)

static: $(VENV)/test-ready ## clang-tidy, cppcheck with MISRA, gcc -fanalyzer, Frama-C, complexity of lib/: static.json
	@$(TINYKOOP) static $(UPDATED)

soak: $(VENV)/ready ## every kind of estimator under every kind of fault (UPDATES= in total): soak.json
	@$(TINYKOOP) soak $(if $(UPDATES),--updates "$(UPDATES)") $(UPDATED)

flips: $(VENV)/ready ## one flipped bit in the storage of learner, gate, supervisor and controller (TRIALS= in total, SEED=): flips.json
	@$(TINYKOOP) flips $(if $(TRIALS),--trials "$(TRIALS)") $(if $(SEED),--seed "$(SEED)") $(UPDATED)

determinism: $(VENV)/ready ## the same bits from both compilers, all optimisation levels and a Cortex-M4F: determinism.json
	@$(TINYKOOP) determinism $(UPDATED)

flags: $(VENV)/ready ## the C tests with lib/ under the compiler flags of flight stacks and more aggressive ones (COMPILER=, SET= select one): flags.json
	@$(TINYKOOP) flags $(if $(COMPILER),--compiler "$(COMPILER)") $(if $(SET),--set "$(SET)")

sanitize: build c-tests $(VENV)/test-ready ## the tests under AddressSanitizer, UBSan, ThreadSanitizer and valgrind: sanitize.json
	@$(TINYKOOP) sanitize $(UPDATED)

amalgamate: system ## the drop-in pair tinykoop.c, tinykoop.h (PREFIX=my_ is added to every name) and an Arduino library: amalgamated/
	@$(PYTHON) tools/amalgamate.py --out $(BUILD)/out/amalgamated $(if $(PREFIX),--prefix "$(PREFIX)")

# A separate environment, since they install dozens of packages.
$(BUILD)/packagers/ready: tools/requirements-packagers.txt | system
	@echo "Package managers ..."
	@rm -rf $(BUILD)/packagers
	@$(PYTHON) -m venv $(BUILD)/packagers
	@$(call install,$(BUILD)/packagers,tools/requirements-packagers.txt)
	@touch $@

packagers: $(VENV)/ready $(BUILD)/packagers/ready ## tests of the manifests with PlatformIO, ESP-IDF's component manager and Kconfig
	@$(VENV)/bin/python -m pytest -q -rs test/python/test_drop_in.py

# What names the wheel after the systems that it runs on.
$(VENV)/wheel-ready: tools/requirements-wheel.txt $(VENV)/ready
	@echo "Packages for the wheel ..."
	@$(call install,$(VENV),tools/requirements-wheel.txt)
	@touch $@

wheel: $(VENV)/wheel-ready ## the Python package with its compiled library, for `pip install`, and its sources: build/dist
	@rm -rf $(BUILD)/dist $(BUILD)/wheel
	@$(VENV)/bin/python -c "from scikit_build_core.build import build_sdist; build_sdist('$(BUILD)/dist')" >$(BUILD)/wheel.log
	@$(VENV)/bin/pip wheel $(PIP_OPTIONS) --no-build-isolation --no-deps -w $(BUILD)/wheel $(BUILD)/dist/*.tar.gz
	@$(VENV)/bin/auditwheel repair --patcher none -w $(BUILD)/dist $(BUILD)/wheel/*.whl >>$(BUILD)/wheel.log 2>&1 || { \
		cat $(BUILD)/wheel.log >&2; exit 1; }
	@ls $(BUILD)/dist/*

# The packages that build the documentation site.
$(VENV)/docs-ready: tools/requirements-docs.txt $(VENV)/ready
	@echo "Packages for the docs ..."
	@$(call install,$(VENV),tools/requirements-docs.txt)
	@touch $@

docs: $(VENV)/docs-ready ## the documentation site with the reference of C, Python and the commands, with checked links: build/site
	@$(VENV)/bin/python docs/site.py $(BUILD)/docs
	@$(VENV)/bin/sphinx-build --quiet --fail-on-warning --keep-going -c docs $(BUILD)/docs $(BUILD)/site
	@echo "The site is in $(BUILD)/site: open $(BUILD)/site/index.html"

clean: ## removes build/
	@rm -rf $(BUILD)
