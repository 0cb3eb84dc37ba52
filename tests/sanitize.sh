#!/usr/bin/env bash
# Usage: tests/sanitize.sh PYTHON [pytest arguments]
# Builds the native module with AddressSanitizer and UndefinedBehaviorSanitizer in a copy of the sources, and runs
# the Python tests against it.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$(realpath --no-symlinks "$1")
shift

copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
git ls-files -z --cached --others --exclude-standard | xargs -0 cp --parents --target-directory="$copy"
cd "$copy"

flags="-fsanitize=address,undefined -fno-sanitize-recover=undefined -fno-omit-frame-pointer -g -O1"
SPINDECK_CFLAGS="$flags" SPINDECK_LDFLAGS="-fsanitize=address,undefined" \
    "$python" setup.py --quiet build_ext --inplace

# The interpreter is not built with the sanitizer, so its runtime must be loaded first; Python's own allocations at
# exit would be reported as leaks. The referee compares what cross compilers and QEMU make of other builds.
libraries="$(gcc -print-file-name=libasan.so) $(gcc -print-file-name=libubsan.so)"
LD_PRELOAD="$libraries" ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 PYTHONPATH="$copy" \
    "$python" -m pytest -q -p no:cacheprovider --ignore=tests/referee "$@"
