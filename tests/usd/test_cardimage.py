"""Files out of a card's image: as FatFs wrote them, as mtools and pyfatfs read them, and what damage leaves of them."""

import random
import shutil
import struct
import sys
from pathlib import Path

import pytest

from host.cli import main
from host.protocol.errors import LocalError, PeerError
from host.usd.cardimage import CardImage

sys.path.insert(0, str(Path(__file__).resolve().parent))

from logs import Writer, fill
from other_readers import by_mtools, by_pyfatfs, run

pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")

from sim.card import Card
from sim.card_format import SECTOR

SIZES_MB = [16, 128, 4096]  # FAT12, FAT16, FAT32


def content(name: str, size: int) -> bytes:
    return random.Random(name).randbytes(size)


LONG_NAME = "a long name, and more than 13 letters.bin"
FILES = {"config.txt": 70, "log00": 300_000, "LOG01": 0, "log02": 16384, LONG_NAME: 999, "log03": 123_456}


def filled(size_mb: int) -> Card:
    """The files' clusters take turns, as two logs that grow together would have them."""
    card = Card(size_mb)
    card.put("hole", bytes(20_000))
    for name, size in FILES.items():
        card.put(name, content(name, size))
    card._mounted().remove(b"hole")
    card.put("log04", content("log04", 100_000))
    return card


def all_files() -> dict[str, bytes]:
    return {name: content(name, size) for name, size in {**FILES, "log04": 100_000}.items()}


def read(image: CardImage, name: str) -> bytes:
    found = image.read(image.find(name))
    assert found.faults == ()
    return found.data


@pytest.fixture(scope="module")
def card16() -> tuple[Card, bytes]:
    card = filled(128)
    return card, image_of(card, 2 << 20)


def image_of(card: Card, size: int) -> bytes:
    """Its beginning, where all files are."""
    out = bytearray(size)
    for sector, data in card.sectors.sectors.items():
        out[sector * SECTOR : (sector + 1) * SECTOR] = data
    return bytes(out)


def entry_at(card: Card, image: bytes, name: bytes) -> int:
    """Of the directory's entry with this short name."""
    root = (card.layout.data - 32) * SECTOR
    return image.index(name.ljust(11), root)


def fat_entry(card: Card, cluster: int, copy: int = 0) -> int:
    return (card.layout.start + card.layout.reserved + copy * card.layout.fat_sectors) * SECTOR + 2 * cluster


@pytest.mark.parametrize("size_mb", SIZES_MB)
def test_every_file(tmp_path, size_mb):
    card = filled(size_mb)
    card.save(str(tmp_path / "card.img"))
    whole = CardImage((tmp_path / "card.img").read_bytes() if size_mb < 1000 else open_mapped(tmp_path / "card.img"))
    start = card.layout.start * SECTOR
    without_partition = CardImage(memoryview(whole.volume.data)[start:])
    for image in (whole, without_partition):
        assert image.faults == []
        assert sorted(each.path for each in image.files) == sorted("/" + name for name in all_files())
        for name, data in all_files().items():
            assert read(image, name) == data
            assert read(image, name.upper()) == data
    assert read(whole, "ALONGN~1.BIN") == all_files()[LONG_NAME]


@pytest.mark.parametrize("size_mb", SIZES_MB)
def test_without_a_table_of_partitions_the_volume_is_searched(size_mb):
    card = filled(size_mb)
    start = card.layout.start
    image = bytearray(image_of(card, (card.layout.data + 4096) * SECTOR))
    image[:SECTOR] = bytes(SECTOR)
    found = CardImage(image)
    assert [(each.sector, str(start) in each.why) for each in found.faults] == [(0, True)]
    for name, data in all_files().items():
        assert read(found, name) == data
    image[start * SECTOR + 28] ^= 1  # A boot sector that says that it lies elsewhere is somebody's copy of one.
    with pytest.raises(PeerError, match="not the image of"):
        CardImage(image)


def open_mapped(path):
    import mmap

    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


