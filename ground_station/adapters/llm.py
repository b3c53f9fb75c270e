"""An LLM behind any OpenAI-compatible server: one question, one answer, within bounds."""

import asyncio
import json
from dataclasses import dataclass
from typing import Any

import httpx

LARGEST_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class LlmParams:
    """The server and the model. `url`: its base, for example http://127.0.0.1:8000/v1."""

    url: str
    model: str
    key: str | None = None
    timeout_s: float = 30.0


@dataclass(frozen=True, slots=True)
class LlmAnswer:
    """The text of the answer."""

    text: str


@dataclass(frozen=True, slots=True)
class NoAnswer:
    """Why there is no answer."""

    reason: str


def ask(params: LlmParams, system: str, user: str, schema: dict[str, Any]) -> LlmAnswer | NoAnswer:
    """Ask once. Takes at most `timeout_s` and 1 MiB, whatever the server does."""
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
    """The raw answer, within the bounds.

    httpx bounds each read, and a server that sends its headers byte by byte never exceeds that:
    hence one time-out around everything. Compressed answers are neither asked for nor unpacked:
    they may unpack to any size.
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
