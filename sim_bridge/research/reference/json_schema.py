"""JSON Schema of a file or message, generated from the structure that decodes it.

Draft 7, since TOML editors support it. msgspec provides types, required keys and limits declared in
a type. The meaning of a key is its docstring in the class; the range of a number is taken from the
error message for an invalid value.
"""

import inspect
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args, get_type_hints

import msgspec

from sim_bridge.research.reference.keys import (
    Range,
    docstring_by_field,
    iterate_structs_in,
    probe_permitted_ranges,
)
from sim_bridge.research.reference.schema_page import Schema, iterate_number_schemas

SCHEMA_DIALECT_URL = "http://json-schema.org/draft-07/schema#"


@dataclass(frozen=True, slots=True)
class Format:
    """File or message format: name, decoding structure, and valid examples.

    `opaque`: fields that are decoded elsewhere (CLASS.field), with the decoding type.
    """

    name: str
    kind: type[msgspec.Struct]
    examples: tuple[msgspec.Struct, ...] = ()
    opaque: Mapping[str, Any] = field(default_factory=dict)

    @property
    def stem(self) -> str:
        """File name stem of the format."""
        return self.name.replace("/", "-").replace(" ", "-")


def build_json_schema(format_: Format) -> Schema:
    """Return the complete schema. Raises ValueError if a key has no docstring."""
    types = [format_.kind, *format_.opaque.values()]
    roots, parts = msgspec.json.schema_components(types, ref_template="#/definitions/{name}")
    kinds = {kind.__name__: kind for type_ in types for kind in _struct_types_in(type_)}
    examples: defaultdict[type, list[msgspec.Struct]] = defaultdict(list)
    for example in format_.examples:
        for one in iterate_structs_in(example):
            examples[type(one)].append(one)
    for name, part in parts.items():
        if name in kinds:
            kind = kinds[name]
            _add_descriptions_and_ranges_in_place(
                part, kind, probe_permitted_ranges(kind, examples[kind])
            )
    for field_path, schema in zip(format_.opaque, roots[1:], strict=True):
        _replace_opaque_schema_in_place(parts, field_path, schema)
    root = parts.pop(format_.kind.__name__)
    whole = {"$schema": SCHEMA_DIALECT_URL, **root, "title": format_.name, "definitions": parts}
    return _convert_to_draft7(whole)


def _add_descriptions_and_ranges_in_place(
    part: Schema, struct_type: type[msgspec.Struct], ranges: Mapping[str, Range]
) -> None:
    """Add descriptions and ranges to a structure's schema."""
    part["description"] = inspect.cleandoc(struct_type.__doc__ or "")
    docs = docstring_by_field(struct_type)
    docs = {
        field.encode_name: docs.get(field.name) for field in msgspec.structs.fields(struct_type)
    }
    tag = struct_type.__struct_config__.tag_field
    if (
        struct_type.__struct_config__.array_like
    ):  # names for documentation; validators check `items`
        part["properties"] = dict(
            zip(struct_type.__struct_fields__, part["prefixItems"], strict=True)
        )
        part["additionalProperties"] = False
    for name, schema in part["properties"].items():
        if name == tag:
            schema["description"] = "Selects the variant."
            continue
        if docs.get(name) is None:
            raise ValueError(
                f"{struct_type.__module__}.{struct_type.__name__}.{name}: no docstring under it"
            )
        schema["description"] = docs[name]
        if schema.get("default", ...) is None:
            del schema["default"]
        if name in ranges:
            limits = [int(x) if x.is_integer() else x for x in ranges[name]]
            for number in iterate_number_schemas(schema):
                number["minimum"], number["maximum"] = limits


def _replace_opaque_schema_in_place(
    parts: Mapping[str, Schema], field_path: str, schema: Schema
) -> None:
    """Insert the schema of an opaque table; an optional table may be empty."""
    owner, _, name = field_path.partition(".")
    old = parts[owner]["properties"][name]
    if old.get("type") == "array":
        old["items"] = schema["items"]
        return
    old.pop("type", None)
    options = schema.get("anyOf", [schema])
    empty = {"title": "still air", "type": "object", "maxProperties": 0}
    old["anyOf"] = [*options, empty] if old.get("default") == {} else options


def _convert_to_draft7(schema: Any) -> Any:
    """Convert tuples, references with sibling keys, and patterns to draft 7."""
    if isinstance(schema, list):
        return [_convert_to_draft7(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    new = {key: _convert_to_draft7(part) for key, part in schema.items() if key != "discriminator"}
    if "prefixItems" in new:
        new["items"] = new.pop("prefixItems")
        new["additionalItems"] = False
    if "$ref" in new and len(new) > 1:
        new["allOf"] = [{"$ref": new.pop("$ref")}]
    if isinstance(new.get("pattern"), str):
        new["pattern"] = new["pattern"].replace(r"\Z", "$")
    return new


def _struct_types_in(type_: Any, seen: set[type] | None = None) -> set[type[msgspec.Struct]]:
    """Return all structures that a type can contain."""
    seen = set() if seen is None else seen
    if isinstance(type_, type) and issubclass(type_, msgspec.Struct) and type_ not in seen:
        seen.add(type_)
        for hint in get_type_hints(type_).values():
            _struct_types_in(hint, seen)
    for part in get_args(type_):
        _struct_types_in(part, seen)
    return seen
