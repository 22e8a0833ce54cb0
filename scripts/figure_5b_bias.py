"""Figure 5b of the ABS paper, made again: bias of the half-cheetah's gradient, constant kappas against ABS.

    .venv/bin/python scripts/figure_5b_bias.py [--out FILE]

Zhang, Jin & Wang (ICML 2023). About two minutes. Policy, noise and reward are our choice, like the schedule of ABS:
the paper's own (its equation 6.2) is not available.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from cmbrl.bench.studies.gradients.figures_policy import figure_5b

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out", type=Path, default=Path("figure_5b_bias.png"), help="picture to write (default: %(default)s)"
    )
    parser.add_argument("--samples", type=int, default=256, help="initial states (default: %(default)s)")
    arguments = parser.parse_args()
    figure_5b(
        arguments.out, samples=arguments.samples, progress=lambda share, what: print(f"{100 * share:3.0f} % {what}")
    )
