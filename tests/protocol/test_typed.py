"""What counts as a number when somebody types it."""

import argparse

import pytest

from host.cli.ports import seconds
from host.cli.stream import positive
from host.protocol.typed import integer, real


@pytest.mark.parametrize(
    ("text", "value"), [("0", 0), ("-7", -7), ("+7", 7), (" 7", 7), ("18446744073709551615", 2**64 - 1)]
)
def test_integers(text: str, value: int) -> None:
    assert integer(text) == value


@pytest.mark.parametrize(
    ("text", "value"), [("0", 0), ("-0.25", -0.25), (".5", 0.5), ("2.", 2), ("1e-3", 0.001), ("1E2", 100)]
)
def test_reals(text: str, value: float) -> None:
    assert real(text) == value


@pytest.mark.parametrize(
    "text",
    ["", " ", "-", "1_0", "\uff11", "\u0661", "0x10", "1 0", "1\n", "\t1", "--1", "nan", "inf", "-inf", "e5", "1" * 31],
)  # fmt: skip
def test_what_python_takes_and_we_do_not(text: str) -> None:
    for read in (integer, real):
        with pytest.raises(ValueError, match="not a number"):
            read(text)


def test_too_large() -> None:
    with pytest.raises(ValueError, match="1e400"):
        real("1e400")


@pytest.mark.parametrize("text", ["1_0", "\uff11", "nan", "inf", "-1"])
def test_options(text: str) -> None:
    for read in (positive(int), positive(float), seconds):
        with pytest.raises((ValueError, argparse.ArgumentTypeError)):
            read(text)
