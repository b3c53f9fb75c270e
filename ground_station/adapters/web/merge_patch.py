"""Difference of two JSON objects, as a JSON merge patch (RFC 7396)."""

from typing import Any

Table = dict[str, Any]


def merge_patch(before: Table, after: Table) -> Table:
    """Return the smallest patch from `before` to `after`; `{}` if they are equal.

    Neither may contain `None` as a member: in a patch `null` removes a member (RFC 7396, 1). Lists
    and plain values are replaced whole.
    """
    removed: Table = {key: None for key in before if key not in after}
    changed = {
        key: merge_patch(before[key], value)
        if isinstance(value, dict) and isinstance(before.get(key), dict)
        else value
        for key, value in after.items()
        if key not in before or before[key] != value
    }
    return removed | changed
