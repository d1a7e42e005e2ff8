# `make test` and `make demo` each do all that they need, from Python 3.10 and Rust alone: they create .venv, build the
# package and install it there. A second run rebuilds what has changed. The tests need Ipopt and other packages; the demo
# does without, and with a build that is compiled faster (the profile `demo` in Cargo.toml), unless there is a better one.

PYTHON ?= python3
VENV   ?= .venv
CARGO  ?= cargo
# A Python that the lowest supported numpy has wheels for.
OLD_PYTHON ?= $(shell for p in python3.10 python3.11; do $$p -c '' 2>/dev/null && echo $$p && break; done)
# Platforms for which `make wheels` builds, as Rust names them, and a free-threaded Python, such as python3.14t.
WHEEL_TARGETS ?= x86_64-unknown-linux-gnu aarch64-unknown-linux-gnu x86_64-unknown-linux-musl aarch64-unknown-linux-musl
FREE_THREADED ?=
# Options for pytest, such as PYTEST="-k collocation -x".
PYTEST ?=

py := $(VENV)/bin/python
sources := Cargo.toml $(wildcard Cargo.lock) pyproject.toml $(wildcard README.md LICENSE) \
           $(shell find rust python -name '*.rs' -o -name Cargo.toml -o -name '*.py' -o -name '*.pyi' -o -name py.typed \
                    -o -type d ! -name __pycache__)

