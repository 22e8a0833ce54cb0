#!/usr/bin/env bash
# Builds the core with a sanitizer of GCC into a folder of its own and runs tests of it there.
#   scripts/sanitize.sh address | undefined | thread          further arguments go to pytest
# Needs scripts/setup.sh and g++. Python, NumPy, PyTorch and MuJoCo are not instrumented: what they do is not seen.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
kind=${1:-}
shift || true
case $kind in
  address) library=libasan.so ;;
  undefined) library=libubsan.so ;;
  thread) library=libtsan.so ;;
  *) echo "sanitize: give address, undefined or thread" >&2; exit 2 ;;
esac

isa=generic
[ "$(uname -m)" != x86_64 ] || isa=avx2
# An environment that shares the packages of .venv, but for cmbrl itself.
folder=$PWD/build/sanitize-$kind
python=$folder/venv/bin/python
[ -x "$python" ] || .venv/bin/python -m venv --without-pip "$folder/venv"
site=$("$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))' > "$site/shared.pth"
CXX=g++ .venv/bin/python -m pip --python "$python" install -qq --disable-pip-version-check --no-deps --force-reinstall . \
  --config-settings "build-dir=$folder/build" --config-settings "cmake.define.CMBRL_SANITIZE=$kind" \
  --config-settings "cmake.define.CMBRL_ISAS=$isa" --config-settings install.strip=false

# Leaks are not looked for: Python and PyTorch keep memory until the end on purpose. The allocator returns null as the
# system's does, which is what the core must be able to stand.
export ASAN_OPTIONS=detect_leaks=0:allocator_may_return_null=1:abort_on_error=1
export UBSAN_OPTIONS=print_stacktrace=1:halt_on_error=1
export TSAN_OPTIONS=halt_on_error=1:second_deadlock_stack=1:die_after_fork=0
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1  # their threads are not seen either
export LD_PRELOAD="$(g++ -print-file-name=$library) $(g++ -print-file-name=libstdc++.so)"

case $kind in
  thread) tests=(tests/native/test_{batches,fork,interrupt}.py tests/contact/test_native_solver.py) ;;
  *) tests=(tests/native tests/contact tests/models/test_autograd.py tests/scene/test_steps_of_files.py) ;;
esac
start=()
[ "$kind" = thread ] && start=(setarch "$(uname -m)" -R)  # where the kernel spreads addresses wider than it can map
exec "${start[@]}" "$python" -P -m pytest -p no:cacheprovider "${tests[@]}" "$@"  # -P: not the sources here
