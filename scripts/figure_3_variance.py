"""Figure 3 of the ABS paper, made again: variance of the policy gradient against the horizon for several kappas.

    .venv/bin/python scripts/figure_3_variance.py [--out FILE]

Zhang, Jin & Wang (ICML 2023). About two minutes. Policies, noise, rewards and kappas are our choice.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from cmbrl.bench.studies.gradients.figures_policy import figure_3

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out", type=Path, default=Path("figure_3_variance.png"), help="picture to write (default: %(default)s)"
    )
    parser.add_argument("--samples", type=int, default=256, help="initial states (default: %(default)s)")
    arguments = parser.parse_args()
    figure_3(
        arguments.out, samples=arguments.samples, progress=lambda share, what: print(f"{100 * share:3.0f} % {what}")
    )
