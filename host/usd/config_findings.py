"""What is wrong with a line of config.txt, why, and what to write instead."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from ..native import lib

STOCK_VARIABLES = 20
"""In a block, in the Crazyflie's firmware."""
STOCK_RING = 9000
"""Its ring comes from the heap of FreeRTOS, of which 9 to 16 kB are free."""
RING_PLACE = 2
"""Among the lines that are not empty."""
STOCK_NAME_LINE = 12
"""Characters that it reads of line 3."""
MARK = "\xef\xbb\xbf"


@dataclass(frozen=True, slots=True, order=True)
class Finding:
    line: int
    """1 is the first."""
    severity: Literal["error", "warning"]
    """An error: something that was asked for is not logged."""
    kind: str
    text: str
    """What, why, and what to write instead."""


class Known(Protocol):
    """Of config.Names."""

    @property
    def source(self) -> str: ...
    @property
    def variables(self) -> Mapping[str, str]: ...
    @property
    def payloads(self) -> Mapping[str, str]: ...


class BlockLike(Protocol):
    @property
    def event(self) -> str: ...
    @property
    def variables(self) -> Sequence[object]: ...
    @property
    def lines(self) -> Sequence[int]: ...


def explain(line: int, kind: int, said: str, place: int, names: Known) -> Finding:
    """A finding of the C's. `said`: the line without white space and comment; `place`: its number among those that are
    not empty then."""
    severity: Literal["error", "warning"] = "error" if kind <= lib.USD_ERROR_LAST else "warning"
    return Finding(line, severity, TEXTS[kind].__name__, printable(TEXTS[kind](said, place, names)))


def version(said: str, place: int, names: Known) -> str:
    if said.startswith(MARK):
        return "the file begins with a byte order mark: save it as plain ASCII (UTF-8 without BOM)"
    older = "; the format of 2019, which began with the frequency, is not read any more" if said.isdigit() else ""
    return f"'{said}' is not the version{older}: write 1"


def number(said: str, place: int, names: Known) -> str:
    if place == RING_PLACE:
        return f"'{said}' is not the bytes of the ring: write {lib.USD_CONFIG_RING_MIN} to {lib.USD_CONFIG_RING_MAX}"
    return f"'{said}' is neither 0 nor 1, which say whether logging begins at boot: write one of them"


def name(said: str, place: int, names: Known) -> str:
    return f"'{said}' is no name of a file: write letters and digits, as log"


def head(said: str, place: int, names: Known) -> str:
    return "the text ends within its first four lines: write version (1), bytes of the ring, name, and 0 or 1 for boot"


def line_long(said: str, place: int, names: Known) -> str:
    rest = said[lib.USD_CONFIG_LINE_MAX :]
    return (
        f"{len(said)} characters, and {lib.USD_CONFIG_LINE_MAX} count: it is left out, and the Crazyflie's firmware "
        f"takes the rest, '{shortened(rest)}', for the next line: write a shorter one, or # before what is a comment"
    )


def event(said: str, place: int, names: Known) -> str:
    here = said.removeprefix("on:")
    maybe = near(here, [*names.payloads, "fixedFrequency"], "on:")
    return f"no event '{here}'{nowhere(names)}: its block is left out{maybe}"


def variable(said: str, place: int, names: Known) -> str:
    return f"no variable '{said}'{nowhere(names)}: it is missing in every row{near(said, names.variables)}"


def nowhere(names: Known) -> str:
    return f" in {names.source}" if names.source else ""


def near(said: str, known: Iterable[str], before: str = "") -> str:
    same = [each for each in known if each.lower() == said.lower()]
    found = same or difflib.get_close_matches(said, known, n=1, cutoff=0.7)
    return f"; did you mean {before}{found[0]}?" if found else ""


def no_block(said: str, place: int, names: Known) -> str:
    return f"'{said}' belongs to no block and is not logged: write on:fixedFrequency, frequency and mode before it"


def repeated(said: str, place: int, names: Known) -> str:
    return f"a second block '{said}' is left out: put its variables into the first"


def full(said: str, place: int, names: Known) -> str:
    if said.startswith("on:"):
        return f"more than {lib.USD_CONFIG_BLOCKS_MAX} blocks: this one is left out"
    return f"more than {lib.USD_CONFIG_VARIABLES_MAX} variables in a block: '{said}' is left out"


def frequency(said: str, place: int, names: Known) -> str:
    if said.isdigit() and int(said) > lib.USD_CONFIG_HZ_MAX:
        return f"{said} Hz is above {lib.USD_CONFIG_HZ_MAX}: nothing of this block is logged; write 1000 or less"
    return (
        f"'{said}' is no frequency: nothing of this block is logged; write 1 to {lib.USD_CONFIG_HZ_MAX}, then the mode"
    )


def mode(said: str, place: int, names: Known) -> str:
    return f"'{said}' is no mode: nothing of this block is logged; write 1 (or 2; 0 is off) on a line of its own"


