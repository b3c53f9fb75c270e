"""Meanings and permitted ranges of a structure's keys, from its source and its decoder.

The meaning of a key is the docstring under its field. Ranges declared in a field's type are part of
its JSON Schema. Ranges checked at construction (`check_range`) are found by decoding each valid
example with one number replaced by a far too large one; the error message contains the range.
"""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import msgspec

from companion.core.base.errors import LeewayError

FAR_TOO_LARGE = 10**15
_REFUSAL = re.compile(r"^([\w.]+) = .*: expected a number from (\S+) to ([^\s;]+)")

Range = tuple[float, float]


def iterate_structs_in(value: Any) -> Iterator[msgspec.Struct]:
    """Yield all structures in a value, including the value itself."""
    if isinstance(value, msgspec.Struct):
        yield value
        for name in value.__struct_fields__:
            yield from iterate_structs_in(getattr(value, name))
    elif isinstance(value, Mapping):
        for part in value.values():
            yield from iterate_structs_in(part)
    elif isinstance(value, list | tuple):
        for part in value:
            yield from iterate_structs_in(part)


def probe_permitted_ranges(
    struct_type: type[msgspec.Struct], examples: Iterable[msgspec.Struct]
) -> dict[str, Range]:
    """Return (minimum, maximum) by field for numbers that `struct_type` checks."""
    found: dict[str, Range] = {}
    for example in examples:
        table = msgspec.to_builtins(example)
        for field in msgspec.structs.fields(struct_type):
            name = field.encode_name
            if name not in found and (
                limits := _probe_range_by_invalid_value(struct_type, table, name)
            ):
                found[name] = limits
    return found


def _probe_range_by_invalid_value(
    struct_type: type[msgspec.Struct], table: dict[str, Any], name: str
) -> Range | None:
    value = table.get(name)
    wrong: Any = FAR_TOO_LARGE
    if isinstance(value, list | tuple) and value:
        wrong = [FAR_TOO_LARGE] * len(value)
    try:
        msgspec.convert({**table, name: wrong}, struct_type)
    except (msgspec.ValidationError, LeewayError) as error:
        range_match = _REFUSAL.match(str(error))
        if range_match and range_match[1].rpartition(".")[2] == name:
            return float(range_match[2]), float(range_match[3])
    return None


def docstring_by_field(kind: type) -> dict[str, str]:
    """Return one-line docstrings by field name; a class overrides its base classes."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if base.__module__.partition(".")[0] in {"builtins", "msgspec"}:
            continue
        found |= _own_docstring_by_field(base)
    return found


def _own_docstring_by_field(kind: type) -> dict[str, str]:
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(tree, ast.ClassDef)
    found: dict[str, str] = {}
    for field, after in zip(tree.body, tree.body[1:], strict=False):
        match field, after:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(words))),
            ):
                found[name] = " ".join(words.split())
    return found