@pytest.mark.parametrize("size_mb", SIZES_MB)
def test_as_mtools_and_pyfatfs_read_them(tmp_path, size_mb):
    """Folders too: mtools makes them."""
    if not shutil.which("mcopy"):
        pytest.skip("mtools is not installed: apt-get install mtools")
    card = filled(size_mb)
    path = tmp_path / "card.img"
    card.save(str(path))
    offset = card.layout.start * SECTOR
    drive = ["-i", f"{path}@@{offset}"]
    folder = "flights/of the summer of 2026"
    (tmp_path / "inner.bin").write_bytes(content("inner", 70_000))
    run("mmd", *drive, "::flights")
    run("mmd", *drive, f"::{folder}")
    run("mcopy", *drive, tmp_path / "inner.bin", f"::{folder}/größte höhe.bin")
    run("mdel", *drive, "::log02")
    image = CardImage(open_mapped(path))
    expected = {f"/{name}": data for name, data in all_files().items() if name != "log02"}
    expected[f"/{folder}/größte höhe.bin"] = content("inner", 70_000)
    assert {each.path: read(image, each.path) for each in image.files if not each.is_folder} == expected
    with pytest.raises(LocalError, match=r"no file /log02 on this card; there are /log04, /config.txt"):
        image.find("log02")
    assert {name: by_mtools(path, offset, name) for name in expected} == expected
    assert by_pyfatfs(path, offset, list(expected)) == expected


def test_chain_that_comes_back(card16):
    card, image = card16
    damaged = bytearray(image)
    first = struct.unpack_from("<H", image, entry_at(card, image, b"LOG03") + 26)[0]
    for copy in range(2):
        struct.pack_into("<H", damaged, fat_entry(card, first + 3, copy), first + 1)
    found = CardImage(damaged)
    data, faults = found.read(found.find("log03")).data, found.read(found.find("log03")).faults
    assert data == all_files()["log03"][: 4 * 16384]
    assert [str(each) for each in faults] == [
        f"sector {fat_entry(card, first + 3) // SECTOR} of the card: the chain of clusters comes back to "
        f"cluster {first + 1}",
        f"sector {entry_at(card, image, b'LOG03') // SECTOR} of the card: 123456 bytes, says the directory: there are "
        "clusters for 65536",
    ]
    assert read(found, "log00") == all_files()["log00"], "nothing else is touched"


@pytest.mark.parametrize(("entry", "why"), [(0, "a free cluster"), (0xFFF7, "cluster 65527"), (9000, "cluster 9000")])
def test_chain_that_runs_out(card16, entry, why):
    card, image = card16
    damaged = bytearray(image)
    first = struct.unpack_from("<H", image, entry_at(card, image, b"LOG03") + 26)[0]
    struct.pack_into("<H", damaged, fat_entry(card, first + 2), entry)
    found = CardImage(damaged)
    assert found.read(found.find("log03")).data == all_files()["log03"], "the second FAT knows"
    assert "the second was used" in str(found.read(found.find("log03")).faults[0])
    struct.pack_into("<H", damaged, fat_entry(card, first + 2, 1), entry)
    found = CardImage(damaged)
    content = found.read(found.find("log03"))
    assert content.data == all_files()["log03"][: 3 * 16384]
    assert why in content.faults[0].why
    assert len(content.faults) == 2


def test_clusters_of_two_files(card16):
    card, image = card16
    damaged = bytearray(image)
    first = struct.unpack_from("<H", image, entry_at(card, image, b"LOG03") + 26)[0]
    struct.pack_into("<H", damaged, entry_at(card, image, b"LOG02") + 26, first + 1)
    found = CardImage(damaged)
    content = found.read(found.find("log03"))
    assert content.data == all_files()["log03"]
    sector = card.layout.data + (first - 1) * card.layout.cluster_sectors
    assert [str(each) for each in content.faults] == [
        f"sector {sector} of the card: /log02 has this cluster too, and 6 more: one of them is wrong"
    ]


@pytest.mark.parametrize(("size", "taken"), [(0, 8 * 16384), (16384, 8 * 16384), (8 * 16384 - 5, 8 * 16384 - 5)])
def test_size_that_was_not_noted_yet(card16, size, taken):
    card, image = card16
    damaged = bytearray(image)
    struct.pack_into("<I", damaged, entry_at(card, image, b"LOG03") + 28, size)
    found = CardImage(damaged)
    content = found.read(found.find("log03"))
    assert len(content.data) == taken
    assert content.data[:123_456] == all_files()["log03"][:taken]
    assert len(content.faults) == (size < taken)