def cut(said: str, place: int, names: Known) -> str:
    return "the text ends before frequency and mode of on:fixedFrequency: write both, and then the variables"


def rounded(said: str, place: int, names: Known) -> str:
    hz = int(digits(said))
    real_hz = 1000 / (1000 // hz)
    exact = [each for each in range(1, 1001) if 1000 % each == 0]
    below, above = max(each for each in exact if each < hz), min(each for each in exact if each > hz)
    return f"{hz} Hz become {real_hz:.6g}: rows come every whole number of ms; write {below} or {above}"


def ring(said: str, place: int, names: Known) -> str:
    low, high = lib.USD_CONFIG_RING_MIN, lib.USD_CONFIG_RING_MAX
    if int(digits(said)) < low:
        return (
            f"{said} bytes hold no sector of the card, a row and the log's end; they become {low}: write {low} or more"
        )
    return f"{said} bytes become {high}, the most that there is: write {low} to {high}"


def name_long(said: str, place: int, names: Known) -> str:
    most = lib.USD_CONFIG_NAME_MAX
    rest = said[STOCK_NAME_LINE:]
    spills = f"; the Crazyflie's firmware takes '{rest}' for line 4" if rest else ""
    return f"'{said}' becomes '{said[:most]}', then two digits{spills}: write at most {most} characters"


def no_newline(said: str, place: int, names: Known) -> str:
    return f"the Crazyflie's firmware does not see '{said}', as its line does not end: end the last line with a newline"


def blank(said: str, place: int, names: Known) -> str:
    return (
        "empty, and the Crazyflie's firmware takes it for one of the first four: remove it, or make it a comment with #"
    )


def short(said: str, place: int, names: Known) -> str:
    return f"'{said}' is ignored, as all lines of 1 to 3 characters: write group.name"


def trailing(said: str, place: int, names: Known) -> str:
    value = digits(said)
    return f"'{said.removeprefix(value)}' behind the number is ignored: write {value}, and # before a comment"


def digits(said: str) -> str:
    """That it begins with."""
    return said[: len(said) - len(said.lstrip("0123456789"))]


TEXTS: dict[int, Callable[[str, int, Known], str]] = {
    lib.USD_ERROR_VERSION: version,
    lib.USD_ERROR_NUMBER: number,
    lib.USD_ERROR_NAME: name,
    lib.USD_ERROR_HEAD: head,
    lib.USD_ERROR_LINE_LONG: line_long,
    lib.USD_ERROR_EVENT: event,
    lib.USD_ERROR_VARIABLE: variable,
    lib.USD_ERROR_NO_BLOCK: no_block,
    lib.USD_ERROR_REPEATED: repeated,
    lib.USD_ERROR_FULL: full,
    lib.USD_ERROR_FREQUENCY: frequency,
    lib.USD_ERROR_MODE: mode,
    lib.USD_ERROR_CUT: cut,
    lib.USD_WARNING_ROUNDED: rounded,
    lib.USD_WARNING_RING: ring,
    lib.USD_WARNING_NAME_LONG: name_long,
    lib.USD_WARNING_NO_NEWLINE: no_newline,
    lib.USD_WARNING_BLANK: blank,
    lib.USD_WARNING_SHORT: short,
    lib.USD_WARNING_TRAILING: trailing,
}
"""Programs know a finding by the name of its function."""


def beyond(blocks: Sequence[BlockLike], ring_bytes: int, ring_line: int) -> Iterator[Finding]:
    """What the C does not look for."""
    if ring_bytes > STOCK_RING:
        text = (
            f"{ring_bytes} bytes for the ring: the Crazyflie's firmware takes them from its heap, of which 9 to 16 kB "
            f"are free, and does not log without them; write {STOCK_RING} or less, unless yours has more"
        )
        yield Finding(ring_line, "warning", "heap", text)
    for block in blocks:
        if len(block.variables) > STOCK_VARIABLES:
            text = (
                f"the {STOCK_VARIABLES + 1}st variable of {block.event}: the Crazyflie's firmware takes "
                f"{STOCK_VARIABLES} and leaves out the others; remove some, unless yours takes more"
            )
            yield Finding(block.lines[STOCK_VARIABLES], "warning", "many", text)
        seen: dict[object, int] = {}
        for each, line in zip(block.variables, block.lines, strict=True):
            if each in seen:
                yield Finding(line, "warning", "twice", f"the same variable as in line {seen[each]}: remove one")
            seen.setdefault(each, line)


def nothing(line: int) -> Finding:
    """No block, and no error that says why."""
    text = "no block, so nothing is logged: write on:fixedFrequency, a frequency, 1, and variables"
    return Finding(line, "error", "nothing", text)


def shortened(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:40]}..."


def printable(text: str) -> str:
    """On any terminal."""
    return "".join(each if " " <= each <= "~" else f"\\x{ord(each):02x}" for each in text)
