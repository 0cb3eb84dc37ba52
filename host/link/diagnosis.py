"""What is wrong with a robot, and what limits its frame rate, judged from what host.link.listening heard. Pure.

Where several stages could be to blame, it is the last of them on the way of the data: what the camera did not take SPI
cannot carry.
"""

from __future__ import annotations

from dataclasses import dataclass

from .finding import Finding, Stage
from .listening import NS, Listening
from .rules import LOST_SHARE, RULES, capture_period_us, host_is_slow


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """All findings, the worst first, and what limits the frame rate."""

    findings: list[Finding]
    bottleneck: Stage | None
    rate: str
    """The frame rate and its limit, in words."""

    @property
    def healthy(self) -> bool:
        return all(finding.severity == "note" for finding in self.findings)


def diagnose(heard: Listening) -> Diagnosis:
    """From all that was heard."""
    found = [finding for rule in RULES for finding in rule(heard)]
    order = ("problem", "warning", "note")
    bottleneck, rate = limit(heard)
    return Diagnosis(sorted(found, key=lambda finding: order.index(finding.severity)), bottleneck, rate)


def limit(heard: Listening) -> tuple[Stage | None, str]:
    """The last stage of the way that cannot carry all it is given; without one, the camera."""
    times = [arrival_ns for arrival_ns, _, _ in heard.frames]
    if len(times) < 2 or times[-1] == times[0]:
        return None, "no frame rate: fewer than two frames"
    fps = (len(times) - 1) / ((times[-1] - times[0]) / NS)
    came = f"{fps:.2f} frames per second"
    dropped, late = heard.esp32.grown["frames_dropped"], heard.gap8.grown["captures_late"]
    if host_is_slow(heard):
        return "host", f"{came}; the limit is this computer, which is busy all the time"
    if not heard.numbered:
        return None, f"{came}; {heard.spoken} frames do not say what limits them"
    if dropped > LOST_SHARE * (dropped + len(times)):
        link: Stage = "UART2" if heard.framing == "cpx-uart" else "Wi-Fi"
        return link, f"{came}; the limit is {link}: the ESP32 had to drop {dropped} more"
    if late > LOST_SHARE * (late + heard.gap8.grown["frame"]):
        return "SPI", f"{came}; the limit is SPI: the GAP8 had to leave out {late} more"
    period_us = capture_period_us(heard)
    return "camera", f"{came}; the limit is the camera, which takes one every {period_us / 1000:.1f} ms"
