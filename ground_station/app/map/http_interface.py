"""OpenAPI 3.1 document of the map's HTTP interface, from the types of its messages."""

from typing import Any

import msgspec

from ground_station.adapters.web.people import COMMANDS_PATH
from ground_station.app.map.picture import MapPicture
from ground_station.core.people.map_command_messages import WebCommand

VERSION = "1"
REF = "#/components/schemas/{name}"


class CommandReply(msgspec.Struct, frozen=True):
    """Result of a command that was carried out. `checks`: what a person has to look at."""

    messages: list[str]
    checks: list[str]


class CommandError(msgspec.Struct, frozen=True):
    """Reason for which a command was not carried out."""

    error: str


class Identity(msgspec.Struct, frozen=True, omit_defaults=True):
    """Holder of the request's token. `people`: the map has users; `token_to_read`: data needs a
    token; `may_order`: the holder may send commands.
    """

    people: bool
    may_order: bool
    token_to_read: bool
    name: str = ""
    role: str = ""


def openapi_document() -> dict[str, Any]:
    """Return the document; its JSON schemas are of the types that encode and decode messages."""
    types = (MapPicture, WebCommand, CommandReply, CommandError, Identity)
    (picture, command, reply, error, identity), schemas = msgspec.json.schema_components(
        types, ref_template=REF
    )
    errors = {
        "400": _content("Not a command", error),
        "401": {"description": "No valid token"},
        "409": _content("Refused, with the reason", error),
    }
    paths = {
        "/picture.json": {"get": _operation("Fleet, orders and plan of this moment", picture)},
        "/events": {"get": _stream("The same, as server-sent events: a picture, then patches")},
        "/order.json": {
            "get": _operation(
                "An order with its history and proof; status 204: unknown",
                {"type": "object"},
                "order",
            )
        },
        "/history.json": {
            "get": _operation(
                "Margins and P(home) of a drone's flight", {"type": "array"}, "vehicle"
            )
        },
        "/reach.json": {
            "get": _operation("Area in which a drone can land", {"type": "array"}, "vehicle")
        },
        "/me.json": {"get": _operation("Holder of the token", identity)},
        COMMANDS_PATH: {
            "post": {
                "summary": "Carry out one command of a dispatcher",
                "requestBody": {"required": True} | _json_content(command),
                "responses": {"200": _content("Carried out", reply), **errors},
            }
        },
        "/healthz": {"get": _text("The server runs")},
        "/readyz": {"get": _text("The picture is new; status 503: not ready")},
    }
    return {
        "openapi": "3.1.0",
        "info": {"title": "Leeway ground station", "version": VERSION},
        "paths": paths,
        "components": {
            "schemas": schemas,
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
        "security": [{"token": []}],
    }


def _json_content(schema: dict[str, Any]) -> dict[str, Any]:
    return {"content": {"application/json": {"schema": schema}}}


def _content(description: str, schema: dict[str, Any]) -> dict[str, Any]:
    return {"description": description} | _json_content(schema)


def _operation(summary: str, schema: dict[str, Any], parameter: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {"summary": summary, "responses": {"200": _content(summary, schema)}}
    if parameter:
        place = {"name": parameter, "in": "query", "required": True, "schema": {"type": "string"}}
        found["parameters"] = [place]
    return found


def _stream(summary: str) -> dict[str, Any]:
    events = {"description": summary, "content": {"text/event-stream": {}}}
    return {"summary": summary, "responses": {"200": events}}


def _text(summary: str) -> dict[str, Any]:
    return {"summary": summary, "security": [], "responses": {"200": {"description": summary}}}
