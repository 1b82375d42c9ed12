# Everything runs in .venv, which .ci/setup brings into the state it should have, whatever state it is in.
PY := .venv/bin/python
OUT ?= out/demo

.PHONY: help demo test bench docs lint clean

help:  ## List the targets
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 10

demo:  ## Render a built-in scene along a camera path and write a report
	@.ci/setup
	@.venv/bin/jaxrefl compare mirror_room --techniques raytrace envmap --reference raytrace \
		--frames 12 --size 480 270 --light.area-samples 32 --out $(OUT)
	@echo "The report is in $(CURDIR)/$(OUT)/report.html"

test:  ## Run the test suite
	@.ci/setup test
	@$(PY) -m pytest -m "not slow" -n 2 --dist worksteal $(ARGS)

bench:  ## Measure speed, memory and start-up; writes docs/pages/figures
	@.ci/setup test
	@.venv/bin/jaxrefl bench $(ARGS)

docs:  ## Build the documentation into docs/site
	@.ci/setup docs
	@.venv/bin/mkdocs build --strict --quiet -f docs/mkdocs.yml
	@echo "The documentation is in $(CURDIR)/docs/site/index.html"

lint:  ## ruff and pyright
	@.ci/setup test
	@.venv/bin/ruff check . && .venv/bin/ruff format --check . && .venv/bin/pyright

clean:  ## Remove everything that was made here
	rm -rf .venv out docs/site .pytest_cache .ruff_cache
