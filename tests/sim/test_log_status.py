"""The log on a simulated card, as a host hears of it over the image stream, and what host doctor makes of that."""

from itertools import pairwise
from typing import Any

import pytest

pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")

from doctor_cases import Case, listen

from host.link.diagnosis import diagnose
from host.link.listening import Listening
from host.link.ports import open_port
from host.link.records import Event, LogState, LogStatus
from host.link.rules_of_log import card_log
from host.link.session import Session
from host.usd.decode import decode
from sim.world import World

CARD: dict[str, Any] = {"camera_width": 64, "camera_height": 48, "usd_config": "full", "usd_size_mb": 64}
STALLS = {"usd_stall_p99_ms": 900, "usd_stall_max_ms": 3000}


def streamed(world: World, session: Session, seconds: float) -> list[Event]:
    robot, events = world.robots[0], []
    end_ns = world.now_ns + round(seconds * 1e9)
    robot.connect()
    while world.now_ns < end_ns:
        world.run_until(world.now_ns + 5_000_000)
        events += session.receive(robot.read(1 << 16), world.now_ns)
        robot.write(session.data_to_send())
    return events


def test_a_host_hears_every_second_what_is_in_the_log_by_then() -> None:
    with World("hover", seed=3, **CARD) as world:
        said = [event for event in streamed(world, Session(), 12) if isinstance(event, LogStatus)]
        robot = world.robots[0]
        robot.shut_down()
        world.run(2.0)
        assert robot.card is not None
        log = decode(robot.card.get("log00"))
    assert log.is_whole
    assert 10 <= len(said) <= 12
    stamps = [rows.stamp_us for name, rows in log.rows.items() if name != "log.status"]
    for status in said:
        assert (status.state, status.files, status.session) == ("on", 1, log.session)
        assert status.counters["accepted"] == sum(int((each <= status.stm32_us).sum()) for each in stamps)
        assert status.counters["requested"] == status.counters["accepted"]
        assert (status.counters["dropped"], status.counters["card_errors"]) == (0, 0)
    assert all(abs(later.stm32_us - before.stm32_us - 1_000_000) < 5000 for before, later in pairwise(said))
    assert said[-1].counters["syncs"] >= 35
    assert said[-1].counters["stall_us"] == max(status.counters["stall_us"] for status in said) > 50_000


def test_a_host_that_does_not_ask_hears_nothing_of_it() -> None:
    with World("hover", **CARD) as world:
        events = streamed(world, Session(dialect="stock"), 3)
        assert not [event for event in events if isinstance(event, LogStatus)]
        assert world.robots[0].esp32["packets_unsent"] == 0


def test_after_a_restart_of_the_stm32_there_is_another_log() -> None:
    with World("hover", **CARD) as world:
        session = Session()
        before = [event for event in streamed(world, session, 3) if isinstance(event, LogStatus)]
        world.robots[0].reboot("stm32", 0.3)
        after = [event for event in streamed(world, session, 8) if isinstance(event, LogStatus)]
    assert before[-1].session != after[-1].session
    assert len(after) >= 3
    assert after[-1].stm32_us < 9_000_000


def test_no_card_is_no_fault_and_is_said() -> None:
    port = open_port("sim://hover?pace=max&camera_width=64&camera_height=48")
    session, said = Session(), []
    while port.clock_ns() < 2_000_000_000:
        data = port.read(1)
        said += [e for e in session.receive(data or b"", port.clock_ns()) if isinstance(e, LogStatus)]
        port.write(session.data_to_send())
    port.close()
    assert {(status.state, status.files, status.session) for status in said} == {("no_card", 0, 0)}


@pytest.mark.parametrize(
    ("settings", "cause", "others"),
    [
        ({}, None, set()),
        ({"usd_config": "state"}, None, set()),
        (STALLS, "log_drops", set()),
        ({"usd_bad": 0.003, "usd_stall_ms": 0}, "card_errors", {"log_drops"}),
        ({"usd_free_mb": 1, "usd_stall_ms": 0}, "card_full", {"log_drops"}),
        ({"usd_remove_s": 6}, "card_gone", {"log_drops"}),
    ],
    ids=["nothing wrong", "nothing wrong, 250 Hz", "stalls", "bad sectors", "full", "pulled out"],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_the_doctor_names_what_is_wrong_with_the_log(
    settings: dict[str, Any], cause: str | None, others: set[str], seed: int
) -> None:
    found = diagnose(listen(Case("card", "card", ()), seed, 20, **CARD | settings)).findings
    named = {(finding.stage, finding.cause) for finding in found}
    assert named - {("card", other) for other in others} == ({("card", cause)} if cause else set())


@pytest.mark.parametrize(
    ("state", "cause"), [("failed", "card_fails"), ("no_name", "no_log_name"), ("bad_config", "bad_config")]
)
def test_the_doctor_names_what_has_ended_a_log(state: LogState, cause: str) -> None:
    heard = Listening()
    for second in range(3):
        counters = dict.fromkeys(("requested", "accepted", "dropped", "stall_us", "syncs", "errors", "card_errors"), 0)
        heard.take([LogStatus(second, state, second, 0, 0, 0, counters)])
    assert ("card", cause) in {(finding.stage, finding.cause) for finding in card_log(heard)}
