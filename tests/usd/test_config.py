"""`config.txt`: the C parser through Python against a reading written from the description, every trap, and figures."""

import random
import struct

import pytest
from logs import Writer, fill, real

from host.native import lib
from host.protocol.errors import LocalError
from host.usd.budget import budget
from host.usd.config import Names, names_of_firmware, names_of_log, names_of_text, read_config
from host.usd.decode import decode

HEAD = b"1 # version\n4096 # ring\nlog\n0\n"
FIXED = b"on:fixedFrequency\n500\n1\n"
NAMES = Names("", {f"tt.{letter}": letter for letter in "BbHhIif"}, {"estPose": "", "estTDOA": "BBf"})


def simple_reading(text: bytes) -> tuple[int, str, bool, int, list[tuple[str, list[str]]]]:
    """Of a file without any trap: ring, name, boot, Hz, blocks."""
    lines = [line.split("#")[0].replace(" ", "").replace("\t", "").strip() for line in text.decode().split("\n")]
    version, ring, name, boot, *rest = [line for line in lines if line]
    assert version == "1"
    hz, blocks = 0, []
    for line in (places := iter(rest)):
        if line == "on:fixedFrequency":
            hz, mode = int(next(places)), int(next(places))
            assert mode in (1, 2)
        if line.startswith("on:"):
            blocks.append((line[3:], list[str]()))
        else:
            blocks[-1][1].append(line)
    return int(ring), name, boot == "1", hz, blocks


def written(rng: random.Random) -> bytes:
    """A config.txt as people write it, without traps."""
    blocks = []
    for event in rng.sample(["fixedFrequency", *NAMES.payloads], rng.randrange(1, 4)):
        lines = [f"on:{event}"]
        if event == "fixedFrequency":
            lines += [f"{rng.choice([1, 50, 100, 125, 250, 500, 1000])} # frequency", rng.choice("12")]
        blocks.append(lines + rng.sample(list(NAMES.variables), rng.randrange(1, 8)))
    lines = ["1 # version", f"{rng.randrange(753, 9000)}", rng.choice(["log", "x", "flight_1"]), rng.choice("01")]
    lines += [line for block in blocks for line in block]
    spiced = []
    for line in lines:
        spiced += ["# " + "a comment " * rng.randrange(9)] * rng.randrange(2)
        spiced.append(rng.choice(["", "  ", "\t"]) + line + rng.choice(["", " ", "  # " + "why " * 20, "\r"]))
    return "".join(f"{line}\n" for line in spiced).encode()


@pytest.mark.parametrize("seed", range(60))
def test_a_second_reading_agrees(seed: int) -> None:
    text = written(random.Random(seed))
    ring, name, boot, hz, blocks = simple_reading(text)
    config = read_config(text, NAMES)
    assert (config.findings, config.usable) == ((), True), f"seed {seed}: {text!r}"
    assert (config.ring_bytes, config.name, config.on_startup) == (ring, name, boot)
    assert config.fixed_hz == hz
    assert [(block.event, [each.name for each in block.variables]) for block in config.blocks] == blocks
    lines = [line.split("#")[0].strip() for line in text.decode().split("\n")]
    for block in config.blocks:
        assert [lines[line - 1] for line in block.lines] == [each.name for each in block.variables]
        letters = "".join(each.letter for each in block.variables) + NAMES.payloads.get(block.event, "")
        assert block.row_bytes == struct.calcsize(f"<HQ{letters}")


LONG = b"stateEstimate.a_very_long_name_indeed"

