#!/usr/bin/env bash
# Set everything up and run every check and test. Arguments go to pytest: ./test.sh -k lofo
set -euo pipefail
cd "$(dirname "$0")"
[ -x .venv/bin/python ] || "${PYTHON:-python3.11}" -m venv .venv
.venv/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
.venv/bin/ruff check .
.venv/bin/ruff format --check .
.venv/bin/mypy &
types=$!
.venv/bin/lint-imports --no-cache
.venv/bin/python -m pytest --numprocesses 2 --dist worksteal "$@"
wait "$types"
