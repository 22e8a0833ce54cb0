#!/bin/sh
# Logs of the three hidden G1 and their fits, for configs/studies/g1_fitted.yaml; about
# three hours on one core, most of it for the fits.
# A policy that is trained on the published file drives the log: 60 s of bending and stepping in place.
set -eu
out=runs/g1_fitted
[ -e "$out/warm_up/train.json" ] || cmbrl train g1 --iterations 1500 --out "$out/warm_up" --threads 1
cmbrl export "$out/warm_up" --torchscript "$out/warm_up.pt"
for draw in 2 0 1; do
  [ -e "$out/log_$draw.npz" ] || cmbrl record "g1_hidden_$draw" --steps 3000 --policy "$out/warm_up.pt" --out "$out/log_$draw.npz"
  [ -e "$out/fit_$draw/fit.json" ] || cmbrl fit "g1_hidden_$draw" --data "$out/log_$draw.npz" --out "$out/fit_$draw" --threads 1 --time-limit 1500
done
