"""What the boards bring in place of a C library and of the compiler's, compiled for this machine, against Python."""

import ctypes
import random
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
STRING_H = ("memchr", "memcmp", "memcpy", "memmove", "memset", "strlen")
DIVISIONS = ("__udivsi3", "__umodsi3", "__divsi3", "__modsi3")
SIZE = 64


def library(source: str, names: tuple[str, ...], folder: Path) -> ctypes.CDLL:
    """With names of its own, so that nothing of this machine's library is tested by mistake."""
    made = folder / "board.so"
    renamed = [f"-D{name}=board_{name}" for name in names]
    flags = ["-std=c11", "-O2", "-ffreestanding", "-fno-builtin", "-shared", "-fPIC", *renamed]
    subprocess.run(["gcc", *flags, f"-I{ROOT}/firmware/board", ROOT / source, "-o", made], check=True)
    return ctypes.CDLL(str(made))


@pytest.fixture(scope="module")
def memory(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    loaded = library("firmware/board/memory.c", STRING_H, tmp_path_factory.mktemp("memory"))
    for name in ("memchr", "memcpy", "memmove", "memset"):
        getattr(loaded, f"board_{name}").restype = ctypes.c_void_p
    loaded.board_strlen.restype = ctypes.c_size_t
    return loaded


def at(buffer: ctypes.Array[ctypes.c_char], offset: int) -> ctypes.c_void_p:
    return ctypes.c_void_p(ctypes.addressof(buffer) + offset)


def test_copies_and_fills_just_the_bytes_asked_for(memory: ctypes.CDLL) -> None:
    rng = random.Random(4)
    source = ctypes.create_string_buffer(rng.randbytes(SIZE), SIZE)
    for start in range(5):
        for from_ in range(5):
            for size in range(21):
                out = ctypes.create_string_buffer(b"\xa5" * SIZE, SIZE)
                returned = memory.board_memcpy(at(out, start), at(source, from_), ctypes.c_size_t(size))
                assert returned == at(out, start).value
                assert out.raw == b"\xa5" * start + source.raw[from_ : from_ + size] + b"\xa5" * (SIZE - start - size)
        for size in range(21):
            out = ctypes.create_string_buffer(b"\xa5" * SIZE, SIZE)
            assert memory.board_memset(at(out, start), 0x1C3, ctypes.c_size_t(size)) == at(out, start).value
            assert out.raw == b"\xa5" * start + b"\xc3" * size + b"\xa5" * (SIZE - start - size)


def test_moves_what_overlaps(memory: ctypes.CDLL) -> None:
    content = random.Random(5).randbytes(SIZE)
    for to in range(20):
        for from_ in range(20):
            out = ctypes.create_string_buffer(content, SIZE)
            memory.board_memmove(at(out, to), at(out, from_), ctypes.c_size_t(30))
            assert out.raw == content[:to] + content[from_ : from_ + 30] + content[to + 30 :]


def test_compares_and_searches(memory: ctypes.CDLL) -> None:
    rng = random.Random(6)
    for _ in range(300):
        a, b = (bytes(rng.choice(b"\x00\x01\xff") for _ in range(4)) for _ in "ab")
        result = memory.board_memcmp(a, b, ctypes.c_size_t(4))
        assert (result > 0) - (result < 0) == (a > b) - (a < b)
        held = ctypes.create_string_buffer(a, 4)
        found = memory.board_memchr(held, 0x1FF, ctypes.c_size_t(4))
        assert found == (None if 0xFF not in a else ctypes.addressof(held) + a.index(0xFF))
        text = ctypes.create_string_buffer(a + b"\0", 5)
        assert memory.board_strlen(text) == (a + b"\0").index(0)


def test_divides_as_c_does(tmp_path: Path) -> None:
    loaded = library("firmware/esp32/board/arithmetic.c", DIVISIONS, tmp_path)
    for name in ("__udivsi3", "__umodsi3"):
        getattr(loaded, f"board_{name}").restype = ctypes.c_uint32
    rng = random.Random(7)
    edges = [0, 1, 2, 3, 10, 0x7FFFFFFF, 0x80000000, 0x80000001, 0xFFFFFFFE, 0xFFFFFFFF]
    drawn = [(rng.getrandbits(32), rng.getrandbits(rng.randrange(1, 33)) or 1) for _ in range(2000)]
    for a, b in [(a, b) for a in edges for b in edges if b] + drawn:
        assert loaded.board___udivsi3(ctypes.c_uint32(a), ctypes.c_uint32(b)) == a // b
        assert loaded.board___umodsi3(ctypes.c_uint32(a), ctypes.c_uint32(b)) == a % b
        left, right = ctypes.c_int32(a).value, ctypes.c_int32(b).value
        quotient = abs(left) // abs(right) * (1 if (left < 0) == (right < 0) else -1)
        assert loaded.board___divsi3(ctypes.c_int32(a), ctypes.c_int32(b)) == ctypes.c_int32(quotient).value
        assert loaded.board___modsi3(ctypes.c_int32(a), ctypes.c_int32(b)) == left - quotient * right
