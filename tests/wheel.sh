#!/usr/bin/env bash
# Usage: tests/wheel.sh PYTHON
# What a user of `pip install` gets: sdist -> wheel -> empty environment -> five frames from the simulated robot.
# Everything that the package needs (headers, sources, scenarios) must travel with it.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$(realpath --no-symlinks "$1")

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" -m build --outdir "$work" . >"$work/build.log" 2>&1 || { cat "$work/build.log"; exit 1; }
"$python" -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check "$work"/*.whl
cd "$work"
venv/bin/host --help >/dev/null
[ "$(venv/bin/spindeck --version)" = "$(venv/bin/python -m host --version)" ]
venv/bin/host stream --port "sim://hover?pace=max" --count 5 --json | tail -1
venv/bin/python - <<'PY'
from importlib.resources import files

for package, name in [
    ("firmware.core", "cpx.h"), ("firmware.gap8", "app.c"), ("firmware.board", "string.h"), ("firmware.gap8.board", "startup.S"),
    ("firmware.stm32.board", "stm32f405.ld"), ("sim.scenarios", "hover.toml"), ("sim.kernel", "kernel.h"),
]:
    assert files(package).joinpath(name).is_file(), f"{package}/{name} is not in the wheel"
PY
# Firmware too comes out of the wheel, the same as out of the checkout.
if command -v arm-none-eabi-gcc >/dev/null; then
    venv/bin/pip install --quiet --disable-pip-version-check pyelftools
    XDG_CACHE_HOME="$work/cache" venv/bin/host firmware build --target stm32 --toolchain gcc --output installed --json >/dev/null
    (cd "$OLDPWD" && "$python" -m host firmware build --target stm32 --toolchain gcc --output "$work/checkout" --json >/dev/null)
    cmp installed/stm32.elf checkout/stm32.elf
else
    echo "wheel: no arm-none-eabi-gcc (apt-get install gcc-arm-none-eabi): no image is built from it"
fi
echo "wheel: five frames from an empty environment"
