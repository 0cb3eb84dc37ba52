"""An empty card as it comes out of its package: a partition with FAT12, FAT16 or FAT32, laid out by the rules of the
SD Association's file system specification. FatFs, fsck.fat, mtools and pyfatfs are what the tests hold it against.

FatFs could format too, but the package that brings it makes neither partitions nor FAT32.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

SECTOR = 512
FATS = 2
ROOT_ENTRIES = 512
"""Of FAT12 and FAT16, whose root is no file."""
FILE_BYTES_MAX = 0xFFFFFFFF
SIZES = [  # up to MiB, FAT's bits, sectors per cluster, sectors by which the data area is aligned
    (63, 12, 32, 32),
    (256, 16, 32, 64),
    (1024, 16, 32, 128),
    (2048, 16, 64, 128),
    (2080, 32, 32, 8192),  # No such cards are made: larger clusters would be too few for FAT32.
    (32768, 32, 64, 8192),
]
MB_MIN, MB_MAX = 16, 32768


@dataclass(frozen=True, slots=True)
class Layout:
    """Of a card; places are sectors of the card."""

    sectors: int
    bits: int
    cluster_sectors: int
    start: int
    """Of the partition."""
    reserved: int
    fat_sectors: int
    data: int
    """The first sector of cluster 2."""
    clusters: int


def layout_of(size_mb: int) -> Layout:
    sectors = size_mb * (1 << 20) // SECTOR
    _, bits, cluster_sectors, boundary = next(row for row in SIZES if size_mb <= row[0])
    start = boundary
    root_sectors = 0 if bits == 32 else ROOT_ENTRIES * 32 // SECTOR
    # As many sectors of FAT as the clusters need for which they leave room.
    fat_sectors = 1
    while True:
        fixed = (32 if bits == 32 else 1) + FATS * fat_sectors + root_sectors
        data = start + -(-fixed // boundary) * boundary
        clusters = (sectors - data) // cluster_sectors
        if (clusters + 2) * bits <= fat_sectors * SECTOR * 8:
            break
        fat_sectors += 1
    reserved = data - start - FATS * fat_sectors - root_sectors
    return Layout(sectors, bits, cluster_sectors, start, reserved, fat_sectors, data, clusters)


def formatted(size_mb: int, free_mb: int | None, serial: int) -> tuple[Layout, dict[int, bytes]]:
    """The sectors of a new card that are not zero. With `free_mb` large files leave only so much of it free."""
    layout = layout_of(size_mb)
    cluster_bytes = layout.cluster_sectors * SECTOR
    free = layout.clusters if free_mb is None else min(layout.clusters, (free_mb << 20) // cluster_bytes)
    root_clusters = 1 if layout.bits == 32 else 0
    taken = max(layout.clusters - free - root_clusters, 0)
    sectors = {0: master_boot_record(layout, serial)}
    boot = boot_sector(layout, serial)
    sectors[layout.start] = boot
    if layout.bits == 32:
        info = information(layout.clusters - root_clusters - taken)
        sectors |= {layout.start + 1: info, layout.start + 6: boot, layout.start + 7: info}
    table = allocation_table(layout, taken)
    for copy in range(FATS):
        first = layout.start + layout.reserved + copy * layout.fat_sectors
        sectors |= {first + at // SECTOR: table[at : at + SECTOR] for at in range(0, len(table), SECTOR)}
    root = layout.data if layout.bits == 32 else layout.data - ROOT_ENTRIES * 32 // SECTOR
    sectors[root] = taken_entries(layout, taken)
    return layout, {number: data for number, data in sectors.items() if any(data)}


def master_boot_record(layout: Layout, serial: int) -> bytes:
    kind = {12: 0x01, 16: 0x06, 32: 0x0C}[layout.bits]
    unknown = b"\xfe\xff\xff"
    entry = struct.pack("<B3sB3sII", 0, unknown, kind, unknown, layout.start, layout.sectors - layout.start)
    return struct.pack("<440xI2x16s48xH", serial & 0xFFFFFFFF, entry, 0xAA55)


def boot_sector(layout: Layout, serial: int) -> bytes:
    total = layout.sectors - layout.start
    wide = layout.bits == 32
    head = struct.pack(
        "<3s8sHBHBHHBHHHII",
        *(b"\xeb\x58\x90" if wide else b"\xeb\x3c\x90", b"SPINDECK", SECTOR, layout.cluster_sectors, layout.reserved),
        *(FATS, 0 if wide else ROOT_ENTRIES, total if total < 1 << 16 and not wide else 0, 0xF8),
        *(0 if wide else layout.fat_sectors, 63, 255, layout.start, 0 if total < 1 << 16 and not wide else total),
    )
    if wide:
        head += struct.pack("<IHHIHH12x", layout.fat_sectors, 0, 0, 2, 1, 6)
    tail = struct.pack(
        "<BBBI11s8s", 0x80, 0, 0x29, serial & 0xFFFFFFFF, b"NO NAME    ", f"FAT{layout.bits}   ".encode()
    )
    return (head + tail).ljust(SECTOR - 2, b"\0") + b"\x55\xaa"


def information(free: int) -> bytes:
    """FAT32's sector that says how many clusters are free, and where the next free one may be."""
    return struct.pack("<I480xIII12xI", 0x41615252, 0x61417272, free, 2, 0xAA550000)


def taken_files(layout: Layout, taken: int) -> list[tuple[int, int]]:
    """First cluster and clusters of the files that take so many."""
    most = FILE_BYTES_MAX // (layout.cluster_sectors * SECTOR)
    first = 3 if layout.bits == 32 else 2
    return [(first + at, min(taken - at, most)) for at in range(0, taken, most)]


def taken_entries(layout: Layout, taken: int) -> bytes:
    entries = b""
    for number, (first, clusters) in enumerate(taken_files(layout, taken)):
        name, size = f"VIDEO{number:02} MP4".encode(), clusters * layout.cluster_sectors * SECTOR
        entries += struct.pack("<11sB8xHHHHI", name, 0x20, first >> 16, 0, 0x5C21, first & 0xFFFF, size)
    return entries.ljust(SECTOR, b"\0")


def allocation_table(layout: Layout, taken: int) -> bytes:
    """The media byte, the mark of a clean volume, the root of FAT32, and the files' chains."""
    end = (1 << min(layout.bits, 28)) - 1
    used = 2 + (layout.bits == 32) + taken
    table = np.arange(1, used + 1, dtype=np.uint32)
    table[0], table[1:3] = end - 7, end
    for first, clusters in taken_files(layout, taken):
        table[first : first + clusters] = np.arange(first + 1, first + clusters + 1)
        table[first + clusters - 1] = end
    if layout.bits == 12:
        pairs = np.append(table, [0] * (used % 2)).astype("<u4").reshape(-1, 2)
        data = bytes((pairs[:, 0] | pairs[:, 1] << 12).astype("<u4").view(np.uint8).reshape(-1, 4)[:, :3].tobytes())
    else:
        data = bytes(table.astype("<u2" if layout.bits == 16 else "<u4").tobytes())
    return data.ljust(layout.fat_sectors * SECTOR, b"\0")
