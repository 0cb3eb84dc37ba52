"""The power goes while a log is written: behind any sector write, with the last writes torn, lost or out of order.

Always the card is in order but for what fsck.fat calls lost clusters and stale counts; all rows up to the last sync are
there and verified; no row that is called verified is wrong; the next flight logs on, without harm to the first log.

A sample here. SPINDECK_CUTS=all: every write of the 20 s logs, as it is and damaged, and 2,000 points of 10-minute
logs, damaged. One cut again: python tests/sim/test_card_cuts.py FLIGHT WRITE [damaged]
"""

import os
import sys
import tempfile
from pathlib import Path

import pytest

pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")

from card_campaign import LONG, SHORT, every_write, flight_of, random_writes, run, some_writes
from card_judge import Image, judge

from sim.card_cuts import Cuts

ALL = os.environ.get("SPINDECK_CUTS") == "all"
SAMPLE = 10
LONG_CUTS = 2000


@pytest.mark.parametrize("damaged", [False, True], ids=["plain", "damaged"])
@pytest.mark.parametrize("name", SHORT if ALL else ["stm32-4096-20-1", "mocap-128-20-1"])
def test_a_log_of_20_s(name, damaged, tmp_path):
    result = run(name, every_write(name) if ALL else some_writes(name, SAMPLE), damaged, tmp_path)
    assert not result.failures, "\n".join(result.failures)
    assert result.found[0].promised == 0
    assert damaged or result.found[-1].verified == len(flight_of(name).files["log00"].content)


@pytest.mark.skipif(not ALL, reason="half an hour: SPINDECK_CUTS=all")
@pytest.mark.parametrize("name", [each.format(600) for each in LONG])
def test_logs_of_10_minutes(name, tmp_path):
    result = run(name, random_writes(name, -(-LONG_CUTS // len(LONG))), True, tmp_path, others=50)
    assert not result.failures, "\n".join(result.failures)


def test_a_reader_that_is_wrong_is_found(tmp_path):
    """The judge's own test: content that is not what was written, promises that are not kept."""
    flight = flight_of("mocap-128-20-1")
    writes = len(flight.recording.writes)
    image, cuts = Image(flight, tmp_path / "partition"), Cuts(flight.recording)
    image.put(cuts.after(writes // 2))
    assert judge(image, flight, writes // 2).promised > 50_000
    with pytest.raises(AssertionError, match="a sync had covered"):
        judge(image, flight, writes)
    content, values = flight.files["log00"].content, flight.given["fixedFrequency"]["v.f1"]
    kept = values[50]
    try:
        content[100] ^= 1
        with pytest.raises(AssertionError, match="is wrong"):
            judge(image, flight, 0)
        content[100] ^= 1
        values[50] += 1
        with pytest.raises(AssertionError, match="never given"):
            judge(image, flight, 0)
    finally:
        values[50] = kept
    judge(image, flight, writes // 2)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        again = run(sys.argv[1], [int(sys.argv[2])], "damaged" in sys.argv[3:], Path(temporary))
        print(*again.found, *again.failures, sep="\n")
        sys.exit(bool(again.failures))
