"""Order system that adds, changes and cancels an order over HTTP.

    ground-station token add shop --role dispatcher
    ground-station map --day harbour --tokens leeway-map-tokens.json
    python examples/order_client.py http://127.0.0.1:8714 TOKEN

Only Python's standard library is used.
"""

import json
import sys
from typing import Any
from urllib.error import HTTPError
from urllib.parse import quote
from urllib.request import Request, urlopen

ORDER = {"id": "SHOP-1", "lat_deg": "55.4695", "lon_deg": "8.4560", "alt_amsl_m": "12",
         "mass_kg": "0.4", "customer": "Shop counter", "priority": "urgent"}  # fmt: skip


def call(server: str, token: str, path: str, content: object = None) -> Any:
    """Return the decoded reply. Exits with the reason if the server refuses."""
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    data = None if content is None else json.dumps(content).encode()
    try:
        with urlopen(Request(server + path, data, headers), timeout=30.0) as reply:
            text = reply.read()
    except HTTPError as error:
        sys.exit(f"{path}: {error.code}: {error.read().decode()}")
    return json.loads(text) if text else None


def main(server: str, token: str) -> None:
    """Check, add, change, read and cancel one order."""

    def command(name: str, **fields: object) -> list[str]:
        reply = call(server, token, "/commands", {"do": name, **fields})
        return [*reply["checks"], *reply["messages"]]

    print("check: ", *command("add", cells=ORDER, check=True))
    print("add:   ", *command("add", cells=ORDER))
    print("change:", *command("change", order=ORDER["id"], cells={"note": "ring twice"}))
    found = call(server, token, f"/order.json?order={quote(ORDER['id'])}")
    print("read:  ", found["state"], found["note"])
    print("cancel:", *command("cancel", order=ORDER["id"], reason="test of the interface"))


if __name__ == "__main__":
    main(*sys.argv[1:])
