#!/usr/bin/env bash
# Checks the bare install: in a fresh environment `pip install .` alone gives a --help of every command and one fit.
#   scripts/check_install.sh            PYTHON=python3.12 scripts/check_install.sh   to choose the interpreter
# Needs a package index and about 2 GB in the temporary folder; takes a few minutes, most of it download and build.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
export PIP_DISABLE_PIP_VERSION_CHECK=1
"$folder/venv/bin/python" -m pip install -qq --constraint configs/constraints.txt --config-settings "build-dir=$folder/build" .

cd "$folder"  # away from the sources: what is imported below is what was installed
cmbrl=$folder/venv/bin/cmbrl
if venv/bin/python -c 'import tasks' 2> missing.txt; then
  echo "check_install: 'import tasks' works: the bundled tasks belong into cmbrl.tasks" >&2; exit 1
fi
tail -n 1 missing.txt
$cmbrl --help > overview.txt
commands=$(sed -n '/^commands:/,/^$/s/^  \([a-z]*\) .*/\1/p' overview.txt)
[ "$(wc -w <<< "$commands")" -ge 9 ] || { echo "check_install: too few commands in 'cmbrl --help'" >&2; exit 1; }
for command in $commands; do
  $cmbrl "$command" --help > help.txt || { echo "check_install: 'cmbrl $command --help' fails" >&2; exit 1; }
done

# A cube that is tossed with friction 0.15; its file says 0.3, and the fit has to find the difference.
venv/bin/python - <<'PYTHON'
import numpy as np
import cmbrl
from cmbrl.registry import load_task

task = load_task("cube_toss")
scene = task.load_scene()
truth = scene.parameter_vector()
truth[[parameter.name.startswith("friction") for parameter in scene.parameters]] = 0.15
model = cmbrl.ComplementarityModel(scene, **task.model_options(), parameters=truth)
draw, tosses, steps = np.random.default_rng(0), 16, 60
states = [(np.tile([0, 0, 0.1, 1, 0, 0, 0], (tosses, 1)), draw.normal(size=(tosses, 6)))]
for _ in range(steps):
    after = model.predict(*states[-1], np.zeros((tosses, 0)))
    states.append((after.q_next, after.v_next))
q, v = (np.stack([state[k] for state in states], axis=1) for k in (0, 1))  # toss, step, coordinate
rows = {"q": q[:, :-1], "v": v[:, :-1], "q_next": q[:, 1:], "v_next": v[:, 1:]}
rows = {name: array.reshape(tosses * steps, -1) for name, array in rows.items()}
cmbrl.Transitions(
    **rows, u=np.zeros((tosses * steps, 0)), dt=task.control_dt, episode=np.repeat(np.arange(tosses), steps)
).save("log.npz")
PYTHON
$cmbrl fit cube_toss --data log.npz --groups friction --out fit > fit.txt
$cmbrl error --data log.npz --horizons 1 20 --json hold nominal fit > error.json
venv/bin/python - <<'PYTHON'
import json

entries = json.load(open("error.json"))["entries"]
error = {entry["model"]: entry["error"] for entry in entries if (entry["horizon"], entry["stratum"]) == (20, "all")}
print("error over 20 steps:", ", ".join(f"{name} {value:.3g}" for name, value in error.items()))
assert error["fit"] < 0.1 * error["nominal"], "the fit does not find the friction that the log was made with"
PYTHON
echo "bare install: $(wc -w <<< "$commands") commands, one fit"
