"""config.txt: what each line means, and every way in which a line can go wrong, with its number."""

import random

import pytest
from usd_table import Config

from host.native import lib

HEAD = b"1 # version\n 4096 # bytes\nlog\n1\n"
FIXED = b"on:fixedFrequency\n500\n1\n"
ERR_VALUE = -5


def test_the_file_that_everybody_has() -> None:
    config = Config(
        b"1     # version\n1024  # buffer size in bytes\njana  # file name\n0     # enable on startup (0/1)\n"
        b"on:fixedFrequency\n500     # frequency\n1     # mode (0: disabled, 1: synchronous stabilizer)\n"
        b"t.f0\nt.f1\nt.H0\non:estPose\nt.f0\non:estTDOA\n"
    )
    assert config.result == 0
    assert config.findings == []
    assert (config.state.ring_bytes, config.name, config.state.on_startup) == (1024, "jana", False)
    assert config.state.period_us == 2000
    assert config.blocks == [("fixedFrequency", ["t.f0", "t.f1", "t.H0"]), ("estPose", ["t.f0"]), ("estTDOA", [])]


def test_white_space_comments_and_carriage_returns_do_not_count() -> None:
    config = Config(
        b"# all about it\r\n1\r\n\t40 96\r\n# the name\r\nlo g\r\n1\r\n\r\n \r\n o n : fixedFrequency #x\r\n"
        b"10 0\r\n2\r\nt.\tf0#a\x00\xff\r\n#on:estPose\r\n"
    )
    assert (config.result, config.findings) == (0, [])
    assert (config.state.ring_bytes, config.name, config.state.period_us) == (4096, "log", 10_000)
    assert config.blocks == [("fixedFrequency", ["t.f0"])]


LONG = b"x" * 32

CASES: list[tuple[str, bytes, list[tuple[int, int]], list[str]]] = [
    ("version", b"2\n" + HEAD[12:] + FIXED + b"t.f0\n", [(1, lib.USD_ERROR_VERSION)], []),
    ("no number", b"1\nmany\nlog\n1\n" + FIXED, [(2, lib.USD_ERROR_NUMBER)], []),
    ("a number of ten digits", b"1\n4294967298\nlog\n1\n" + FIXED, [(2, lib.USD_ERROR_NUMBER)], []),
    ("a name with a folder", b"1\n1024\na/b\n1\n" + FIXED, [(3, lib.USD_ERROR_NAME)], []),
    ("startup is neither", b"1\n1024\nlog\n2\n" + FIXED, [(4, lib.USD_ERROR_NUMBER)], []),
    ("nothing", b"", [(1, lib.USD_ERROR_HEAD)], []),
    ("only a head", HEAD, [], []),
    ("cut in the head", b"1\n1024\nlog\n", [(4, lib.USD_ERROR_HEAD)], []),
    ("a long line in the head", b"1\n1024\n" + LONG + b"\n1\n" + FIXED, [(3, lib.USD_ERROR_LINE_LONG)], []),
    (
        "a long line behind a bad head",
        b"1\n1024\n/\n1\non:" + LONG + b"\non:estPose\n",
        [(3, lib.USD_ERROR_NAME), (5, lib.USD_ERROR_LINE_LONG)],
        [],
    ),
    ("a long variable", HEAD + FIXED + LONG + b"\nt.f0\n", [(8, lib.USD_ERROR_LINE_LONG)], ["fixedFrequency t.f0"]),
    (
        "a long event takes its variables with it",
        HEAD + FIXED + b"t.f0\non:" + LONG + b"\nt.f1\non:estPose\n",
        [(9, lib.USD_ERROR_LINE_LONG)],
        ["fixedFrequency t.f0", "estPose"],
    ),
    (
        "an event that there is not",
        HEAD + b"on:estFlow\nt.f0\nt.f1\non:estPose\nt.f0\n",
        [(5, lib.USD_ERROR_EVENT)],
        ["estPose t.f0"],
    ),
    (
        "variables that there are not",
        HEAD + FIXED + b"t.f0\nt.nothing\nt.f1\nt.\n",
        [(9, lib.USD_ERROR_VARIABLE), (11, lib.USD_WARNING_SHORT)],
        ["fixedFrequency t.f0 t.f1"],
    ),
    ("a variable of no block", HEAD + b"t.f0\n" + FIXED, [(5, lib.USD_ERROR_NO_BLOCK)], ["fixedFrequency"]),
    (
        "a block twice",
        HEAD + FIXED + b"t.f0\non:fixedFrequency\n100\n1\nt.f1\n",
        [(9, lib.USD_ERROR_REPEATED)],
        ["fixedFrequency t.f0"],
    ),
    ("no frequency", HEAD + b"on:fixedFrequency\nt.f0\nt.f1\n", [(6, lib.USD_ERROR_FREQUENCY)], []),
    ("0 Hz", HEAD + b"on:fixedFrequency\n0\n1\nt.f0\n", [(6, lib.USD_ERROR_FREQUENCY)], []),
    ("on: alone", HEAD + b"on:\nt.f0\n", [(5, lib.USD_ERROR_EVENT)], []),
    ("above 1 kHz", HEAD + b"on:fixedFrequency\n1001\n", [(6, lib.USD_ERROR_FREQUENCY)], []),
    ("mode 3", HEAD + b"on:fixedFrequency\n100\n3\nt.f0\n", [(7, lib.USD_ERROR_MODE)], []),
    ("mode 0 is off", HEAD + b"on:fixedFrequency\n100\n0\nt.f0\non:estPose\n", [], ["estPose"]),
    ("cut before the mode", HEAD + b"on:fixedFrequency\n100\n", [(7, lib.USD_ERROR_CUT)], []),
    (
        "300 Hz are 333",
        HEAD + b"on:fixedFrequency\n300\n1\nt.f0\n",
        [(6, lib.USD_WARNING_ROUNDED)],
        ["fixedFrequency t.f0"],
    ),
    ("a small ring", b"1\n10\nlog\n1\n" + FIXED, [(2, lib.USD_WARNING_RING)], ["fixedFrequency"]),
    ("a large ring", b"1\n70000\nlog\n1\n" + FIXED, [(2, lib.USD_WARNING_RING)], ["fixedFrequency"]),
    ("a long name", b"1\n1024\nabcdefghijk\n1\n" + FIXED, [(3, lib.USD_WARNING_NAME_LONG)], ["fixedFrequency"]),
    ("no newline", HEAD + FIXED + b"t.f0\nt.f1", [(9, lib.USD_WARNING_NO_NEWLINE)], ["fixedFrequency t.f0 t.f1"]),
    ("a comment without newline", HEAD + FIXED + b"t.f0\n#", [], ["fixedFrequency t.f0"]),
    ("blank in the head", b"1\n\n1024\nlog\n1\n" + FIXED, [(2, lib.USD_WARNING_BLANK)], ["fixedFrequency"]),
    ("a unit", HEAD + b"on:fixedFrequency\n500Hz\n1\n", [(6, lib.USD_WARNING_TRAILING)], ["fixedFrequency"]),
]


