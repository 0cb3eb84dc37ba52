"""Power cuts of a recorded card: what is on it when the power goes after the n-th sector write.

What has been written before FatFs last waited for the card is there. Of the few writes behind that, in any combination:
some may never have been done though later ones were (so their sectors hold what was there before, maybe of an older
log), and some may be torn.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import Literal

import numpy as np

from .card_format import SECTOR
from .card_sectors import ZEROS, Recording

OPEN_WRITES_MAX = 8
"""A card has no more than these in its hands."""
Fate = Literal["done", "torn", "lost"]


class Cuts:
    """For rising n: each write is played once."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.now: dict[int, bytes] = {}
        """Sectors that differ from the recording's base, after `played` writes."""
        self.played = 0
        self._before: list[bytes] = []
        """What each write played has replaced."""

    def after(self, count: int) -> dict[int, bytes]:
        """Plays so many writes. Returns the sectors that have changed since the last call."""
        changed = {}
        for sector, data in self.recording.writes[self.played : count]:
            self._before.append(self.now.get(sector, self.recording.base.get(sector, ZEROS)))
            self.now[sector] = changed[sector] = data
        self.played = max(self.played, count)
        return changed

    def restored(self, sectors: dict[int, bytes]) -> dict[int, bytes]:
        """What these are in `now`."""
        return {sector: self.now.get(sector, self.recording.base.get(sector, ZEROS)) for sector in sectors}

    def damaged(self, rng: np.random.Generator) -> tuple[dict[int, bytes], list[Fate]]:
        """Sectors that are otherwise than in `now` if the power goes here, and what became of the last writes. Nobody
        has waited for the very last one yet."""
        waited = bisect_left(self.recording.barriers, self.played) - 1
        settled = self.recording.barriers[waited] if waited >= 0 else 0
        open_writes = range(max(settled, self.played - OPEN_WRITES_MAX), self.played)
        found: dict[int, bytes] = {}
        fates: list[Fate] = []
        for number in open_writes:
            sector, data = self.recording.writes[number]
            old = found.get(sector, self._before[number])
            fate: Fate = ("done", "done", "torn", "lost")[int(rng.integers(4))]
            torn_at = int(rng.integers(1, SECTOR))
            found[sector] = {"done": data, "torn": data[:torn_at] + old[torn_at:], "lost": old}[fate]
            fates.append(fate)
        return found, fates
