"""The rows of a log as CSV, Parquet, NPZ or MCAP."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Container, Iterator
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np

from ..link.mcap import MAGIC, Channel, Chunk, Schema, encode_channel, encode_header, encode_schema
from ..link.mcap_summary import finish
from ..protocol.errors import LocalError
from ..usd.log import Log, Rows
from .new_file import new_file

ROWS_AT_ONCE = 10_000
"""Turned into text at a time."""
MCAP_CHUNK = 1 << 20
MCAP_US_MAX = (2**64 - 1) // 1000
Written = dict[str, int]
"""Rows by file."""


def write(log: Log, output: str, verified_only: bool, force: bool) -> Written:
    """LocalError for an ending that is not known, or a file that exists."""
    path = Path(output)
    ending = path.suffix.lower()
    if ending not in WRITERS:
        raise LocalError(f"{output}: its ending chooses the format: {', '.join(WRITERS)}")
    tables = {name: Table(rows, verified_only) for name, rows in log.rows.items() if len(rows)}
    return WRITERS[ending](tables, path, force)


class Table:
    """Rows of one type with their epoch and whether they are verified."""

    def __init__(self, rows: Rows, verified_only: bool) -> None:
        keep = rows.is_verified if verified_only else slice(None)
        self.rows = rows
        self.data = rows.data[keep]
        self.stamp_us = rows.stamp_us[keep]
        self.epoch = rows.epoch[keep]
        self.verified = rows.is_verified[keep]

    def columns(self) -> dict[str, np.ndarray[Any, np.dtype[Any]]]:
        columns: dict[str, np.ndarray[Any, np.dtype[Any]]]
        columns = {"stamp_stm32_us": self.stamp_us, "epoch": self.epoch, "verified": self.verified}
        for each in self.rows.type.variables:
            columns[free_name(each.name, columns)] = self.data[each.name]
        return columns


def each_its_file(tables: dict[str, Table], path: Path) -> dict[Path, Table]:
    """A file for one type has the name that was asked for."""
    if len(tables) == 1:
        return {path: next(iter(tables.values()))}
    files: dict[str, Table] = {}
    for name, table in tables.items():
        files[free_name(re.sub(r"[^\w.#-]", "_", name), files)] = table
    return {path.with_name(f"{path.stem}.{name}{path.suffix}"): table for name, table in files.items()}


def free_name(name: str, taken: Container[str]) -> str:
    """As it is, or with #2, #3 and so on behind it."""
    return next(free for free in chain([name], (f"{name}#{copy}" for copy in count(2))) if free not in taken)


def write_csv(tables: dict[str, Table], path: Path, force: bool) -> Written:
    written: Written = {}
    files = each_its_file(tables, path)
    all_new(files, force)
    for target, table in files.items():
        columns = table.columns()
        with new_file(target, force) as file:
            file.write((",".join(quoted(name) for name in columns) + "\n").encode())
            for begin in range(0, len(table.data), ROWS_AT_ONCE):
                parts = [texts(values[begin : begin + ROWS_AT_ONCE]) for values in columns.values()]
                file.write("".join(",".join(row) + "\n" for row in zip(*parts, strict=True)).encode())
        written[str(target)] = len(table.data)
    return written


def texts(values: np.ndarray[Any, np.dtype[Any]]) -> list[str]:
    """The shortest decimals that give the same number back in the same type."""
    if values.dtype.kind == "b":
        return ["1" if each else "0" for each in values.tolist()]
    return [str(each) for each in values] if values.dtype.kind == "f" else [str(each) for each in values.tolist()]


def quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if re.search(r'[",\n]', name) else name


