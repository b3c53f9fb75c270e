"""The part of a ULog that is wanted, by message headers, before it is parsed.

A log has thousands of messages a second and we listen to a dozen topics: leaving the others' data
out first makes reading several times faster. Format: docs.px4.io, "ULog File Format".
"""

import struct
from collections.abc import Mapping

HEADER = struct.Struct("<HB")
STAMP = struct.Struct("<Q")
FILE_HEADER_BYTES = 16
FLAGS, DATA, SUBSCRIBE = ord("B"), ord("D"), ord("A")
KINDS = frozenset(b"BFIMPQARDLCSO")
APPENDED_BYTE, APPENDED_BIT = 8, 1


def wanted_part(raw: bytes, least_step_s: Mapping[str, float]) -> bytes:
    """Return the log with these topics' data only, no nearer in time than each one's step.

    From the first header that is damaged on, everything is passed as it is: finding the way back
    is the parser's. So is a whole file with data appended, since that is found by its offset.
    """
    at, size = FILE_HEADER_BYTES, len(raw)
    others: set[bytes] = set()
    steps_us: dict[bytes, float] = {}
    heard_us: dict[bytes, int] = {}
    parts: list[bytes] = []
    kept_from = 0
    unpack = HEADER.unpack_from
    while at + 3 <= size:
        length, kind = unpack(raw, at)
        end = at + 3 + length
        if kind == DATA:
            number = raw[at + 3 : at + 5]
            idle = number in others
            if number in steps_us and end <= size and length >= 10:
                (stamp_us,) = STAMP.unpack_from(raw, at + 5)
                idle = 0 <= stamp_us - heard_us.get(number, -(1 << 62)) < steps_us[number]
                if not idle:
                    heard_us[number] = stamp_us
            if idle:
                if kept_from < at:
                    parts.append(raw[kept_from:at])
                kept_from = end
        elif kind not in KINDS or end > size:
            break
        elif kind == SUBSCRIBE:
            name = raw[at + 6 : end].decode("ascii", errors="replace")
            if name not in least_step_s:
                others.add(raw[at + 4 : at + 6])
            elif least_step_s[name] > 0.0:
                steps_us[raw[at + 4 : at + 6]] = 1e6 * least_step_s[name]
        elif kind == FLAGS and raw[at + 3 + APPENDED_BYTE] & APPENDED_BIT:
            return raw
        at = end
    parts.append(raw[min(kept_from, size) :])
    return b"".join(parts)
