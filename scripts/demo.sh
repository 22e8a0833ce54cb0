#!/usr/bin/env bash
# The main job from nothing: set-up, then record 5,000 transitions of MuJoCo's Hopper-v5, fit a contact model to them, and
# compare it with its rivals on episodes that the fit has not seen.   scripts/demo.sh [RUN_FOLDER]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
scripts/setup.sh

run=${1:-runs/hopper-$(date +%Y%m%d-%H%M%S)}
cmbrl=.venv/bin/cmbrl
$cmbrl record hopper --steps 5000 --seed 0 --out "$run/train.npz"
$cmbrl record hopper --steps 2000 --seed 1 --out "$run/held_out.npz"
$cmbrl fit --config configs/hopper.yaml --data "$run/train.npz" --out "$run/fit"
# The ensemble takes most of the time; should the machine be slow it is stopped early, and the table says so.
$cmbrl error --data "$run/held_out.npz" --train "$run/train.npz" --train-seconds 100 --out "$run/error" \
  hold nominal ensemble "$run/fit"
echo "run folder: $run (fit/ has the parameters, error/ the table and its plot)"