TRAPS: list[tuple[str, bytes, list[tuple[int, str, str]]]] = [
    ("no newline", HEAD + FIXED + b"tt.f\ntt.B", [(9, "no_newline", "'tt.B'")]),
    ("long line", HEAD + FIXED + LONG + b"\n", [(8, "line_long", "'indeed'")]),
    ("long line, not ASCII", HEAD + FIXED + b"\xe9" * 40 + b"\n", [(8, "line_long", r"40 characters, and 31 count")]),
    ("not ASCII", HEAD + FIXED + b"tt.\xe9\x1b\n", [(8, "variable", r"'tt.\xe9\x1b'")]),
    ("unknown variable", HEAD + FIXED + b"tt.F\ntt.f\n", [(8, "variable", "did you mean tt.f?")]),
    ("unknown event", HEAD + b"on:estPos\ntt.f\n", [(5, "event", "did you mean on:estPose?")]),
    ("wrong case", HEAD + b"on:fixedfrequency\n500\n1\n", [(5, "event", "did you mean on:fixedFrequency?")]),
    ("300 Hz", HEAD + b"on:fixedFrequency\n300\n1\ntt.f\n", [(6, "rounded", "become 333.333:")]),
    ("300 Hz, instead", HEAD + b"on:fixedFrequency\n300\n1\ntt.f\n", [(6, "rounded", "write 250 or 500")]),
    ("999 Hz", HEAD + b"on:fixedFrequency\n999\n1\ntt.f\n", [(6, "rounded", "write 500 or 1000")]),
    ("2000 Hz", HEAD + b"on:fixedFrequency\n2000\n1\ntt.f\n", [(6, "frequency", "write 1000 or less")]),
    ("a unit", HEAD + b"on:fixedFrequency\n500Hz\n1\ntt.f\n", [(6, "trailing", "write 500")]),
    ("mode", HEAD + b"on:fixedFrequency\n500\n3\ntt.f\n", [(7, "mode", "write 1")]),
    ("no mode", HEAD + b"on:fixedFrequency\n500\n", [(7, "cut", "frequency and mode")]),
    (
        "21 variables",
        HEAD + b"on:estPose\n" + b"".join(b"tt.%c\n" % b"BbHhIif"[n % 7] for n in range(7)) + b"tt.f\n" * 14,
        [*((line, "twice", "line 12") for line in range(13, 26)), (26, "many", "21st"), (26, "twice", "line 12")],
    ),
    ("small ring", b"1\n100\nlog\n0\n" + FIXED + b"tt.f\n", [(2, "ring", "become 753")]),
    ("large ring", b"1\n70000\nlog\n0\n" + FIXED + b"tt.f\n", [(2, "heap", "heap"), (2, "ring", "become 65535")]),
    ("much of the heap", b"1\n20000\nlog\n0\n" + FIXED + b"tt.f\n", [(2, "heap", "9000 or less")]),
    ("no ring", b"1\nmany\nlog\n0\n" + FIXED, [(2, "number", "753 to 65535")]),
    ("huge ring", b"#\n1\n\t\n12345678901\nlog\n0\n" + FIXED, [(3, "blank", "#"), (4, "number", "753 to 65535")]),
    ("boot", b"1\n1024\nlog\nyes\n" + FIXED, [(4, "number", "neither 0 nor 1")]),
    ("name", b"1\n1024\na/b\n0\n" + FIXED, [(3, "name", "letters and digits")]),
    ("long name", b"1\n1024\nabcdefghijk\n0\n" + FIXED + b"tt.f\n", [(3, "name_long", "'abcdefghij'")]),
    ("name that spills", b"1\n1024\nabcdefghijklmn\n0\n" + FIXED + b"tt.f\n", [(3, "name_long", "'mn' for line 4")]),
    ("version", b"2\n" + HEAD[12:] + FIXED, [(1, "version", "write 1")]),
    ("2019", b"100 # Hz\n25\ncf_\n0\n1\ntt.f\n", [(1, "version", "format of 2019")]),
    ("byte order mark", b"\xef\xbb\xbf" + HEAD + FIXED, [(1, "version", "byte order mark")]),
    ("nothing", b"", [(1, "head", "first four lines")]),
    ("only a head", HEAD, [(5, "nothing", "on:fixedFrequency")]),
    ("off", HEAD + b"on:fixedFrequency\n500\n0\ntt.f\n", [(9, "nothing", "so nothing is logged")]),
    ("no block", HEAD + b"tt.f\n", [(5, "no_block", "on:fixedFrequency")]),
    ("twice", HEAD + FIXED + b"tt.f\n" + FIXED, [(9, "repeated", "into the first")]),
    ("short", HEAD + FIXED + b"tt.f\nt.\n", [(9, "short", "group.name")]),
]


@pytest.mark.parametrize(("text", "expected"), [each[1:] for each in TRAPS], ids=[each[0] for each in TRAPS])
def test_every_trap_is_named_with_its_line_and_what_to_write(text: bytes, expected: list[tuple[int, str, str]]) -> None:
    config = read_config(text, NAMES)
    assert [(each.line, each.kind) for each in config.findings] == [each[:2] for each in expected]
    for finding, (_, _, says) in zip(config.findings, expected, strict=True):
        assert says in finding.text
    warnings = {"no_newline", "rounded", "trailing", "many", "twice", "ring", "heap", "blank", "name_long", "short"}
    assert [each.severity for each in config.findings] == [
        "warning" if each.kind in warnings else "error" for each in config.findings
    ]


