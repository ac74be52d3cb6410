# SPDX-License-Identifier: GPL-3.0-or-later
# All that a newcomer types: `make demo` and `make test`.  Both install what they need into .venv the first time.
.NOTPARALLEL:
.PHONY: help demo test test-all lint test-library test-addon test-lts test-all-bpy test-blender test-windows docs-pictures api-docs bench extension store site gallery test-site clean

# Where the environment forbids Python to keep compiled modules, each process would compile all of ours, and pytest's rewritten tests, anew.
export PYTHONDONTWRITEBYTECODE :=

PY := .venv/bin/python
LTS := .venv313/bin/python

help:
	@echo "make demo          import the example model, move a camera around it and render it through Blender"
	@echo "make test          style, library and add-on tests on Blender 5.0.1, without the slow ones"
	@echo "make test-all      with the slow ones, and on Blender 5.2.3 too where Python 3.13 is found"
	@echo "make test-all-bpy  the add-on's tests on Blender 4.2.23, 4.5.15, 5.0.1, 5.2.3, and 5.3 once it is to be had"
	@echo "make test-blender  the extension's zip in real Blenders with windows, 4.3 and 5.2 (root, Debian packages; see CONTRIBUTING)"
	@echo "make test-windows  the library's quick tests with Windows' Python, under Wine (root, Debian packages; see CONTRIBUTING)"
	@echo "make lint | test-library | test-addon | test-lts    parts of make test-all"
	@echo "make bench         the figures that the README quotes"
	@echo "make extension     dist/*.zip to install in Blender, one a system, and a repository's index"
	@echo "make store         dist/store/*.zip as extensions.blender.org takes them, and a moderator's checklist of each"
	@echo "make site          dist/index.html, the home page with the documents; WEBSITE=URL where its address is known"
	@echo "make clean         remove everything that make made"

# The stamps depend on pyproject.toml, so a changed dependency is installed by the next make.
.venv/ready: pyproject.toml tools/constraints.txt tools/wheels.txt
	@tools/make_venv.sh .venv 3.11 5.0.1 train,torch
.venv313/ready: pyproject.toml tools/constraints.txt tools/wheels.txt
	@tools/make_venv.sh .venv313 3.13 5.2.3
.venvs/4.2.23/ready: pyproject.toml tools/constraints.txt tools/wheels.txt
	@mkdir -p .venvs && tools/make_venv.sh .venvs/4.2.23 3.11 4.2.23
.venvs/4.5.15/ready: pyproject.toml tools/constraints.txt tools/wheels.txt
	@mkdir -p .venvs && tools/make_venv.sh .venvs/4.5.15 3.11 4.5.15

.venvs/site/ready: pyproject.toml tools/constraints.txt tools/wheels.txt
	@mkdir -p .venvs && tools/make_venv.sh .venvs/site 3.11 "" site

demo: .venv/ready
	@$(PY) tools/demo.py

test: CHOSEN := -m "not slow"
test: export FASTGS_MUTATIONS ?= 100
test: lint test-library test-addon test-site
	@echo "Left out: tests that are marked slow, and Blender 5.2.3. make test-all runs them too."

test-all: lint test-library test-addon test-lts test-site

lint: .venv/ready
	@$(PY) -m ruff check .
	@$(PY) -m mypy --no-error-summary

test-library: .venv/ready
	@$(PY) -m pytest tests/library -n 2 --dist worksteal $(CHOSEN)

# Blender has one set of global data a process, so these never share a process with the library's tests, and a file stays in one process.
# A process that crashes ends the run, with the test's name: xdist would give the file's other tests to a new process, which then waits
# for ever (github.com/pytest-dev/pytest-xdist/issues/1327).
ADDON := tests/addon -n 2 --dist loadfile --no-loadscope-reorder --max-worker-restart 0
test-addon: .venv/ready
	@$(PY) -m pytest $(ADDON) $(CHOSEN)

test-lts:
	@if tools/find_python.sh 3.13 >/dev/null; then $(MAKE) --no-print-directory test-addon-5.2.3; \
	else echo "Python 3.13 was not found: the add-on's rendering tests on Blender 5.2.3 are left out."; fi

.PHONY: test-addon-5.2.3 test-addon-4.5.15 test-addon-4.2.23
test-addon-5.2.3: .venv313/ready
	@echo "Blender 5.2.3, Python 3.13:" && $(LTS) -m pytest $(ADDON)
test-addon-4.5.15: .venvs/4.5.15/ready
	@echo "Blender 4.5.15:" && .venvs/4.5.15/bin/python -m pytest $(ADDON)
test-addon-4.2.23: .venvs/4.2.23/ready
	@echo "Blender 4.2.23:" && .venvs/4.2.23/bin/python -m pytest $(ADDON)

# Blender 5.3 as soon as the package index has it.
.PHONY: test-addon-5.3
test-addon-5.3: .venv313/ready
	@version=$$($(LTS) -m pip index versions bpy 2>/dev/null | grep -o '5\.3\.[0-9]*' | head -n 1); \
	if [ -z "$$version" ]; then echo "The package index has no bpy 5.3 for Python 3.13: its tests are left out."; else \
	folder=.venvs/$$version && mkdir -p .venvs && { [ -e $$folder/ready ] || tools/make_venv.sh $$folder 3.13 $$version; } && \
	echo "Blender $$version:" && $$folder/bin/python -m pytest $(ADDON); fi

test-all-bpy: test-addon-4.2.23 test-addon-4.5.15 test-addon test-addon-5.2.3 test-addon-5.3

test-blender: .venv/ready
	@$(PY) tools/test_blender.py $(ARGS)

test-windows: .venv/ready
	@$(PY) tools/test_windows.py $(ARGS)

# The screenshots that the last test-blender took.
docs-pictures: .venv/ready
	@$(PY) tools/docs_pictures.py

# docs/api.md, from the docstrings.
api-docs: .venv/ready
	@$(PY) tools/api_docs.py

bench: .venv/ready
	@$(PY) benchmarks/raster_cpu.py
	@$(PY) benchmarks/processors.py
	@$(PY) benchmarks/viewport.py
	@$(PY) benchmarks/features.py
	@$(PY) benchmarks/scene_light.py
	@$(PY) benchmarks/baked_passes.py
	@$(PY) benchmarks/points.py
	@$(PY) benchmarks/shots.py

extension: .venv/ready
	@$(PY) tools/build_extension.py

site: .venvs/site/ready .venv/ready
	@$(PY) tools/website/gallery.py --models
	@.venvs/site/bin/python tools/website/build.py $(if $(WEBSITE),--website $(WEBSITE))

# The pictures in docs/gallery, and the models that they show.  The site makes those models that are not there yet.
gallery: .venv/ready
	@$(PY) tools/website/gallery.py

# The generator has an environment of its own, and so has the test that it builds the site.
test-site: .venvs/site/ready
	@.venvs/site/bin/python -m pytest tests/library/test_site.py

store: .venv/ready
	@$(PY) tools/build_extension.py --store --out dist/store
	@$(PY) tools/checklist.py dist/store/*.zip

clean:
	rm -rf .venv .venv313 .venvs build dist wheels demo *.egg-info .ruff_cache .mypy_cache tests/.pytest_cache .hypothesis
