"""A client of the map's stream that shares no code with it: WHATWG event streams, RFC 7396."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx

PATIENCE_S = 30.0


def merged(target: Any, patch: Any) -> Any:
    """RFC 7396, section 2, as its pseudocode has it."""
    if not isinstance(patch, dict):
        return patch
    result = dict(target) if isinstance(target, dict) else {}
    for name, value in patch.items():
        if value is None:
            result.pop(name, None)
        else:
            result[name] = merged(result.get(name), value)
    return result


class SseClient:
    """Follows the stream; `picture` is what a page would show, `kinds` the events so far."""

    def __init__(self, lines: Iterator[str]) -> None:
        self._numbered_lines_without_comments = lines
        self.picture: Any = None
        self.kinds: list[str] = []

    def take(self) -> str:
        """The next event's kind."""
        fields: dict[str, str] = {}
        for line in self._numbered_lines_without_comments:
            if not line and "data" in fields:
                break
            name, _, value = line.partition(": ")
            fields[name] = value
        content = json.loads(fields["data"])["content"]
        whole = fields["event"] == "picture"
        self.picture = content if whole else merged(self.picture, content)
        self.kinds.append(fields["event"])
        return fields["event"]

    def until(self, picture: Any) -> None:
        """Follow until this is shown; the time-out of the connection ends a wait that is vain."""
        while self.picture != picture:
            self.take()


def lines_of(chunks: Iterator[bytes]) -> Iterator[str]:
    """Lines as WHATWG has them: U+2028, at which str.splitlines breaks, is a character."""
    rest = b""
    for chunk in chunks:
        *whole, rest = (rest + chunk).split(b"\n")
        yield from (line.decode() for line in whole)


@contextmanager
def following(address: str) -> Iterator[SseClient]:
    """A client that has joined."""
    with httpx.stream("GET", f"{address}/events", timeout=PATIENCE_S) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        yield SseClient(lines_of(answer.iter_bytes()))
