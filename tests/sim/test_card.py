"""The virtual card: the storage port's operations on a real FAT image, and what goes wrong with cards."""

import shutil
import struct
import subprocess

import numpy as np
import pytest

pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")

from sim.card import CLOSE, CREATE, DISK, EXISTS, FULL, NO_CARD, NO_FILE, OPEN, READ, SEEK, SYNC, TRUNCATE, WRITE, Card
from sim.card_format import FATS, MB_MAX, MB_MIN, SECTOR, layout_of

SIZES_MB = [MB_MIN, 63, 64, 128, 257, 1024, 2048, 2049, 2081, 4096, MB_MAX]


class Port:
    """The storage port with time that goes on."""

    def __init__(self, card: Card) -> None:
        self.card = card
        self.now_ns = 0

    def __call__(self, operation: int, argument: bytes | int = b"") -> int | bytes:
        """The data of a read, otherwise the result."""
        if isinstance(argument, int):
            argument = struct.pack("<I" if operation == SEEK else "<H", argument)
        answer, self.took_ns = self.card.request(bytes([operation]) + argument, self.now_ns)
        self.now_ns += self.took_ns
        assert answer[0] == operation
        (result,) = struct.unpack("<i", answer[1:5])
        if operation == READ and result >= 0:
            assert len(answer) == 5 + result
            return answer[5:]
        assert len(answer) == 5
        return result


def sample(size: int, seed: int = 1) -> bytes:
    return np.random.default_rng(seed).bytes(size)


