"""A robot with somebody who listens: its bytes decoded by the same session as a real robot's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from host.link.counters import SessionCounters
from host.link.frame import Frame
from host.link.records import Event
from host.link.session import Session

from .robot import Robot
from .truth import errors_us, stamped

if TYPE_CHECKING:
    from .world import World

Dialect = Literal["auto", "stock", "paper", "nanocockpit", "native"]
FRAMINGS: dict[str, Literal["tcp", "cpx-uart", "stamps"]] = {"tcp": "tcp", "uart2": "cpx-uart", "uart1": "stamps"}


class Receiver(Robot):
    """Made by World.listen. Everything that came is kept: frames, events."""

    def __init__(self, world: World, index: int, dialect: Dialect) -> None:
        known = world.robots[index]
        super().__init__(world, index, known.settings, known.images)
        self._wires = known._wires
        self.dialect = dialect
        self.frames: list[Frame] = []
        self.events: list[Event] = []
        """All that came, frames too, in order."""
        self.connect()

    def connect(self) -> None:
        """Anew, as after a reboot of the ESP32; counters then count from 0, frames and events stay."""
        super().connect()
        self._session = Session(FRAMINGS[self.settings.wire], self.dialect)

    def run(self, seconds: float) -> list[Frame]:
        """Lets the whole world run; the frames of this robot so far."""
        self.world.run(seconds)
        return self.frames

    def poll(self) -> None:
        """Reads and answers once; World.run calls it."""
        now_ns = self.world.now_ns
        data = self.read()
        if data:
            events = self._session.receive(data, now_ns)
            self.events += events
            self.frames += [event for event in events if isinstance(event, Frame)]
        else:
            self._session.tick(now_ns)
        out = self._session.data_to_send()
        if out:
            self.write(out)

    @property
    def counters(self) -> SessionCounters:
        """What was received and lost on this connection."""
        return self._session.counters

    @property
    def truth(self) -> NDArray[np.void]:
        """Completed captures of this robot, dtype TRUTH_DTYPE."""
        truth: NDArray[np.void] = self.world.truth
        own: NDArray[np.void] = truth[truth["robot"] == self.index]
        return own

    @property
    def stamp_errors_us(self) -> NDArray[np.float64]:
        """Estimated less true STM32 time at end of frame, of each frame that has an estimate."""
        pictures = self.world.picture_numbers(self.index)
        return errors_us(stamped(self.frames), self.truth, self.settings.stm32.stamp_bits, pictures)
