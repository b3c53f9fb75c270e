"""Compares the decisions of two runs: identifiers, times, numbers, messages; texts by a table."""

import json
import math
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

TIMINGS = re.compile(r"_us_|^seconds$|cpu|wall|^run$|^runs$|speed_up|real_time|^took|faster")
"""Keys whose values depend on the machine: processing times and folders."""

TEXTS = re.compile(r"^(reason|why|text|words|said|remedy|name)$")
NOT_COMMANDS = ("HEARTBEAT", "TIMESYNC")
COMPANION = 191


class TextTable:
    """Replacements for texts of the base, by regular expression."""

    def __init__(self, pairs: list[tuple[str, str]]) -> None:
        self._replacements = [(re.compile(old), new) for old, new in pairs]

    def mapped(self, text: str) -> str:
        """Return a text of the base in the wording of the present code."""
        for old, new in self._replacements:
            text = old.sub(new, text)
        return text


def differences(base: Any, now: Any, texts: TextTable, where: str = "") -> Iterator[str]:
    """Yield the differences of two JSON documents, except for processing times."""
    if isinstance(base, dict) and isinstance(now, dict):
        for key in sorted(base.keys() | now.keys()):
            if TIMINGS.search(key):
                continue
            if key not in base or key not in now:
                yield f"{where}.{key}: only in {'the base' if key in base else 'the present'}"
            elif TEXTS.search(key) and isinstance(base[key], str):
                yield from differences(texts.mapped(base[key]), now[key], texts, f"{where}.{key}")
            else:
                yield from differences(base[key], now[key], texts, f"{where}.{key}")
    elif isinstance(base, list) and isinstance(now, list):
        if len(base) != len(now):
            yield f"{where}: {len(base)} entries, now {len(now)}"
        for number, (one, other) in enumerate(zip(base, now, strict=False)):
            yield from differences(one, other, texts, f"{where}[{number}]")
    elif not _same(base, now):
        yield f"{where}: {base!r}, now {now!r}"


def _same(base: Any, now: Any) -> bool:
    if isinstance(base, float) and isinstance(now, float):
        return base == now or (math.isnan(base) and math.isnan(now))
    return type(base) is type(now) and base == now


def sent_messages(recording: Path, texts: TextTable) -> list[tuple[str, str]]:
    """Return type and payload of the companion's messages in order, without the frame counter."""
    from pymavlink import mavutil

    found: list[tuple[str, str]] = []
    with closing(mavutil.mavlink_connection(str(recording))) as stream:
        while (message := stream.recv_match()) is not None:
            kind = message.get_type()
            if message.get_srcComponent() != COMPANION or kind in NOT_COMMANDS:
                continue
            fields = message.to_dict()
            if kind == "STATUSTEXT":
                fields["text"] = texts.mapped(fields["text"])
            found.append((kind, json.dumps(fields, sort_keys=True, default=str)))
    return found


def compare_files(base: Path, now: Path, texts: TextTable) -> list[str]:
    """Compare two files of one case according to their kind."""
    if base.suffix == ".tlog":
        ours, theirs = sent_messages(now, texts), sent_messages(base, texts)
        for number, (old, new) in enumerate(zip(theirs, ours, strict=False)):
            if old != new:
                return [f"message {number}: {old[0]} {old[1][:200]}, now {new[0]} {new[1][:200]}"]
        return [] if len(ours) == len(theirs) else [f"{len(theirs)} messages, now {len(ours)}"]
    documents = (json.loads(path.read_text()) for path in (base, now))
    return list(differences(*documents, texts))
