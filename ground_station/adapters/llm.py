"""Client of an OpenAI-compatible LLM server: one response, bounded in size and time."""

import asyncio
import json
import re
from dataclasses import dataclass
from typing import Any

import httpx

from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text

MAX_RESPONSE_BYTES = 1 << 20
MAX_REASON_LENGTH = 200
SCHEMA_REFUSED = (400, 422, 501)
"""Statuses of servers that know no `json_schema`."""
THOUGHTS = re.compile(r"\A<think>.*?</think>\s*", re.DOTALL)
FENCE = re.compile(r"```\w*\s*\n(.*?)\n?```", re.DOTALL)


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
    """Send a request; return the text of the model's response.

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
        return asyncio.run(_answer_within_limits(params, body))
    except (TimeoutError, httpx.TimeoutException):
        raise LeewayError(f"no complete response in {params.timeout_s:g} s") from None
    except (httpx.HTTPError, httpx.InvalidURL, httpx.StreamError, UnicodeError) as error:
        raise LeewayError(f"{params.url}: {error}"[:200]) from error


async def _answer_within_limits(params: LlmParams, body: dict[str, Any]) -> str:
    """Return the answer, asked once more without a schema where the server refuses that.

    httpx bounds each read only, and a server that sends its headers byte by byte never exceeds
    that: hence one time-out around everything.
    """
    async with asyncio.timeout(params.timeout_s):
        status, found, raw = await _fetch_response(params, body)
        if status in SCHEMA_REFUSED:
            without = {key: value for key, value in body.items() if key != "response_format"}
            status, found, raw = await _fetch_response(params, without)
    document = _decode_object(raw, found)
    if status != httpx.codes.OK:
        reason = _server_reason(document)
        raise LeewayError(f"HTTP status {status}, expected 200{reason and f': {reason}'}")
    return _answer_text(document)


def _decode_object(raw: bytes, content_type: str) -> dict[str, Any]:
    """Return a JSON object; of other content its type as an error."""
    try:
        document = json.loads(raw)
    except (ValueError, RecursionError):
        document = None
    if isinstance(document, dict):
        return document
    return {"error": f"found {content_type}, expected a JSON object"} if content_type else {}


def _server_reason(document: dict[str, Any]) -> str:
    """Return the text of an error object; `""`: none."""
    error = document.get("error")
    text = error.get("message") if isinstance(error, dict) else error
    return safe_text(text)[:MAX_REASON_LENGTH] if isinstance(text, str) else ""


def _answer_text(document: dict[str, Any]) -> str:
    """Return the model's text, without a block of thoughts before it and a fence around it."""
    try:
        choice = document["choices"][0]
        message, content = choice["message"], choice["message"]["content"]
        if isinstance(content, list):
            content = "".join(part["text"] for part in content if part.get("type") == "text")
        finish, refusal = choice.get("finish_reason"), message.get("refusal")
    except (KeyError, IndexError, TypeError, AttributeError) as error:
        reason = _server_reason(document) or "expected choices with a message"
        raise LeewayError(f"not an OpenAI-compatible response: {reason}") from error
    if refusal:
        raise LeewayError("the model refused to answer")
    if finish == "length":
        raise LeewayError("the answer is cut at the server's limit of tokens")
    if not isinstance(content, str) or not content.strip():
        raise LeewayError("response without content")
    text = THOUGHTS.sub("", content.strip())
    fenced = FENCE.fullmatch(text)
    return fenced[1] if fenced else text


async def _fetch_response(params: LlmParams, body: dict[str, Any]) -> tuple[int, str, bytes]:
    """Return status, content type and raw body of the response.

    Compressed responses are not requested or unpacked: they may unpack to any size.
    """
    headers = {"Accept-Encoding": "identity"}
    if params.key:
        headers["Authorization"] = f"Bearer {params.key}"
    url = f"{params.url.rstrip('/')}/chat/completions"
    async with (
        httpx.AsyncClient(timeout=params.timeout_s, follow_redirects=False) as client,
        client.stream("POST", url, json=body, headers=headers) as response,
    ):
        raw = b""
        async for chunk in response.aiter_raw():
            raw += chunk
            if len(raw) > MAX_RESPONSE_BYTES:
                raise LeewayError(f"response of more than {MAX_RESPONSE_BYTES} bytes")
        return response.status_code, response.headers.get("content-type", ""), raw
