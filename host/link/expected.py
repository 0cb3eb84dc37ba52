"""Whether a robot speaks the dialect that was chosen.

The choice sets the rule by which packets are read, and bytes of the other rule are garbage then: so somebody else, who
has not chosen, reads them too, until something has told.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .dialects import Dialect
from .frame import Frame
from .records import Announced

if TYPE_CHECKING:
    from .session import Session

LOOKS: dict[str, str] = {
    "stock": "stock CPX",
    "paper": "of the paper's firmware",
    "nanocockpit": "NanoCockpit's",
    "native": "of firmware that speaks native",
}
"""What bytes are, by dialect."""
GARBAGE_MOST = 0.5
"""Of the bytes: with more, what looks like packets is chance."""


class Expected:
    """The first thing that tells decides."""

    def __init__(self, dialect: Dialect, witness: Session | None) -> None:
        """`witness`: reads the same bytes without a dialect chosen; None where the choice does not change the rule."""
        self.dialect = dialect
        self.decided = dialect in ("auto", "stock")
        self.other: Dialect | None = None
        """What the robot speaks in its place."""
        self._witness = None if self.decided else witness

    def heard(self, dialect: Dialect) -> None:
        """A whole frame or a time message of this dialect, or the announcement of native."""
        if not self.decided:
            self.decided = True
            self._witness = None
            self.other = None if dialect == self.dialect else dialect

    def receive(self, data: bytes | memoryview, arrival_host_ns: int) -> None:
        """What the session has received, and heard nothing in that decides."""
        if self._witness is not None:
            for event in self._witness.receive(data, arrival_host_ns):
                if isinstance(event, Announced | Frame):
                    self.heard("native" if isinstance(event, Announced) else event.dialect)

    def contradiction(self) -> str:
        """For people, what is wrong with the choice; empty while nothing is."""
        if self.other is None:
            return ""
        ways = "stock or auto" if self.other == "stock" else f"{self.other} or auto"
        return f"these bytes are {LOOKS[self.other]}, and dialect {self.dialect} was chosen: use --dialect {ways}"

    def suspicion(self) -> str:
        """Likewise when no whole frame has come and packets alone have to tell."""
        witness = self._witness
        if witness is None or witness.packets_received == 0 or witness.reads_cpx != (self.dialect == "nanocockpit"):
            return ""
        if witness.counters.garbage_bytes > GARBAGE_MOST * witness.bytes_received:
            return ""
        looks = "CPX" if witness.reads_cpx else LOOKS["nanocockpit"]
        return f"these bytes look like {looks}, and dialect {self.dialect} was chosen: use --dialect auto"
