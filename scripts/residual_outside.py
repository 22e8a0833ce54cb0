"""Does a residual net in front of a fit explain what no parameter expresses, from the log of the fit alone?

    python scripts/residual_outside.py runs/residual_outside 0 1 2 3 4 5 6 7 8 9
    python scripts/residual_outside.py runs/residual_outside            # only shows what is there

Arms: the file, a default fit, the same fit with a residual, and a neural ensemble, all on the same 1,000 random
transitions of a hidden hopper outside the model's class (late commands, slow motors, backlash, friction loss, noise;
`hopper@outside:DRAW`). Errors are of 2,000 transitions of another seed after 1, 5 and 20 steps.

The answer, fixed before the first run: the mean over ten draws of the logarithm of residual / fit, by horizon, with a
95 % interval by bootstrap over draws. Below 1 as a whole, the net helps; a mean below .8 closes a gap worth naming;
an interval that holds 1 leaves it open. Wins against the ensemble are counted beside it. A draw that has its
`errors.json` is not run again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

HORIZONS, TRANSITIONS, UNSEEN, ERRORS = (1, 5, 20), 1000, 2000, "errors.json"
MODELS = ("nominal", "fit", "residual", "ensemble")


def cmbrl(*words: object) -> str:
    """What a command prints."""
    command = [sys.executable, "-m", "cmbrl", *map(str, words)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def run(out: Path, draw: int) -> None:
    """All arms on one draw, one thread."""
    folder = out / str(draw)
    if (folder / ERRORS).exists():
        return
    task, log, unseen, fit, residual = f"hopper@outside:{draw}", *(
        folder / name for name in ("log.npz", "unseen.npz", "fit", "residual")
    )  # fmt: skip
    for seed, file, count in ((draw, log, TRANSITIONS), (1000 + draw, unseen, UNSEEN)):
        if not file.exists():
            cmbrl("record", task, "--steps", count, "--seed", seed, "--out", file)
    for made, words in ((fit, ("fit", task)), (residual, ("residual", fit))):
        if not (made / "fit.json").exists():
            cmbrl(*words, "--data", log, "--threads", 1, "--out", made)
    models = ("nominal", fit, residual, "ensemble")
    given = ("--data", unseen, "--train", log, "--horizons", *HORIZONS, "--threads", 1, "--json")
    (folder / ERRORS).write_text(cmbrl("error", *models, *given), encoding="utf-8")


def table(out: Path) -> None:
    """Errors by draw [1 = the standard deviation of what is predicted], and the answer."""
    found = []
    for file in sorted(out.glob(f"*/{ERRORS}"), key=lambda file: int(file.parent.name)):
        entries = [e for e in json.loads(file.read_text(encoding="utf-8"))["entries"] if e["stratum"] == "all"]
        errors = {(e["model"], e["horizon"]): e["error"] for e in entries}
        names = list(dict.fromkeys(e["model"] for e in entries))  # in the order of MODELS
        found.append([[errors[name, h] for h in HORIZONS] for name in names])
        print(
            file.parent.name,
            *(f"{m} {' '.join(f'{e:.4g}' for e in row)}" for m, row in zip(MODELS, found[-1], strict=True)),
            sep="  ",
        )
    if not found:
        return
    all_errors = np.array(found)  # (draws, models, horizons)
    file, fit, residual, ensemble = all_errors.swapaxes(0, 1)
    resampled = np.random.default_rng(0).integers(len(found), size=(10_000, len(found)))
    for label, ratio in (
        ("residual / fit", residual / fit),
        ("residual / ensemble", residual / ensemble),
        ("fit / file", fit / file),
    ):
        means = np.exp(np.log(ratio)[resampled].mean(axis=1))
        for k, steps in enumerate(HORIZONS):
            low, high = np.quantile(means[:, k], [0.025, 0.975])
            mean, wins = np.exp(np.log(ratio[:, k]).mean()), int((ratio[:, k] < 1).sum())
            print(f"{label}, {steps} steps: {mean:.3f} [{low:.3f}, {high:.3f}], less on {wins} of {len(found)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("draws", type=int, nargs="*", metavar="DRAW")
    given = parser.parse_args()
    for draw in given.draws:
        run(given.out, draw)
    table(given.out)
