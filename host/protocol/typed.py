"""Numbers as people type them: decimal, in ASCII. Python's int and float take more: `1_0`, full-width digits, nan."""

from __future__ import annotations

import re

INTEGER = re.compile(r"[+-]?[0-9]+")
REAL = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
DIGITS_MOST = 30
"""More are no number that is meant, and int() refuses thousands of them."""


def integer(text: str) -> int:
    """ValueError when it is none."""
    return int(checked(INTEGER, text))


def real(text: str) -> float:
    """ValueError when it is none, or too large to be finite."""
    value = float(checked(REAL, text))
    if value in (float("inf"), float("-inf")):
        raise ValueError(text)
    return value


def checked(pattern: re.Pattern[str], text: str) -> str:
    """Spaces around it do no harm: in a URL, + is one."""
    stripped = text.strip(" ")
    if len(stripped) > DIGITS_MOST or not pattern.fullmatch(stripped):
        raise ValueError(f"not a number: {text}")
    return stripped
