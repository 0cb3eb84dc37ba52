"""Every scenario key by its name, made from the fields of sim.settings; and keys that there cannot be."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin, get_type_hints

from .settings import General, Number, RobotSettings, Scalar


@dataclass(frozen=True, slots=True)
class Setting:
    """One key."""

    name: str
    """As in a URL: `gap8_ppm`."""
    table: str
    """As in TOML; empty: above all tables."""
    field: str
    kind: type[int] | type[float] | type[str]
    default: Scalar
    choices: tuple[Scalar, ...]
    """Empty: a number within low..high, or any text."""
    low: Number
    high: Number
    unit: str
    meaning: str
    per_robot: bool

    @property
    def allowed(self) -> str:
        if self.choices:
            return " | ".join(str(value) for value in self.choices)
        if self.kind is str:
            return "any path"
        return f"{plain(self.low)} .. {plain(self.high)}{' ' if self.unit else ''}{self.unit}"


def plain(value: Number) -> str:
    """Without an exponent, and without a fraction that is not there."""
    return str(int(value)) if value == int(value) else repr(value)


TABLES: dict[str, type] = {
    name: hint
    for name, hint in get_type_hints(RobotSettings).items()
    if isinstance(hint, type) and dataclasses.is_dataclass(hint)
}
"""The class of each table."""


def _settings(owner: Any, table: str, per_robot: bool) -> list[Setting]:
    hints = get_type_hints(owner)
    found = []
    for each in dataclasses.fields(owner):
        if each.name in TABLES and not table:
            found += _settings(TABLES[each.name], each.name, per_robot)
            continue
        hint: Any = hints[each.name]
        default: Any = each.default
        choices = get_args(hint) if get_origin(hint) is Literal else ()
        found.append(
            Setting(
                name=f"{table}_{each.name}" if table else each.name,
                table=table,
                field=each.name,
                kind=type(choices[0]) if choices else hint,
                default=default,
                choices=choices,
                low=each.metadata.get("low", 0),
                high=each.metadata.get("high", 0),
                unit=each.metadata["unit"],
                meaning=each.metadata["meaning"],
                per_robot=per_robot,
            )
        )
    return found


SETTINGS: dict[str, Setting] = {
    setting.name: setting
    for setting in [*_settings(General, "", per_robot=False), *_settings(RobotSettings, "", per_robot=True)]
}
"""By name, in the order of the documentation."""

IMPOSSIBLE = {
    "tcp_reorder": "TCP delivers in order",
    "tcp_duplicate": "TCP delivers once",
    "spi_reorder": "on SPI one window follows the other",
    "gap8_divider": "only the STM32's stamp clock has the divider",
    "esp32_divider": "only the STM32's stamp clock has the divider",
}
"""Keys that a user may well try, and why there is no such key."""
