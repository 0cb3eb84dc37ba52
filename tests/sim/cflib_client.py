"""An unmodified Bitcraze client (cflib.cpx), as a program: python cflib_client.py PORT FRAMES BRIDGE.

Prints a JSON line for each frame with its header and the hash of its body, and one for the first CRTP packet after the
bridge was enabled. A program of its own, as cflib's reading thread never stops."""

import contextlib
import hashlib
import json
import os
import queue
import struct
import sys

from cflib.cpx import CPX, CPXFunction, CPXPacket, CPXTarget
from cflib.cpx.transports import SocketTransport

port, count, bridge = (int(word) for word in sys.argv[1:])
cpx = CPX(SocketTransport("127.0.0.1", port))
for function in (CPXFunction.APP, CPXFunction.CRTP):
    # Packets of a function that nobody has asked for yet are thrown away by cflib.
    with contextlib.suppress(queue.Empty):
        cpx.receivePacket(function, timeout=0.01)
if bridge:
    cpx.sendPacket(CPXPacket(CPXFunction.SYSTEM, CPXTarget.STM32, data=bytearray([0x21, 1])))
for _ in range(count):
    packet = cpx.receivePacket(CPXFunction.APP, timeout=30)
    magic, width, height, depth, kind, size = struct.unpack("<BHHBBI", packet.data)
    body = bytearray()
    while len(body) < size:
        body += cpx.receivePacket(CPXFunction.APP, timeout=30).data
    header = [magic, width, height, depth, kind, size]
    print(json.dumps({"header": header, "sha256": hashlib.sha256(body).hexdigest()}), flush=True)
if bridge:
    packet = cpx.receivePacket(CPXFunction.CRTP, timeout=30)
    print(json.dumps({"source": packet.source.name, "crtp": packet.data.hex()}), flush=True)
os._exit(0)
