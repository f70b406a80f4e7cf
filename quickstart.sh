#!/usr/bin/env bash
# Set everything up, generate a small office data set, run three methods and the trivial ones on it, print the leaderboard.
# Other sizes, of 61 transmitters or more: NUM_TX=240 METHODS=all BUDGET=1000steps ./quickstart.sh
set -euo pipefail
cd "$(dirname "$0")"
say() { printf '\n== %s\n' "$*"; }
methods=${METHODS:-line-of-sight,nearest,mean-over-frequency,log-frequency,frequency-embedded-gs,xfreq-gs,aperture-gs}
budget=${BUDGET:-quick} data=data/office-quick.h5 results=results/quickstart

if ! [ -e .venv/installed ]; then
    say "Installing 3 GB (8 GB where there is an NVIDIA GPU), and compiling what traces rays; three minutes and the download"
fi
.ci/environment

say "Tracing ${NUM_TX:-120} transmitters of the office at 10 carriers, from 1 to 94 GHz; ten seconds"
.venv/bin/xfreqbench generate office --tx "${NUM_TX:-120}" --output "$data"

say "Drawing the room, rays and maps of a transmitter; ten seconds"
.venv/bin/xfreqbench view "$data" --tx 60 --output "$results/view"

say "Fitting at nine carriers and predicting the tenth, at 2.4, 24.25 and 77 GHz in turn, budget $budget; two minutes on two cores"
.venv/bin/xfreqbench run --method "$methods" --data "$data" --protocol lofo --budget "$budget" --executor "$(nproc)" \
    --results "$results"

say "Writing the leaderboard as Markdown and as a page; ten seconds"
.venv/bin/xfreqbench report "$results" --output "$results/BENCHMARK.md" --html "$results/page.html"

say "Done: $results/page.html and $results/view/index.html. One seed and few transmitters are a look: nothing learned is ranked"
say "The best method here, virtual-source, takes a minute more: METHODS=virtual-source ./quickstart.sh"
