"""The HTTP interface is as its OpenAPI document says, and the example client works with it."""

import re
import subprocess
import sys
from pathlib import Path

import httpx
import jsonschema
import pytest

from tests.ground_station.web.test_people import Desk, desk

__all__ = ("desk",)
pytestmark = pytest.mark.timeout(120)
CLIENT = Path(__file__).parents[3] / "examples" / "order_client.py"


def document_of(desk: Desk) -> dict:
    return httpx.get(f"{desk.address}/openapi.json").json()


def assert_described(document: dict, operation: dict, reply: httpx.Response) -> None:
    (content,) = operation["responses"][str(reply.status_code)]["content"].values()
    jsonschema.validate(reply.json(), content["schema"] | {"components": document["components"]})


def test_every_reply_fits_its_schema(desk: Desk) -> None:
    desk.site.until_flying("d1")
    document, token = document_of(desk), {"authorization": f"Bearer {desk.tokens['anna']}"}
    given = {"vehicle": "d1", "order": "H-101"}
    read = []
    for path, operations in document["paths"].items():
        operation = operations.get("get")
        if operation is None or "application/json" not in operation["responses"]["200"].get(
            "content", {}
        ):
            continue
        reply = httpx.get(f"{desk.address}{path}", params=given, headers=token)
        if reply.status_code == 204:  # nothing known of it
            continue
        assert_described(document, operation, reply)
        read.append(path)
    assert {"/picture.json", "/order.json", "/history.json", "/me.json"} <= set(read)
    picture = httpx.get(f"{desk.address}/picture.json").json()
    assert {"drones", "orders", "site"} <= picture.keys()
    operation = document["paths"]["/picture.json"]["get"]
    wrong = httpx.Response(200, json=picture | {"drones": 3})
    with pytest.raises(jsonschema.ValidationError):
        assert_described(document, operation, wrong)


@pytest.mark.parametrize(
    ("content", "status"),
    [
        ({"do": "hold", "vehicle": "d2", "reason": "propeller"}, 200),
        ({"do": "cancel", "order": "nosuch", "reason": "test"}, 409),
        ({"do": "fly"}, 400),
        ({"do": "hold", "vehicle": "d2"}, 400),
        ({"do": "hold", "vehicle": "d2", "reason": "motor", "out_of_service": True}, 200),
        ({"do": "hold", "reason": "motor", "spare": "d9"}, 409),
        ({"do": "confirm", "order": "nosuch", "pack": "P7"}, 409),
        ({"do": "hand_over", "note": "d1: motor"}, 200),
        ({"do": "accept"}, 409),
        ({"do": "cancel", "order": "H-105", "reason": "not at home", "to_sender": True}, 200),
    ],
    ids=[
        "done",
        "refused",
        "unknown",
        "incomplete",
        "out of service",
        "no drone",
        "pack",
        "hand over",
        "nothing to accept",
        "to sender",
    ],
)
def test_commands_and_their_replies_fit_the_document(desk: Desk, content: dict, status: int):
    desk.site.step()
    document = document_of(desk)
    operation = document["paths"]["/commands"]["post"]
    schema = operation["requestBody"]["content"]["application/json"]["schema"]
    schema |= {"components": document["components"]}
    reply = desk.post(content)
    assert reply.status_code == status, reply.text
    assert_described(document, operation, reply)
    assert jsonschema.Draft202012Validator(schema).is_valid(content) == (status != 400)


def test_a_request_without_a_valid_token_is_unauthorized(desk: Desk) -> None:
    assert desk.post_with("wrong", {"do": "recall"}).status_code == 401
    assert desk.post({"do": "recall"}, "vera").status_code == 409


def test_the_example_adds_changes_reads_and_cancels_an_order(desk: Desk) -> None:
    desk.site.step()
    command = [sys.executable, str(CLIENT), desk.address, desk.tokens["anna"]]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60.0)
    assert done.returncode == 0, done.stderr
    assert re.search(r"check: +SHOP-1: can be flown from the depot", done.stdout)
    assert re.search(r"read: +open ring twice", done.stdout)
    assert {row.order.id: row.state.value for row in desk.site.store.orders()}[
        "SHOP-1"
    ] == "cancelled"
    again = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60.0)
    assert again.returncode == 1
    assert "/commands: 409: " in again.stderr
