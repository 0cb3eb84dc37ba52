"""Files in memory, as a robot's card."""

import itertools
import struct

CONFIG = (
    b"1\n16384\nlog\n1\non:fixedFrequency\n1000\n1\nstateEstimate.x\nstateEstimate.vx\nstateEstimate.yaw\nacc.z\n"
    b"pm.vbatMV\nstateEstimateZ.quat\nusd.stallUs\non:estGyroscope\ngyro.z\non:estPose\nlocSrv.x\nlocSrv.qw\n"
)
MS = 1_000_000
DISK = -4


class Store:
    """Files in memory. A request takes 2 ms, and each 40th a stall."""

    def __init__(
        self, config: bytes = CONFIG, stall_ms: int = 0, fails: frozenset[int] | set[int] = frozenset()
    ) -> None:
        self.files: dict[str, bytearray] = {"config.txt": bytearray(config)}
        self.name, self.at = "", 0
        self.cuts: list[int] = []
        self.took = itertools.cycle([2 * MS] * 39 + [max(2, stall_ms) * MS])
        self.fails = fails
        """Requests that fail, by their number."""
        self.requests: list[tuple[int, bytes]] = []

    def request(self, request: bytes, true_ns: int) -> tuple[bytes, int]:
        self.requests.append((true_ns, request))
        failed = len(self.requests) in self.fails
        result, data = (DISK, b"") if failed else self.do(request[0], request[1:])
        return struct.pack("<Bi", request[0], result) + data, next(self.took)

    def do(self, operation: int, argument: bytes) -> tuple[int, bytes]:
        if operation <= 2:
            self.name, self.at = argument.decode(), 0
            if (operation == 1) == (self.name in self.files):
                return -2 if operation == 1 else -1, b""
            self.files.setdefault(self.name, bytearray())
            return 0, b""
        file = self.files[self.name]
        if operation == 3:
            data = bytes(file[self.at : self.at + struct.unpack("<H", argument)[0]])
            self.at += len(data)
            return len(data), data
        if operation == 4:
            file[self.at : self.at + len(argument)] = argument
            self.at += len(argument)
            return len(argument), b""
        if operation == 5:
            (self.at,) = struct.unpack("<I", argument)
            file += bytes(max(0, self.at - len(file)))
        elif operation == 6:
            del file[self.at :]
        return 0, b""

    def cut(self, true_ns: int) -> None:
        self.cuts.append(true_ns)