def test_entry_that_leads_nowhere(card16):
    card, image = card16
    damaged = bytearray(image)
    struct.pack_into("<H", damaged, entry_at(card, image, b"LOG03") + 26, 9999)
    found = CardImage(damaged)
    content = found.read(found.find("log03"))
    assert content.data == b""
    assert content.faults[0].why == "begins in cluster 9999, which there is not"
    damaged[entry_at(card, image, b"LOG03") : entry_at(card, image, b"LOG03") + 11] = b"\x01garbage\xff\xff\xff"
    found = CardImage(damaged)
    assert sorted(each.path for each in found.files) == sorted(f"/{name}" for name in all_files() if name != "log03")
    assert len(found.faults) == 1
    assert "no entry of a directory" in str(found.faults[0])


def test_boot_sectors(tmp_path):
    card = filled(4096)
    card.save(str(tmp_path / "card.img"))
    image = bytearray(open_mapped(tmp_path / "card.img")[: 20 << 20])
    start = card.layout.start * SECTOR
    image[start : start + SECTOR] = bytes(SECTOR)
    assert read(CardImage(image), "log00") == all_files()["log00"], "FAT32 has a second one"
    image[start + 6 * SECTOR : start + 7 * SECTOR] = bytes(SECTOR)
    for data in (image, b"", b"\xbc", bytes(10_000), random.Random(1).randbytes(5000)):
        with pytest.raises(PeerError, match="not the image of a FAT card"):
            CardImage(data)
    image[start + 3 : start + 11] = b"EXFAT   "
    with pytest.raises(PeerError, match="exFAT"):
        CardImage(image)


def test_images_that_end_too_soon(card16):
    card, image = card16
    end = (card.layout.data + 6 * card.layout.cluster_sectors) * SECTOR
    found = CardImage(image[: end + 100])
    content = found.read(found.find("log00"))
    assert content.faults[0].why == "the image ends here, its files do not"
    assert content.data == all_files()["log00"][: len(content.data)]
    assert len(content.data) > 16384
    for size in [*range(0, 1 << 20, 17_001), *range(0, 70_000, 2509)]:
        try:
            found = CardImage(image[:size])
        except PeerError:
            assert size < card.layout.start * SECTOR + SECTOR
            continue
        for each in found.files:
            found.read(each)


@pytest.mark.parametrize("seed", range(150))
def test_random_damage(seed):
    """Never an exception but PeerError, and always an end."""
    rng = random.Random(seed)
    card = CARDS.setdefault(16, filled(16))
    image = bytearray(IMAGES.setdefault(16, image_of(card, 1 << 20)))
    metadata = card.layout.data * SECTOR
    for _ in range(rng.choice([1, 5, 100, 2000])):
        at = rng.randrange(card.layout.start * SECTOR, metadata)
        image[at] = rng.randrange(256)
    try:
        found = CardImage(image)
    except PeerError:
        return
    for each in found.files:
        content = found.read(each)
        assert len(content.data) <= len(image)
        assert "\n" not in each.path


CARDS: dict[int, Card] = {}
IMAGES: dict[int, bytes] = {}


def test_damaged_card_is_a_fault(tmp_path, capsys):
    card = Card(128)
    card.put("log00", fill(Writer(session=7), seed=1, rows=400).close())
    image = bytearray(image_of(card, 1 << 20))
    at = entry_at(card, image, b"LOG00")
    struct.pack_into("<I", image, at + 28, 40_000)
    (tmp_path / "card.img").write_bytes(image)
    assert main(["usd", "check", "--json", str(tmp_path / "card.img")]) == 4
    first = capsys.readouterr().out.splitlines()[0]
    assert '"event":"card"' in first
    assert f'"sector":{at // SECTOR}' in first
    assert main(["usd", "info", f"{tmp_path / 'card.img'}:/log00"]) == 0
    assert f"sector {at // SECTOR} of the card: 40000 bytes" in capsys.readouterr().err
