"""Scenarios: what the files and URLs mean, and every refusal with the key and what is allowed."""

import dataclasses
import json
from pathlib import Path

import pytest

from host.protocol.errors import LocalError
from sim import scenario
from sim.keys import SETTINGS

ROOT = Path(__file__).resolve().parents[2]


def test_url_overrides_the_file():
    made = scenario.from_url("sim://hover?gap8_ppm=80&uart1_loss=0.2&seed=7&pace=max")
    assert (made.name, made.seed, made.pace, made.robot) == ("hover", 7, "max", 0)
    (robot,) = made.robots
    assert robot.gap8.ppm == 80.0
    assert robot.uart1.loss == 0.2
    assert robot.uart1.jitter_us == 200.0, "of hover.toml"
    assert robot.spi.hz == 10_000_000, "default"


def test_no_name_is_hover():
    assert scenario.from_url("sim://").robots == scenario.load("hover").robots
    assert scenario.from_url("sim://hover/").name == "hover"


@pytest.mark.parametrize("name", scenario.names())
def test_built_in_scenarios_load_and_survive_json(name):
    made = scenario.load(name)
    again = scenario.Scenario.of(name, json.loads(json.dumps(dict(made.values))))
    assert again == made


def test_built_in_names():
    assert scenario.names() == ["hover", "lossy", "nanocockpit", "paper", "stock", "swarm"]


def test_a_list_is_one_value_per_robot():
    made = scenario.load("swarm")
    assert [robot.stm32.ppm for robot in made.robots] == [0, 54, 237, -120]
    two = scenario.from_url("sim://hover?robots=2&gap8_ppm=12,-40")
    assert [robot.gap8.ppm for robot in two.robots] == [12, -40]
    assert len(scenario.load("swarm", robots=2).robots) == 2
    with pytest.raises(LocalError, match="stm32_ppm: 4 values for robots=5"):
        scenario.load("swarm", robots=5)
    with pytest.raises(LocalError, match="seed: one value, not a list"):
        scenario.load("hover", seed=[1, 2])


REFUSED = [
    ("gap8_pmm=80", "no scenario key 'gap8_pmm': did you mean gap8_ppm?"),
    ("zzz=1", "no scenario key 'zzz'; docs/SCENARIOS.md"),
    ("gap8_ppm=30000", "gap8_ppm=30000.0: allowed is -20000 .. 20000 ppm"),
    ("gap8_ppm=nan", "gap8_ppm=nan: allowed is -20000 .. 20000 ppm"),
    ("gap8_ppm=inf", "gap8_ppm=inf: allowed"),
    ("gap8_ppm=", "gap8_ppm=: allowed"),
    ("gap8_ppm=1_0", "gap8_ppm=1_0: allowed"),
    ("seed=\uff11", "seed=\uff11: allowed"),
    ("gap8_ppm=fast", "gap8_ppm=fast: allowed"),
    ("gap8_ppm=1&gap8_ppm=2", "gap8_ppm is given twice"),
    ("camera=a&camera_path=b", "camera_path is given twice"),
    ("seed=1.5", "seed=1.5: allowed is 0 .. 18446744073709551615"),
    ("seed=-1", "seed=-1: allowed"),
    ("uart1_loss=1.01", "uart1_loss=1.01: allowed is 0 .. 1"),
    ("wire=usb", "wire=usb: allowed is tcp | uart2 | uart1"),
    ("stm32_divider=86", "stm32_divider=86: allowed is 84 | 85"),
    ("gap8_divider=84", "gap8_divider is not possible: only the STM32"),
    ("tcp_reorder=0.1", "tcp_reorder is not possible: TCP delivers in order"),
    ("robots=2&robot=2", "robot=2: robots=2, so it may be 0 .. 1"),
    ("robots=0", "robots=0: allowed is 1 .. 256"),
    ("gap8_stamp_bits=32&gap8_stamp_start_us=4294967296", "gap8_stamp_start_us=4294967296: allowed is 0 .. 2^32 - 1"),
    ("camera_fps=30", "camera_fps=30: allowed is 0 .. 23.19, as 244 rows and 100 lines of exposure take 43.1 ms"),
    ("crtp_hz=0.0001", "crtp_hz=0.0001: allowed is 0, or 0.001 and more"),
    ("camera_fps=0.01", "camera_fps=0.01: allowed is 0, or 0.1 and more with camera_burst=1"),
    ("firmware=stock&wire=uart1", "wire=uart1 with firmware=stock"),
    ("firmware=nanocockpit&wire=uart2", "wire=uart2 with firmware=nanocockpit"),
    ("firmware=nanocockpit&camera_encoding=jpeg", "camera_encoding=jpeg with firmware=nanocockpit"),
    ("paper_floor=1", "paper_floor=1: allowed is yes | no"),
    ("gap8_ppm", "it should read sim://SCENARIO"),
]


@pytest.mark.parametrize(("query", "message"), REFUSED)
def test_refusals(query, message):
    with pytest.raises(LocalError) as error:
        scenario.from_url(f"sim://hover?{query}")
    assert message in str(error.value)


def test_every_number_has_its_range():
    for setting in SETTINGS.values():
        if setting.choices or setting.kind is str:
            continue
        assert setting.low <= setting.default <= setting.high
        for value in (setting.low - 1, setting.high + 1):
            with pytest.raises(LocalError) as error:
                scenario.load("hover", **{setting.name: setting.kind(value)})
            assert setting.name in str(error.value)
            assert setting.allowed in str(error.value)


def test_types_are_exact():
    for value in (True, "7", None, 7.0):
        with pytest.raises(LocalError, match="seed="):
            scenario.load("hover", seed=value)
    assert scenario.load("hover", gap8_ppm=3).robots[0].gap8.ppm == 3.0


def test_unknown_scenario_lists_those_there_are():
    with pytest.raises(LocalError) as error:
        scenario.load("hoover")
    message = "no scenario 'hoover': did you mean hover?; there are hover, lossy, nanocockpit, paper, stock, swarm, or"
    assert message in str(error.value)


def test_a_file(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('camera = "pictures"\n[gap8]\nppm = 5\n')
    made = scenario.from_url(f"sim://{file}?seed=3")
    assert made.seed == 3
    assert made.robots[0].gap8.ppm == 5.0
    assert made.robots[0].camera_path == str(tmp_path / "pictures"), "beside the file"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[gap8\n", "mine.toml"),
        ("[gap9]\nppm = 1\n", "no scenario key 'gap9_ppm': did you mean gap8_ppm?"),
        ("[gap8.x]\nppm = 1\n", "no scenario key 'gap8_x'"),
        ("gap8_ppm = 1\n[gap8]\nppm = 2\n", "gap8_ppm is given twice"),
        ("[gap8]\nppm = nan\n", "gap8_ppm=nan: allowed"),
        ("[gap8]\nppm = {a = 1}\n", "gap8_ppm={'a': 1}: allowed"),
    ],
)
def test_bad_files(tmp_path, text, message):
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(LocalError) as error:
        scenario.load(str(file))
    assert message in str(error.value)


def test_a_file_that_is_not_there():
    with pytest.raises(LocalError, match=r"nowhere/mine\.toml"):
        scenario.from_url("sim://nowhere/mine.toml")


def test_a_scenario_cannot_be_changed():
    made = scenario.load("hover")
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.robots[0].gap8.ppm = 1.0


def test_the_page_is_the_table():
    page = (ROOT / "docs" / "SCENARIOS.md").read_text(encoding="utf-8")
    assert page == scenario.markdown(), "run: python -m sim.scenario > docs/SCENARIOS.md"
