#!/usr/bin/env bash
# Set everything up, generate a small office data set, run every method on it and print the leaderboard.
set -euo pipefail
cd "$(dirname "$0")"
[ -x .venv/bin/python ] || "${PYTHON:-python3.11}" -m venv .venv
.venv/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable .
.venv/bin/xfreqbench generate office --tx "${NUM_TX:-240}" --output data/office-small.h5
.venv/bin/xfreqbench info data/office-small.h5
.venv/bin/xfreqbench run --method all --data data/office-small.h5 --protocol lofo --budget "${BUDGET:-15s}" \
    --results results/quickstart
.venv/bin/xfreqbench report results/quickstart --output results/quickstart/BENCHMARK.md
