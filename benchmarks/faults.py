"""What faults of clocks and links do to the times of frames, as they are taken and from the whole recording.

A frame is wrong if it has a time that is off by more than its bound, and nothing flags it. Online those are counted
apart that ended before the first message that reveals the fault (tests/clock/oracle.py: the best test that knows the
clocks, the fault and its start, with false alarms of --alpha): they cannot be known, and what is wrong after it could
be. A fault of messages alone changes no frame's time: there is no before. A bound is of 99 %, so that some frames are
beyond it by chance: what is so without the fault too does not count, but in the first row. 100 messages a second,
their delays exponential, and 30 frames.

    python benchmarks/faults.py [--seeds 4] [--alpha 0.001] [--only WORD] [--json]
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests/clock"))

import models  # type: ignore[import-not-found]
import numpy as np
import oracle  # type: ignore[import-not-found]
from models import Link, Run
from track import tracked  # type: ignore[import-not-found]

from host.clock.stamps import stamp

SECONDS = 60
AT = 3000
"""The message at which a fault begins, in the middle."""
PLAIN = Link("presc85", 500, SECONDS)
BITS = 32
NEAR_WRAP = (1 << BITS) - 30_000_000


@dataclass(frozen=True)
class Fault:
    act: Callable[[Run, int], Run] = lambda made, _: made
    """To a run, with a seed."""
    link: Link = PLAIN
    leap_us: Callable[[Run], float] | None = None
    """Of the STM32's clock at message AT."""
    resets: bool = False
    """The STM32 says that it has begun anew from message AT on."""
    plus: dict[str, int] = field(default_factory=dict)
    """What track.tracked adds to the clocks, which then have 32 bits."""


def leap(by_us: int) -> Fault:
    return Fault(lambda made, _: models.stm32_leap(made, AT, by_us), leap_us=lambda _: by_us)


def to_zero(made: Run) -> int:
    return -int(made.stm32_us[AT])


def rate_step(ppm: float, mu_us: float = 500) -> Fault:
    return Fault(link=replace(PLAIN, rate_step_ppm=ppm, mu_us=mu_us))


def first(count: int) -> Fault:
    return Fault(lambda made, _: models.take(made, np.arange(len(made.stm32_us)) < count))


def late(delay_us: Callable[[models.Floats], models.Floats], mu_us: float = 500) -> Fault:
    return Fault(link=replace(PLAIN, delay_us=delay_us, mu_us=mu_us))


NONE = Fault()
FAULTS: dict[str, Fault] = {
    "none": NONE,
    "STM32's clock of 32 bits wraps": Fault(plus={"stm32_plus": NEAR_WRAP}),
    "GAP8's clock of 32 bits wraps": Fault(plus={"gap8_plus": NEAR_WRAP}),
    "both wrap": Fault(plus={"stm32_plus": NEAR_WRAP, "gap8_plus": NEAR_WRAP}),
    "STM32 set to 0": Fault(lambda made, _: models.stm32_leap(made, AT, to_zero(made)), leap_us=to_zero, resets=True),
    "STM32 set to 0, not told": Fault(lambda made, _: models.stm32_leap(made, AT, to_zero(made)), leap_us=to_zero),
    "STM32 set to 0, 15 times, 1 ms apart": Fault(
        lambda made, _: models.stm32_resets(made, AT, 15, 1_000), leap_us=to_zero, resets=True
    ),
    "STM32 250 ms on": leap(250_000),
    "STM32 250 ms back": leap(-250_000),
    "STM32 3 ms back": leap(-3_000),
    "GAP8 starts anew": Fault(lambda made, _: models.gap8_reboot(made, AT, 1.5)),
    **{
        f"rate {ppm:+d} ppm, mu {mu} us": rate_step(ppm, mu) for mu in (50, 500, 2000) for ppm in (50, -50, 2000, -2000)
    },
    "no messages for 3 s": Fault(lambda made, _: models.silence(made, AT, 3)),
    "no messages for 15 s": Fault(lambda made, _: models.silence(made, AT, 15)),
    "0.5 s of them at once": Fault(lambda made, _: models.backlog(made, AT, 0.5)),
    "one in five twice": Fault(lambda made, seed: models.duplicates(made, 0.2, seed)),
    "one pair in twenty swapped": Fault(lambda made, seed: models.swapped(made, 0.05, seed)),
    "STM32's clock stands for 2 s": Fault(lambda made, _: models.stuck(made, AT, 2)),
    "each 500th 65.536 ms early": Fault(lambda made, _: models.glitches(made, [*range(250, 6000, 500)], 65_536)),
    "each 500th 65.536 ms late": Fault(lambda made, _: models.glitches(made, [*range(250, 6000, 500)], -65_536)),
    "one in 256 damaged, unseen": Fault(lambda made, seed: models.damaged(made, 1 / 256, seed)),
    "the first 10 ms early": Fault(lambda made, _: models.glitches(made, [0], 10_000)),
    "the first 65 ms late": Fault(lambda made, _: models.glitches(made, [0], -65_536)),
    "40 ms late each second": late(models.starved),
    "mu from 50 us to 2 ms": Fault(link=replace(PLAIN, mu_us=lambda at_s: np.where(at_s < 30, 50.0, 2000.0))),
    "delay a saw of 1 ms in 0.6 s": late(lambda at_s: 1000 * (at_s / 0.6173 % 1), 1),
    "delay a sine of 1 ms in 1 s": late(lambda at_s: 500 - 500 * np.cos(2 * np.pi * at_s), 100),
    "half lost, 2 s at a time": Fault(link=replace(PLAIN, loss=0.5, burst_s=2)),
    "no message ever": first(0),
    "one message": first(1),
    "two messages": first(2),
    "3 hours": Fault(link=replace(PLAIN, seconds=10_800, fps=3)),
}


