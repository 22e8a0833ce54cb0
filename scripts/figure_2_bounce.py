"""Figure 2 of the ABS paper, made again: speed after a ball's bounce and its derivative along the start.

    .venv/bin/python scripts/figure_2_bounce.py [--out FILE]

Zhang, Jin & Wang (ICML 2023). A few seconds. Mass, speed, step and kappas are our choice.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from cmbrl.bench.studies.gradients.figures import figure_2

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out", type=Path, default=Path("figure_2_bounce.png"), help="picture to write (default: %(default)s)"
    )
    figure_2(parser.parse_args().out)
