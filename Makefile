# Two commands do everything: `make demo` and `make test`. Both make their environment (.venv) first.
PYTHON_BIN := .venv/bin
# An empty environment has no search path.
PATH ?= /usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
export PATH

.PHONY: help setup demo test accuracy nightly browser bench results docs gallery lint style format clean

# What is imported is compiled once for all processes, also where Python is asked to keep no bytecode: else each of the
# many that tests start compiles all of its modules anew, and asserts of tests once more.
demo lint style test accuracy nightly browser bench docs gallery format: export PYTHONDONTWRITEBYTECODE :=

help:
	@echo "make demo    environment, then the noise cube: render, estimate, score, report (outputs/cube/report.html)"
	@echo "make test    environment, then lint, types and all tests"
	@echo "make accuracy environment, then all methods over the core of the metrology suite, against bounds of theory"
	@echo "make nightly environment, then 10,000 broken scene files, 1,000 stores, 250 killed runs, 300 flipped bits, 1000 simulations; two hours"
	@echo "make browser environment, chromium and playwright, then the pages in a headless browser"
	@echo "make bench   environment, then the benchmarks"
	@echo "make results environment and programs of others, then all methods over the suite: docs/results (resumable)"
	@echo "make docs    environment and Sphinx, then the site in outputs/site: warnings and dead links are errors"
	@echo "make gallery environment, then the pictures of all scenes (docs/reference/scene_gallery.md) and of the README"
	@echo "make format  environment, then the formatter"
	@echo "make clean   remove the environment, caches and results"

setup:
	@bash tools/setup.sh

demo:
	@bash tools/setup.sh demo
	$(PYTHON_BIN)/scenetruth run scenes/cube.yaml -o outputs/cube --overwrite

lint: style
	$(PYTHON_BIN)/mypy

style: setup
	$(PYTHON_BIN)/ruff check .
	$(PYTHON_BIN)/ruff format --check .

# Checking types keeps one processor busy for minutes: kernels are compiled and tests run meanwhile, and the messages
# follow those of the tests. Linear algebra of parallel tests has one thread each.
test: style
	@tests=1 types=1; messages=$$(mktemp) && trap 'rm -f "$$messages"' EXIT && \
	{ $(PYTHON_BIN)/mypy >"$$messages" 2>&1 & types=$$!; } && \
	{ $(PYTHON_BIN)/scenetruth precompile >/dev/null 2>&1 || true; } && \
	{ OPENBLAS_NUM_THREADS=1 $(PYTHON_BIN)/python -m pytest -n auto --maxprocesses 4 --dist worksteal; tests=$$?; } ; \
	wait $$types; types=$$?; cat "$$messages"; exit $$((tests ? tests : types))

accuracy: setup
	SCENETRUTH_CORE=1 $(PYTHON_BIN)/python -m pytest -q -p no:cacheprovider tests/benchmark/test_suite_core.py

nightly: setup
	HYPOTHESIS_PROFILE=nightly $(PYTHON_BIN)/python -m pytest -q -rP -p no:cacheprovider \
		tests/fuzz tests/pipeline tests/dataset tests/schema tests/storage/test_reader.py tests/test_resident_memory.py tests/test_accuracy.py \
		tests/estimators tests/truth tests/camera tests/validation_studies tests/scoring tests/benchmark tests/bound tests/testing \
		tests/design tests/render tests/raycast/test_edges.py tests/cli tests/capture tests/jobs tests/strain tests/exporters \
		tests/scene/test_scene_repair.py tests/scene/test_scene_report.py tests/scene/test_vertex_animation_finite_elements.py tests/scene/leaf/test_leaf_mesh.py tests/scene/test_taylor.py \
		tests/scene/mesh/test_mesh_file.py tests/docs/test_adding.py tests/docs/test_results_pages.py tests/test_bands.py \
		tests/resources/test_quick_preview.py tests/test_own_estimator.py tests/test_simulation.py tests/test_threads.py

browser: setup
	@bash tools/setup.sh browser
	$(PYTHON_BIN)/python -m pytest -q tests/browser

bench: setup
	$(PYTHON_BIN)/python -m pytest benchmarks --benchmark-only

# Methods and programs on the benchmark suite, the gallery and the same four images: data and tables of docs/results.
results: setup
	$(PYTHON_BIN)/python -m pip install -q --disable-pip-version-check -e '.[opencv]'
	$(PYTHON_BIN)/python -m benchmarks.results

# What is kept between builds lies beside the site: pages that did not change, and the results of notebooks. Pages with
# warnings are read again: what has failed fails until it is mended.
docs:
	@bash tools/setup.sh docs
	$(PYTHON_BIN)/python -m sphinx -q -W --keep-going -j 2 -b html -d outputs/site_cache/doctrees docs outputs/site || \
		{ rm -rf outputs/site_cache/doctrees; exit 1; }
	PYTHONPATH=docs/_ext $(PYTHON_BIN)/python -m scenetruth_site.dead_links outputs/site
	$(PYTHON_BIN)/python -m pytest -q -n0 tests/docs/test_search.py
	@echo "open outputs/site/index.html"

gallery: setup
	$(PYTHON_BIN)/python docs/_make/make_gallery.py
	$(PYTHON_BIN)/python docs/_make/draw_first_screen.py

format: setup
	$(PYTHON_BIN)/ruff check --fix .
	$(PYTHON_BIN)/ruff format .

clean:
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
	find outputs -mindepth 1 ! -name .gitignore -delete
