"""JSON Schema as a Markdown page: a table for each part, a row for each key."""

import json
import re
from collections.abc import Iterator
from typing import Any

Schema = dict[str, Any]

TYPES = {"string": "text", "boolean": "true or false", "object": "table", "null": "nothing"}


def render_markdown_page(schema: Schema, schema_file: str) -> str:
    """Return the page in Markdown."""
    lines = [f"# {schema['title']}", "", *_description_lines(schema), ""]
    lines += [f"Its JSON Schema is [{schema_file}]({schema_file}). Unknown keys are rejected.", ""]
    lines += _key_table_lines(schema)
    for name, part in schema["definitions"].items():
        lines += ["", f"## {name}", "", *_description_lines(part), ""]
        if "properties" in part:
            lines += _key_table_lines(part)
        elif "enum" in part:
            lines.append("One of " + ", ".join(f"`{value}`" for value in part["enum"]) + ".")
    return "\n".join(lines) + "\n"


def _description_lines(schema: Schema) -> list[str]:
    paragraphs = re.split(r"\n\s*\n", schema.get("description", ""))
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs).split("\n")


def _key_table_lines(schema: Schema) -> list[str]:
    if not schema["properties"]:
        return ["It has no keys."]
    lines = ["| key | type | range | default | meaning |", "| --- | --- | --- | --- | --- |"]
    required = set(schema.get("required", ()))
    for key, part in schema["properties"].items():
        cells = [
            f"`{key}`",
            _type_text(part),
            _limits_text(part),
            "required" if key in required else _default_text(part),
            part.get("description", ""),
        ]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return lines


def _type_text(part: Schema) -> str:
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "allOf" in part:
        return _type_text(part["allOf"][0])
    if "anyOf" in part:
        kinds = [one for one in part["anyOf"] if one.get("type") != "null"]
        return " or ".join(_title_or_type_text(one) for one in kinds)
    if "enum" in part:
        return ", ".join(f"`{value}`" for value in part["enum"])
    if part.get("type") == "array":
        items = part.get("items", {})
        if isinstance(items, list):
            return "[" + ", ".join(_type_text(one) for one in items) + "]"
        return f"list of {_type_text(items)}" if items else "list"
    if isinstance(part.get("additionalProperties"), dict):
        return f"table of {_type_text(part['additionalProperties'])}"
    kind = str(part.get("type", "anything"))
    return TYPES.get(kind, kind)


def _title_or_type_text(part: Schema) -> str:
    return f"nothing ({part['title']})" if part.get("maxProperties") == 0 else _type_text(part)


def _limits_text(part: Schema) -> str:
    """Return the range of the numbers, or the length or pattern of the text."""
    for number in iterate_number_schemas(part):
        least, most = number.get("minimum"), number.get("maximum")
        above = number.get("exclusiveMinimum")
        if least is not None and most is not None:
            return f"{least} to {most}"
        if least is not None:
            return f"at least {least}"
        if above is not None:
            return f"above {above}"
    for text in _iterate_alternatives(part):
        if "pattern" in text:
            return f"`{text['pattern']}`"
        if "maxLength" in text:
            return f"at most {text['maxLength']} characters"
    return ""


def _iterate_alternatives(part: Schema) -> Iterator[Schema]:
    yield part
    for one in part.get("anyOf", ()):
        yield from _iterate_alternatives(one)


def iterate_number_schemas(part: Schema) -> Iterator[Schema]:
    """Yield the schemas of the numbers in a part, and in its lists and alternatives."""
    for one in _iterate_alternatives(part):
        if one.get("type") in ("number", "integer"):
            yield one
        items = one.get("items")
        for item in items if isinstance(items, list) else [items]:
            if isinstance(item, dict):
                yield from iterate_number_schemas(item)


def _default_text(part: Schema) -> str:
    if "default" not in part:
        return ""
    value = part["default"]
    if isinstance(value, dict):
        return "its defaults" if value else "empty"
    if value in ([], ""):
        return "empty"
    return f"`{json.dumps(value)}`"
