#!/usr/bin/env bash
# Creates .venv with cmbrl built and installed in it (editable) at the tested versions; does nothing when all is in place.
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

# A digest of everything that the installation depends on tells whether it is up to date. It knows modules by their places: none may have moved.
digest=$({ "$python" -VV; echo "$compiler"; cat pyproject.toml CMakeLists.txt configs/constraints.txt cmbrl/native/*.[ch]pp cmbrl/native/*/*.[ch]pp; pwd; } | cksum)
stamp=.venv/cmbrl-setup
moved() { grep -oh "'/[^']*\.py'" .venv/lib/*/site-packages/_editable_*cmbrl.py | tr -d "'" | while read -r file; do [ -e "$file" ] || echo "$file"; done; }
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$digest" ] && [ -z "$(moved)" ]; then exit 0; fi

echo "setup: building cmbrl into .venv (a few minutes the first time)" >&2
[ -x .venv/bin/python ] || "$python" -m venv .venv
export PIP_DISABLE_PIP_VERSION_CHECK=1
CXX=$compiler .venv/bin/python -m pip install -qq --constraint configs/constraints.txt --editable '.[tasks,fit,data,logs,urdf,train,play,export,dev]'
# Optional packages, by name so that the core is not built again. Some have no wheel for every platform: then go on without.
optional() {
  .venv/bin/python -c 'import sys, tomllib; extras = tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]
for name in sys.argv[1:]: print(*extras[name], sep="\n")' "$@" > .venv/optional.txt
  .venv/bin/python -m pip install -qq --constraint configs/constraints.txt --requirement .venv/optional.txt
}
optional bench pinocchio \
  || echo "setup: not all competitors of 'cmbrl bench' could be installed; the studies leave out what is missing" >&2
optional drake || echo "setup: Drake could not be installed; 'cmbrl evaluate --simulator drake' is not there, and its tests are skipped" >&2
optional dm || echo "setup: dm_control could not be installed; the tests of its tasks are skipped" >&2
optional ray dask || echo "setup: Ray or Dask could not be installed; their tests are skipped" >&2
echo "$digest" > "$stamp"
