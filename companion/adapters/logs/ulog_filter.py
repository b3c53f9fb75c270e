"""Extracts the required part of a ULog by its message headers, before it is parsed.

A log has thousands of messages a second and a dozen topics are used: removing the other data first
makes reading several times faster. Format: docs.px4.io, "ULog File Format".
"""

import struct
from collections.abc import Mapping

HEADER = struct.Struct("<HB")
STAMP = struct.Struct("<Q")
FILE_HEADER_BYTES = 16
FLAGS, DATA, SUBSCRIBE = ord("B"), ord("D"), ord("A")
KINDS = frozenset(b"BFIMPQARDLCSO")
APPENDED_BYTE, APPENDED_BIT = 8, 1


def extract_topics_at_min_interval(raw: bytes, min_interval_s: Mapping[str, float]) -> bytes:
    """Return the log with these topics' data only, at each topic's minimum interval.

    After the first damaged header, all bytes are kept: the parser resynchronises. A file with
    appended data is returned unchanged, since it refers to them by offset.
    """
    at, size = FILE_HEADER_BYTES, len(raw)
    others: set[bytes] = set()
    steps_us: dict[bytes, float] = {}
    last_kept_us: dict[bytes, int] = {}
    parts: list[bytes] = []
    kept_from = 0
    unpack = HEADER.unpack_from
    while at + 3 <= size:
        length, kind = unpack(raw, at)
        end = at + 3 + length
        if kind == DATA:
            number = raw[at + 3 : at + 5]
            is_skipped = number in others
            if number in steps_us and end <= size and length >= 10:
                (stamp_us,) = STAMP.unpack_from(raw, at + 5)
                is_skipped = 0 <= stamp_us - last_kept_us.get(number, -(1 << 62)) < steps_us[number]
                if not is_skipped:
                    last_kept_us[number] = stamp_us
            if is_skipped:
                if kept_from < at:
                    parts.append(raw[kept_from:at])
                kept_from = end
        elif kind not in KINDS or end > size:
            break
        elif kind == SUBSCRIBE:
            name = raw[at + 6 : end].decode("ascii", errors="replace")
            if name not in min_interval_s:
                others.add(raw[at + 4 : at + 6])
            elif min_interval_s[name] > 0.0:
                steps_us[raw[at + 4 : at + 6]] = 1e6 * min_interval_s[name]
        elif kind == FLAGS and raw[at + 3 + APPENDED_BYTE] & APPENDED_BIT:
            return raw
        at = end
    parts.append(raw[min(kept_from, size) :])
    return b"".join(parts)
