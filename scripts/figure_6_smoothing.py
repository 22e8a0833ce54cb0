"""Figure 6 of the ABS paper, made again: derivative of an impact and of a pushed box, barrier against random smoothing.

    .venv/bin/python scripts/figure_6_smoothing.py [--out FILE]

Zhang, Jin & Wang (ICML 2023). A few seconds. Block, noise and kappas are our choice (500 samples: Dojo's comparison).
"""

from __future__ import annotations

import argparse
from pathlib import Path

from cmbrl.bench.studies.gradients.figures import figure_6

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out", type=Path, default=Path("figure_6_smoothing.png"), help="picture to write (default: %(default)s)"
    )
    figure_6(parser.parse_args().out)