def write_parquet(tables: dict[str, Table], path: Path, force: bool) -> Written:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise LocalError("Parquet needs pyarrow, which is not installed: pip install 'spindeck[parquet]'") from error
    written: Written = {}
    files = each_its_file(tables, path)
    all_new(files, force)
    for target, table in files.items():
        arrays = {name: pyarrow.array(np.ascontiguousarray(values)) for name, values in table.columns().items()}
        with new_file(target, force) as file:
            parquet.write_table(pyarrow.table(arrays), file)
        written[str(target)] = len(table.data)
    return written


def all_new(files: dict[Path, Table], force: bool) -> None:
    """Before the first is written."""
    there = [str(path) for path in files if path.exists()]
    if there and not force:
        raise LocalError(f"{', '.join(there)}: exists, and is not overwritten: use --force")


def write_npz(tables: dict[str, Table], path: Path, force: bool) -> Written:
    arrays: dict[str, np.ndarray[Any, np.dtype[Any]]] = {}
    for name, table in tables.items():
        arrays |= {name: table.data, f"{name}.epoch": table.epoch, f"{name}.verified": table.verified}
    with new_file(path, force) as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
    return {str(path): sum(len(table.data) for table in tables.values())}


def write_mcap(tables: dict[str, Table], path: Path, force: bool) -> Written:
    """Messages in the order of their times, epoch by epoch; log_time is the stamp, in ns."""
    last_us = max(int(table.stamp_us.max(initial=0)) for table in tables.values())
    if last_us > MCAP_US_MAX:
        raise LocalError(f"{path}: a stamp is {last_us} us, and MCAP counts ns in 64 bits: choose .csv or .npz")
    order = np.lexsort(
        (
            np.concatenate([table.stamp_us for table in tables.values()]),
            np.concatenate([table.epoch for table in tables.values()]),
        )
    )
    sizes = [len(table.data) for table in tables.values()]
    sources = np.repeat(np.arange(len(sizes)), sizes)[order]
    places = order - np.concatenate([[0], np.cumsum(sizes)[:-1]])[sources]
    messages = [json_rows(table, places[sources == at]) for at, table in enumerate(tables.values())]
    with new_file(path, force) as file:
        file.write(MAGIC + encode_header("spindeck"))
        for number, (name, table) in enumerate(tables.items(), 1):
            file.write(encode_schema(Schema(number, f"usd.{name}", "jsonschema", json_schema(name, table))))
            file.write(encode_channel(Channel(number, number, f"/usd/{name}", "json", {})))
        chunk = Chunk()
        for number, source in enumerate(sources.tolist()):
            stamp_us, message = next(messages[source])
            chunk.add(source + 1, number & 0xFFFFFFFF, stamp_us * 1000, stamp_us * 1000, (message,))
            if chunk.size >= MCAP_CHUNK:
                file.writelines(chunk.encode())
                chunk.clear()
        if chunk.size:
            file.writelines(chunk.encode())
        finish(file)
    return {str(path): len(order)}


def json_rows(table: Table, order: np.ndarray[Any, np.dtype[Any]]) -> Iterator[tuple[int, bytes]]:
    """Time and message of each row. JSON has no word for what is no number: such a value is left out."""
    columns = table.columns()
    for begin in range(0, len(order), ROWS_AT_ONCE):
        part = order[begin : begin + ROWS_AT_ONCE]
        for row in zip(*(values[part].tolist() for values in columns.values()), strict=True):
            values = {key: value for key, value in zip(columns, row, strict=True) if math.isfinite(value)}
            yield row[0], json.dumps(values, separators=(",", ":")).encode()


def json_schema(name: str, table: Table) -> bytes:
    kinds = {"f": "number", "b": "boolean"}
    properties = {key: {"type": kinds.get(values.dtype.kind, "integer")} for key, values in table.columns().items()}
    return json.dumps({"title": f"usd.{name}", "type": "object", "properties": properties}).encode()


WRITERS: dict[str, Callable[[dict[str, Table], Path, bool], Written]] = {
    ".csv": write_csv,
    ".parquet": write_parquet,
    ".npz": write_npz,
    ".mcap": write_mcap,
}
