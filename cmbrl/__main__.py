"""``python -m cmbrl`` is the command ``cmbrl``."""

import sys

from cmbrl.cli import main

sys.exit(main())