@dataclass(frozen=True)
class Judged:
    """Of one run."""

    frames: int
    before: int
    after: int
    worst_us: float
    """Error of frames without a flag, after."""
    over_us: float
    """The most that one of them is beyond its bound."""
    revealed_s: float
    """After the fault began; infinite: it did not begin at an instant, or nothing does."""
    flagged_s: float
    """Until the first frame with a flag that would not have one without the fault."""
    flagged: int
    offline: int
    offline_over_us: float
    offline_worst_us: float
    refused: int


def without(fault: Fault, seed: int) -> Run:
    """The same run as it would have been."""
    mu_us = fault.link.mu_us
    plain = replace(PLAIN, seconds=fault.link.seconds, fps=fault.link.fps, mu_us=50 if callable(mu_us) else mu_us)
    return models.run(plain, seed)


def judge(fault: Fault, seed: int, alpha: float) -> Judged:
    plain = models.run(fault.link, seed)
    made = fault.act(plain, seed)
    epochs = (np.arange(len(made.stm32_us)) >= AT).astype(np.int64) if fault.resets else None
    online = tracked(made, epochs=epochs, bits=BITS if fault.plus else 64, **fault.plus)
    wrong = online.wrong_unflagged
    wrong_later, over_later_us, error_later_us, refused = offline(made, fault.plus, epochs)
    usual = without(fault, seed)
    if fault is not NONE and np.array_equal(usual.frame_us, made.frame_us):
        wrong &= ~tracked(usual).wrong_unflagged
        wrong_later &= ~offline(usual, {}, None)[0]
    begin_us, seen_us = -np.inf, -np.inf
    if fault.leap_us:
        begin_us = float(plain.sent_us[AT]) - models.LEAP_BEFORE_US
        shift = oracle.of_leap(plain, AT, fault.leap_us(plain))
        seen_us = oracle.revealed_us(plain, shift, float(fault.link.mu_us), alpha)
    if fault.link.rate_step_ppm:
        begin_us = fault.link.seconds / 2 * 1e6
        seen_us = oracle.revealed_us(plain, oracle.of_rate_step(plain, fault.link), float(fault.link.mu_us), alpha)
    hidden = wrong & (made.frame_us >= begin_us) & (made.frame_us < seen_us)
    known = wrong & ~hidden
    quiet = online.given & ~online.flagged & ~hidden
    told = (online.flagged | ~online.given) & (made.frame_us >= begin_us)
    return Judged(
        frames=len(wrong),
        before=int(hidden.sum()),
        after=int(known.sum()),
        worst_us=float(np.abs(online.error_us[quiet]).max(initial=0)),
        over_us=float((np.abs(online.error_us) - online.times["bound_us"])[known].max(initial=0)),
        revealed_s=(seen_us - begin_us) / 1e6,
        flagged_s=float(made.frame_us[told][0] - begin_us) / 1e6 if told.any() else math.inf,
        flagged=int((online.flagged | ~online.given).sum()),
        offline=int(wrong_later.sum()),
        offline_over_us=float(over_later_us[wrong_later].max(initial=0)),
        offline_worst_us=float(np.nanmax(error_later_us, initial=0)),
        refused=refused,
    )


