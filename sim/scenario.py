"""Scenarios: TOML files and URLs into one frozen Scenario. Unknown keys and impossible values are refused here."""

from __future__ import annotations

import difflib
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Any, Literal
from urllib.parse import parse_qsl, unquote, urlsplit

from host.protocol.errors import LocalError
from host.protocol.typed import integer, real

from .keys import IMPOSSIBLE, SETTINGS, TABLES, Setting, plain
from .possible import check_general, check_robot
from .settings import CONFIGS, General, RobotSettings, Scalar

# The module object, not its name: another project's `sim` may be the one of that name when a scenario is read.
_PACKAGE = sys.modules[__package__]

Value = Scalar | list[Scalar]
TYPED: dict[type, Callable[[str], Scalar]] = {int: integer, float: real, str: str}
PATHS = {"camera_path", "usd_config", "usd_image"}


@dataclass(frozen=True)
class Scenario:
    name: str
    """Of a built-in scenario, or the path of a TOML file."""
    seed: int
    robot: int
    pace: Literal["real", "max"]
    general: General
    """These and the other keys above all tables."""
    robots: tuple[RobotSettings, ...]
    values: Mapping[str, Value]
    """Every key with its value, JSON-able: Scenario.of(name, values) makes the same one again."""

    @classmethod
    def of(cls, name: str, values: Mapping[str, Value]) -> Scenario:
        """LocalError when a value is impossible."""
        resolved: dict[str, Value] = {key: setting.default for key, setting in SETTINGS.items()}
        for key, value in values.items():
            resolved[key] = checked(find(key), value)
        top: dict[str, Any] = {each.name: resolved[each.name] for each in fields(General)}
        general = General(**top)
        robots = tuple(_robot(resolved, index, general.robots) for index in range(general.robots))
        for robot in robots:
            check_robot(robot)
        check_general(general, robots)
        return cls(name, general.seed, general.robot, general.pace, general, robots, resolved)

    def changed(self, overrides: Mapping[str, object]) -> Scenario:
        """With these keys set anew."""
        if not overrides:
            return self
        return Scenario.of(
            self.name, {**self.values, **{find(key).name: checked(find(key), each) for key, each in overrides.items()}}
        )


def names() -> list[str]:
    """The built-in scenarios."""
    folder = resources.files(_PACKAGE).joinpath("scenarios")
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load(name: str = "hover", **overrides: object) -> Scenario:
    """A built-in scenario, or a TOML file if `name` ends in .toml, with some keys set anew."""
    if name.endswith(".toml"):
        try:
            source = Path(name).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise LocalError(f"scenario {name}: {error}") from error
    else:
        if name not in names():
            raise LocalError(
                f"no scenario {name!r}{near(name, names())}; there are {', '.join(names())}, or a path ending in .toml"
            )
        source = resources.files(_PACKAGE).joinpath("scenarios", f"{name}.toml").read_text(encoding="utf-8")
    values = parse_toml(source, name)
    for key in PATHS & values.keys() if name.endswith(".toml") else ():
        values[key] = _beside(Path(name), values[key])
    # Together: what is impossible in the file alone may be possible with what is set anew.
    values |= {find(key).name: checked(find(key), value) for key, value in overrides.items()}
    return Scenario.of(name, values)


def _beside(scenario: Path, value: Value) -> Value:
    """Paths in a scenario file start at its folder."""
    if isinstance(value, list):
        return [str(_beside(scenario, each)) for each in value]
    return value if value == "" or value in CONFIGS else str(scenario.parent / str(value))


def parse_toml(source: str, name: str) -> dict[str, Value]:
    """The keys that the text sets."""
    try:
        tables = tomllib.loads(source)
    except tomllib.TOMLDecodeError as error:
        raise LocalError(f"scenario {name}: {error}") from error
    values: dict[str, Value] = {}
    for key, value in _flat(tables):
        setting = find(key)
        if setting.name in values:
            raise LocalError(f"scenario {name}: {setting.name} is given twice")
        values[setting.name] = checked(setting, value)
    return values


def parse_url(url: str) -> tuple[str, dict[str, Value]]:
    """sim://SCENARIO?key=value&... as name and overrides. A list is written with commas."""
    try:
        parts = urlsplit(url)
        pairs = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
    except ValueError as error:
        raise LocalError(f"{url}: {error}; it should read sim://SCENARIO?key=value&key=value") from error
    if parts.scheme.lower() != "sim" or parts.fragment:
        raise LocalError(f"{url}: it should read sim://SCENARIO?key=value&key=value")
    values: dict[str, Value] = {}
    for key, text in pairs:
        setting = find(key)
        if setting.name in values:
            raise LocalError(f"{url}: {key} is given twice")
        listed = setting.per_robot and (setting.kind is not str or setting.choices)  # a path may have commas
        items = text.split(",") if listed else [text]
        converted = [_from_text(setting, item) for item in items]
        values[setting.name] = checked(setting, converted if len(converted) > 1 else converted[0])
    return unquote(parts.netloc + parts.path).rstrip("/") or "hover", values


