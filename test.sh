#!/usr/bin/env bash
# Set everything up, run every check, and every test but the slow ones: ./test.sh --all runs those too, as CI does.
# Other arguments go to pytest: ./test.sh -k lofo
set -euo pipefail
cd "$(dirname "$0")"
chosen=(-m "not slow")
if [ "${1:-}" = --all ]; then
    chosen=()
    shift
fi
unset PYTHONDONTWRITEBYTECODE  # files are compiled when they are first imported, and not all of them at installation
[ -x .venv/bin/python ] || "${PYTHON:-$(command -v python3.11 || command -v python3)}" -m venv .venv
.venv/bin/python -m pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
.venv/bin/ruff check .
.venv/bin/ruff format --check .
.venv/bin/mypy &
types=$!
# Kernels are compiled once, of channels and of paths; otherwise both processes of pytest would do it.
rm -f .venv/kernels.h5
.venv/bin/xfreqbench generate office --tx 1 --paths --quiet -o .venv/kernels.h5 &
kernels=$!
.venv/bin/lint-imports --no-cache
wait "$kernels"
[ -z "${MEANWHILE:-}" ] || tail --pid="$MEANWHILE" --follow /dev/null  # the process that CI has beside this one
.venv/bin/python -m pytest --numprocesses 2 --dist worksteal "${chosen[@]}" "$@"
wait "$types"
