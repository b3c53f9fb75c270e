"""All errors in a table written by people; msgspec alone stops at the first."""

from types import UnionType
from typing import Any, Union, get_args, get_origin

import msgspec
from msgspec import Struct, structs

from companion.core.base.errors import LeewayError, RangeError


def table_errors(table: dict[str, Any], struct_type: type[Struct], key_path: str = "") -> list[str]:
    """Return a message for each key that is unknown, missing, mistyped or out of range."""
    fields = {field.encode_name: field for field in structs.fields(struct_type)}
    found: list[str] = []
    valid: dict[str, Any] = {}
    for key, value in table.items():
        if key not in fields:
            found.append(f"{key_path}{key}: unknown key, expected {', '.join(sorted(fields))}")
            continue
        value_errors = _value_errors(value, fields[key].type, f"{key_path}{key}")
        found += value_errors
        if not value_errors:
            valid[key] = value
    required = [name for name, field in fields.items() if field.required]
    found += [f"{key_path}{name}: missing" for name in required if name not in table]
    if all(name in valid for name in required):
        found += _range_errors(valid, struct_type, key_path)
    return found


def _value_errors(value: Any, expected_type: Any, key_path: str) -> list[str]:
    if get_origin(expected_type) in (Union, UnionType):
        structures = [one for one in get_args(expected_type) if _is_struct(one)]
        if len(structures) == 1 and isinstance(value, dict):
            expected_type = structures[0]
    if _is_struct(expected_type) and isinstance(value, dict):
        return table_errors(value, expected_type, f"{key_path}.")
    item_kind = get_args(expected_type)[0] if get_origin(expected_type) is list else None
    if _is_struct(item_kind) and isinstance(value, list):
        lines = [_value_errors(one, item_kind, f"{key_path}[{n}]") for n, one in enumerate(value)]
        return [words for line in lines for words in line]
    try:
        msgspec.convert(value, expected_type)
    except (msgspec.ValidationError, LeewayError) as error:
        return [f"{key_path}: {error}"]
    return []


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Struct)


def _range_errors(valid: dict[str, Any], struct_type: type[Struct], key_path: str) -> list[str]:
    """Return the errors of the structure's own checks. A number out of its range is then replaced
    by the lower limit, so that the next error is found.
    """
    found: list[str] = []
    while True:
        try:
            msgspec.convert(valid, struct_type)
        except RangeError as error:
            found.append(_error_text_with_key_path(error, key_path))
            name = error.key.rpartition(".")[2]
            if valid.get(name) in (None, error.low):
                return found
            valid = valid | {name: error.low}
        except (msgspec.ValidationError, LeewayError) as error:
            return [*found, _error_text_with_key_path(error, key_path)]
        else:
            return found


def _error_text_with_key_path(error: Exception, key_path: str) -> str:
    """Return the error with its key's path: it names `depot.lat_deg`, or only `lat_deg`."""
    words, outermost = str(error), key_path.partition(".")[0].partition("[")[0]
    return words if words.startswith(f"{outermost}.") else f"{key_path}{words}"
