"""What host doctor knows about the log on the STM32's card: whether it is complete, and what ended it. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from .finding import Finding
from .listening import Listening

ENDS = {
    "full": (
        "card_full",
        "the card is full: nothing is logged any more",
        "Another card, or take old logs off this one.",
    ),
    "failed": (
        "card_fails",
        "the card takes no log any more",
        "Copy what is on it (host usd check names damage), then format it, or take another one.",
    ),
    "no_name": ("no_log_name", "all hundred names are taken: nothing is logged", "Take old logs off the card."),
    "bad_config": ("bad_config", "config.txt says nothing that can be logged", "host usd config check says why."),
    "no_card": ("card_gone", "the card is gone in the middle of a log", "Is it seated firmly? Look at its contacts."),
}
"""By the state in which a log has ended by itself: cause, what, todo."""


def card_log(heard: Listening) -> Iterator[Finding]:
    logs = [log.counters for session, log in heard.logs.items() if session]
    dropped, requested = sum(log["dropped"] for log in logs), sum(log["requested"] for log in logs)
    stall_ms = max((log["stall_us"] for log in logs), default=0) / 1000
    if dropped:
        evidence = f"{dropped} of {requested} rows are not in it; the card's longest pause was {stall_ms:.0f} ms"
        todo = "host usd config check says how long a pause its ring survives: a larger ring, fewer rows, another card."
        yield Finding("card", "problem", "log_drops", "the log on the card drops rows", evidence, todo)
    errors = max((log["card_errors"] for log in logs), default=0)
    if heard.log is not None and heard.log.state in ENDS and (heard.log.session or heard.log.state != "no_card"):
        cause, what, todo = ENDS[heard.log.state]
        evidence = f"logs begun since boot: {heard.log.files}; operations that failed: {errors}"
        yield Finding("card", "problem", cause, what, evidence, todo)
    elif errors:
        evidence = f"{errors} operations failed, and the log goes on"
        todo = "Copy what is on it, and take another card. Does another one fail too? Look at the deck's contacts."
        yield Finding("card", "problem", "card_errors", "the card reports errors", evidence, todo)
