"""Client of an OpenAI-compatible LLM server: one request, one response, both bounded."""

import asyncio
import json
from dataclasses import dataclass
from typing import Any

import httpx

MAX_RESPONSE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class LlmParams:
    """Server and model. `url`: base URL, for example http://127.0.0.1:8000/v1."""

    url: str
    model: str
    key: str | None = None
    timeout_s: float = 30.0


@dataclass(frozen=True, slots=True)
class LlmResponse:
    """Text of the model's response."""

    text: str


@dataclass(frozen=True, slots=True)
class NoLlmResponse:
    """Reason for a missing response."""

    reason: str


def request_completion(
    params: LlmParams, system_prompt: str, user_prompt: str, response_schema: dict[str, Any]
) -> LlmResponse | NoLlmResponse:
    """Send one request. Bounded by `timeout_s` and 1 MiB, whatever the server does."""
    body = {
        "model": params.model,
        "temperature": 0,
        "messages": [
            {"role": "system", "content": system_prompt},
            {"role": "user", "content": user_prompt},
        ],
        "response_format": {
            "type": "json_schema",
            "json_schema": {"name": "clusters", "strict": True, "schema": response_schema},
        },
    }
    try:
        raw = asyncio.run(_fetch_response_within_limits(params, body))
    except (TimeoutError, httpx.TimeoutException):
        return NoLlmResponse(f"no complete response in {params.timeout_s:g} s")
    except (httpx.HTTPError, httpx.InvalidURL, httpx.StreamError, UnicodeError) as error:
        return NoLlmResponse(f"{type(error).__name__}: {error}"[:200])
    return raw if isinstance(raw, NoLlmResponse) else _parse_response(raw)


async def _fetch_response_within_limits(
    params: LlmParams, body: dict[str, Any]
) -> bytes | NoLlmResponse:
    """Return the raw response body, within the bounds.

    httpx bounds each read only, and a server that sends its headers byte by byte never exceeds
    that: hence one time-out around everything. Compressed responses are not requested or unpacked:
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
            return NoLlmResponse(f"HTTP status {response.status_code}, expected 200")
        raw = b""
        async for chunk in response.aiter_raw():
            raw += chunk
            if len(raw) > MAX_RESPONSE_BYTES:
                return NoLlmResponse(f"response of more than {MAX_RESPONSE_BYTES} bytes")
        return raw


def _parse_response(raw: bytes) -> LlmResponse | NoLlmResponse:
    try:
        text = json.loads(raw)["choices"][0]["message"]["content"]
    except (ValueError, KeyError, IndexError, TypeError, RecursionError):
        return NoLlmResponse("not an OpenAI-compatible response")
    return LlmResponse(text) if isinstance(text, str) else NoLlmResponse("response without content")
