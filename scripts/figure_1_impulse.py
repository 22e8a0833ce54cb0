"""Figures 1c and 1d of the ABS paper, made again: impulse of one contact against z, and kappa(z).

    .venv/bin/python scripts/figure_1_impulse.py [--out FILE]

Zhang, Jin & Wang (ICML 2023). A few seconds. Mass, step and kappas are our choice.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from cmbrl.bench.studies.gradients.figures import figure_1

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out", type=Path, default=Path("figure_1_impulse.png"), help="picture to write (default: %(default)s)"
    )
    figure_1(parser.parse_args().out)
