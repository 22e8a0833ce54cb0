#!/usr/bin/env bash
# The main job from nothing: set-up, then record 5,000 transitions of MuJoCo's Hopper-v5, fit a contact model to them, and
# compare it with its rivals on episodes that the fit has not seen.   scripts/demo.sh [RUN_FOLDER]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
scripts/setup.sh

run=${1:-runs/hopper}
if [ -e "$run" ]; then
  echo "demo: $run exists: remove it or name another run folder, scripts/demo.sh FOLDER" >&2
  exit 2
fi
cmbrl=.venv/bin/cmbrl
$cmbrl record hopper --steps 5000 --seed 0 --out "$run/train.npz"
$cmbrl record hopper --steps 2000 --seed 1 --out "$run/held_out.npz"
$cmbrl fit --config configs/hopper.yaml --data "$run/train.npz" --out "$run/fit"
$cmbrl error --data "$run/held_out.npz" --train "$run/train.npz" --out "$run/error" hold nominal ensemble "$run/fit"
echo "The run folder is $run: fit/ has the parameters, error/ the table and its plots."