def offline(made: Run, plus: dict[str, int], epochs: Any) -> tuple[Any, Any, Any, int]:
    """Of each frame whether it is wrong, by how much it is beyond its bound, its error; and how many are refused."""
    mask = np.uint64((1 << BITS) - 1 if plus else (1 << 64) - 1)
    stm32_plus, gap8_plus = (plus.get(name, 0) for name in ("stm32_plus", "gap8_plus"))
    stm32 = (made.stm32_us + stm32_plus).astype(np.uint64) & mask
    gap8, frames = ((each + gap8_plus).astype(np.uint64) & mask for each in (made.gap8_us, made.frame_gap8_us))
    got = stamp(stm32, gap8, frames, made.frame_after, epochs)
    error_us, bound_us = np.full(len(frames), np.nan), np.full(len(frames), np.nan)
    error_us[got.frame] = np.abs(got.stm32_us - stm32_plus - made.frame_true_us[got.frame])
    bound_us[got.frame] = got.bound_us
    return error_us > bound_us, error_us - bound_us, error_us, len(got.refused)


def row(fault: Fault, seeds: int, alpha: float) -> dict[str, float | None]:
    all_ = [judge(fault, seed, alpha) for seed in range(seeds)]

    def total(name: str) -> float:
        return float(sum(getattr(each, name) for each in all_))

    def most(name: str) -> float:
        return max(float(getattr(each, name)) for each in all_)

    def median(name: str) -> float | None:
        middle = float(np.median([getattr(each, name) for each in all_]))
        return middle if math.isfinite(middle) else None

    return {
        "frames": total("frames"),
        "flagged": total("flagged"),
        "before": total("before"),
        "after": total("after"),
        "over_us": most("over_us"),
        "worst_us": most("worst_us"),
        "revealed_s": median("revealed_s"),
        "flagged_s": median("flagged_s"),
        "offline": total("offline"),
        "offline_over_us": most("offline_over_us"),
        "offline_worst_us": most("offline_worst_us"),
        "refused": total("refused"),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--alpha", type=float, default=0.001, help="false alarms of the test that reveals a fault")
    parser.add_argument("--only", default="", metavar="WORD", help="faults with this in their name")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.seeds < 1 or not 0 < options.alpha < 1:
        parser.error("--seeds must be at least 1, --alpha between 0 and 1")
    names = [name for name in FAULTS if options.only in name]
    if not names:
        parser.error(f"--only {options.only}: no such fault; there are: {', '.join(FAULTS)}")
    if options.json:
        print(json.dumps({name: row(FAULTS[name], options.seeds, options.alpha) for name in names}))
        return
    print(f"{'':38}{'online: wrong without a flag':^38}{'seconds until':^16}{'offline':^29}")
    print(
        f"{'fault':38}{'before':>8}{'after':>7}{'over us':>9}{'worst us':>9}{'flagged':>8}"
        f"{'told':>7}{'flag':>7}{'wrong':>7}{'over us':>9}{'worst us':>9}{'refused':>8}  of frames"
    )
    for name in names:
        each = row(FAULTS[name], options.seeds, options.alpha)
        told, flag = (f"{each[key]:.2f}" if each[key] is not None else "-" for key in ("revealed_s", "flagged_s"))
        print(
            f"{name:38}{each['before']:8.0f}{each['after']:7.0f}{each['over_us']:9.0f}{each['worst_us']:9.0f}"
            f"{each['flagged']:8.0f}{told:>7}{flag:>7}{each['offline']:7.0f}{each['offline_over_us']:9.1f}"
            f"{each['offline_worst_us']:9.0f}{each['refused']:8.0f}{each['frames']:11.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
