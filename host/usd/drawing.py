"""A picture made of boxes, lines, dots and words: as SVG, or as PNG by way of Pillow."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal
from xml.sax.saxutils import escape

Point = tuple[float, float]
Anchor = Literal["start", "middle", "end"]

FONT = "Helvetica, Arial, 'DejaVu Sans', sans-serif"
SCALE = 2
"""Pixels of a PNG to one of the picture."""
FINER = 2
"""And drawn so many times finer, to be smooth."""


@dataclass(frozen=True, slots=True)
class Box:
    x: float
    y: float
    width: float
    height: float
    fill: str


@dataclass(frozen=True, slots=True)
class Line:
    points: Sequence[Point]
    stroke: str
    width: float = 1.0
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Dots:
    points: Sequence[Point]
    fill: str
    size: float = 2.5


@dataclass(frozen=True, slots=True)
class Words:
    x: float
    y: float
    """Of the line that the letters stand on."""
    text: str
    size: float = 12
    anchor: Anchor = "start"
    fill: str = "#222222"
    bold: bool = False


Shape = Box | Line | Dots | Words


def svg(width: int, height: int, shapes: Sequence[Shape]) -> bytes:
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}">',
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
        f'<g font-family="{FONT}" fill="none" stroke-linejoin="round">',
        *(svg_of(shape) for shape in shapes),
        "</g></svg>",
    ]
    return "\n".join(lines).encode()


def svg_of(shape: Shape) -> str:
    match shape:
        case Box(x, y, width, height, fill):
            return f'<rect x="{x:.2f}" y="{y:.2f}" width="{width:.2f}" height="{height:.2f}" fill="{fill}"/>'
        case Line(points, stroke, width, dashed):
            dash = ' stroke-dasharray="5 4"' if dashed else ""
            path = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
            return f'<polyline points="{path}" stroke="{stroke}" stroke-width="{width}"{dash}/>'
        case Dots(points, fill, size):
            path = "".join(f"M{x:.2f} {y:.2f}h0" for x, y in points)
            return f'<path d="{path}" stroke="{fill}" stroke-width="{size}" stroke-linecap="round"/>'
        case Words(x, y, text, size, anchor, fill, bold):
            weight = ' font-weight="bold"' if bold else ""
            place = f'x="{x:.2f}" y="{y:.2f}" font-size="{size}" text-anchor="{anchor}"'
            return f'<text {place} fill="{fill}"{weight}>{escape(clean(text))}</text>'


def clean(text: str) -> str:
    """What XML has no way to say is left out."""
    return "".join(each if each.isprintable() else "\ufffd" for each in text)


def png(width: int, height: int, shapes: Sequence[Shape]) -> bytes:
    from PIL import Image, ImageDraw, ImageFont

    factor = SCALE * FINER
    image = Image.new("RGB", (width * factor, height * factor), "#ffffff")
    draw = ImageDraw.Draw(image)
    for shape in shapes:
        match shape:
            case Box(x, y, across, down, fill):
                draw.rectangle([x * factor, y * factor, (x + across) * factor, (y + down) * factor], fill=fill)
            case Line(points, stroke, thick, dashed):
                for part in dashes(points) if dashed else [points]:
                    scaled = [(x * factor, y * factor) for x, y in part]
                    draw.line(scaled, fill=stroke, width=max(1, round(thick * factor)), joint="curve")
            case Dots(points, fill, size):
                for x, y in points:
                    box = [(x - size / 2) * factor, (y - size / 2) * factor]
                    draw.ellipse([*box, *(each + size * factor for each in box)], fill=fill)
            case Words(x, y, text, size, anchor, fill, bold):
                font = ImageFont.load_default(size * factor)
                where = {"start": "ls", "middle": "ms", "end": "rs"}[anchor]
                thick = factor / 4 if bold else 0
                draw.text((x * factor, y * factor), clean(text), fill, font, where, stroke_width=thick)
    out = io.BytesIO()
    image.resize((width * SCALE, height * SCALE), Image.Resampling.BOX).save(out, "PNG")
    return out.getvalue()


def dashes(points: Sequence[Point]) -> Iterator[Sequence[Point]]:
    """Of a straight line from the first point to the last."""
    (x1, y1), (x2, y2) = points[0], points[-1]
    length = max(((x2 - x1) ** 2 + (y2 - y1) ** 2) ** 0.5, 1e-9)
    at = 0.0
    while at < length:
        part = [at / length, min(at + 5, length) / length]
        yield [(x1 + (x2 - x1) * each, y1 + (y2 - y1) * each) for each in part]
        at += 9
