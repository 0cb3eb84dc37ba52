"""`host sim serve` and `host ports` as a user meets them."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from sim.serial import registry
from sim.world import World

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def runtime(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    return tmp_path


def host(*words):
    return subprocess.run([sys.executable, "-m", "host", *words], capture_output=True, text=True, timeout=120)


@contextlib.contextmanager
def serving(*words, ending=signal.SIGINT):
    """The program, its first line read; ended with Ctrl-C."""
    program = subprocess.Popen(
        [sys.executable, "-m", "host", "sim", "serve", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        program.first = program.stdout.readline().strip()
        yield program
    finally:
        program.send_signal(ending)
        program.rest, program.said = program.communicate(timeout=60)


def test_served_listed_streamed_and_ended_with_ctrl_c(runtime):
    log = runtime / "run.json"
    with serving("--listen", "127.0.0.1:0", "--seed", "7", "--pace", "max", "--log", str(log)) as program:
        port = program.first
        assert port.startswith("socket://127.0.0.1:")
        listed = [json.loads(line) for line in host("ports", "--timeout", "0").stdout.splitlines()]
        assert [each for each in listed if each["kind"] == "simulator"] == [
            {"event": "port", "kind": "simulator", "port": port, "scenario": "hover", "robot": 0, "wire": "tcp",
             "firmware": "native", "pid": program.pid}
        ]  # fmt: skip
        streamed = host("stream", "--port", port, "--count", "4")
        assert streamed.returncode == 0, streamed.stderr
    assert program.returncode == 0
    lines = program.said.splitlines()
    assert lines[0].startswith("serving 1 robot of hover (native firmware)")
    assert "has come" in lines[1]
    assert lines[-1].startswith("served ")
    assert "1 clients, 0 refused" in lines[-1]
    assert not list((runtime / "spindeck").iterdir()), "its file has gone with it"
    with World.replay(json.loads(log.read_text())) as again:
        assert again.robots[0].esp32["frames_forwarded"] >= 4
    again = host("sim", "serve", "--listen", "127.0.0.1:0", "--log", str(log))
    assert (again.returncode, again.stderr) == (2, f"host: {log}: exists, and is not overwritten: name another file\n")


def test_a_server_that_never_was_leaves_no_log(runtime):
    for _ in range(2):
        result = host("sim", "serve", "--listen", "192.0.2.1:5000", "--log", str(runtime / "run.json"))
        assert "no address of this computer" in result.stderr
    assert not list(runtime.glob("run.json*"))


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_json(runtime, ending):
    with serving("--listen", "127.0.0.1:0", "--scenario", "swarm", "--json", ending=ending) as program:
        pass
    assert program.returncode == 0
    first, *_, last = [json.loads(line) for line in [program.first, *program.rest.splitlines()]]
    assert [robot["firmware"] for robot in first["robots"]] == ["native"] * 4
    assert last["event"] == "summary"
    assert last["clients"] == 0


def test_the_whole_network_only_when_asked_and_said(runtime):
    with serving("--listen", "0.0.0.0:0") as program:
        assert program.first.startswith("socket://127.0.0.1:"), "what a client on this computer opens"
    assert "every computer in your networks can connect" in program.said


def test_consecutive_ports(runtime):
    with serving("--listen", "127.0.0.1:0") as taken:
        port = int(taken.first.rpartition(":")[2])
        result = host("sim", "serve", "--listen", f"127.0.0.1:{port - 1}", "robots=2")
        assert result.returncode == 2
        assert f"127.0.0.1:{port}" in result.stderr or f"127.0.0.1:{port - 1}" in result.stderr
        assert "in use" in result.stderr


def test_a_serial_port(runtime):
    with serving("--pty", "camera_encoding=jpeg") as program:
        streamed = host("stream", "--port", program.first, "--count", "2")
        assert streamed.returncode == 0, streamed.stderr


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--listen", "5000"], "write ADDRESS:PORT"),
        (["--listen", "192.0.2.1:5000"], "no address of this computer"),
        (["--pty", "wire=tcp"], "use --listen"),
        (["--pty", "--pace", "max"], "credit"),
        (["--pty", "--announce"], "leave out --pty"),
        (["robot=1"], "robots="),
        (["--seed", "3", "seed=4"], "seed is given twice"),
        (["gap8_pmm=3"], "gap8_ppm"),
        (["nonsense"], "KEY=VALUE"),
        (["--dialect", "nonsense"], "native"),
        (["--scenario", "hoover"], "hover"),
        (["--camera", "/no/such/folder"], "/no/such/folder"),
        (["--log", "/no/such/folder/log"], "/no/such/folder/log: No such file"),
    ],
)
def test_wrong_input_is_told_in_one_line(words, says, runtime):
    result = host("sim", "serve", *words)
    assert result.returncode == 2
    assert says in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_simulators_that_died_are_recognised_by_their_process(runtime):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    folder = registry.folder()
    folder.mkdir()
    robots = [{"port": "socket://127.0.0.1:5000", "wire": "tcp", "firmware": "native"}]
    simulator = {"scenario": "hover", "robots": robots}
    (folder / "1.json").write_text(json.dumps({"pid": dead.pid, "born": "5", **simulator}))
    (folder / "2.json").write_text(json.dumps({"pid": os.getpid(), "born": "another's", **simulator}))
    (folder / "3.json").write_text("{")
    with registry.entered("hover", robots):
        assert registry.running() == [{"pid": os.getpid(), **simulator}]
        assert len(list(folder.iterdir())) == 1, "the stale ones are removed"
    assert registry.running() == []


def test_a_folder_that_cannot_be_written_is_no_reason_not_to_serve(runtime, monkeypatch):
    (runtime / "file").touch()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime / "file"))
    with registry.entered("hover", []):
        assert registry.running() == []


def mdns_works():
    from zeroconf import Zeroconf

    try:
        Zeroconf(interfaces=["127.0.0.1"]).close()
    except OSError:
        return False
    return True


@pytest.mark.skipif(not mdns_works(), reason="this machine's loopback takes no multicast")
def test_announced_and_found_on_the_network(runtime):
    with serving("--listen", "127.0.0.1:0", "--announce", "robots=2") as program:
        ports = {program.first, program.stdout.readline().strip()}
        found = {}
        for _ in range(10):  # until it is there: the network takes its time
            listed = [json.loads(line) for line in host("ports", "--timeout", "2").stdout.splitlines()]
            found = {each["port"]: each for each in listed if each["kind"] == "deck" and each["port"] in ports}
            if set(found) == ports:
                break
    assert set(found) == ports
    assert {each["about"] for each in found.values()} == {"simulated: hover, robot 0", "simulated: hover, robot 1"}
    assert all(each["name"].startswith("aideck-") for each in found.values())
