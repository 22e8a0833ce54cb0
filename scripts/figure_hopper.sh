#!/usr/bin/env bash
# Writes docs/hopper_error.png and docs/hopper_error.txt, the figure and the numbers of the README, by running the demo.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
run=$(mktemp -d)/hopper
scripts/demo.sh "$run"
made=$(.venv/bin/python -c 'from cmbrl.bench.provenance import line, made; print(line(made("cmbrl.cli.error", seeds=1)))')
cp "$run/error/error.png" docs/hopper_error.png
{
  sed "s|$run/||" "$run/error/error.txt"
  printf '\n%s\n' "$made"
} > docs/hopper_error.txt
