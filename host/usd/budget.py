"""What a config.txt asks of the card: bytes per second, and how long a stall of the card the ring survives.

The logger of firmware/stm32 writes as soon as there is a whole sector, and what is being written stays in the ring
until the card has answered. So when a stall begins, the ring of a card that was prompt until then holds at most a
sector less one byte, the rows of one moment, a status row, and the rows that came during the few operations around a
sync. A row is dropped if it does not fit into the rest, of which the file's end is always kept free.

The Crazyflie's own logger writes what there is, at the lowest priority: its ring is empty at best.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from ..native import lib
from .config import FIXED, Config

PROMPT_S = 0.002
"""A card is prompt that takes no longer for an operation."""
OPERATIONS = 4
"""Space allocated, back to the place of the next write, written, synced: most that are between two writes of rows."""
STALL_S = 0.5
"""So long the Crazyflie's firmware waits for a card before it gives up: a longer stall is an error."""


@dataclass(frozen=True, slots=True)
class Budget:
    rows_per_s: float
    bytes_per_s: float
    """Status rows included."""
    mb_per_hour: float
    stall_ms: float
    """Of this project's logger: a single stall up to this long costs no row, if the card is prompt otherwise. 0: rows
    are lost without any."""
    stock_stall_ms: float
    """Of the Crazyflie's: a longer one costs rows; a shorter one may, too."""
    ring_least: int
    """With less, rows are lost even by a prompt card."""
    ring_wanted: int
    """Bytes for a stall of STALL_S."""
    uncounted: tuple[str, ...]
    """Events whose rate is not known: none of their rows are in these figures."""


def budget(config: Config, rates_hz: Mapping[str, float]) -> Budget:
    """`rates_hz`: how often each event comes. Config.txt does not say."""
    rates = {FIXED: config.fixed_hz, **rates_hz}
    counted = [block for block in config.blocks if block.event in rates]
    rows = sum(rates[block.event] for block in counted)
    row_bytes = sum(rates[block.event] * block.row_bytes for block in counted)
    moment = sum(block.row_bytes for block in config.blocks)
    ahead = lib.STORAGE_SECTOR_BYTES - 1 + moment + lib.USD_STATUS_BYTES + math.ceil(OPERATIONS * PROMPT_S * row_bytes)
    least = lib.USD_LOG_END_BYTES + ahead
    # One row of each event may come at once, and others before a period is over.
    early = sum(block.row_bytes for block in counted if block.event != FIXED)
    room = config.ring_bytes - least - early
    status = lib.USD_STATUS_BYTES * 1e6 / lib.STM32_LOG_SYNC_US
    return Budget(
        rows_per_s=rows,
        bytes_per_s=row_bytes + status,
        mb_per_hour=(row_bytes + status) * 3600 / 1e6,
        stall_ms=max(0.0, room / row_bytes * 1000) if row_bytes else 0.0,
        stock_stall_ms=max(0.0, (config.stock_ring_bytes - moment) / row_bytes * 1000) if row_bytes else 0.0,
        ring_least=least,
        ring_wanted=int(least + early + STALL_S * row_bytes) + 1,
        uncounted=tuple(block.event for block in config.blocks if block.event not in rates),
    )
