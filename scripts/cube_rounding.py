"""How round the corners of the tossed cube are: the fit's loss over the radius of its edges, under both contact laws.

    CMBRL_DATA=/path/to/cube_tosses.npz .venv/bin/python scripts/cube_rounding.py

Fits the training tosses of docs/fit/cube.md once for every radius (about two minutes) and prints the Huber loss and the
RMSE, cross-validated within them. It does not use the held-out log of that page.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import cmbrl
from cmbrl.tasks.cube_toss import ROUNDED

GROUPS = {
    "rigid": ["friction", "plane_height", "com_x", "com_y", "com_z", "softness_time"],
    "mujoco": [
        "friction", "plane_height", "com_x", "com_y", "com_z", "softness_time", "softness_damping", "softness_scale",
        "impedance_low", "impedance_high", "impedance_width", "radius",
    ],
}  # fmt: skip
RADII = (0.0, 1.0, 2.0, 3.0, 4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0, 8.0)  # [mm]


def main() -> None:
    if "CMBRL_DATA" not in os.environ:
        sys.exit("set CMBRL_DATA to the file of tosses, cube_tosses.npz")
    train, _ = cmbrl.Transitions.load(os.environ["CMBRL_DATA"]).split(0.6, seed=0)
    text = Path(ROUNDED.scene_path).read_text(encoding="utf-8")
    print(f"{'radius mm':>10}" + "".join(f"{law + ' loss':>14}{'RMSE':>8}" for law in GROUPS))
    with tempfile.TemporaryDirectory() as folder:
        for radius in RADII:
            file = Path(folder) / "cube.xml"
            file.write_text(text.replace('data="0.0055"', f'data="{1e-3 * radius}"'), encoding="utf-8")
            line = f"{radius:>10.1f}"
            for law, groups in GROUPS.items():
                scene = cmbrl.Scene.from_mjcf(file, contact_law=law)
                smoothing = cmbrl.Barrier(ROUNDED.smoothing_kappa)
                model = cmbrl.ComplementarityModel(scene, **ROUNDED.model_options(), smoothing=smoothing)
                loss = cmbrl.fit(model, train, groups=groups).report["loss"]["held out, fitted"]
                line += f"{loss['loss']:>14.4f}{loss['rmse']:>8.4f}"
            print(line, flush=True)


if __name__ == "__main__":
    main()
