"""An LLM behind any OpenAI-compatible server: one question, one answer, bounded."""

import asyncio
import json
from dataclasses import dataclass
from typing import Any

import httpx

LARGEST_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class LlmParams:
    """Where and whom to ask. `url` is the server's base, for example http://127.0.0.1:8000/v1."""

    url: str
    model: str
    key: str | None = None
    timeout_s: float = 30.0


@dataclass(frozen=True, slots=True)
class LlmAnswer:
    """What the model answered."""

    text: str


@dataclass(frozen=True, slots=True)
class NoAnswer:
    """Why there is none."""

    reason: str


def ask(params: LlmParams, system: str, user: str, schema: dict[str, Any]) -> LlmAnswer | NoAnswer:
    """Ask once, whatever the server does: no longer than `timeout_s`, no more than 1 MiB."""
    body = {
        "model": params.model,
        "temperature": 0,
        "messages": [{"role": "system", "content": system}, {"role": "user", "content": user}],
        "response_format": {
            "type": "json_schema",
            "json_schema": {"name": "clusters", "strict": True, "schema": schema},
        },
    }
    try:
        raw = asyncio.run(_bounded(params, body))
    except (TimeoutError, httpx.TimeoutException):
        return NoAnswer(f"no whole answer in {params.timeout_s:g} s")
    except (httpx.HTTPError, httpx.InvalidURL, httpx.StreamError, UnicodeError) as error:
        return NoAnswer(f"{type(error).__name__}: {error}"[:200])
    return raw if isinstance(raw, NoAnswer) else _content(raw)


async def _bounded(params: LlmParams, body: dict[str, Any]) -> bytes | NoAnswer:
    """httpx bounds each read, which a server that drips its headers never exceeds: hence one
    timeout around all. Compressed answers are not asked for and not unpacked: they may unpack to
    anything.
    """
    headers = {"Accept-Encoding": "identity"}
    if params.key:
        headers["Authorization"] = f"Bearer {params.key}"
    url = f"{params.url.rstrip('/')}/chat/completions"
    async with (
        asyncio.timeout(params.timeout_s),
        httpx.AsyncClient(timeout=params.timeout_s, follow_redirects=False) as client,
        client.stream("POST", url, json=body, headers=headers) as response,
    ):
        if response.status_code != httpx.codes.OK:
            return NoAnswer(f"the server answers {response.status_code}")
        raw = b""
        async for chunk in response.aiter_raw():
            raw += chunk
            if len(raw) > LARGEST_BYTES:
                return NoAnswer(f"more than {LARGEST_BYTES} bytes")
        return raw


def _content(raw: bytes) -> LlmAnswer | NoAnswer:
    try:
        text = json.loads(raw)["choices"][0]["message"]["content"]
    except (ValueError, KeyError, IndexError, TypeError, RecursionError):
        return NoAnswer("not an OpenAI-compatible answer")
    return LlmAnswer(text) if isinstance(text, str) else NoAnswer("an answer without content")
