"""The README's figure: how far off times of frames are, by the paper's rule and by ours, and the bounds of ours.

    python benchmarks/figure.py [--plot FILE]

One simulated flight of two minutes: STM32 firmware that counts 84 where 85 have passed, messages 500 us late on
average, none for three seconds. The paper's rule is idealised: the last stamp, and what has passed since, with the
fixed delay removed and clocks of 1 us.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "clock"))

from models import Floats, Link, run, silence  # type: ignore[import-not-found]
from track import tracked  # type: ignore[import-not-found]

from host.clock.stamps import stamp
from host.usd.drawing import Box, Dots, Line, Shape, Words, svg

SECONDS, SEED = 120, 3
SILENT_AT_S, SILENT_S = 60, 3
WIDTH, HEIGHT = 976, 470
LEFT, RIGHT, TOP, BOTTOM = 74, 230, 58, 46
LOW_US, HIGH_US = 0.1, 1e5
LEVELS = {0.1: "0.1 us", 1.0: "1 us", 10.0: "10 us", 100.0: "100 us", 1e3: "1 ms", 1e4: "10 ms", 1e5: "100 ms"}
EVERY = 7
"""Of so many frames one is drawn; all count."""
NAMES = {"paper": "the paper's rule", "online": "ours, as frames are taken", "offline": "ours, afterwards"}
RED, BLUE, GREEN, GREY, GRID = "#c8344b", "#0b62a4", "#2a8f57", "#6b7280", "#e3e6ea"


@dataclass(frozen=True)
class Times:
    """Of all frames that have one."""

    at_s: Floats
    error_us: Floats
    bound_us: Floats | None


def flight() -> dict[str, Times]:
    made = silence(run(Link("presc85", 500.0, SECONDS), SEED), 100 * SILENT_AT_S, SILENT_S)
    at_s = made.frame_us * 1e-6
    last = np.searchsorted(made.come_us, made.frame_us, side="right") - 1
    paper = made.stm32_us[last] + made.frame_gap8_us - made.gap8_us[last] - made.frame_true_us
    online = tracked(made)
    given = online.given
    stm32, gap8, frames = (each.astype(np.uint64) for each in (made.stm32_us, made.gap8_us, made.frame_gap8_us))
    offline = stamp(stm32, gap8, frames, made.frame_after)
    return {
        "paper": Times(at_s[last >= 0], np.abs(paper[last >= 0]), None),
        "online": Times(at_s[given], np.abs(online.error_us[given]), online.times["bound_us"][given].astype(float)),
        "offline": Times(
            at_s[offline.frame], np.abs(offline.stm32_us - made.frame_true_us[offline.frame]), offline.bound_us
        ),
    }


def x(at_s: Floats) -> Floats:
    return LEFT + at_s / SECONDS * (WIDTH - LEFT - RIGHT)


def y(value_us: Floats) -> Floats:
    part = np.log(np.clip(value_us, LOW_US, HIGH_US) / LOW_US) / np.log(HIGH_US / LOW_US)
    return HEIGHT - BOTTOM - part * (HEIGHT - TOP - BOTTOM)


def size(value_us: float) -> str:
    return f"{value_us / 1000:.1f} ms" if value_us >= 1000 else f"{value_us:.1f} us"


def points(at_s: Floats, value_us: Floats) -> list[tuple[float, float]]:
    return list(zip(x(at_s).tolist(), y(value_us).tolist(), strict=True))


def picture(flown: dict[str, Times]) -> Iterator[Shape]:
    yield Words(LEFT, 26, "How far off is the STM32 time of a frame?", 17, bold=True)
    about = f"84/85 clock, messages 500 us late on average, 100 a second; none for {SILENT_S} s"
    yield Words(LEFT, 45, f"one simulated flight, 30 frames a second; {about}", 12, fill=GREY)
    yield Box(LEFT, TOP, WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM, "#f8f9fa")
    silent = x(np.array([SILENT_AT_S, SILENT_AT_S + SILENT_S], np.float64))
    yield Box(float(silent[0]), TOP, float(silent[1] - silent[0]), HEIGHT - TOP - BOTTOM, "#eceff3")
    for level, name in LEVELS.items():
        height = float(y(np.array(level)))
        yield Line([(LEFT, height), (WIDTH - RIGHT, height)], GRID)
        yield Words(LEFT - 8, height + 4, name, 12, "end", GREY)
    for second in range(0, SECONDS + 1, 20):
        yield Words(float(x(np.array(float(second)))), HEIGHT - BOTTOM + 18, str(second), 12, "middle", GREY)
    yield Words(WIDTH - RIGHT, HEIGHT - 10, "time, s", 12, "end", GREY)
    for name, color, label_us in (("paper", RED, 800.0), ("online", BLUE, 30.0), ("offline", GREEN, 3.0)):
        times = flown[name]
        yield Dots(points(times.at_s[::EVERY], times.error_us[::EVERY]), color, 2.2)
        beside, label = WIDTH - RIGHT + 14, float(y(np.array(label_us)))
        yield Words(beside, label, NAMES[name], 13, fill=color, bold=True)
        yield Words(beside, label + 16, f"95 % of frames within {size(p95(times))}", 12, fill=color)
        if times.bound_us is not None:
            yield Line(points(*by_second(times)), color, 1.6)
            bound = size(float(np.median(times.bound_us)))
            yield Words(beside, label + 32, f"line: its bound, median {bound}", 12, fill=color)


def by_second(times: Times) -> tuple[Floats, Floats]:
    """The greatest bound of each half second."""
    begin = np.flatnonzero(np.diff(np.floor(times.at_s * 2), prepend=-1))
    assert times.bound_us is not None
    return times.at_s[begin], np.maximum.reduceat(times.bound_us, begin)


def p95(times: Times) -> float:
    return float(np.quantile(times.error_us, 0.95))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plot", type=Path, help="the picture, .svg; without it, only the figures are printed")
    plot = parser.parse_args().plot
    flown = flight()
    for name, times in flown.items():
        bound = "" if times.bound_us is None else f", bound {size(np.median(times.bound_us))} (median)"
        held = "" if times.bound_us is None else f", holds for {(times.error_us <= times.bound_us).mean():.2%}"
        print(f"{name:10}p95 {size(p95(times))}, worst {size(times.error_us.max())}{bound}{held}")
    if plot:
        plot.write_bytes(svg(WIDTH, HEIGHT, list(picture(flown))))


if __name__ == "__main__":
    main()
