"""The command line: parses, calls, prints. One small file for each command.

argparse, because it is in the standard library and every message stays ours: a mistake is one line and exit code 2.
"""

from cmbrl.cli.main import main

__all__ = ["main"]
