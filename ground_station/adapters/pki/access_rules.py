"""zenoh configurations of a fleet's members: TLS, whom they call, and what each certificate may do.

The rules stand where others call in, and deny what they do not name. They keep strangers and
members apart on the network; what is believed is decided by signatures (`companion.fleet.trust`).
"""

import ipaddress
import json
from typing import Any

from companion.fleet.identity import TLS_CERTIFICATE
from companion.fleet.roles import COMMANDS, LISTENS, MEASURES, NEIGHBOURS, SPEAKS, Role
from companion.fleet.roster import Roster, RosterMember
from companion.fleet.topics import VehicleKeys, roster_key, station_key
from companion.fleet.zenoh_config import BATCH_BYTES, LEASE_MS, RECEIVE_BUFFER_BYTES

TLS_KEY, TLS_AUTHORITIES = "tls.key", "ca.pem"

MANY_CALLERS = {"max_sessions": 5000, "accept_pending": 1000}
"""zenoh's own limits are 1000 members, and 100 of them calling at the same moment: a fleet that
comes back after a cut would wait for its turn.
"""

Rule = dict[str, Any]


def zenoh_json(roster: Roster, member: RosterMember) -> str:
    """A member's configuration; files are named as they lie beside it."""
    listens = member.role in LISTENS and bool(member.address)
    table = _listener(roster, member) if listens else _client(roster)
    table["scouting"] = {"multicast": {"enabled": False}}
    table["transport"] = {
        "link": {
            "tx": {"lease": LEASE_MS, "batch_size": BATCH_BYTES},
            "rx": {"buffer_size": RECEIVE_BUFFER_BYTES},
            "tls": _tls(listens=listens),
        },
        "shared_memory": {"enabled": False},  # all as `read_config` has it: for zenoh's own router
    }
    if listens:
        table["transport"]["unicast"] = MANY_CALLERS
    return json.dumps(table, indent=2) + "\n"


def _client(roster: Roster) -> dict[str, Any]:
    return {"mode": "client", "connect": _calls(_listeners(roster))}


def _listener(roster: Roster, member: RosterMember) -> dict[str, Any]:
    """It calls those that listen and stand before it on the roster, so that all are joined."""
    others = _listeners(roster)
    return {
        "mode": "router",
        "listen": {"endpoints": [f"tls/{_bind(member.address)}"], "exit_on_failure": True},
        "connect": _calls(others[: others.index(member)]),
        "access_control": access_control(roster),
    }


def _listeners(roster: Roster) -> list[RosterMember]:
    return [m for m in roster.members if m.role in LISTENS and m.address and not m.revoked]


def _calls(whom: list[RosterMember]) -> dict[str, Any]:
    """A vehicle flies on where nobody is there, and calls again twice a second."""
    return {
        "endpoints": [f"tls/{member.address}" for member in whom],
        "exit_on_failure": False,
        "timeout_ms": 0,
        "retry": {"period_init_ms": 200, "period_max_ms": 500},
    }


def _bind(address: str) -> str:
    """Where to listen: an address on the outside may be another one here, loopback is not."""
    host, _, port = address.rpartition(":")
    try:
        here = ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        here = host == "localhost"
    return address if here else f"0.0.0.0:{port}"


def _tls(*, listens: bool) -> dict[str, Any]:
    """`close_link_on_expiration` false: a certificate that ends cuts nothing in flight; who shows
    an ended one when it calls is not let in.
    """
    files = {
        "root_ca_certificate": TLS_AUTHORITIES,
        "connect_private_key": TLS_KEY,
        "connect_certificate": TLS_CERTIFICATE,
    }
    if listens:
        files |= {"listen_private_key": TLS_KEY, "listen_certificate": TLS_CERTIFICATE}
    ways = {"enable_mtls": True, "verify_name_on_connect": True, "close_link_on_expiration": False}
    return files | ways


# --- rules -----------------------------------------------------------------------------------


def access_control(roster: Roster) -> dict[str, Any]:
    """zenoh's rules for all of a roster, as a desk or router that others call holds them."""
    rules = {rule["id"]: rule for m in roster.members for rule in _rules_of(roster, m)}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": list(rules.values()),
        "subjects": [{"id": m.name, "cert_common_names": [m.name]} for m in _allowed(roster)],
        "policies": [
            {"rules": [rule["id"] for rule in _rules_of(roster, m)], "subjects": [m.name]}
            for m in _allowed(roster)
        ],
    }


def _allowed(roster: Roster) -> list[RosterMember]:
    return [member for member in roster.members if not member.revoked]


def _rules_of(roster: Roster, member: RosterMember) -> list[Rule]:
    if member.role in LISTENS:
        return [*_carries_all(roster.fleet), *_carries_neighbours(roster)]
    told = _hears_roster(roster.fleet)
    if member.role in NEIGHBOURS:
        return [*_near(roster.fleet), *told]
    if member.role in SPEAKS:
        beside = _beside(roster) if member.role is Role.VEHICLE else []
        return [*_speaks(roster.fleet, member), *beside, *told]
    if member.role in MEASURES:
        return [*_measures(roster.fleet, member), *told]
    looks = [*_looks(roster.fleet), *told]
    return [*looks, *_commands(roster.fleet)] if member.role in COMMANDS else looks


