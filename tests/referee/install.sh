#!/usr/bin/env bash
# Installs the cross compilers and QEMU (Debian, Ubuntu; as root; some 250 MB to download, 1.1 GB on disk).
# Without them the tests in this folder are skipped, and say so.
set -euo pipefail

packages=(
    gcc-arm-none-eabi       # STM32
    gcc-riscv64-unknown-elf # GAP8
    gcc-xtensa-lx106        # ESP32
    qemu-system-arm
    qemu-system-misc # RISC-V and Xtensa
)

missing=()
for package in "${packages[@]}"; do
    dpkg-query --show --showformat='${db:Status-Abbrev}' "$package" 2>/dev/null | grep -q ^ii || missing+=("$package")
done
[ ${#missing[@]} = 0 ] && exit 0
if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
    echo "run as root on Debian or Ubuntu: apt-get install --no-install-recommends ${missing[*]}" >&2
    exit 1
fi
{ apt-get update -q && apt-get install -qy --no-install-recommends "${missing[@]}"; } >/dev/null 2>&1 || {
    echo "apt-get cannot install ${missing[*]}" >&2
    exit 1
}
