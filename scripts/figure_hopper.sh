#!/usr/bin/env bash
# Makes docs/hopper_error.png and docs/hopper_error.txt, the figure and the numbers of the README, by running the demo.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
run=$(mktemp -d)/hopper
scripts/demo.sh "$run"
cp "$run/error/error.png" docs/hopper_error.png
cp "$run/error/error.txt" docs/hopper_error.txt
