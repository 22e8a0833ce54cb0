#!/usr/bin/env bash
# Builds the core with GCC, with Clang and for 64-bit ARM, with every warning an error, and replays calls recorded with the
# installed core on each build: the ARM one in an emulator, with an ARM Python and NumPy.
#   scripts/compilers.sh [gcc] [clang] [arm]          default: all; takes some 15 minutes
# Needs scripts/setup.sh and, on Debian: apt-get install clang g++-aarch64-linux-gnu qemu-user; dpkg --add-architecture arm64
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
python=$PWD/.venv/bin/python out=$PWD/build/compilers jobs=${JOBS:-$(nproc)}
mkdir -p "$out"

tools=$out/tools
[ -d "$tools" ] || "$python" -m pip install -qq --target "$tools" nanobind cmake ninja
export PYTHONPATH=$tools
cmake=$tools/bin/cmake
"$python" tests/native/replay.py record "$out/calls.pickle"

build() {  # name, compiler, more options of cmake
  local folder=$out/$1 compiler=$2
  shift 2
  "$cmake" -S . -B "$folder" -G Ninja -DCMAKE_MAKE_PROGRAM="$tools/bin/ninja" -DCMAKE_BUILD_TYPE=Release \
    -DCMAKE_CXX_COMPILER="$compiler" -DCMAKE_COMPILE_WARNING_AS_ERROR=ON -DPython_EXECUTABLE="$python" \
    -Dnanobind_DIR="$("$python" -m nanobind --cmake_dir)" "$@" > "$folder.log" || { cat "$folder.log" >&2; return 1; }
  "$cmake" --build "$folder" --parallel "$jobs" > "$folder.log" || { cat "$folder.log" >&2; return 1; }
  # A function that copies of the hot code share could use what a processor lacks: the linker keeps any one of them.
  local shared
  shared=$(find "$folder" -path '*/core_*.dir/*' -name '*.o' -exec nm -C {} + | grep -E ' [VWu] ' | grep -v 'cmbrl::[a-z0-9]*\(_pair\)*::' || true)
  [ -z "$shared" ] || { echo "compilers: functions outside the namespace of their instruction set: $shared" >&2; return 1; }
}

arm_python() {  # an arm64 Python with NumPy in $out/arm-root
  local root=$out/arm-root
  [ -x "$root/usr/bin/python3.11" ] && return
  mkdir -p "$root" "$out/packages"
  local packages=(python3.11-minimal libpython3.11-{minimal,stdlib} libexpat1 zlib1g libffi8 libssl3 libbz2-1.0 liblzma5 libc6 libgcc-s1 libstdc++6)
  (cd "$out/packages" && apt-get download -qq "${packages[@]/%/:arm64}")
  for package in "$out"/packages/*.deb; do dpkg -x "$package" "$root"; done
  "$python" -m pip install -qq --no-deps --only-binary=:all: --platform manylinux2014_aarch64 --python-version 3.11 --target "$root/numpy" numpy
}

[ $# -gt 0 ] || set -- gcc clang arm
for name in "$@"; do
  case $name in
    gcc) build gcc "$(command -v g++)" && "$python" tests/native/replay.py replay "$out/calls.pickle" "$out/gcc" ;;
    clang) build clang "$(command -v clang++)" && "$python" tests/native/replay.py replay "$out/calls.pickle" "$out/clang" ;;
    arm)
      arm_python
      include=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
      build arm aarch64-linux-gnu-g++ -DCMAKE_SYSTEM_NAME=Linux -DCMAKE_SYSTEM_PROCESSOR=aarch64 -DPython_INCLUDE_DIR="$include"
      mkdir -p "$out/arm-module"
      cp "$out"/arm/_core.*.so "$out/arm-module/_core.cpython-311-aarch64-linux-gnu.so"
      PYTHONPATH=$out/arm-root/numpy qemu-aarch64 -L "$out/arm-root" "$out/arm-root/usr/bin/python3.11" \
        tests/native/replay.py replay "$out/calls.pickle" "$out/arm-module" ;;
    *) echo "compilers: unknown $name; give gcc, clang or arm" >&2; exit 2 ;;
  esac
done