def from_url(url: str) -> Scenario:
    name, values = parse_url(url)
    return load(name, **values)


def find(key: str) -> Setting:
    """LocalError when there is no such key, with the nearest one that there is."""
    if key in IMPOSSIBLE:
        raise LocalError(f"{key} is not possible: {IMPOSSIBLE[key]}")
    key = "camera_path" if key == "camera" else key
    if key not in SETTINGS:
        raise LocalError(f"no scenario key {key!r}{near(key, list(SETTINGS))}; docs/SCENARIOS.md lists them all")
    return SETTINGS[key]


def near(word: str, words: list[str]) -> str:
    match = difflib.get_close_matches(word, words, n=1)
    return f": did you mean {match[0]}?" if match else ""


def checked(setting: Setting, value: object) -> Value:
    """The value as the key's type, or LocalError with the key and what is allowed."""
    if isinstance(value, list | tuple):
        if not setting.per_robot:
            raise LocalError(f"{setting.name}: one value, not a list")
        return [_checked_scalar(setting, each) for each in value]
    return _checked_scalar(setting, value)


def _checked_scalar(setting: Setting, value: object) -> Scalar:
    if setting.kind is float and type(value) is int:
        value = float(value)
    refusal = LocalError(f"{setting.name}={value}: allowed is {setting.allowed}")
    # An exact type: True is an int to isinstance.
    if type(value) is not setting.kind:
        raise refusal
    if setting.choices:
        if value not in setting.choices:
            raise refusal
    elif isinstance(value, int | float) and not setting.low <= value <= setting.high:
        raise refusal
    return value


def _from_text(setting: Setting, text: str) -> Scalar:
    try:
        return TYPED[setting.kind](text)
    except ValueError:
        raise LocalError(f"{setting.name}={text}: allowed is {setting.allowed}") from None


def _flat(tables: Mapping[str, Any]) -> Iterator[tuple[str, object]]:
    for key, value in tables.items():
        if isinstance(value, dict):
            for inner, each in value.items():
                yield f"{key}_{inner}", each
        else:
            yield key, value


def _robot(values: Mapping[str, Value], index: int, count: int) -> RobotSettings:
    """Its settings: of a list, its own value."""
    tables: dict[str, dict[str, Scalar]] = {}
    for setting in SETTINGS.values():
        if not setting.per_robot:
            continue
        value = values[setting.name]
        if isinstance(value, list):
            if len(value) < count:
                raise LocalError(f"{setting.name}: {len(value)} values for robots={count}; give one, or one for each")
            value = value[index]
        tables.setdefault(setting.table, {})[setting.field] = value
    top: dict[str, Any] = dict(tables.pop(""))
    for name, table in tables.items():
        top[name] = TABLES[name](**table)
    return RobotSettings(**top)


def markdown() -> str:
    """docs/SCENARIOS.md."""
    lines = [
        "# Scenarios",
        "",
        "A scenario describes a simulated world: `sim://NAME?key=value&key=value`, a keyword argument of",
        "`spindeck_world` and `spindeck_robot`, or a TOML file (`sim://path/to/file.toml`).",
        f"Built in: {', '.join(f'`{name}`' for name in names())} (sim/scenarios/).",
        "",
        "In TOML the part before the first underscore is a table: `gap8_ppm=80` is `ppm = 80` under `[gap8]`; keys in",
        "the first table below stand above all tables. A key of a robot may have a list, one value for each robot:",
        "`ppm = [12, -40]`, in a URL `gap8_ppm=12,-40`; values for robots that do not fly are not used.",
        "`camera=PATH` is short for `camera_path=PATH`; in a file, paths start at the file's folder.",
        "Anything else is refused. This page is made by `python -m sim.scenario`.",
    ]
    table: str | None = None
    for setting in SETTINGS.values():
        if setting.table != table:
            table = setting.table
            lines += ["", f"## {f'[{table}]' if table else 'Above all tables'}", ""]
            lines += ["| key | allowed | default | meaning |", "|---|---|---|---|"]
        default = plain(setting.default) if isinstance(setting.default, int | float) else setting.default
        allowed = setting.allowed.replace("|", "\\|")
        lines.append(f"| `{setting.name}` | {allowed} | {default or '(none)'} | {setting.meaning} |")
    lines += ["", "Not possible:", "", *(f"- `{key}`: {why}." for key, why in IMPOSSIBLE.items()), ""]
    return "\n".join(lines)


if __name__ == "__main__":
    print(markdown(), end="")
