"""Pictures of logs: every number is where it belongs, and what is missing is marked where it is missing."""

import io
import math
import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np
import pytest
from logs import FIXED, Writer, fill
from PIL import Image

from host.protocol.errors import LocalError
from host.usd import drawing
from host.usd.decode import decode
from host.usd.drawing import Box, Dots, Line, Words
from host.usd.examine import examine
from host.usd.log import Log
from host.usd.plot import LEFT, MARKS, PANEL, RIGHT, TOP, WIDTH, Curve, decimal, nice_step, plot, reduced
from host.usd.units import unit_of

CURVES = ("#0b62a4", "#c8344b")
Shapes = list[drawing.Shape]


def pictured(log: Log, *names: str, **between: float) -> tuple[int, int, Shapes]:
    curves = [Curve(log.rows[kind], name) for kind, name in (each.split(":") for each in names)]
    return plot(log, examine(log), [curves], "made", **between)


def boxes(shapes: Shapes, kind: str) -> list[tuple[float, float]]:
    fill = MARKS[kind][0]
    found = [each for each in shapes if isinstance(each, Box) and each.fill == fill and each.height == PANEL]
    return [(each.x, each.x + each.width) for each in found]


def lines(shapes: Shapes, color: str) -> list[list[tuple[float, float]]]:
    return [list(each.points) for each in shapes if isinstance(each, Line) and each.stroke == color]


def marked_log() -> Log:
    """5 to 8 s, a hole from 6.999 to 7.3, 40 rows dropped about 6.5; a reset; 0.1 to 1.1 s, the last 20 ms open."""
    log = Writer(session=7)
    for start, rows in ((5_000_000, 3000), (100_000, 1020)):
        for number in range(rows):
            if start == 5_000_000 and 2000 <= number < 2300:
                continue
            log.row(FIXED, start + 1000 * number, number, -number, 4000)
            if number % 50 == 49:
                log.status(start + 1000 * number + 500)
            log.dropped += 40 * (number == 1500)
    return decode(bytes(log.data))


def test_a_curve_goes_through_its_rows() -> None:
    log = Writer()
    values = [3.0, -1, 4, 1, -5, 9, 2, 6]
    for number, value in enumerate(values):
        log.row(FIXED, 1_000_000 + 2000 * number, value, 0, 0)
    width, height, shapes = pictured(decode(log.close()), "fixedFrequency:acc.x")
    ((points,),) = (lines(shapes, CURVES[0]),)
    assert (width, height) == (WIDTH, TOP + PANEL + 82)
    across = WIDTH - LEFT - RIGHT
    assert [x for x, _ in points] == pytest.approx([LEFT + across * number / 7 for number in range(8)])
    pad = 0.06 * 14
    expected = [TOP + PANEL * (9 + pad - value) / (14 + 2 * pad) for value in values]
    assert [y for _, y in points] == pytest.approx(expected)


def test_ticks_are_where_they_say() -> None:
    log = marked_log()
    _, _, shapes = pictured(log, "fixedFrequency:acc.x")
    words = [each for each in shapes if isinstance(each, Words)]
    shown = {each.text: each for each in words if each.anchor == "middle"}
    assert "time, s of the STM32's stamp clock" in shown
    first, second = shown["5.5"].x, shown["7.5"].x
    (hole,) = boxes(shapes, "hole")
    scale = (second - first) / 2
    assert (hole[0] - first) / scale + 5.5 == pytest.approx(6.999, abs=1e-3)
    assert (hole[1] - first) / scale + 5.5 == pytest.approx(7.3, abs=1e-3)
    left = {each.text: each.y - 4 for each in words if each.anchor == "end"}
    top, bottom = max(left, key=float), min(left, key=float)
    low, high = -0.06 * 2999, 1.06 * 2999
    for text in (top, bottom):
        assert left[text] == pytest.approx(TOP + PANEL * (high - float(text)) / (high - low))


def test_what_is_missing_is_marked_and_the_curve_broken_there() -> None:
    log = marked_log()
    _, _, shapes = pictured(log, "fixedFrequency:acc.x", "fixedFrequency:acc.y")
    (hole,), (drop,), (open_end,) = (boxes(shapes, kind) for kind in ("hole", "drop", "unverified"))
    pieces = lines(shapes, CURVES[0])
    assert len(pieces) == 3
    assert pieces[0][-1][0] == pytest.approx(hole[0])
    assert pieces[1][0][0] == pytest.approx(hole[1])
    assert pieces[0][0][0] < drop[0] < drop[1] < hole[0]
    assert pieces[1][-1][0] + 10 < pieces[2][0][0] < open_end[0] < open_end[1] <= pieces[2][-1][0] + 1
    assert any(isinstance(each, Line) and each.dashed and each.points[0][0] > pieces[1][-1][0] for each in shapes)
    said = " ".join(each.text for each in shapes if isinstance(each, Words))
    assert all(text in said for _, text in MARKS.values())
    assert "the clock was reset" in said


def test_a_good_log_has_no_marks() -> None:
    _, _, shapes = pictured(decode(fill(Writer(session=1), seed=1).close()), "fixedFrequency:acc.x")
    assert not any(boxes(shapes, kind) for kind in MARKS)
    said = " ".join(each.text for each in shapes if isinstance(each, Words))
    assert not any(text in said for _, text in MARKS.values())