@pytest.mark.parametrize("free_mb", [None, 5])
@pytest.mark.parametrize("size_mb", SIZES_MB)
def test_a_new_card_is_in_order(tmp_path, size_mb, free_mb):
    if not shutil.which("fsck.fat"):
        pytest.skip("fsck.fat is not installed: apt-get install dosfstools")
    card = Card(size_mb, free_mb=free_mb)
    image = tmp_path / "partition"
    with image.open("wb") as out:
        out.truncate((card.layout.sectors - card.layout.start) * SECTOR)
        for sector, data in card.sectors.sectors.items():
            if sector >= card.layout.start:
                out.seek((sector - card.layout.start) * SECTOR)
                out.write(data)
    found = subprocess.run(["fsck.fat", "-n", image], capture_output=True, text=True)
    files = 0 if free_mb is None else -(-(size_mb - free_mb) // 4096)
    assert found.returncode == 0, found.stdout
    assert found.stdout.count("\n") == 2, found.stdout
    assert f" {files} files" in found.stdout
    assert f"/{card.layout.clusters} clusters" in found.stdout


@pytest.mark.parametrize("size_mb", SIZES_MB)
def test_mtools_reads_what_was_written(tmp_path, size_mb):
    if not shutil.which("mcopy"):
        pytest.skip("mtools is not installed: apt-get install mtools")
    card, data = Card(size_mb), sample(123_457)
    card.put("config.txt", b"1\n")
    card.put("a long name.bin", data)
    card.save(str(tmp_path / "card.img"))
    drive = f"{tmp_path / 'card.img'}@@{card.layout.start * SECTOR}"
    found = subprocess.run(["mcopy", "-n", "-i", drive, "::a long name.bin", tmp_path / "out"], capture_output=True)
    assert found.returncode == 0, found.stderr
    assert (tmp_path / "out").read_bytes() == data


def test_sizes_have_the_fat_of_their_kind():
    """By the number of clusters alone readers tell one FAT from the other."""
    for size_mb in [*range(MB_MIN, 2300), *range(2300, MB_MAX, 777), MB_MAX]:
        layout = layout_of(size_mb)
        low, high = {12: (1, 4084), 16: (4085, 65524), 32: (65525, 1 << 28)}[layout.bits]
        assert low <= layout.clusters <= high, size_mb
        assert layout.data + layout.clusters * layout.cluster_sectors <= layout.sectors
        assert layout.start + layout.reserved + FATS * layout.fat_sectors <= layout.data
        assert (layout.clusters + 2) * layout.bits <= layout.fat_sectors * SECTOR * 8


@pytest.mark.parametrize("size_mb", [16, 128, 4096])
def test_operations(size_mb):
    card = Card(size_mb)
    card.put("config.txt", b"x" * 700)
    port = Port(card)
    assert port(OPEN, b"nothing") == NO_FILE
    assert port(CREATE, b"config.txt") == EXISTS
    assert port(WRITE, b"no file is open") == DISK
    assert port(OPEN, b"config.txt") == 0
    assert port(OPEN, b"config.txt") == DISK, "one at a time"
    assert [len(port(READ, 512)) for _ in range(3)] == [512, 188, 0]
    assert port(CLOSE) == 0
    assert port(CREATE, b"log00") == 0
    data = sample(10_000)
    assert port(WRITE, data[:700]) == 700
    assert port(SEEK, 1 << 20) == 0
    assert port(SEEK, 700) == 0
    assert port(WRITE, data[700:]) == 9300
    assert port(SYNC) == 0
    assert port(SEEK, 100) == 0
    assert port(WRITE, b"") == 0
    assert port(READ, 50) == data[100:150], "a file that is written can be read"
    assert port(SEEK, 10_000) == 0
    card.cut(port.now_ns)
    assert len(card.get("log00")) == 1 << 20, "what was allocated is of the file, and on the card"
    assert card.get("log00")[:10_000] == data
    card.cut(port.now_ns)
    assert port(CREATE, b"log01") == 0
    assert port(WRITE, data) == 10_000
    assert port(SEEK, 1 << 18) == 0
    assert port(SEEK, 9000) == 0
    assert port(TRUNCATE) == 0
    assert port(CLOSE) == 0
    assert port(9) == DISK
    assert card.get("log01") == data[:9000]


def test_time_on_the_bus():
    port = Port(Card(128, stall_ms=0))
    assert port(CREATE, b"log00") == 0
    assert port(SEEK, 1 << 20) == 0
    assert port(SEEK, 0) == 0
    port(WRITE, bytes(511))
    assert port.took_ns == round((8 + 516) * 8e3 / 21), "as the file is allocated: the sector is read, CMD17"
    port(WRITE, bytes(1))
    assert port.took_ns == 0, "stays in FatFs's buffer"
    port(WRITE, bytes(512))
    assert port.took_ns == round(2 * (8 + 516) * 8e3 / 21), "CMD24, twice"
    port(WRITE, bytes(4096))
    assert port.took_ns == round((8 + 8 * 516 + 2) * 8e3 / 21), "CMD25, eight blocks"


def test_stalls_have_the_stated_quantiles():
    card = Card(16, seed=5)
    drawn_ms = np.array([card.times.draw_stall_ns() for _ in range(200_000)]) / 1e6
    assert np.median(drawn_ms) == pytest.approx(2, rel=0.02)
    assert (drawn_ms > 100).mean() == pytest.approx(0.01, rel=0.08)
    assert drawn_ms.max() == 500
    logs = np.log(drawn_ms[drawn_ms < 100])
    assert np.percentile(logs, 15.87) == pytest.approx(np.log(2) - 1.68, abs=0.05), "log-normal"


def test_requests_stall_once():
    port = Port(Card(128, stall_ms=7, stall_p99_ms=7))
    port(CREATE, b"log00")
    port(WRITE, bytes(40_000))
    assert port.took_ns == pytest.approx(7e6 + 80 * 516 * 8e3 / 21, rel=0.05)


def test_equal_seeds_give_equal_cards():
    def run(seed):
        port = Port(Card(16, seed=seed))
        port(CREATE, b"log00")
        times = [(port(WRITE, sample(3000, number)), port.took_ns)[1] for number in range(20)]
        port(CLOSE)
        return times, port.card.image()

    assert run(1) == run(1)
    assert run(1)[0] != run(2)[0]


def test_cards_do_not_share_anything():
    ports = [Port(Card(128)) for _ in range(3)]
    for port in ports:
        assert port(CREATE, b"log00") == 0
    for round_ in range(20):
        for number, port in enumerate(ports):
            assert port(WRITE, sample(777, 100 * number + round_)) == 777
    for number, port in enumerate(ports):
        assert port(CLOSE) == 0
        assert port.card.get("log00") == b"".join(sample(777, 100 * number + round_) for round_ in range(20))


@pytest.mark.parametrize("size_mb", [128, 4096])
def test_full(size_mb):
    port = Port(Card(size_mb, free_mb=1))
    assert port(CREATE, b"log00") == 0
    data = sample(100)
    assert port(WRITE, data) == 100
    assert port(SEEK, 2 << 20) == FULL
    assert port(SEEK, 1 << 20) == 0, "all there is"
    assert port(SEEK, 100) == 0
    assert port(TRUNCATE) == 0
    assert port(SEEK, 1 << 20) == 0
    assert port(SEEK, (1 << 20) - 10) == 0
    assert port(WRITE, data) == 10
    assert port(WRITE, data) == 0
    assert port(CLOSE) == 0
    content = port.card.get("log00")
    assert len(content) == 1 << 20
    assert (content[:100], content[-10:]) == (data, data[:10])


def test_bad_sector_when_writing():
    port = Port(Card(128))
    data = sample(3000)
    assert port(CREATE, b"log00") == 0
    assert port(WRITE, data[:1000]) == 1000
    assert port(SYNC) == 0
    port.card.sectors.bad_sectors = {port.card.layout.data + 2}
    assert [port(WRITE, data[1000:]) for _ in range(3)] == [DISK] * 3
    assert port(SYNC) == 0, "what is there is in order"
    port.card.sectors.bad_sectors = set()
    assert port(WRITE, data[1000:]) == 2000
    assert port(CLOSE) == 0
    assert port.card.get("log00") == data


def test_bad_sector_when_reading():
    card = Card(128)
    data = sample(3000)
    card.put("config.txt", data)
    card.sectors.bad_sectors = {card.layout.data + 2}
    port = Port(card)
    assert port(OPEN, b"config.txt") == 0
    assert port(READ, 512) == data[:512]
    assert port(READ, 1024) == DISK
    assert port(READ, 512) == data[512:1024]
    card.sectors.bad_sectors = {card.layout.data - 1, card.layout.data - 32}  # The root directory.
    card.cut(port.now_ns)
    assert port(OPEN, b"config.txt") == DISK
    card.sectors.bad_sectors = {0}
    card.cut(port.now_ns)
    assert port(OPEN, b"config.txt") == DISK


def test_share_of_bad_sectors():
    card = Card(16, bad=0.01, seed=3)
    first = card.layout.data
    assert sum(card.sectors.is_bad(each) for each in range(first)) == 0
    assert sum(card.sectors.is_bad(first + each) for each in range(20_000)) == pytest.approx(200, rel=0.3)


def test_removed():
    card = Card(128, stall_ms=10, stall_p99_ms=10)
    port = Port(card)
    assert port(CREATE, b"log00") == 0
    assert port(WRITE, sample(1000)) == 1000
    assert port(SYNC) == 0
    card.removed_ns = port.now_ns + 2_000_000
    assert port(WRITE, sample(20_000, 2)) == NO_CARD
    assert port.took_ns == 2_000_000
    for operation in (WRITE, SYNC, CLOSE, OPEN):
        assert port(operation, b"log00") == NO_CARD
        assert port.took_ns == 0
    card.removed_ns = None
    assert port(WRITE, b"x") == DISK, "its file is not open any more"
    assert port(OPEN, b"log00") == 0
    assert port(READ, 1000) == sample(1000)


def test_power_cut_within_an_operation():
    """What had its time is written, one sector is torn, what comes behind is as it was."""
    torn = 0
    for seed in range(20):
        card = Card(128, seed=seed, stall_ms=0)
        card.leave(b"\xee" * 200_000)
        recording = card.record()
        port = Port(card)
        port(CREATE, b"log00")
        port(SEEK, 100_000)
        port(SEEK, 0)
        port(SYNC)
        begin_ns = port.now_ns
        written = len(recording.writes)
        assert port(WRITE, b"\x11" * 20_480) == 20_480
        sectors = 10 + seed
        card.cut(begin_ns + round((8 + (sectors + 0.5) * 516) * 8e3 / 21))
        content = card.get("log00")
        assert len(content) == 100_000
        assert content[: sectors * 512] == b"\x11" * sectors * 512
        assert content[(sectors + 1) * 512 :] == b"\xee" * (100_000 - (sectors + 1) * 512)
        part = content[sectors * 512 : (sectors + 1) * 512]
        torn += 0 < part.count(b"\x11") < 512
        assert part == b"\x11" * part.count(b"\x11") + b"\xee" * part.count(b"\xee")
        assert len(recording.writes) == written + sectors + 1
        assert recording.writes[-1][1] == part
    assert torn > 10


def test_without_a_sync_all_is_lost():
    """As the stock logger's flights are, that nobody ends with usd.logging=0."""
    port = Port(Card(128))
    port(CREATE, b"log00")
    for _ in range(100):
        port(WRITE, sample(1000))
    port.card.cut(port.now_ns)
    assert port.card.get("log00") == b""