activate := . $(VENV)/bin/activate &&
build_wheel := maturin build --release --locked --zig --out out/wheels
own_wheel := out/wheels/*abi3-manylinux*$(shell uname -m).whl
export MPLBACKEND := Agg
# The blocks that Ipopt's linear solver works on are tiny: more BLAS threads only get into each other's way.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1

.PHONY: help test test-all test-rust test-python demo bench docs wheels lint lint-rust lint-python format develop clean

help:
	@echo "make test     all tests, Rust and Python       make demo     examples/demo.py, results in out/"
	@echo "make test-all the same, campaigns in full size"
	@echo "make lint     what CI checks besides tests     make bench    benchmarks against other packages"
	@echo "make format   formats Rust and Python          make develop  installs the package for editing"
	@echo "make docs     the documentation, in out/docs   make wheels   wheel and sdist, in out/wheels, tried"
	@echo "make clean    removes .venv, target and out"

test: test-rust test-python

# Long campaigns, of which `make test` runs a part of the cases, are run with all of them.
test-all: export PHUGOID_FULL := 1
test-all: test

# The bindings crate has no tests of its own: the Python tests are.
test-rust:
	$(CARGO) test --workspace --exclude phugoid-python

# Also runs the examples in the docstrings of the package as installed. A file's tests stay in one process: they share
# records that take long to make.
test-python: $(VENV)/.package $(VENV)/.ipopt
	$(py) -m pytest -n auto --dist loadfile --doctest-modules --pyargs phugoid tests $(PYTEST)

demo: $(if $(wildcard $(VENV)/.package),$(VENV)/.package,$(VENV)/.demo)
	$(py) examples/demo.py

bench: $(VENV)/.package $(VENV)/.ipopt
	$(py) benchmarks/compare.py

# Runs the gallery as well; the tests run all code in the pages, and build them without.
docs: $(VENV)/.package
	$(py) -m sphinx -q -W --keep-going -d out/doctrees docs out/docs
	@echo "out/docs/index.html"

# Wheels for Linux: with the glibc of 2014 or a later one, and with musl (both linked by zig), and the source distribution. One
# abi3 wheel serves Python 3.10 and later; a free-threaded Python, if FREE_THREADED names one, gets a wheel of its own. Those that
# this machine can run are tried without Rust: at the lowest versions of what they need, where there is a Python that these know,
# and at the newest; the wheel that pip builds from the source distribution, at the newest.
wheels: $(VENV)/.created
	$(py) -m pip install --quiet "maturin>=1.7,<2" ziglang
	rustup target add $(WHEEL_TARGETS) || { echo "make wheels: install Rust's library for each of $(WHEEL_TARGETS)," \
	  "or name those that you have: make wheels WHEEL_TARGETS=$(firstword $(WHEEL_TARGETS))"; exit 1; }
	rm -rf out/wheels
	$(activate) $(foreach t,$(WHEEL_TARGETS),$(build_wheel) --target $t --compatibility $(if $(findstring musl,$t),musllinux_1_2,manylinux2014) &&) true
	$(if $(FREE_THREADED),$(activate) $(build_wheel) --target $(firstword $(WHEEL_TARGETS)) --compatibility manylinux2014 --interpreter $(FREE_THREADED))
	$(activate) maturin sdist --out out/wheels
	$(py) -m pip wheel --quiet --no-deps --wheel-dir out/wheels/of_sdist out/wheels/*.tar.gz
	$(if $(OLD_PYTHON),$(py) tools/try_wheel.py $(own_wheel) --titles --versions lowest --python $(OLD_PYTHON))
	$(py) tools/try_wheel.py $(own_wheel) --titles --versions newest --python $(PYTHON)
	$(py) tools/try_wheel.py out/wheels/of_sdist/*.whl --versions newest --python $(PYTHON)
	$(if $(FREE_THREADED),$(py) tools/try_wheel.py out/wheels/*t-manylinux*.whl --versions newest --python $(FREE_THREADED))
	ls -l out/wheels

# Rust and Python are checked side by side: one core each is all that either can use for most of the time. The output of each is shown
# when it ends.
lint: $(VENV)/.package $(VENV)/.lint
	$(MAKE) --no-print-directory --jobs=2 --output-sync=target lint-rust lint-python

# The crate is checked without its default features as well, which the demo builds it without. With its examples it is documented from
# the packages that clippy has checked; alone it needs them with other features, and checks them all again.
lint-rust: $(VENV)/.lint
	$(CARGO) fmt --all --check
	$(activate) $(CARGO) clippy --workspace --all-targets -- -D warnings
	$(CARGO) check -p phugoid --no-default-features
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --no-deps --workspace --lib --examples

# The stub of the bindings is compared with them in a package of their own: otherwise stubtest analyses all of this one again.
lint-python: $(VENV)/.package $(VENV)/.lint
	$(py) tools/check_layers.py
	$(py) tools/check_words.py
	$(py) -m ruff check
	$(py) -m ruff format --check
	$(py) -m codespell_lib
	$(py) -m mypy
	rm -rf out/stub && mkdir -p out/stub/phugoid && touch out/stub/phugoid/__init__.py
	cp python/phugoid/_core.pyi `$(py) -c "import phugoid._core; print(phugoid._core.__file__)"` out/stub/phugoid
	cd out/stub && MYPYPATH=. PYTHONPATH=. $(abspath $(py)) -m mypy.stubtest phugoid._core

format: $(VENV)/.lint
	$(CARGO) fmt --all
	$(py) -m ruff check --fix
	$(py) -m ruff format

# Python sources are used where they lie; run it again after a change in Rust.
develop: $(VENV)/.package $(VENV)/.lint
	$(activate) maturin develop --release

clean:
	rm -rf $(VENV) target out docs/examples

$(VENV)/.created:
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 10) and 'Python 3.10 or later is needed, see PYTHON in the Makefile')"
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/.package: $(sources) | $(VENV)/.created
	$(py) -m pip install --quiet ".[test]"
	touch $@

# What the package needs is installed while it is built, when the compiler leaves a core idle. Python code is compiled where the
# demo imports it, and that is a part of what is installed. Without its default features the crate has a third less to compile.
$(VENV)/.demo: $(sources) | $(VENV)/.created
	sed -n 's/^dependencies = \[\(.*\)\]/\1/p' pyproject.toml | tr -d '" ' | tr ',' '\n' > $(VENV)/requirements.txt
	$(py) tools/show_progress.py "Building the package" sh -c '\
	  nice -n 19 $(py) -m pip install --no-compile --quiet -r $(VENV)/requirements.txt & needed=$$!; \
	  MATURIN_PEP517_ARGS="--profile demo --no-default-features" $(py) -m pip install --no-compile --no-deps -v . && wait $$needed'
	touch $@

$(VENV)/.lint: pyproject.toml | $(VENV)/.created
	$(py) -m pip install --quiet "maturin>=1.7,<2" "mypy>=1.8" "ruff==0.17.*" "codespell[toml]==2.4.*"
	touch $@

$(VENV)/.ipopt: tools/ipopt.py | $(VENV)/.package
	$(py) tools/ipopt.py
	touch $@
