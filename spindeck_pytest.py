"""pytest fixtures with simulated robots: spindeck_robot, spindeck_world. See docs/SCENARIOS.md for what they take.

Nothing of spindeck is imported until a fixture is used. Its packages are called `host` and `sim`, and so may be some
of the project under test: ours are imported beside them and then leave sys.modules as it was.
"""

from __future__ import annotations

import contextlib
import importlib
import sys
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from sim.receiver import Receiver
    from sim.world import World

ROOT = Path(__file__).resolve().parent
PACKAGES = ("host", "sim")
STARTED = pytest.StashKey[list[tuple[Any, bool]]]()
"""Of a test: each of its worlds, and whether the test chose the seed."""

_loaded: dict[str, ModuleType] = {}


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.getgroup("spindeck").addoption(
        "--spindeck-seed", type=int, metavar="N", help="seed of simulated worlds whose test gives none (default 1)"
    )


@pytest.fixture
def spindeck_world(request: pytest.FixtureRequest) -> Iterator[Callable[..., World]]:
    """Start a simulated world: spindeck_world("swarm", robots=2, gap8_ppm=80) -> world with .robots, .run(seconds)."""
    with contextlib.ExitStack() as worlds:
        yield lambda scenario="hover", **settings: worlds.enter_context(_start(request, scenario, settings))


@pytest.fixture
def spindeck_robot(request: pytest.FixtureRequest) -> Iterator[Callable[..., Receiver]]:
    """Start a robot and listen: spindeck_robot("hover", gap8_ppm=80) -> robot with .run(seconds), .frames, .truth."""
    with contextlib.ExitStack() as worlds:

        def start(scenario: str = "hover", *, dialect: str = "native", **settings: object) -> Receiver:
            world = worlds.enter_context(_start(request, scenario, settings))
            return world.listen(world.scenario.robot, dialect)  # type: ignore[arg-type]

        yield start


def _start(request: pytest.FixtureRequest, scenario: str, settings: dict[str, object]) -> World:
    chosen = "seed" in settings
    seed = request.config.getoption("--spindeck-seed")
    if not chosen and seed is not None:
        settings = {**settings, "seed": seed}
    world: World = load("sim.world").World(scenario, **settings)
    request.node.stash.setdefault(STARTED, []).append((world, chosen))
    return world


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    started = item.stash.get(STARTED, [])
    if report.failed and started:
        lines = [f"{world.scenario.name}, seed {world.scenario.seed}" for world, _ in started]
        free = {world.scenario.seed for world, chosen in started if not chosen}
        option = "".join(f" --spindeck-seed={seed}" for seed in free)
        report.sections.append(("spindeck", "\n".join([*lines, f"again: pytest '{item.nodeid}'{option}"])))
    return report


def load(name: str) -> ModuleType:
    """Our module of that name, whatever `host` and `sim` mean to the project under test, before or after."""
    if name in _loaded:
        return _loaded[name]
    before = {key: module for key, module in sys.modules.items() if key.partition(".")[0] in PACKAGES}
    ours = {package for package in PACKAGES if package in before and _is_ours(package, before[package])}
    for key in before:
        if key.partition(".")[0] not in ours:
            del sys.modules[key]
    sys.path.insert(0, str(ROOT))
    try:
        _loaded[name] = importlib.import_module(name)
    finally:
        sys.path.remove(str(ROOT))
        for key in list(sys.modules):
            if key.partition(".")[0] in PACKAGES and key.partition(".")[0] not in ours:
                del sys.modules[key]
        sys.modules.update(before)
    return _loaded[name]


def _is_ours(package: str, module: ModuleType) -> bool:
    return [Path(path).resolve() for path in getattr(module, "__path__", [])] == [ROOT / package]
