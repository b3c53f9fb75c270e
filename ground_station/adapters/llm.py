"""Client of an OpenAI-compatible LLM server: one request, one response, both bounded."""

import asyncio
import json
from dataclasses import dataclass
from typing import Any

import httpx

from companion.core.base.errors import LeewayError

MAX_RESPONSE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class LlmParams:
    """Server and model. `url`: base URL, for example http://127.0.0.1:8000/v1."""

    url: str
    model: str
    key: str | None = None
    timeout_s: float = 30.0


def request_completion(
    params: LlmParams, system_prompt: str, user_prompt: str, response_schema: dict[str, Any]
) -> str:
    """Send one request; return the text of the model's response.

    Bounded by `timeout_s` and 1 MiB, whatever the server does. Raises LeewayError without one.
    """
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
        raise LeewayError(f"no complete response in {params.timeout_s:g} s") from None
    except (httpx.HTTPError, httpx.InvalidURL, httpx.StreamError, UnicodeError) as error:
        raise LeewayError(f"{type(error).__name__}: {error}"[:200]) from error
    try:
        text = json.loads(raw)["choices"][0]["message"]["content"]
    except (ValueError, KeyError, IndexError, TypeError, RecursionError) as error:
        raise LeewayError("not an OpenAI-compatible response") from error
    if not isinstance(text, str):
        raise LeewayError("response without content")
    return text


async def _fetch_response_within_limits(params: LlmParams, body: dict[str, Any]) -> bytes:
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
            raise LeewayError(f"HTTP status {response.status_code}, expected 200")
        raw = b""
        async for chunk in response.aiter_raw():
            raw += chunk
            if len(raw) > MAX_RESPONSE_BYTES:
                raise LeewayError(f"response of more than {MAX_RESPONSE_BYTES} bytes")
        return raw
