#!/usr/bin/env bash
# Set everything up, generate a small office data set, run two methods and the baselines on it, print the leaderboard.
# Other sizes, of 61 transmitters or more: NUM_TX=240 METHODS=all BUDGET=1000steps ./quickstart.sh
set -euo pipefail
cd "$(dirname "$0")"
say() { printf '\n== %s\n' "$*"; }
methods=${METHODS:-line-of-sight,nearest,mean-over-frequency,log-frequency,frequency-embedded-gs,xfreq-gs}
budget=${BUDGET:-quick} data=data/office-quick.h5 results=results/quickstart

if ! [ -e .venv/installed ]; then
    say "Installing 1.8 GB (5.8 GB with CUDA), and compiling what traces rays; two minutes and the download"
fi
.ci/environment

say "Tracing ${NUM_TX:-120} transmitters of the office at 10 carriers, from 1 to 94 GHz; ten seconds"
.venv/bin/xfreqbench generate office --tx "${NUM_TX:-120}" --output "$data"

say "Fitting at nine carriers and predicting the tenth, at 2.4, 24.25 and 77 GHz in turn, budget $budget; a minute on two cores"
.venv/bin/xfreqbench run --method "$methods" --data "$data" --protocol lofo --budget "$budget" --executor "$(nproc)" \
    --results "$results"

say "Writing the leaderboard as Markdown and as a page; ten seconds"
.venv/bin/xfreqbench report "$results" --output "$results/BENCHMARK.md" --html "$results/page.html"

say "Done: $results/page.html. One seed and few transmitters are a look: nothing learned is ranked"
say "The room, with the rays and maps of a transmitter (two minutes of compilation, once):
   .venv/bin/xfreqbench view $data --tx 60 --output $results/view"
say "The best method here, virtual-source, takes a minute more: METHODS=virtual-source ./quickstart.sh"
