"""What host doctor knows about faults: each rule looks at one kind of evidence and says what it means. Pure."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .finding import RARE, Finding
from .listening import NS, Listening
from .rules_of_log import card_log
from .rules_of_time import clocks, time_wire

LOST_SHARE = 0.02
STALL_S = 0.25
HANG_S = 0.4
"""A capture that fails at once costs a period; one that never ends costs half a second more."""
BUSY_SHARE = 0.9


UNSEEN = {
    "stock": (
        "without stamps and counters the clocks, UART1, the camera and dropped frames cannot be judged",
        "this firmware sends neither",
    ),
    "paper": (
        "without numbers and counters the clocks, UART1, the camera and dropped frames cannot be judged",
        "this firmware sends a pose, and a time that is about 4 ms early",
    ),
    "nanocockpit": (
        "without counters UART1, the camera and what drops frames cannot be judged",
        "this firmware sends times and the sensor's number",
    ),
}
"""By dialect, what cannot be seen and why."""


def silence(heard: Listening) -> Iterator[Finding]:
    counters = heard.counters
    if counters.bytes == 0 and heard.framing == "stamps":
        todo = "Does the STM32's firmware send them? Is the tap on its TX, and the ground connected?"
        yield Finding("UART1", "problem", "silent", "not a byte came", f"{heard.seconds:.0f} s of silence", todo)
    elif counters.bytes == 0 and heard.framing == "cpx-uart":
        todo = "Is the ESP32 on? Is the wire on its TX and RX, and the ground connected?"
        yield Finding("ESP32", "problem", "silent", "not a byte came", f"{heard.seconds:.0f} s of silence", todo)
    elif counters.bytes == 0 and heard.ends:
        evidence = f"it ended {times(len(heard.ends))} before a byte had come: {heard.ends[-1][1]}"
        todo = "End the other program: an AI-deck serves one client at a time. Nobody else? Restart the deck."
        yield Finding("Wi-Fi", "problem", "another_client", "the robot takes no connection from here", evidence, todo)
    elif heard.garbage_bytes > counters.bytes / 2:
        evidence = f"{heard.garbage_bytes} of {counters.bytes} bytes are no part of a packet"
        todo = "Check --baud and --framing. 'host dissect' shows single bytes."
        yield Finding("host", "problem", "not_understood", "what comes is read in the wrong way", evidence, todo)
    elif not heard.frames and heard.framing != "stamps" and not heard.broken:
        kinds = ", ".join(f"{count} {name}" for name, count in counters.packets.items() if count)
        evidence = f"the ESP32 is there, and in {heard.seconds:.0f} s it passed on {kinds or 'nothing'}"
        todo = "Is the camera's cable in? Restart the GAP8 and look at its console: is its firmware the streamer?"
        if counters.bytes == 0:
            todo += " Is another program connected? The ESP32 serves one client, and leaves a second one unheard."
        yield Finding("camera", "problem", "no_frames", "the camera or the GAP8 is silent", evidence, todo)


def camera(heard: Listening) -> Iterator[Finding]:
    failed = heard.gap8.grown["captures_failed"]
    if failed:
        period_us = capture_period_us(heard)
        extra = [us - (numbers + lost) * period_us for numbers, us, lost in heard.captures if lost]
        each = sum(extra) / 1e6 / max(1, sum(lost for _, _, lost in heard.captures if lost))
        evidence = f"{failed} of {failed + heard.gap8.grown['frame']} captures"
        if each > HANG_S / 2:
            what, cause = "captures never end and are given up", "camera_hangs"
            evidence += f"; each held up the camera for {each:.1f} s"
        else:
            what, cause = "captures fail", "camera_fails"
        todo = "Reseat the camera's connector. Does it happen with another deck too? Then it is the firmware's driver."
        yield Finding("camera", "problem", cause, what, evidence, todo)
    broken = count(heard, "bad_jpeg")
    if broken:
        evidence = f"{broken} came whole and are no JPEG files"
        todo = "Ask for raw images: host deck camera --encoding raw."
        yield Finding("GAP8", "problem", "bad_jpeg", "JPEG files are broken before they are sent", evidence, todo)


def restarts(heard: Listening) -> Iterator[Finding]:
    if heard.gap8_restarts:
        evidence = f"{times(heard.gap8_restarts)} its counters and frame numbers began anew"
        todo = "Look at its supply (a full battery, the deck's pins) and its console: a watchdog, or an exception?"
        yield Finding("GAP8", "problem", "gap8_restarts", "the GAP8 restarts", evidence, todo)
    if heard.gap8_forgot:
        evidence = f"{times(heard.gap8_forgot)} the stream was stock again, with the numbers going on"
        todo = "A packet to the GAP8 was damaged on SPI. If it comes again: seat the deck anew."
        yield Finding("SPI", "warning", "gap8_forgets", "the GAP8 took this host for gone", evidence, todo)
    if heard.esp32_restarts:
        evidence = f"{times(heard.esp32_restarts)} its uptime began anew; connections ended: {len(heard.ends)}"
        todo = "Look at its supply (a full battery, the deck's pins) and its console: a watchdog, or an exception?"
        yield Finding("ESP32", "problem", "esp32_restarts", "the ESP32 restarts", evidence, todo)
    elif heard.ends and heard.counters.bytes:
        evidence = f"{times(len(heard.ends))}, the last: {heard.ends[-1][1]}"
        todo = "Does the ESP32 restart, does the computer leave the network, does another client take its place?"
        yield Finding("Wi-Fi", "problem", "connection_ends", "the connection ends", evidence, todo)
    if heard.stm32_restarts:
        evidence = f"{times(heard.stm32_restarts)} the numbers of its time messages began anew"
        todo = "Look at its supply and at the console in cfclient: an assertion that failed?"
        yield Finding("STM32", "problem", "stm32_restarts", "the STM32 restarts", evidence, todo)
    if heard.stm32_resets:
        evidence = f"{times(heard.stm32_resets)} a new epoch began, with the numbers of the messages going on"
        todo = "Set usec.reset once, before a recording, or never. Times of two epochs must not be mixed."
        yield Finding("STM32", "warning", "stm32_clock_reset", "the STM32's clock is set back", evidence, todo)


def spi(heard: Listening) -> Iterator[Finding]:
    errors = heard.gap8.grown["spi_errors"], heard.esp32.grown["spi_errors"]
    causes = ["missing_data", "bad_crc", "overrun"]
    if heard.numbered and not heard.esp32.grown["frames_dropped"]:
        causes.append("unexplained")  # else: the ESP32's next status will say
    broken = {cause: count(heard, cause) for cause in causes if count(heard, cause)}
    cut = heard.esp32.grown["frames_cut"]
    # A frame that is under way when an MCU restarts is lost to that. Behind SPI is TCP, whose checksums let nothing
    # through: without garbage the damage is older.
    excused = heard.gap8_restarts + heard.gap8_forgot + len(heard.ends)
    lost = max(cut, 0 if heard.garbage_bytes else sum(broken.values())) - excused
    if sum(errors) + max(0, lost) >= 2:
        evidence = f"{errors[0]} bad windows at the GAP8, {errors[1]} at the ESP32, {cut} frames cut short there"
        evidence += "".join(f", {number} {cause} here" for cause, number in broken.items())
        todo = "Seat the AI-deck anew. In other firmware: a slower SPI clock (10 MHz is what is tried)."
        yield Finding(
            "SPI", "problem", "spi_damage", "packets between GAP8 and ESP32 are lost or damaged", evidence, todo
        )
    late = heard.gap8.grown["captures_late"]
    if late > LOST_SHARE * (late + heard.gap8.grown["frame"]):
        evidence = f"{late} captures were left out of {late + heard.gap8.grown['frame']}: no buffer was free"
        todo = "Ask for fewer or smaller frames (host deck camera), or JPEG; or a faster SPI clock in the firmware."
        yield Finding(
            "SPI", "warning", "spi_slow", "the GAP8 takes frames faster than SPI carries them", evidence, todo
        )


def uart2(heard: Listening) -> Iterator[Finding]:
    names = ("uart_bad_check", "uart_bad_length", "uart_garbage_bytes", "uart_gaps")
    ours = heard.counters
    at_host = ours.bad_check + ours.bad_length + ours.gaps + heard.garbage_bytes if heard.framing == "cpx-uart" else 0
    counted = {name: heard.esp32.grown[name] for name in names if heard.esp32.grown[name]}
    if counted or at_host:
        evidence = ", ".join(f"{number} {name}" for name, number in counted.items()) + " at the ESP32" * bool(counted)
        evidence += f"{', ' if counted else ''}{at_host} bad frames and bytes here" if at_host else ""
        todo = "Reseat the decks. Is the rate the same at both ends? 576000 Bd, before mid-2022 115200."
        yield Finding("UART2", "problem", "uart2_damage", "what comes over UART2 is damaged", evidence, todo)
    dropped = heard.esp32.grown["packets_dropped"]
    if dropped:
        todo = "Something sends more than its receiver takes: CRTP logging at too high a rate?"
        evidence = f"{dropped} packets other than images"
        yield Finding("ESP32", "warning", "esp32_drops", "the ESP32 drops packets for want of room", evidence, todo)


def wireless(heard: Listening) -> Iterator[Finding]:
    ours, theirs = heard.garbage_bytes, heard.esp32.grown["tcp_skipped_bytes"]
    if heard.framing != "tcp":
        return
    if (ours or theirs) and ours <= heard.counters.bytes / 2:
        evidence = f"{ours} bytes here and {theirs} at the ESP32 are no part of a packet"
        todo = "TCP's checksum missed it: look at the ESP32's firmware, and at what is between (a relay, a cable)."
        yield Finding("Wi-Fi", "problem", "tcp_damage", "the connection changes or loses bytes", evidence, todo)
    dropped = heard.esp32.grown["frames_dropped"]
    if host_is_slow(heard):
        return
    stalls = stalls_s(heard)
    if len(stalls) >= RARE or sum(stalls) > 1:
        evidence = f"{times(len(stalls))}, up to {max(stalls):.1f} s; {dropped} frames were dropped"
        todo = "Another channel, less distance; no power saving here (Linux: iw dev wlan0 set power_save off)."
        yield Finding("Wi-Fi", "problem", "wifi_stalls", "the connection stands still again and again", evidence, todo)
    elif dropped > LOST_SHARE * (dropped + len(heard.frames)):
        rate = sum(size for _, size, _ in heard.frames) / max(heard.seconds, 1e-9)
        evidence = f"it carries {rate / 1000:.0f} kB/s; {dropped} frames of {dropped + len(heard.frames)} were dropped"
        todo = "JPEG, fewer or smaller frames (host deck camera), another channel, less distance."
        yield Finding("Wi-Fi", "warning", "wifi_slow", "the connection is slower than the camera", evidence, todo)


def this_host(heard: Listening) -> Iterator[Finding]:
    if host_is_slow(heard):
        total = heard.busy_ns + heard.waited_ns
        evidence = f"busy for {heard.busy_ns / total:.0%} of the time: bytes wait for it, it never waits for them"
        todo = "Close what else runs, write to a faster disk, show fewer pictures; or let the robot send fewer frames."
        yield Finding("host", "problem", "host_slow", "this computer does not read fast enough", evidence, todo)


def not_to_be_seen(heard: Listening) -> Iterator[Finding]:
    counters = heard.counters
    if heard.framing == "stamps" or not heard.frames or heard.numbered:
        return
    lost = {cause: number for cause, number in counters.frames_lost.items() if number and cause != "disconnected"}
    skipped = lost.pop("unexplained", 0)
    if skipped > LOST_SHARE * (skipped + len(heard.frames)):
        evidence = f"the sensor counted {skipped} frames more than the {len(heard.frames)} that came"
        todo = "Fewer or smaller frames, another channel, less distance: GAP8, SPI or Wi-Fi cannot carry them all."
        yield Finding("Wi-Fi", "warning", "frames_skipped", "frames are left out", evidence, todo)
    if sum(lost.values()) >= RARE:
        evidence = ", ".join(f"{number} {cause}" for cause, number in lost.items())
        todo = "Firmware that speaks native would say where: GAP8, SPI, ESP32 or Wi-Fi."
        yield Finding("SPI", "problem", "frames_broken", "frames lose pieces on their way", evidence, todo)
    slow = stalls_s(heard)
    if slow:
        evidence = f"{len(slow)} pauses of up to {max(slow):.1f} s"
        todo = "The camera, the ESP32 or the Wi-Fi: firmware that speaks native would say which."
        yield Finding("Wi-Fi", "warning", "pauses", "the stream pauses", evidence, todo)
    what, evidence = UNSEEN[heard.spoken]
    todo = "Use this project's firmware."
    if heard.announced:
        refused = heard.dialect != "stock"
        evidence = "it announced native, and did not answer" if refused else "this firmware would send both"
        todo = "Do requests reach the GAP8? See SPI." if refused else "Listen without --dialect stock."
    yield Finding("robot", "note", heard.spoken, what, evidence, todo)


RULES = (silence, camera, restarts, time_wire, clocks, spi, uart2, wireless, this_host, card_log, not_to_be_seen)


def times(number: int) -> str:
    return "once" if number == 1 else f"{number} times"


def count(heard: Listening, cause: str) -> int:
    return heard.counters.frames_lost.get(cause, 0)


def capture_period_us(heard: Listening) -> float:
    """GAP8 time from frame to frame, on average, where none failed."""
    whole = [(numbers, us) for numbers, us, failed in heard.captures if numbers and not failed]
    return sum(us for _, us in whole) / sum(numbers for numbers, _ in whole) if whole else 0.0


def host_is_slow(heard: Listening) -> bool:
    return heard.busy_ns > BUSY_SHARE * (heard.busy_ns + heard.waited_ns) > 0


def stalls_s(heard: Listening) -> list[float]:
    """How long the stream stood still, each time that it did and the camera does not explain it."""
    usual_ns = float(np.median([gap_ns for gap_ns, _ in heard.gaps])) if heard.gaps else 0.0
    return [
        gap_ns / NS
        for gap_ns, by_camera_ns in heard.gaps
        if gap_ns > 2 * usual_ns and gap_ns - max(by_camera_ns, usual_ns) > STALL_S * NS
    ]
