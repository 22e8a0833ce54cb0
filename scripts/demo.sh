#!/usr/bin/env bash
# The main job from nothing: set up, record 2,000 transitions (16 s) of a hopper whose file is wrong, fit the file to them,
# and compare before, after and the true file on unseen episodes.   scripts/demo.sh [RUN_FOLDER]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
scripts/setup.sh
SECONDS=0

run=${1:-runs/demo-$(date +%Y%m%d-%H%M%S)}
cmbrl=.venv/bin/cmbrl
$cmbrl record hopper_payload --steps 2000 --seed 0 --out "$run/train.npz"
$cmbrl record hopper_payload --steps 2000 --seed 1 --out "$run/held_out.npz"
$cmbrl fit hopper_payload --data "$run/train.npz" --out "$run/fitted"
.venv/bin/python -m cmbrl.tasks.hopper_payload.real "$run/true_file.xml"
# A neural ensemble learns from the same transitions; on a slow computer it is stopped early, and the table says so.
$cmbrl error --data "$run/held_out.npz" --train "$run/train.npz" --train-seconds 100 --horizons 1 5 20 --out "$run/error" \
  hold ensemble nominal "$run/fitted" "$run/true_file.xml"
echo "run folder after ${SECONDS} s: $run (fitted/ has the parameters, error/ the table and its plot)"
