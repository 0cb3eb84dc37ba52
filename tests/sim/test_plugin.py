"""The pytest plugin in projects of other people: one that has its own `sim` and `host`, and one that has not."""

import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run_pytest(folder, tests, *options):
    """Runs the files in a fresh interpreter, as a user of the installed package would. Returns its result."""
    for name, text in tests.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(textwrap.dedent(text))
    # The folder of this checkout stands last, as site-packages would.
    path = os.pathsep.join([str(folder), str(ROOT)])
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "spindeck_pytest", *options],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


THEIR_OWN = {
    "sim/__init__.py": "WHOSE = 'theirs'\n",
    "sim/world.py": "WHOSE = 'theirs'\n",
    "sim/later.py": "import host\nWHOSE = host.WHOSE\n",
    "host/__init__.py": "WHOSE = 'theirs'\n",
    "host/native.py": "WHOSE = 'theirs'\n",
}


def test_beside_their_own_host_and_sim(tmp_path):
    result = run_pytest(
        tmp_path,
        {
            **THEIR_OWN,
            "tests/test_theirs.py": """
                import sys
                import sim.world as their_world

                def test_robot(spindeck_robot):
                    path = list(sys.path)
                    before = {name for name in sys.modules if name.split(".")[0] in ("host", "sim")}
                    robot = spindeck_robot("hover", gap8_ppm=80, seed=7)
                    assert len(robot.run(seconds=3)) > 20
                    assert robot.frames[-1].pixels.shape == (244, 324)
                    assert abs(robot.stamp_errors_us).max() < 100_000
                    assert {name for name in sys.modules if name.split(".")[0] in ("host", "sim")} == before
                    assert sys.path == path

                def test_theirs_before_and_after():
                    assert their_world.WHOSE == "theirs"
                    import host.native
                    import sim.later
                    assert host.native.WHOSE == sim.later.WHOSE == sys.modules["host"].WHOSE == "theirs"

                def test_world(spindeck_world):
                    world = spindeck_world("swarm", robots=2)
                    a, b = world.listen(0), world.listen(1)
                    world.run(2)
                    assert a.frames and b.frames
                    jpeg = spindeck_world("lossy", camera_encoding="jpeg").listen()
                    jpeg.run(3)
                    jpeg.set_faults("tcp", loss=0.5)
                    jpeg.reboot("gap8")
                    jpeg.run(3)
                    assert jpeg.frames[0].pixels.shape == (244, 324)
                    assert type(jpeg.world).replay(jpeg.world.log).now_ns == jpeg.world.now_ns

                def test_errors_name_the_key(spindeck_robot):
                    try:
                        spindeck_robot(gap8_pmm=80)
                    except Exception as error:
                        assert "did you mean gap8_ppm?" in str(error)
                    else:
                        raise AssertionError
            """,
        },
        "-q",
    )
    assert "4 passed" in result.stdout, result.stdout + result.stderr


def test_real_images_beside_their_own_host_and_sim(tmp_path):
    pytest.importorskip("unicorn", reason="Unicorn is not installed")
    pytest.importorskip("elftools", reason="pyelftools is not installed")
    if not (shutil.which("arm-none-eabi-gcc") and shutil.which("riscv64-unknown-elf-gcc")):
        pytest.skip("no compilers for the STM32 and the GAP8")
    result = run_pytest(
        tmp_path,
        {
            **THEIR_OWN,
            "test_images.py": """
                import sim.world as their_world

                def test_robot(spindeck_robot, monkeypatch, tmp_path):
                    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # so that it is built
                    robot = spindeck_robot("hover", backend="emulated", toolchain="gcc", seed=7)
                    assert robot.backends == {"stm32": "emulated", "gap8": "emulated", "esp32": "native"}
                    assert len(robot.run(seconds=2)) > 10
                    assert robot.stm32["stamps_sent"] == 200
                    assert robot.gap8["frames_sent"] > 10
                    assert their_world.WHOSE == "theirs"
            """,
        },
        "-q",
    )
    assert "1 passed" in result.stdout, result.stdout + result.stderr


def test_with_ours_imported_first(tmp_path):
    result = run_pytest(
        tmp_path,
        {
            "test_ours.py": """
                import sys
                import host.link.frame

                def test_robot(spindeck_robot):
                    frame = spindeck_robot().run(2)[0]
                    assert isinstance(frame, host.link.frame.Frame)
                    assert "sim" not in sys.modules

                def test_sim_too(spindeck_world):
                    import sim.world
                    assert sim.world.World("hover").seconds == 0.0
            """
        },
        "-q",
    )
    assert "2 passed" in result.stdout, result.stdout + result.stderr


def test_nothing_is_imported_until_a_fixture_is_used(tmp_path):
    result = run_pytest(
        tmp_path,
        {
            "test_none.py": """
                import sys

                def test_none():
                    assert "spindeck_pytest" in sys.modules
                    ours = [name for name in sys.modules if name.split(".")[0] in ("host", "sim", "numpy", "cffi")]
                    assert not ours
            """
        },
        "-q",
    )
    assert "1 passed" in result.stdout, result.stdout + result.stderr


def test_a_failure_says_how_to_run_it_again(tmp_path):
    tests = {
        "test_failing.py": """
            def test_default(spindeck_robot):
                robot = spindeck_robot("hover", uart1_loss=0.5)
                robot.run(2)
                assert robot.gap8["stamps_missed"] == -1

            def test_chosen(spindeck_world):
                spindeck_world("swarm", seed=9).run(1)
                assert False

            def test_without():
                assert False
        """
    }
    first = run_pytest(tmp_path, tests, "-q").stdout
    assert "hover, seed 1\nagain: pytest 'test_failing.py::test_default' --spindeck-seed=1\n" in first
    assert "swarm, seed 9\nagain: pytest 'test_failing.py::test_chosen'\n" in first
    assert first.count("- spindeck -") == 2

    def missed(*options):
        output = run_pytest(tmp_path, {}, "-q", "test_failing.py::test_default", *options).stdout
        (line,) = [line for line in output.splitlines() if line.startswith("E       assert ") and "== -1" in line]
        return line

    assert missed() == missed("--spindeck-seed=1")
    assert missed("--spindeck-seed=1") != missed("--spindeck-seed=5")


def test_worlds_are_closed_after_the_test(tmp_path):
    result = run_pytest(
        tmp_path,
        {
            "test_closed.py": """
                import pytest

                kept = []

                def test_one(spindeck_world):
                    kept.append(spindeck_world())
                    kept[0].run(1)

                def test_two():
                    assert kept[0].closed
                    with pytest.raises(Exception, match="closed"):
                        kept[0].run(1)
            """
        },
        "-q",
    )
    assert "2 passed" in result.stdout, result.stdout + result.stderr


def test_the_fixtures_are_documented(tmp_path):
    output = run_pytest(tmp_path, {"test_nothing.py": ""}, "--fixtures").stdout
    assert "spindeck_world" in output
    assert "Start a robot and listen" in output


def test_the_plugin_is_registered():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert '[project.entry-points.pytest11]\nspindeck = "spindeck_pytest"' in text
    assert 'py-modules = ["spindeck_pytest"]' in text
