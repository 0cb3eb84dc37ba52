"""The least squares of firmware/core/clock_coarse.c, compiled as they are, beside numpy's."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

CORE = Path(__file__).resolve().parents[2] / "firmware/core"
MAIN = """
#include "clock_parts.h"
#include <stdio.h>
int main(void) {
    long long weight, x, y, at;
    clock_moments_t moments = {0};
    scanf("%lld", &at);
    while (scanf("%lld %lld %lld", &weight, &x, &y) == 3) {
        clock_moments_add(&moments, weight, x, y);
    }
    const clock_least_squares_t line = clock_moments_line(&moments);
    printf("%lld\\n", (long long)clock_least_squares_at(&line, at));
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("least-squares") / "main"
    sources = [CORE / name for name in ("clock.c", "clock_blocks.c", "clock_coarse.c", "clock_window.c")]
    flags = ["-fsanitize=undefined", "-fno-sanitize-recover", f"-I{CORE}", "-x", "c", "-"]
    subprocess.run(["gcc", *flags, *sources, "-o", made], input=MAIN, text=True, check=True)
    return made


def value_at(program: Path, at: int, weight: np.ndarray, x: np.ndarray, y: np.ndarray) -> int:
    text = "\n".join([str(at), *(f"{w} {a} {b}" for w, a, b in zip(weight, x, y, strict=True))])
    return int(subprocess.run([program], input=text, text=True, check=True, capture_output=True).stdout)


@pytest.mark.parametrize("count", [1, 2, 8, 16, 32, 64])
@pytest.mark.parametrize("y", [128_000, -128_000, (1 << 26) - 1])
def test_a_constant_comes_back(program: Path, count: int, y: int) -> None:
    x = -5 * np.arange(count) - 3
    assert value_at(program, 0, np.ones(count, int), x, np.full(count, y)) == y


@pytest.mark.parametrize("slope", [1, -7, 400])
@pytest.mark.parametrize("count", [2, 8, 63])
def test_a_line_comes_back(program: Path, count: int, slope: int) -> None:
    x = -244 * np.arange(count) - 11
    weight = 1 + np.arange(count) * 7 % 25
    assert abs(value_at(program, 500, weight, x, slope * x - 12_345) - (slope * 500 - 12_345)) <= 2


@pytest.mark.parametrize("seed", range(5))
def test_random_points_have_numpys_line(program: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    count = int(random.integers(3, 65))
    x, y = random.integers(-65_535, 65_536, count), random.integers(-(1 << 26) + 1, 1 << 26, count)
    weight = random.integers(1, 256, count)
    due = np.polyval(np.polyfit(x, y, 1, w=np.sqrt(weight)), 0)
    # The slope has 16 bits after the point, and x 16 before it.
    assert value_at(program, 0, weight, x, y) == pytest.approx(due, abs=3), f"seed {seed}"
