"""A sweep as a Slurm array job."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path


def slurm(command: str, config: Path, seeds: Sequence[int], out: Path) -> str:
    """An array job with one task a seed."""
    array = (
        f"{seeds[0]}-{seeds[-1]}" if list(seeds) == list(range(seeds[0], seeds[-1] + 1)) else ",".join(map(str, seeds))
    )
    here = shlex.quote(str(out))
    return "\n".join(
        [
            "#!/bin/bash",
            f"#SBATCH --job-name=cmbrl-{config.stem}",
            f"#SBATCH --array={array}",
            "#SBATCH --cpus-per-task=1",
            f"#SBATCH --output={out}/slurm_%a.txt",
            f"# Submit it from {shlex.quote(str(Path.cwd()))} after: mkdir -p {here}",
            f"run={here}/seed_$SLURM_ARRAY_TASK_ID",
            '[ -e "$run/checkpoint.safetensors" ] || [ -e "$run/state.json" ] && resume=--resume',
            f"cmbrl {command} --config {shlex.quote(str(config))} --threads 1 \\",
            '  --seed "$SLURM_ARRAY_TASK_ID" --out "$run" ${resume-}',
        ]
    )