def test_what_is_said_of_each_frequency_is_what_the_firmware_does() -> None:
    """Its period in the C, the warning, and the two frequencies that it offers, which are taken as they are."""
    for hz in range(1, 1001):
        text = HEAD + b"on:fixedFrequency\n%d\n1\ntt.f\n"
        config = read_config(text % hz, NAMES)
        assert config.fixed_hz == pytest.approx(1000 / (1000 // hz)), hz
        said = [each.text for each in config.findings if each.kind == "rounded"]
        assert bool(said) == (1000 % hz != 0), hz
        if said:
            words = said[0].split()
            assert float(words[3].rstrip(":")) == pytest.approx(config.fixed_hz, rel=1e-5)
            below, above = int(words[-3]), int(words[-1])
            assert below < hz < above
            for better in (below, above):
                offered = read_config(text % better, NAMES)
                assert (offered.fixed_hz, offered.findings) == (better, ())


def test_every_finding_of_the_c_has_a_text() -> None:
    from host.usd.config_findings import TEXTS

    kinds = {getattr(lib, name) for name in dir(lib) if name.startswith(("USD_ERROR_", "USD_WARNING_"))}
    assert set(TEXTS) == kinds
    assert {each[1] for _, _, found in TRAPS for each in found} - {"many", "twice", "heap", "nothing"} == {
        each.__name__ for each in TEXTS.values()
    } - {"full"}


def test_no_finding_is_lost() -> None:
    """The C keeps sixteen."""
    config = read_config(HEAD + FIXED + b"tt.wrong\n" * 40 + b"tt.f\n" * 33, NAMES)
    assert [each.line for each in config.findings if each.kind == "variable"] == list(range(8, 48))
    assert [each.line for each in config.findings if each.kind == "full"] == [80]


@pytest.mark.parametrize("seed", range(40))
def test_any_bytes_end_with_a_result(seed: int) -> None:
    rng = random.Random(seed)
    words = [HEAD, FIXED, b"on:", b"estPose", b"tt.f", b"\n", b"\n", b"#", b"\xff", LONG, b"2000", rng.randbytes(9)]
    text = HEAD * (seed % 2) + b"".join(rng.choices(words, k=100))
    config = read_config(text, names_of_text(text))
    assert config.usable == bool(config.blocks) or config.errors, f"seed {seed}"
    assert all(1 <= each.line <= text.count(b"\n") + 1 for each in config.findings), f"seed {seed}"


def test_more_names_than_a_table_takes() -> None:
    text = HEAD + b"".join(b"g.v%d\n" % number for number in range(256))
    with pytest.raises(LocalError, match="more than 255"):
        read_config(text, names_of_text(text))


def test_names_out_of_a_log() -> None:
    names = names_of_log(decode(fill(Writer(session=1), seed=3, rows=3000).close()), "log00")
    assert names.variables == {"acc.x": "f", "acc.y": "f", "pm.vbatMV": "H"}
    assert names.payloads == {"estTDOA": "BBf"}
    assert 180 < names.rates_hz["estTDOA"] < 260
    with pytest.raises(LocalError, match="no names in it: empty"):
        names_of_log(decode(b""), "log00")


def test_names_of_this_firmware() -> None:
    names = names_of_firmware()
    assert (names.variables["stateEstimate.x"], names.variables["pm.vbatMV"]) == ("f", "H")
    assert names.payloads == {
        "estPose": "",
        "estPosition": "B",
        "estGyroscope": "",
        "estAcceleration": "",
        "beacon": "IIH",
    }
    text = HEAD + FIXED + b"gyro.x\non:estPosition\n"
    config = read_config(text, names)
    assert [block.row_bytes for block in config.blocks] == [14, 11]
    assert not config.findings


def test_the_log_of_a_real_robot_lacks_what_its_firmware_did_not_have() -> None:
    names = names_of_log(decode(real("sync-3-robots/cf231_00")), "cf231_00")
    config = read_config(real("sync-3-robots/config.txt"), names)
    found = [(each.line, each.kind) for each in config.findings]
    assert found == [(2, "ring"), *((line, "variable") for line in (17, 18, 19))]
    assert config.blocks[0].row_bytes == 10 + 12 * 4


def test_figures() -> None:
    """250 Hz of seven floats and poses at 100 Hz: 13.3 kB/s, of which 1024 bytes hold 77 ms."""
    pose = b"".join(b"stateEstimate.%s\n" % name for name in (b"x", b"y", b"z", b"qx", b"qy", b"qz", b"qw"))
    text = b"1\n1024\nlog\n0\non:fixedFrequency\n250\n1\n" + pose + b"on:estPose\n" + pose
    config = read_config(text, names_of_text(text))
    cost = budget(config, {"estPose": 100.0})
    assert (cost.rows_per_s, cost.bytes_per_s) == (350, 350 * 38 + 42 * 4)
    assert cost.mb_per_hour == pytest.approx(48.48, abs=0.01)
    assert 70 < cost.stock_stall_ms < 77
    assert cost.stall_ms == pytest.approx((1024 - 46 - 511 - 2 * 38 - 42 - 107 - 38) / 13.3)
    small = budget(read_config(text.replace(b"1024", b"512"), names_of_text(text)), {"estPose": 100.0})
    assert small.stock_stall_ms == pytest.approx((512 - 2 * 38) / 13.3)
    assert budget(config, {}).uncounted == ("estPose",)
    assert budget(config, {}).rows_per_s == 250
