#!/usr/bin/env bash
# Every benchmark at full size into runs/bench (hours; Ctrl-C, and the same command goes on), and from it the two charts of
# the README and what docs/speed.md shows. Options go to the command, e.g. --threads 1.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
scripts/setup.sh
.venv/bin/cmbrl bench all --out runs/bench "$@"
cp runs/bench/solvers/work_precision.png docs/solvers.png
cp runs/bench/learning/transitions.png docs/learning.png
cp runs/bench/speed/speed.png docs/speed.png
.venv/bin/cmbrl bench speed --out runs/bench "$@" > docs/speed.txt  # measured above: this only prints it
