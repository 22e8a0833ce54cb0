"""The pages of docs/fit: what fits recover, and how the fitted models predict next to other models.

    .venv/bin/python scripts/fit_study.py [CASE ...] [--runs FOLDER]

Runs the commands below with the cmbrl of this environment (about 40 minutes on 2 cores for all cases, most of it the
neural ensembles) and writes docs/fit/CASE.md with every command and what it printed, and the error plot. The cube needs
the published tosses: CMBRL_DATA=/path/to/cube_tosses.npz.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs" / "fit"

WRONG = {  # 30 % off, alternating in sign
    "mass.torso": 1.3, "mass.thigh": 0.7, "mass.leg": 1.3, "mass.foot": 0.7,
    "gear.thigh_joint": 1.3, "gear.leg_joint": 0.7, "gear.foot_joint": 1.3,
    "damping.thigh_joint": 0.7, "damping.leg_joint": 1.3, "damping.foot_joint": 0.7, "friction.foot_geom": 1.4,
}  # fmt: skip
WRONG_START = " ".join(f"--set {name}={value}" for name, value in WRONG.items())

BODY = ["friction", "plane_height", "com_x", "com_y", "com_z"]
SOFTNESS = ["softness_time", "softness_damping", "softness_scale", "impedance_low", "impedance_high", "impedance_width"]
HARD = " ".join(f"--groups {group}" for group in [*BODY, "restitution", "softness_time"])
SOFT = " ".join(f"--groups {group}" for group in [*BODY, *SOFTNESS])

CASES = {
    "ball": [
        "cmbrl record ball_throw --steps 5000 --seed 0 --out train.npz",
        "cmbrl record ball_throw --steps 5000 --seed 1 --out held_out.npz",
        "cmbrl fit ball_throw --data train.npz --out fitted",
        "cmbrl error --data held_out.npz --out error hold nominal fitted",
    ],
    "cube": [
        "python -c \"import os, cmbrl; a, b = cmbrl.Transitions.load(os.environ['CMBRL_DATA']).split(0.6, seed=0); "
        "a.save('train.npz'); b.save('held_out.npz')\"",
        "python scripts/cube_rounding.py",
        f"cmbrl fit cube_toss --data train.npz --out sharp_hard {HARD}",
        f"cmbrl fit cube_toss --data train.npz --out sharp_soft --contact-law mujoco {SOFT}",
        f"cmbrl fit cube_rounded --data train.npz --out round_hard --contact-law rigid {HARD}",
        f"cmbrl fit cube_rounded --data train.npz --out round_soft {SOFT} --groups radius",
        "python scripts/cube_noise.py",
        "cmbrl error --scene cube_toss --data held_out.npz --train train.npz --out error hold ballistic nominal "
        "ensemble sharp_hard sharp_soft round_hard round_soft",
    ],
    "hopper": [
        "cmbrl record hopper --steps 20000 --seed 0 --out train_20000.npz",
        "cmbrl record hopper --steps 1000 --seed 0 --out train_1000.npz",
        "cmbrl record hopper --steps 100 --seed 0 --out train_100.npz",
        "cmbrl record hopper --steps 5000 --seed 1 --out held_out.npz",
        "cmbrl fit hopper --data train_1000.npz --out fitted_1000 --horizon 4",
        "cmbrl fit hopper --data train_1000.npz --out all_1000 --all-parameters",
        "cmbrl fit hopper --data train_100.npz --out all_100 --all-parameters",
        f"cmbrl fit hopper --data train_1000.npz --out wrong_1000 --all-parameters {WRONG_START}",
        f"cmbrl fit hopper --data train_100.npz --out wrong_100 --all-parameters {WRONG_START}",
        "cmbrl error --data held_out.npz --train train_20000.npz --out error "
        "hold nominal ensemble fitted_1000 all_1000 all_100 wrong_1000 wrong_100",
    ],
    "hopper_payload": [
        *(f"cmbrl record hopper_payload --steps 2000 --seed {seed} --out train_{seed}.npz" for seed in range(5)),
        "cmbrl record hopper_payload --steps 5000 --seed 100 --out held_out.npz",
        *(f"cmbrl fit hopper_payload --data train_{seed}.npz --out seed_{seed}" for seed in range(5)),
        "python -m cmbrl.tasks.hopper_payload.real true_file.xml",
        "cmbrl error --data held_out.npz --horizons 1 5 20 --out error hold nominal "
        "seed_0 seed_1 seed_2 seed_3 seed_4 true_file.xml",
    ],
    "cheetah": [
        "cmbrl record cheetah --steps 20000 --seed 0 --out train_20000.npz",
        "cmbrl record cheetah --steps 1000 --seed 0 --out train_1000.npz",
        "cmbrl record cheetah --steps 5000 --seed 1 --out held_out.npz",
        "cmbrl fit cheetah --data train_1000.npz --out fitted_1000",
        "cmbrl fit cheetah --data train_1000.npz --out all_1000 --all-parameters",
        "cmbrl error --data held_out.npz --train train_20000.npz --out error "
        "hold nominal ensemble fitted_1000 all_1000",
    ],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--runs", default="runs/fit_study", help="where the runs go (default: runs/fit_study)")
    arguments = parser.parse_args()
    for case in arguments.cases or CASES:
        study(case, Path(arguments.runs).resolve() / case)


def study(case: str, folder: Path) -> None:
    """Runs a case's commands in a fresh ``folder`` and writes docs/fit/CASE.md and .png."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    lines = [f"# Fit study: {case}", "", "Made by `scripts/fit_study.py`; every command and what it printed.", ""]
    for command in CASES[case]:
        print(f"{case}: {command}", file=sys.stderr)
        words = shlex.split(command)
        program = [sys.executable, "-m", "cmbrl"] if words[0] == "cmbrl" else [sys.executable]
        words = [str(ROOT / word) if word.startswith("scripts/") else word for word in words]
        done = subprocess.run(program + words[1:], cwd=folder, env=os.environ, capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"{command}\n{done.stderr}")
        lines += ["```", f"$ {command}", done.stdout.rstrip(), "```", ""]
    DOCS.mkdir(parents=True, exist_ok=True)
    plots = sorted((folder / "error").glob("*.png"))
    for plot in plots:
        shutil.copy(plot, DOCS / f"{case}_{plot.name}")
        lines += [f"![{plot.stem} of the {case} models]({case}_{plot.name})", ""]
    (DOCS / f"{case}.md").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
