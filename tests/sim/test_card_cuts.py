"""The power goes while a log is written: behind any sector write, with the last writes torn, lost or out of order.

Always the card is in order but for what fsck.fat calls lost clusters and stale counts; all rows up to the last sync are
there and verified; no row that is called verified is wrong; the next flight logs on, without harm to the first log.

A sample here. SPINDECK_CUTS=all: every write of the 20 s logs, as it is and damaged, and 2,000 points of 10-minute
logs, damaged. One cut again: python tests/sim/test_card_cuts.py FLIGHT WRITE
"""

import functools
import os
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")

from card_flights import Flight, Found, Image, Rate, flies_again, fsck, judge, model_flight, same_as_others

from sim.card_cuts import Cuts

ALL = os.environ.get("SPINDECK_CUTS") == "all"
RATES = {"mocap": Rate(), "fast": Rate(hz=1000, floats=20, poses_hz=50)}
SHORT = (
    [f"{rate}-{size_mb}-20-1" for rate in RATES for size_mb in (128, 4096)]
    if ALL
    else ["mocap-128-20-1", "fast-4096-20-1"]
)
LONG = [f"{rate}-{size_mb}-600-{seed}" for rate in RATES for size_mb in (1024, 8192) for seed in (1, 2)]
SAMPLE = 15
EDGE = 8
"""The first and the last writes, in which directory and FAT change."""
LONG_CUTS = 2000


@functools.lru_cache(maxsize=2)
def flight_of(name: str) -> Flight:
    """RATE-CARD_MB-SECONDS-SEED"""
    rate, size_mb, seconds, seed = name.split("-")
    return model_flight(int(size_mb), float(seconds), int(seed), RATES[rate])


def run(name: str, counts: list[int], damaged: bool, folder: Path, others: int = 10) -> tuple[list[Found], list[str]]:
    """What was found after each cut, and what went wrong; of every `others`-th cut more is looked at."""
    flight = flight_of(name)
    image, cuts = Image(flight, folder / "partition"), Cuts(flight.recording)
    found, failures = [], []
    for number, count in enumerate(counts):
        image.put(cuts.after(count))
        sectors, fates = cuts.damaged(np.random.default_rng([count, 7])) if damaged else ({}, [])
        image.put(sectors)
        try:
            if shutil.which("fsck.fat"):
                fsck(image.path)
            found.append(judge(image, flight, count))
            if number % others == 0 or count < EDGE:
                same_as_others(image, flight, count)
                flies_again(image, flight, flight.recording.base | cuts.now | sectors, count)
        except AssertionError as error:
            again = f"python tests/sim/test_card_cuts.py {name} {count}{' damaged' * damaged}"
            failures.append(f"{error}\n  last writes: {fates}\n  again: {again}")
        image.put(cuts.restored(sectors))
    return found, failures


def sample(name: str) -> list[int]:
    """All, or the edges and some in between."""
    writes = len(flight_of(name).recording.writes)
    if ALL:
        return list(range(writes + 1))
    between = np.random.default_rng(1).choice(np.arange(EDGE, writes - EDGE), SAMPLE, replace=False)
    return [*range(EDGE), *sorted(between.tolist()), *range(writes - EDGE, writes + 1)]


@pytest.mark.parametrize("damaged", [False, True], ids=["plain", "damaged"])
@pytest.mark.parametrize("name", SHORT)
def test_a_log_of_20_s(name, damaged, tmp_path):
    found, failures = run(name, sample(name), damaged, tmp_path)
    assert not failures, "\n".join(failures)
    assert found[0].promised == 0
    assert found[-1].verified == len(next(iter(flight_of(name).files.values())).content)
    assert any(each.promised < each.verified for each in found) or damaged


@pytest.mark.skipif(not ALL, reason="some minutes: SPINDECK_CUTS=all")
@pytest.mark.parametrize("name", LONG)
def test_logs_of_10_minutes(name, tmp_path):
    writes = len(flight_of(name).recording.writes)
    counts = np.random.default_rng(2).choice(writes + 1, LONG_CUTS // len(LONG), replace=False)
    _, failures = run(name, sorted(counts.tolist()), True, tmp_path, others=50)
    assert not failures, "\n".join(failures)


def test_a_reader_that_is_wrong_is_found(tmp_path):
    """The judge's own test: content that is not what was written, promises that are not kept."""
    name = SHORT[0]
    flight = flight_of(name)
    writes = len(flight.recording.writes)
    image, cuts = Image(flight, tmp_path / "partition"), Cuts(flight.recording)
    image.put(cuts.after(writes // 2))
    assert judge(image, flight, writes // 2).promised > 50_000
    with pytest.raises(AssertionError, match="a sync had covered"):
        judge(image, flight, writes)
    file = flight.files["log00"]
    file.content[100] ^= 1
    try:
        with pytest.raises(AssertionError, match="wrong"):
            judge(image, flight, 0)
    finally:
        file.content[100] ^= 1
    flight.given["fixedFrequency"]["v.f1"][50] += 1
    try:
        with pytest.raises(AssertionError, match="never given"):
            judge(image, flight, 0)
    finally:
        flight.given["fixedFrequency"]["v.f1"][50] -= 1


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        shown, wrong = run(sys.argv[1], [int(sys.argv[2])], "damaged" in sys.argv[3:], Path(temporary))
        print(*shown, *wrong, sep="\n")
        sys.exit(bool(wrong))
