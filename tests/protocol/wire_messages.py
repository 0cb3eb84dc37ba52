"""Messages that are one C struct with the specification's names for its fields; plain, or with structs in it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st
from wire_format import Format, Values, field_names, parsed, plain

from host.native import ffi, lib


def any_values(ctype: str, **known: st.SearchStrategy[Any]) -> st.SearchStrategy[Values]:
    """Every field over its whole range, but for the known ones."""
    strategies = {
        name: known.get(name, st.integers(0, 256 ** ffi.sizeof(field.type) - 1))
        for name, field in ffi.typeof(ctype).fields
    }
    return st.fixed_dictionaries(strategies)


def message(
    name: str, ctype: str, c_name: str, spec: Any, size: int, values: st.SearchStrategy[Values], **more: Any
) -> Format:
    names = field_names(ctype)
    encoder = getattr(lib, f"{c_name}_encode")

    def encode(given: Values, buffer: Any, room: int) -> int:
        assert room >= size
        encoder(ffi.new(f"{ctype} *", given), buffer)
        return size

    return Format(
        name,
        values,
        spec.build,
        lambda data: parsed(spec, data, lambda found: plain(found, names)),
        encode,
        getattr(lib, f"{c_name}_decode"),
        (f"{ctype} *",),
        lambda outputs, _: {field: getattr(outputs[0], field) for field in names},
        **more,
    )


def merged(*parts: st.SearchStrategy[Values]) -> st.SearchStrategy[Values]:
    return st.tuples(*parts).map(lambda dicts: {name: value for part in dicts for name, value in part.items()})


# Messages whose struct has structs and arrays in it. Their values are flat: no name is in two of the parts.

FLOATS = st.floats(width=32, allow_nan=False)
BY_KIND = {"float": FLOATS, "int16_t": st.integers(-(2**15), 2**15 - 1)}


def flat_values(ctype: Any, **known: st.SearchStrategy[Any]) -> dict[str, st.SearchStrategy[Any]]:
    """A strategy for each leaf."""
    found: dict[str, st.SearchStrategy[Any]] = {}
    for name, field in ctype.fields:
        kind = field.type
        if kind.kind == "struct":
            found |= flat_values(kind, **known)
        elif kind.kind == "array":
            found[name] = st.lists(leaf(kind.item), min_size=kind.length, max_size=kind.length)
        else:
            found[name] = known.get(name, leaf(kind))
    return found


def leaf(kind: Any) -> st.SearchStrategy[Any]:
    return BY_KIND.get(kind.cname, st.integers(0, 256 ** ffi.sizeof(kind) - 1))


def fill(struct: Any, ctype: Any, values: Values) -> Any:
    for name, field in ctype.fields:
        if field.type.kind == "struct":
            fill(getattr(struct, name), field.type, values)
        else:
            setattr(struct, name, values[name])
    return struct


def flat(struct: Any, ctype: Any) -> Values:
    found: Values = {}
    for name, field in ctype.fields:
        value = getattr(struct, name)
        if field.type.kind == "struct":
            found |= flat(value, field.type)
        else:
            found[name] = [same(each) for each in value] if field.type.kind == "array" else same(value)
    return found


def same(value: Any) -> Any:
    """A NaN is equal to nothing, but which one it is is none of our business."""
    return "nan" if value != value else value


def picked(container: Any, names: list[str]) -> Values:
    """Those names out of a Container and the ones in it."""
    found: Values = {}
    for name, value in container.items():
        if name in names:
            found[name] = [same(each) for each in value] if isinstance(value, list) else same(value)
        elif isinstance(value, dict):
            found |= picked(value, names)
    return found


def nested(
    name: str,
    c_name: str,
    spec: Any,
    size: int,
    *,
    arrange: Callable[[Values], Any] = lambda values: values,
    decode: Any = None,
    values: st.SearchStrategy[Values] | None = None,
    **more: Any,
) -> Format:
    ctype = ffi.typeof(f"{c_name}_t")
    encoder = getattr(lib, f"{c_name}_encode")
    own = flat_values(ctype)

    def encode(given: Values, buffer: Any, room: int) -> int:
        assert room >= size
        encoder(fill(ffi.new(f"{c_name}_t *"), ctype, given), buffer)
        return size

    return Format(
        name,
        st.fixed_dictionaries(own) if values is None else merged(st.fixed_dictionaries(own), values),
        lambda given: spec.build(arrange(given)),
        lambda data: parsed(spec, data, lambda found: picked(found, list(own))),
        encode,
        decode or getattr(lib, f"{c_name}_decode"),
        (f"{c_name}_t *",),
        lambda outputs, _: flat(outputs[0], ctype),
        **more,
    )
