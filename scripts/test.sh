#!/usr/bin/env bash
# Sets up, then runs checks and tests, two at a time. Arguments go to pytest: scripts/test.sh -m slow; -n 0 for one at a time
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
scripts/setup.sh
.venv/bin/ruff check .
.venv/bin/lint-imports
.venv/bin/mypy
exec .venv/bin/python -m pytest -n 2 --dist worksteal "$@"