def _rule(id_: str, flow: str, messages: list[str], *keys: str) -> Rule:
    return {
        "id": id_,
        "permission": "allow",
        "flows": [flow],
        "messages": messages,
        "key_exprs": list(keys),
    }


def _carries_all(fleet: str) -> list[Rule]:
    """Desks and routers pass on what others say."""
    every = [
        "put",
        "delete",
        "query",
        "reply",
        "declare_subscriber",
        "declare_queryable",
        "liveliness_token",
        "liveliness_query",
        "declare_liveliness_subscriber",
    ]
    return [
        _rule(f"all-{flow}", flow, every, f"leeway/{fleet}/**") for flow in ("ingress", "egress")
    ]


def _speaks(fleet: str, member: RosterMember) -> list[Rule]:
    """A vehicle speaks for itself only, asks nothing, commands nobody, and hears of its neighbours'
    places, of the winds that others feel, and of others of its own name. (`track/**` is `track`,
    too: where vehicles of before told them.)
    """
    name, own = member.name, f"leeway/{fleet}/vehicle/{member.name}/**"
    everybody = f"leeway/{fleet}/vehicle/*/**"
    wind = VehicleKeys(fleet, name).wind
    says = ["put", "reply", "declare_queryable", "liveliness_token"]
    hears = ["query", "liveliness_token", "declare_queryable", "declare_subscriber"]
    twins = ["declare_liveliness_subscriber", "liveliness_query"]
    return [
        _rule(f"{name}-says", "ingress", says, own),
        _rule(f"{name}-hears", "egress", hears, own),
        _rule(f"{name}-twins", "ingress", twins, f"leeway/{fleet}/vehicle/{name}/alive/**"),
        _rule(f"{name}-wind-asks", "ingress", ["declare_subscriber"], wind),
        _rule(f"{name}-wind-hears", "egress", ["put"], wind),
        _rule("state-asked", "egress", ["query"], VehicleKeys(fleet, "*").state),  # of all at once
        *_near(fleet),
        _rule(
            "desk-interest",
            "egress",
            ["declare_subscriber", "declare_liveliness_subscriber"],
            everybody,
        ),
    ]


def _near(fleet: str) -> list[Rule]:
    """Who is near, a neighbouring fleet's desk for its vehicles too, hears the fleet's tracks."""
    tracks = VehicleKeys(fleet, "*").track("**")
    return [
        _rule("near-asks", "ingress", ["declare_subscriber"], tracks),
        _rule("near-hears", "egress", ["put"], tracks),
    ]


def _beside(roster: Roster) -> list[Rule]:
    """A vehicle hears the tracks of neighbouring fleets, which the desk tells here."""
    tracks = _neighbours_tracks(roster)
    if not tracks:
        return []
    return [
        _rule("beside-asks", "ingress", ["declare_subscriber"], *tracks),
        _rule("beside-hears", "egress", ["put"], *tracks),
    ]


def _carries_neighbours(roster: Roster) -> list[Rule]:
    """Desks and routers pass neighbours' tracks on."""
    tracks, messages = _neighbours_tracks(roster), ["put", "declare_subscriber"]
    if not tracks:
        return []
    return [_rule(f"beside-all-{flow}", flow, messages, *tracks) for flow in ("ingress", "egress")]


def _neighbours_tracks(roster: Roster) -> list[str]:
    return [VehicleKeys(fleet, "*").track("**") for fleet in roster.neighbours]


def _measures(fleet: str, member: RosterMember) -> list[Rule]:
    """A wind station tells its own wind, and hears nobody."""
    own = station_key(fleet, member.name)
    return [
        _rule(f"{member.name}-measures", "ingress", ["put"], own),
        _rule("station-interest", "egress", ["declare_subscriber"], station_key(fleet, "*")),
    ]


def _looks(fleet: str) -> list[Rule]:
    """Who only looks: states, events, who is there; and asks for what it missed."""
    keys = VehicleKeys(fleet, "*")
    alive, stations = f"leeway/{fleet}/vehicle/*/alive/**", station_key(fleet, "*")
    shown = [keys.state, keys.event, alive, stations]
    asks = [
        "query",
        "declare_subscriber",
        "declare_liveliness_subscriber",
        "liveliness_query",
    ]
    hears = ["put", "reply", "liveliness_token", "declare_queryable"]
    return [
        _rule("looks-asks", "ingress", asks, *shown),
        _rule("looks-hears", "egress", hears, *shown),
    ]


def _commands(fleet: str) -> list[Rule]:
    """Who may command asks vehicles and hears their answers."""
    key = VehicleKeys(fleet, "*").command
    return [
        _rule("commands", "ingress", ["query"], key),
        _rule("commands-answered", "egress", ["reply", "declare_queryable"], key),
    ]


def _hears_roster(fleet: str) -> list[Rule]:
    asks, hears = ["declare_subscriber", "query"], ["put", "reply", "declare_queryable"]
    return [
        _rule("roster-asks", "ingress", asks, roster_key(fleet)),
        _rule("roster-hears", "egress", hears, roster_key(fleet)),
    ]