def test_events_are_dots() -> None:
    log = decode(fill(Writer(), seed=1).close())
    _, _, shapes = pictured(log, "estTDOA:distanceDiff")
    (dots,) = (each for each in shapes if isinstance(each, Dots))
    assert 0.8 * len(log.rows["estTDOA"]) < len(dots.points) <= len(log.rows["estTDOA"])
    assert any(isinstance(each, Words) and each.text == "estTDOA: distanceDiff [m]" for each in shapes)


def test_unverified_rows_do_not_set_the_range() -> None:
    log = Writer(session=3)
    for number in range(200):
        log.row(FIXED, 5_000_000 + 1000 * number, math.nan if number == 70 else 1e30 if number > 150 else number, 0, 0)
        if number == 100:
            log.status(5_100_500)
    _, _, shapes = pictured(decode(bytes(log.data)), "fixedFrequency:acc.x")
    labels = [float(each.text) for each in shapes if isinstance(each, Words) and each.anchor == "end"]
    assert 50 <= max(labels) <= 106
    before, behind = lines(shapes, CURVES[0])
    assert len(before) == 70
    assert min(y for _, y in behind) == TOP


@pytest.mark.parametrize("rows", [1, 2, 3])
@pytest.mark.parametrize("value", [0.0, 1e-40, -3e38, math.inf])
def test_hardly_anything(rows: int, value: float) -> None:
    log = Writer()
    for _ in range(rows):
        log.row(FIXED, 7, value, 0, 0)
    width, height, shapes = pictured(decode(log.close()), "fixedFrequency:acc.x")
    ElementTree.fromstring(drawing.svg(width, height, shapes))
    Image.open(io.BytesIO(drawing.png(width, height, shapes))).verify()


def test_a_part_of_the_time() -> None:
    log = marked_log()
    _, _, shapes = pictured(log, "fixedFrequency:acc.x", from_us=6_000_000.0, to_us=6_100_000.0)
    (points,) = lines(shapes, CURVES[0])
    assert len(points) == 101
    assert (points[0][0], points[-1][0]) == (LEFT, WIDTH - RIGHT)
    with pytest.raises(LocalError, match="the log has 5000000 to 7999500 us, 100000 to"):
        pictured(log, "fixedFrequency:acc.x", from_us=9e6)


@pytest.mark.parametrize("seed", range(2))
def test_fewer_points_look_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(84, 1176, 20_000))
    y = np.cumsum(rng.normal(0, 1, 20_000))
    made = np.array(reduced(x, y))
    assert len(made) <= 4 * 2 * 1100
    for column in range(168, 2352):
        old, new = y[np.floor(x * 2) == column], made[np.floor(made[:, 0] * 2) == column, 1]
        assert (new.min(), new.max(), new[0], new[-1]) == (old.min(), old.max(), old[0], old[-1]), f"seed {seed}"


def test_few_points_stay_as_they_are() -> None:
    x, y = np.arange(100.0), np.arange(100.0) ** 2
    assert reduced(x, y) == list(zip(x, y, strict=True))


def test_the_two_formats_show_the_same() -> None:
    log = marked_log()
    width, height, shapes = pictured(log, "fixedFrequency:acc.x")
    root = ElementTree.fromstring(drawing.svg(width, height, shapes))
    name = "{http://www.w3.org/2000/svg}"
    boxes_there = [each for each in root.iter(f"{name}rect") if each.get("fill") == MARKS["hole"][0]]
    (hole,) = [each for each in boxes_there if float(each.get("height", 0)) == PANEL]
    assert len(list(root.iter(f"{name}text"))) == sum(isinstance(each, Words) for each in shapes)
    assert len(list(root.iter(f"{name}polyline"))) == sum(isinstance(each, Line) for each in shapes)
    image = Image.open(io.BytesIO(drawing.png(width, height, shapes)))
    assert image.size == (2 * width, 2 * height)
    middle = float(hole.get("x", 0)) + float(hole.get("width", 0)) / 2
    assert image.getpixel((int(2 * middle), int(2 * (TOP + 3)))) == (0xFF, 0xDF, 0xB3)
    colors: Any = image.getcolors(1 << 24)
    assert sum(count for count, color in colors if color == (0x0B, 0x62, 0xA4)) > 1000


def test_any_title_is_well_formed() -> None:
    text = "a<b> & \x00\x1b\ud800 'ü' ]]>"
    root = ElementTree.fromstring(drawing.svg(10, 10, [Words(0, 0, text)]))
    assert "".join(root.itertext()).strip() == "a<b> & \ufffd\ufffd\ufffd 'ü' ]]>"
    drawing.png(10, 10, [Words(0, 0, text)])


@pytest.mark.parametrize(
    ("least", "step"), [(0.3, 0.5), (1, 1), (1.1, 2), (2.1, 5), (5.1, 10), (0.02, 0.02), (1e-9, 1e-9), (3e30, 5e30)]
)
def test_steps(least: float, step: float) -> None:
    assert nice_step(least) == pytest.approx(step)


def test_numbers_have_the_digits_of_their_step() -> None:
    assert [decimal(*each) for each in ((1.5, 0.5), (2, 1), (0.02, 0.02), (1e7, 5e6), (0.25, 0.05))] == [
        "1.5", "2", "0.02", "1e+07", "0.25",
    ]  # fmt: skip


def test_units() -> None:
    expected = {
        "stateEstimate.x": "m", "stateEstimate.vx": "m/s", "stateEstimate.qx": "", "stateEstimateZ.x": "mm",
        "gyro.z": "deg/s", "acc.x": "g", "acc.x#2": "g", "pm.vbatMV": "mV", "pm.vbat": "V", "locSrv.z": "m", "a.b": "",
    }  # fmt: skip
    assert {name: unit_of(name) for name in expected} == expected
