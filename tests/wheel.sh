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

for package, name in [("firmware.core", "cpx.h"), ("firmware.gap8", "app.c"), ("sim.scenarios", "hover.toml"), ("sim.kernel", "kernel.h")]:
    assert files(package).joinpath(name).is_file(), f"{package}/{name} is not in the wheel"
PY
echo "wheel: five frames from an empty environment"
