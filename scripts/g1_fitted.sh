#!/bin/sh
# Logs of the three hidden G1, their fits, and a neural ensemble on each log, for configs/studies/g1_fitted.yaml; about
# three hours on one core, most of it for the fits.
# A policy that is trained on the published file drives the log: 60 s of bending and stepping in place.
set -eu
out=runs/g1_fitted
[ -e "$out/warm_up/train.json" ] || cmbrl train g1 --iterations 1500 --out "$out/warm_up" --threads 1
cmbrl export "$out/warm_up" --torchscript "$out/warm_up.pt"
for draw in 2 0 1; do
  robot="g1_hidden_$draw" log="$out/log_$draw.npz" unseen="$out/unseen_$draw.npz"
  [ -e "$log" ] || cmbrl record "$robot" --steps 3000 --policy "$out/warm_up.pt" --out "$log"
  [ -e "$unseen" ] || cmbrl record "$robot" --steps 1000 --seed 1 --policy "$out/warm_up.pt" --out "$unseen"
  [ -e "$out/fit_$draw/fit.json" ] || cmbrl fit "$robot" --data "$log" --out "$out/fit_$draw" --threads 1 --time-limit 1500
  [ -e "$out/error_$draw" ] || cmbrl error nominal "$out/fit_$draw" ensemble --scene "$robot" --train "$log" \
    --data "$unseen" --horizons 1 20 100 --out "$out/error_$draw" --threads 1
done
