#!/usr/bin/env bash
# Set everything up, run every check, and every test but the slow ones: ./test.sh --all runs those too, as CI does, and
# checks the types of arguments while tests run. Other arguments go to pytest: ./test.sh -k lofo
set -euo pipefail
cd "$(dirname "$0")"
chosen=(-m "not slow")
if [ "${1:-}" = --all ]; then
    chosen=()
    export CHECK_TYPES=1
    shift
fi
unset PYTHONDONTWRITEBYTECODE  # files are compiled when they are first imported, and not all of them at installation
.ci/environment dev
.venv/bin/ruff check .
.venv/bin/ruff format --check .
.venv/bin/mypy &
types=$!
# Kernels that have changed are compiled once, of tracing and of fits; otherwise both processes of pytest would do it.
.ci/kernels &
tracing=$!
.venv/bin/xfreqbench run --data scenes/office.h5 --methods xfreq-gs,wrf-gs-plus --targets 24.25 \
    --budget 2steps --results .venv/kernels --quiet >/dev/null &
fits=$!
.venv/bin/lint-imports --no-cache
wait "$tracing"
wait "$fits"
.venv/bin/python -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder --durations 40 --durations-min 1 "${chosen[@]}" "$@"
wait "$types"
