#!/usr/bin/env bash
# Makes .venv with cmbrl built and installed in it (editable) at the tested versions. Does nothing when all is in place.
#   scripts/setup.sh            PYTHON=python3.12 scripts/setup.sh   to choose the interpreter
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

python=${PYTHON:-}
if [ -z "$python" ]; then
  for candidate in python3 python3.14 python3.13 python3.12 python3.11; do
    if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then python=$candidate; break; fi
  done
fi
[ -n "$python" ] || { echo "setup: no Python >= 3.11 found: install one or set PYTHON=/path/to/python" >&2; exit 2; }

compiler=${CXX:-}
[ -n "$compiler" ] || compiler=$(command -v g++ || command -v clang++ || true)
echo 'int main() { return []<class T>(T x) { return x; }(0); }' | "${compiler:-c++}" -std=c++20 -x c++ -fsyntax-only - 2>/dev/null \
  || { echo "setup: no C++20 compiler found (tried ${compiler:-g++, clang++}): install g++ >= 11 or set CXX" >&2; exit 2; }

# What was installed is remembered by a digest of everything that the installation depends on.
digest=$({ "$python" -VV; echo "$compiler"; cat pyproject.toml CMakeLists.txt configs/constraints.txt cmbrl/native/*.[ch]pp; pwd; } | cksum)
stamp=.venv/cmbrl-setup
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$digest" ]; then exit 0; fi

echo "setup: building cmbrl into .venv (a few minutes the first time)" >&2
[ -x .venv/bin/python ] || "$python" -m venv .venv
export PIP_DISABLE_PIP_VERSION_CHECK=1
CXX=$compiler .venv/bin/python -m pip install -qq --constraint configs/constraints.txt --editable '.[tasks,fit,data,train,play,export,dev]'
# The rivals of the benchmarks, by name so that the core is not built again. Some have no wheel everywhere; that stops nothing.
.venv/bin/python -c 'import tomllib; extras = tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]
print(*extras["bench"], *extras["pinocchio"], sep="\n")' > .venv/rivals.txt
.venv/bin/python -m pip install -qq --constraint configs/constraints.txt --requirement .venv/rivals.txt \
  || echo "setup: not all solvers of 'cmbrl bench' could be installed here; the studies leave out what is missing" >&2
echo "$digest" > "$stamp"
