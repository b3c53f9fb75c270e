"""Which numbers a structure permits, asked of the reader itself: what does it say to a wrong one?

Ranges that stand in a field's type come with its JSON Schema. Those that a structure checks when it
is made (`check_range`) are found by trying: each number of a valid example is replaced by one that
is far too large, and the refusal names the range.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import msgspec

from companion.core.base.errors import LeewayError

FAR_TOO_LARGE = 10**15
_REFUSAL = re.compile(r"^([\w.]+) = .*: expected a number from (\S+) to ([^\s;]+)")

Range = tuple[float, float]


def structures_in(value: Any) -> Iterator[msgspec.Struct]:
    """Every structure in a value, itself included."""
    if isinstance(value, msgspec.Struct):
        yield value
        for name in value.__struct_fields__:
            yield from structures_in(getattr(value, name))
    elif isinstance(value, Mapping):
        for part in value.values():
            yield from structures_in(part)
    elif isinstance(value, list | tuple):
        for part in value:
            yield from structures_in(part)


def permitted_ranges(
    kind: type[msgspec.Struct], examples: Iterable[msgspec.Struct]
) -> dict[str, Range]:
    """Field name to (least, most) of each number that `kind` checks when it is made."""
    found: dict[str, Range] = {}
    for example in examples:
        table = msgspec.to_builtins(example)
        for field in msgspec.structs.fields(kind):
            name = field.encode_name
            if name not in found and (limits := _refused(kind, table, name)):
                found[name] = limits
    return found


def _refused(kind: type[msgspec.Struct], table: dict[str, Any], name: str) -> Range | None:
    value = table.get(name)
    wrong: Any = FAR_TOO_LARGE
    if isinstance(value, list | tuple) and value:
        wrong = [FAR_TOO_LARGE] * len(value)
    try:
        msgspec.convert({**table, name: wrong}, kind)
    except (msgspec.ValidationError, LeewayError) as error:
        said = _REFUSAL.match(str(error))
        if said and said[1].rpartition(".")[2] == name:
            return float(said[2]), float(said[3])
    return None
