"""The JSON Schema of a file or message, from the structure that reads it.

Draft 7: what editors of TOML files understand. msgspec gives types, required keys and limits that
stand in a type; the meaning of each key is its docstring in the class, and the range of a number
is what the reader says when it refuses one.
"""

import inspect
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from sim_bridge.research.reference.attribute_docs import attribute_docs
from sim_bridge.research.reference.permitted_ranges import (
    Range,
    permitted_ranges,
    structures_in,
)

DRAFT = "http://json-schema.org/draft-07/schema#"
Schema = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Format:
    """A kind of file or message: its name, the structure that reads it, and valid examples.

    `opaque` names fields that are read elsewhere (CLASS.field) with the type that reads them.
    """

    name: str
    kind: type[msgspec.Struct]
    examples: tuple[msgspec.Struct, ...] = ()
    opaque: Mapping[str, Any] = field(default_factory=dict)

    @property
    def stem(self) -> str:
        """The name as a file name."""
        return self.name.replace("/", "-").replace(" ", "-")

    @property
    def path(self) -> Path:
        """Where its schema lies in the reference."""
        return Path("schemas") / f"{self.stem}.json"


def json_schema(format_: Format) -> Schema:
    """The whole schema; raises ValueError where a key has no meaning in words."""
    types = [format_.kind, *format_.opaque.values()]
    roots, parts = msgspec.json.schema_components(types, ref_template="#/definitions/{name}")
    kinds = {kind.__name__: kind for type_ in types for kind in _structures_of(type_)}
    examples: defaultdict[type, list[msgspec.Struct]] = defaultdict(list)
    for example in format_.examples:
        for one in structures_in(example):
            examples[type(one)].append(one)
    for name, part in parts.items():
        if name in kinds:
            kind = kinds[name]
            _describe(part, kind, permitted_ranges(kind, examples[kind]))
    for place, schema in zip(format_.opaque, roots[1:], strict=True):
        _place_opaque(parts, place, schema)
    root = parts.pop(format_.kind.__name__)
    used = _used(root, parts)
    whole = {"$schema": DRAFT, **root, "title": format_.name}
    whole["definitions"] = {name: parts[name] for name in used}
    return _as_draft_7(whole)


def _describe(part: Schema, kind: type[msgspec.Struct], ranges: Mapping[str, Range]) -> None:
    """Words and ranges into a structure's schema."""
    part["description"] = inspect.cleandoc(kind.__doc__ or "")
    docs = attribute_docs(kind)
    tag = kind.__struct_config__.tag_field
    if kind.__struct_config__.array_like:  # named in order for people; a reader checks `items`
        part["properties"] = dict(zip(kind.__struct_fields__, part["prefixItems"], strict=True))
        part["additionalProperties"] = False
    for name, schema in part["properties"].items():
        if name == tag:
            schema["description"] = "Says which of the kinds this is."
            continue
        if name not in docs:
            raise ValueError(f"{kind.__module__}.{kind.__name__}.{name}: no docstring under it")
        schema["description"] = docs[name]
        if schema.get("default", ...) is None:
            del schema["default"]
        if name in ranges:
            for number in _numbers(schema):
                number["minimum"], number["maximum"] = map(_plain, ranges[name])


def _plain(number: float) -> float | int:
    return int(number) if number.is_integer() else number


def _numbers(schema: Schema) -> Iterator[Schema]:
    if schema.get("type") in ("number", "integer"):
        yield schema
    for one in schema.get("anyOf", ()):
        yield from _numbers(one)
    if isinstance(schema.get("items"), dict):
        yield from _numbers(schema["items"])


def _place_opaque(parts: Mapping[str, Schema], place: str, schema: Schema) -> None:
    """What reads an opaque table, in its place; an empty table is allowed where it is optional."""
    owner, _, name = place.partition(".")
    old = parts[owner]["properties"][name]
    if old.get("type") == "array":
        old["items"] = schema["items"]
        return
    old.pop("type", None)
    options = schema.get("anyOf", [schema])
    empty = {"title": "still air", "type": "object", "maxProperties": 0}
    old["anyOf"] = [*options, empty] if old.get("default") == {} else options


def _used(schema: Any, parts: Mapping[str, Schema]) -> list[str]:
    """Names of the definitions that a schema needs, as a reader meets them."""
    found: list[str] = []
    for name in _references(schema):
        if name not in found:
            found += [name, *_used(parts[name], parts)]
    return list(dict.fromkeys(found))


def _references(schema: Any) -> Iterator[str]:
    if isinstance(schema, dict):
        if "$ref" in schema:
            yield schema["$ref"].rpartition("/")[2]
        for part in schema.values():
            yield from _references(part)
    elif isinstance(schema, list):
        for part in schema:
            yield from _references(part)


def _as_draft_7(schema: Any) -> Any:
    """Tuples, references with words beside them, and patterns as draft 7 and editors know them."""
    if isinstance(schema, list):
        return [_as_draft_7(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    new = {key: _as_draft_7(part) for key, part in schema.items() if key != "discriminator"}
    if "prefixItems" in new:
        new["items"] = new.pop("prefixItems")
        new["additionalItems"] = False
    if "$ref" in new and len(new) > 1:
        new["allOf"] = [{"$ref": new.pop("$ref")}]
    if isinstance(new.get("pattern"), str):
        new["pattern"] = new["pattern"].replace(r"\Z", "$")
    return new


def _structures_of(type_: Any, seen: set[type] | None = None) -> set[type[msgspec.Struct]]:
    """Every structure that a type can hold."""
    seen = set() if seen is None else seen
    info = msgspec.inspect.type_info(type_)
    _walk(info, seen)
    return seen


def _walk(info: Any, seen: set[type]) -> None:
    match info:
        case msgspec.inspect.StructType():
            if info.cls not in seen:
                seen.add(info.cls)
                for one in info.fields:
                    _walk(one.type, seen)
        case msgspec.inspect.UnionType():
            for one in info.types:
                _walk(one, seen)
        case msgspec.inspect.ListType() | msgspec.inspect.VarTupleType():
            _walk(info.item_type, seen)
        case msgspec.inspect.TupleType():
            for one in info.item_types:
                _walk(one, seen)
        case msgspec.inspect.DictType():
            _walk(info.value_type, seen)
        case msgspec.inspect.Metadata():
            _walk(info.type, seen)
