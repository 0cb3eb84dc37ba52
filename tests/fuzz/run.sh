#!/usr/bin/env bash
# Usage: tests/fuzz/run.sh [SECONDS [TARGET...]]
# Builds every target (tests/fuzz/fuzz_*.c) with AddressSanitizer and UndefinedBehaviorSanitizer and runs each for
# SECONDS (5), starting from the inputs of seeds.txt. A finding ends it, and says how to replay it.
set -euo pipefail
cd "$(dirname "$0")/../.."

seconds=${1:-5}
targets=("${@:2}")
if [ ${#targets[@]} = 0 ]; then
    for source in tests/fuzz/fuzz_*.c; do
        targets+=("$(basename "$source" .c)")
    done
fi

out=out/fuzz
mkdir -p "$out"

clang=
for candidate in clang-19 clang clang-20 clang-18 clang-17 clang-16 clang-15 clang-14; do
    # An empty program links only where libFuzzer's runtime is installed.
    if echo 'int LLVMFuzzerTestOneInput(void) { return 0; }' |
        "$candidate" -fsanitize=fuzzer,address -x c -o "$out/probe" - 2>/dev/null; then
        clang=$candidate
        break
    fi
done
if [ -z "$clang" ]; then
    echo "tests/fuzz: skipped: no clang with libFuzzer here (Debian, Ubuntu: apt-get install clang-19 libclang-rt-19-dev)"
    exit 0
fi

flags=(-std=c11 -g -O1 -fno-omit-frame-pointer -fsanitize=address,undefined -fno-sanitize-recover=all
    -Wall -Wextra -Wconversion -Werror -I.)

# The code under test, once, as an archive that each target takes from.
objects=()
for source in firmware/{core,stm32,gap8,esp32}/*.c host/native/[!_]*.c; do
    [ -e "$source" ] || continue
    object=$out/${source//\//-}.o
    "$clang" "${flags[@]}" -fsanitize=fuzzer-no-link -c "$source" -o "$object"
    objects+=("$object")
done
rm -f "$out/code.a"
ar rc "$out/code.a" "${objects[@]}"

for target in "${targets[@]}"; do
    "$clang" "${flags[@]}" -fsanitize=fuzzer "tests/fuzz/$target.c" "$out/code.a" -o "$out/$target"
    corpus=$out/corpus/$target
    mkdir -p "$corpus"
    # A line of seeds.txt: the target, then bytes in hexadecimal.
    number=0
    while read -r name bytes; do
        if [ "$name" = "$target" ]; then
            number=$((number + 1))
            printf '%b' "$(sed -E 's/ ?([0-9a-f]{2})/\\x\1/g' <<<"$bytes")" >"$corpus/seed-$number"
        fi
    done <tests/fuzz/seeds.txt
    if ! "$out/$target" -seed=1 -max_total_time="$seconds" -timeout=10 -max_len=4096 -artifact_prefix="$out/$target-" \
        "$corpus" >"$out/$target.log" 2>&1; then
        cat "$out/$target.log"
        finding=$(grep -o "$out/$target-[a-z]*-[0-9a-f]*" "$out/$target.log" | tail -1 || true)
        echo "tests/fuzz: $target found a fault; to replay it: $out/$target $finding"
        exit 1
    fi
    echo "$target: $(grep -o 'Done.*' "$out/$target.log"), $(grep -o 'cov: [0-9]*' "$out/$target.log" | tail -1)"
done
