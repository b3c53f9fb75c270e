"""All errors in a table that people wrote; msgspec by itself stops at the first."""

from types import UnionType
from typing import Any, Union, get_args, get_origin

import msgspec
from msgspec import Struct, structs

from companion.core.base.errors import LeewayError, RangeError


def table_errors(table: dict[str, Any], kind: type[Struct], where: str = "") -> list[str]:
    """Every key that is unknown, missing, of the wrong type or out of range, in words."""
    fields = {field.encode_name: field for field in structs.fields(kind)}
    found: list[str] = []
    good: dict[str, Any] = {}
    for key, value in table.items():
        if key not in fields:
            found.append(f"{where}{key}: unknown key, expected {', '.join(sorted(fields))}")
            continue
        mine = _value_errors(value, fields[key].type, f"{where}{key}")
        found += mine
        if not mine:
            good[key] = value
    required = [name for name, field in fields.items() if field.required]
    found += [f"{where}{name}: missing" for name in required if name not in table]
    if all(name in good for name in required):
        found += _range_errors(good, kind, where)
    return found


def _value_errors(value: Any, kind: Any, where: str) -> list[str]:
    if get_origin(kind) in (Union, UnionType):
        structures = [one for one in get_args(kind) if _is_struct(one)]
        if len(structures) == 1 and isinstance(value, dict):
            kind = structures[0]
    if _is_struct(kind) and isinstance(value, dict):
        return table_errors(value, kind, f"{where}.")
    inner = get_args(kind)[0] if get_origin(kind) is list else None
    if _is_struct(inner) and isinstance(value, list):
        lines = [_value_errors(one, inner, f"{where}[{n}]") for n, one in enumerate(value)]
        return [words for line in lines for words in line]
    try:
        msgspec.convert(value, kind)
    except (msgspec.ValidationError, LeewayError) as error:
        return [f"{where}: {error}"]
    return []


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Struct)


def _range_errors(good: dict[str, Any], kind: type[Struct], where: str) -> list[str]:
    """What the structure's own checks say. A number out of its range is then replaced by the least
    allowed one, so that the next error is found.
    """
    found: list[str] = []
    while True:
        try:
            msgspec.convert(good, kind)
        except RangeError as error:
            found.append(_placed(error, where))
            name = error.key.rpartition(".")[2]
            if good.get(name) in (None, error.low):
                return found
            good = good | {name: error.low}
        except (msgspec.ValidationError, LeewayError) as error:
            return [*found, _placed(error, where)]
        else:
            return found


def _placed(error: Exception, where: str) -> str:
    """With the path of the key: the error names it as `depot.lat_deg`, or only as `lat_deg`."""
    words, outermost = str(error), where.partition(".")[0].partition("[")[0]
    return words if words.startswith(f"{outermost}.") else f"{where}{words}"
