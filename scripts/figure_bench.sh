#!/usr/bin/env bash
# Every benchmark at full size into runs/bench (hours; Ctrl-C, and the same command goes on), and the two charts of the
# README from it. Options go to the command, e.g. --quick or --threads 1.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
scripts/setup.sh
.venv/bin/cmbrl bench all --out runs/bench "$@"
cp runs/bench/solvers/work_precision.png docs/solvers.png
cp runs/bench/learning/transitions.png docs/learning.png
cp runs/bench/speed/speed.png docs/speed.png