@pytest.mark.parametrize(("text", "findings", "blocks"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_every_trap_names_its_line_and_the_rest_is_kept(
    text: bytes, findings: list[tuple[int, int]], blocks: list[str]
) -> None:
    config = Config(text)
    assert config.findings == findings
    assert config.state.errors == sum(kind <= lib.USD_ERROR_LAST for _, kind in findings)
    assert [" ".join([name, *variables]) for name, variables in config.blocks] == blocks
    assert config.result == (0 if blocks else ERR_VALUE)


def test_a_rounded_frequency_is_what_the_grid_of_1_ms_gives() -> None:
    assert Config(HEAD + b"on:fixedFrequency\n300\n1\n").state.period_us == 3000
    assert Config(HEAD + b"on:fixedFrequency\n1000\n1\n").state.period_us == 1000
    assert Config(HEAD + b"on:fixedFrequency\n0300\n3\n").state.period_us == 0


def test_a_ring_is_within_its_bounds() -> None:
    assert Config(b"1\n10\nlog\n1\n").state.ring_bytes == lib.USD_CONFIG_RING_MIN
    assert Config(b"1\n999999999\nlog\n1\n").state.ring_bytes == lib.USD_CONFIG_RING_MAX


def test_a_line_of_31_characters_is_whole() -> None:
    config = Config(HEAD + FIXED + b"g.long_name_of_31_chars_12345 # comments do not count\n")
    assert config.blocks == [("fixedFrequency", ["g.long_name_of_31_chars_12345"])]


def test_blocks_and_variables_are_bounded_and_what_is_too_much_is_said() -> None:
    blocks = b"".join(b"on:more%d\n" % number + b"t.f0\n" * 33 for number in range(21))
    config = Config(HEAD + blocks)
    assert [(name, len(variables)) for name, variables in config.blocks] == [(f"more{n}", 32) for n in range(20)]
    assert config.state.errors == 21
    assert len(config.findings) == lib.USD_CONFIG_FINDINGS_MAX
    assert config.findings[:2] == [(5 + 33, lib.USD_ERROR_FULL), (5 + 2 * 34 - 1, lib.USD_ERROR_FULL)]


@pytest.mark.parametrize("text", [case[1] for case in CASES], ids=[case[0] for case in CASES])
def test_it_does_not_matter_how_the_text_is_cut(text: bytes) -> None:
    whole = Config(text)
    for cut in range(len(text) + 1):
        pieces = Config(text, [cut])
        assert (pieces.findings, pieces.blocks, pieces.result) == (whole.findings, whole.blocks, whole.result)


@pytest.mark.parametrize("seed", range(50))
def test_any_text_ends_with_a_result(seed: int) -> None:
    rng = random.Random(seed)
    words = [
        b"on:",
        b"fixedFrequency",
        b"estPose",
        b"t.f0",
        b"500",
        b"1",
        b"\n",
        b"\n",
        b"#",
        b" ",
        b"\x00",
        b"\xff",
        LONG,
    ]
    config = Config(HEAD + b"".join(rng.choices(words, k=200)))
    assert config.result in (0, ERR_VALUE), f"seed {seed}"
    assert config.state.block_count <= lib.USD_CONFIG_BLOCKS_MAX
