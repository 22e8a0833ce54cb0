#!/usr/bin/env bash
# Runs every benchmark at full size into runs/bench (hours; after Ctrl-C the same command continues) and writes the charts
# of the README and the outputs and pictures of docs/speed.md, docs/bench and docs/results. Options go to the command,
# e.g. --threads 1.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
scripts/setup.sh
.venv/bin/cmbrl bench all --out runs/bench "$@"
cp runs/bench/solvers/work_precision.png docs/solvers.png
cp runs/bench/learning/transitions.png docs/learning.png
cp runs/bench/speed/speed.png docs/speed.png
.venv/bin/cmbrl bench speed --out runs/bench "$@" > docs/speed.txt  # printed, not measured again
for study in solvers stability reduction robustness simulators gradient-scenes gradients derivatives stiffness learning; do
  .venv/bin/cmbrl bench "$study" --out runs/bench "$@" > "docs/bench/$study.txt"
done
cp runs/bench/solvers/profile.png docs/bench/solvers_profile.png
cp runs/bench/stability/bank.png docs/bench/stability.png
cp runs/bench/stability/steps.png docs/bench/stability_steps.png
cp runs/bench/simulators/simulators_own.png docs/bench/simulators.png
cp runs/bench/simulators/simulators_truth.png docs/bench/simulators_truth.png
cp runs/bench/reduction/reduction.png docs/bench/reduction.png
cp runs/bench/gradient-scenes/gradient_scenes.png docs/bench/gradient-scenes.png
cp runs/bench/gradients/gradient_cost.png docs/bench/gradients.png
cp runs/bench/stiffness/stiffness.png docs/bench/stiffness.png
for study in estimators horizons throws smoothing mission hidden; do
  .venv/bin/cmbrl bench "$study" --out runs/bench "$@" > "docs/results/$study.txt"
done
cp runs/bench/mission/{hopper,cheetah}_{transitions,time}.png docs/results/
cp runs/bench/hidden/hidden.png docs/results/
cp runs/bench/throws/throws_{known,real,mission,variance}.png docs/results/
cp runs/bench/smoothing/smoothing_throws.png docs/results/
.venv/bin/cmbrl bench smoothing-robots --scene "cheetah_dojo fopg" --scene "hopper_dojo fopg" --scene "hopper shac" --out runs/bench "$@" > docs/results/smoothing_robots.txt
cp runs/bench/smoothing-robots/smoothing_robots.png docs/results/
for picture in returns kappa gradients; do
  cp "runs/bench/estimators/$picture.png" "docs/results/estimators_$picture.png"
done
cp runs/bench/horizons/horizon_{gradients,learning}.png docs/results/
