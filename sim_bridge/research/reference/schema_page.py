"""A JSON Schema as a page for people: a table for each part, a row for each key."""

import json
import re
from collections.abc import Iterator
from typing import Any

Schema = dict[str, Any]

UNITS = {
    "n_per_mps2": "N/(m/s)²",
    "n_per_mps": "N/(m/s)",
    "m2ps2": "m²/s²",
    "degps": "°/s",
    "mps2": "m/s²",
    "mps": "m/s",
    "nspm": "N/(m/s)",
    "per_s": "1/s",
    "per_w": "1/W",
    "frac": "share",
    "deg": "°",
    "ohm": "Ω",
    "m2": "m²",
    "kg": "kg",
    "wh": "Wh",
    "ah": "Ah",
    "us": "µs",
    "hz": "Hz",
    "pa": "Pa",
    "m": "m",
    "s": "s",
    "w": "W",
    "v": "V",
    "a": "A",
    "c": "°C",
    "k": "K",
    "n": "N",
}
"""What the end of a key says about its unit; longer ends stand first."""

TYPES = {"string": "text", "boolean": "true or false", "object": "table", "null": "nothing"}


def schema_page(schema: Schema, schema_file: str) -> str:
    """The page, in Markdown."""
    lines = [f"# {schema['title']}", "", *_prose(schema), ""]
    lines += [f"Its JSON Schema is [{schema_file}]({schema_file}). Unknown keys are refused.", ""]
    lines += _table(schema)
    for name, part in schema["definitions"].items():
        lines += ["", f"## {name}", "", *_prose(part), ""]
        if "properties" in part:
            lines += _table(part)
        elif "enum" in part:
            lines.append("One of " + ", ".join(f"`{value}`" for value in part["enum"]) + ".")
    return "\n".join(lines) + "\n"


def _prose(schema: Schema) -> list[str]:
    paragraphs = re.split(r"\n\s*\n", schema.get("description", ""))
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs).split("\n")


def _table(schema: Schema) -> list[str]:
    if not schema["properties"]:
        return ["It has no keys."]
    lines = ["| key | type | unit, range | default | meaning |", "| --- | --- | --- | --- | --- |"]
    required = set(schema.get("required", ()))
    for key, part in schema["properties"].items():
        cells = [
            f"`{key}`",
            _type(part),
            ", ".join(filter(None, (_unit(key, part), _limits(part)))),
            "required" if key in required else _default(part),
            part.get("description", ""),
        ]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return lines


def _type(part: Schema) -> str:
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "allOf" in part:
        return _type(part["allOf"][0])
    if "anyOf" in part:
        kinds = [one for one in part["anyOf"] if one.get("type") != "null"]
        return " or ".join(_title_or_type(one) for one in kinds)
    if "enum" in part:
        return ", ".join(f"`{value}`" for value in part["enum"])
    if part.get("type") == "array":
        items = part.get("items", {})
        if isinstance(items, list):
            return "[" + ", ".join(_type(one) for one in items) + "]"
        return f"list of {_type(items)}" if items else "list"
    if isinstance(part.get("additionalProperties"), dict):
        return f"table of {_type(part['additionalProperties'])}"
    kind = str(part.get("type", "anything"))
    return TYPES.get(kind, kind)


def _title_or_type(part: Schema) -> str:
    return f"nothing ({part['title']})" if part.get("maxProperties") == 0 else _type(part)


def _unit(key: str, part: Schema) -> str:
    if not any(True for _ in _numbers(part)):
        return ""
    return next((unit for end, unit in UNITS.items() if f"_{key}".endswith(f"_{end}")), "")


def _limits(part: Schema) -> str:
    """The range of its numbers, or the length or pattern of its text."""
    for number in _numbers(part):
        least, most = number.get("minimum"), number.get("maximum")
        above = number.get("exclusiveMinimum")
        if least is not None and most is not None:
            return f"{least} to {most}"
        if least is not None:
            return f"at least {least}"
        if above is not None:
            return f"above {above}"
    for text in _options(part):
        if "pattern" in text:
            return f"`{text['pattern']}`"
        if "maxLength" in text:
            return f"at most {text['maxLength']} characters"
    return ""


def _options(part: Schema) -> Iterator[Schema]:
    yield part
    for one in part.get("anyOf", ()):
        yield from _options(one)


def _numbers(part: Schema) -> Iterator[Schema]:
    for one in _options(part):
        if one.get("type") in ("number", "integer"):
            yield one
        items = one.get("items")
        for item in items if isinstance(items, list) else [items]:
            if isinstance(item, dict):
                yield from _numbers(item)


def _default(part: Schema) -> str:
    if "default" not in part:
        return ""
    value = part["default"]
    if isinstance(value, dict):
        return "its defaults" if value else "empty"
    if value in ([], ""):
        return "empty"
    return f"`{json.dumps(value)}`"
