"""The README's figure shows what benchmarks/figure.py finds today."""

import sys
from pathlib import Path
from xml.etree import ElementTree

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from figure import HEIGHT, WIDTH, flight, p95, picture

from host.usd.drawing import svg

ROOT = Path(__file__).resolve().parents[2]
SHOWN = ROOT / "docs/frame-times.svg"


def texts(picture: bytes) -> list[str]:
    return [str(each.text) for each in ElementTree.fromstring(picture).iter("{http://www.w3.org/2000/svg}text")]


def test_it_is_up_to_date_and_small() -> None:
    flown = flight()
    made = svg(WIDTH, HEIGHT, list(picture(flown)))
    assert texts(made) == texts(SHOWN.read_bytes()), f"python benchmarks/figure.py --plot {SHOWN.relative_to(ROOT)}"
    assert SHOWN.stat().st_size < 60_000
    assert SHOWN.name in (ROOT / "README.md").read_text(encoding="utf-8")
    assert p95(flown["offline"]) < p95(flown["online"]) < p95(flown["paper"]) / 100
    for times in (flown["online"], flown["offline"]):
        assert times.bound_us is not None
        assert (times.error_us <= times.bound_us).mean() > 0.985
