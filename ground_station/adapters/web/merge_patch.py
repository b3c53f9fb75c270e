"""What changed from one JSON object to the next, as a JSON merge patch (RFC 7396)."""

from typing import Any

Table = dict[str, Any]


def merge_patch(before: Table, after: Table) -> Table:
    """The smallest patch that makes `after` of `before`; `{}`: they are the same.

    Neither may hold `None` as a member: in a patch `null` takes a member away (RFC 7396, 1).
    Lists and plain values are replaced whole.
    """
    gone: Table = {key: None for key in before if key not in after}
    changed = {
        key: _change(before.get(key), value)
        for key, value in after.items()
        if key not in before or before[key] != value
    }
    return gone | changed


def _change(before: Any, after: Any) -> Any:
    if isinstance(before, dict) and isinstance(after, dict):
        return merge_patch(before, after)
    return after
