"""zenoh configurations of a fleet's members: TLS, endpoints, and access rules per certificate.

The rules apply at listening members and deny everything that they do not name. They keep strangers
out and limit members; signatures decide which messages count (`companion.fleet.trust`).
"""

import ipaddress
import json
from typing import Any

from companion.fleet.identity import TLS_CERTIFICATE
from companion.fleet.roles import (
    COMMANDERS,
    NEIGHBOURS,
    SERVERS,
    STATE_PUBLISHERS,
    WIND_STATIONS,
    Role,
)
from companion.fleet.roster import Roster, RosterMember
from companion.fleet.topics import VehicleKeys, desk_key, roster_key, station_wind_key
from companion.fleet.zenoh_config import BATCH_BYTES, LEASE_MS, RECEIVE_BUFFER_BYTES

TLS_KEY, TLS_CA = "tls.key", "ca.pem"

CONNECTION_LIMITS = {"max_sessions": 5000, "accept_pending": 1000}
"""Connection limits. zenoh's defaults are 1000 members, and 100 connecting at the same time: a
fleet that reconnects after an outage would have to wait.
"""

Rule = dict[str, Any]


def member_zenoh_config_json(roster: Roster, member: RosterMember) -> str:
    """Return a member's configuration; file names are relative to it."""
    listens = member.role in SERVERS and bool(member.address)
    table = (
        _listener_config(roster, member)
        if listens
        else {"mode": "client", "connect": _connect_config(_active_listeners(roster))}
    )
    table["scouting"] = {"multicast": {"enabled": False}}
    table["transport"] = {
        "link": {
            "tx": {"lease": LEASE_MS, "batch_size": BATCH_BYTES},
            "rx": {"buffer_size": RECEIVE_BUFFER_BYTES},
            "tls": _tls_config(is_listener=listens),
        },
        "shared_memory": {
            "enabled": False
        },  # equal to `read_and_check_zenoh_config`, for zenoh's own router
    }
    if listens:
        table["transport"]["unicast"] = CONNECTION_LIMITS
    return json.dumps(table, indent=2) + "\n"


def _listener_config(roster: Roster, member: RosterMember) -> dict[str, Any]:
    """A listener connects to all listeners before it on the roster, so that all are connected."""
    others = _active_listeners(roster)
    return {
        "mode": "router",
        "listen": {
            "endpoints": [f"tls/{_local_bind_address(member.address)}"],
            "exit_on_failure": True,
        },
        "connect": _connect_config(others[: others.index(member)]),
        "access_control": access_control_config(roster),
    }


def _active_listeners(roster: Roster) -> list[RosterMember]:
    return [m for m in roster.members if m.role in SERVERS and m.address and not m.revoked]


def _connect_config(listeners: list[RosterMember]) -> dict[str, Any]:
    """A vehicle flies on without a connection, and retries twice per second."""
    return {
        "endpoints": [f"tls/{member.address}" for member in listeners],
        "exit_on_failure": False,
        "timeout_ms": 0,
        "retry": {"period_init_ms": 200, "period_max_ms": 500},
    }


def _local_bind_address(address: str) -> str:
    """Return where to listen: a public address may differ locally, loopback does not."""
    host, _, port = address.rpartition(":")
    try:
        here = ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        here = host == "localhost"
    return address if here else f"0.0.0.0:{port}"


def _tls_config(*, is_listener: bool) -> dict[str, Any]:
    """`close_link_on_expiration` false: an ended certificate cuts no connection in flight; a new
    connection with an ended certificate is refused.
    """
    files = {
        "root_ca_certificate": TLS_CA,
        "connect_private_key": TLS_KEY,
        "connect_certificate": TLS_CERTIFICATE,
    }
    if is_listener:
        files |= {"listen_private_key": TLS_KEY, "listen_certificate": TLS_CERTIFICATE}
    options = {
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": False,
    }
    return files | options


# --- rules -----------------------------------------------------------------------------------


def access_control_config(roster: Roster) -> dict[str, Any]:
    """Return zenoh's access rules for a roster, as a listening desk or router uses them."""
    rules = {
        rule["id"]: rule for m in roster.members for rule in _access_rules_of_member(roster, m)
    }
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": list(rules.values()),
        "subjects": [
            {"id": m.name, "cert_common_names": [m.name]} for m in _active_members(roster)
        ],
        "policies": [
            {
                "rules": [rule["id"] for rule in _access_rules_of_member(roster, m)],
                "subjects": [m.name],
            }
            for m in _active_members(roster)
        ],
    }


def _active_members(roster: Roster) -> list[RosterMember]:
    return [member for member in roster.members if not member.revoked]


def _access_rules_of_member(roster: Roster, member: RosterMember) -> list[Rule]:
    if member.role in SERVERS:
        return [*_forward_all_rules(roster.fleet), *_forward_neighbour_rules(roster)]
    roster_rules = _roster_rules(roster.fleet)
    if member.role in NEIGHBOURS:
        return [*_track_rules(roster.fleet), *roster_rules]
    if member.role in STATE_PUBLISHERS:
        neighbour_rules = _neighbour_track_rules(roster) if member.role is Role.VEHICLE else []
        return [*_vehicle_rules(roster.fleet, member), *neighbour_rules, *roster_rules]
    if member.role in WIND_STATIONS:
        return [*_station_rules(roster.fleet, member), *roster_rules]
    monitor_rules = [*_monitor_rules(roster.fleet), *roster_rules]
    return (
        [*monitor_rules, *_commander_query_and_reply_rules(roster.fleet)]
        if member.role in COMMANDERS
        else monitor_rules
    )


def _allow_rule(rule_id: str, flow: str, message_types: list[str], *key_expressions: str) -> Rule:
    return {
        "id": rule_id,
        "permission": "allow",
        "flows": [flow],
        "messages": message_types,
        "key_exprs": list(key_expressions),
    }


def _forward_all_rules(fleet: str) -> list[Rule]:
    """Desks and routers forward all messages."""
    all_messages = [
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
        _allow_rule(f"all-{flow}", flow, all_messages, f"leeway/{fleet}/**")
        for flow in ("ingress", "egress")
    ]


def _vehicle_rules(fleet: str, member: RosterMember) -> list[Rule]:
    """A vehicle publishes only under its own name, and sends no queries or commands. It receives
    nearby tracks, other members' wind reports, and tokens of its own name. (`track/**` also matches
    `track_key`, the key of older vehicles.)
    """
    name, own = member.name, f"leeway/{fleet}/vehicle/{member.name}/**"
    all_vehicles = f"leeway/{fleet}/vehicle/*/**"
    wind = VehicleKeys(fleet, name).wind_key
    outgoing = ["put", "reply", "declare_queryable", "liveliness_token"]
    incoming = ["query", "liveliness_token", "declare_queryable", "declare_subscriber"]
    twins = ["declare_liveliness_subscriber", "liveliness_query"]
    return [
        _allow_rule(f"{name}-says", "ingress", outgoing, own),
        _allow_rule(f"{name}-hears", "egress", incoming, own),
        _allow_rule(f"{name}-twins", "ingress", twins, f"leeway/{fleet}/vehicle/{name}/alive/**"),
        _allow_rule(f"{name}-wind-asks", "ingress", ["declare_subscriber"], wind),
        _allow_rule(f"{name}-wind-hears", "egress", ["put"], wind),
        _allow_rule(
            "state-asked", "egress", ["query"], VehicleKeys(fleet, "*").state_key
        ),  # one query for all vehicles
        *_track_rules(fleet),
        *_desk_rules(fleet),
        _allow_rule(
            "desk-interest",
            "egress",
            ["declare_subscriber", "declare_liveliness_subscriber"],
            all_vehicles,
        ),
    ]


def _desk_rules(fleet: str) -> list[Rule]:
    """Vehicles receive the heartbeats of desks."""
    desks = desk_key(fleet, "*")
    return [
        _allow_rule("desk-asks", "ingress", ["declare_subscriber"], desks),
        _allow_rule("desk-hears", "egress", ["put"], desks),
    ]


def _track_rules(fleet: str) -> list[Rule]:
    """Vehicles, and desks of neighbouring fleets, receive the fleet's tracks."""
    tracks = VehicleKeys(fleet, "*").track_key("**")
    return [
        _allow_rule("near-asks", "ingress", ["declare_subscriber"], tracks),
        _allow_rule("near-hears", "egress", ["put"], tracks),
    ]


def _neighbour_track_rules(roster: Roster) -> list[Rule]:
    """A vehicle receives tracks of neighbouring fleets, which the desk publishes here."""
    tracks = _neighbour_track_keys(roster)
    if not tracks:
        return []
    return [
        _allow_rule("beside-asks", "ingress", ["declare_subscriber"], *tracks),
        _allow_rule("beside-hears", "egress", ["put"], *tracks),
    ]


def _forward_neighbour_rules(roster: Roster) -> list[Rule]:
    """Desks and routers forward neighbours' tracks."""
    tracks, messages = _neighbour_track_keys(roster), ["put", "declare_subscriber"]
    if not tracks:
        return []
    return [
        _allow_rule(f"beside-all-{flow}", flow, messages, *tracks) for flow in ("ingress", "egress")
    ]


def _neighbour_track_keys(roster: Roster) -> list[str]:
    return [VehicleKeys(fleet, "*").track_key("**") for fleet in roster.neighbour_fleet_names]


def _station_rules(fleet: str, member: RosterMember) -> list[Rule]:
    """A wind station publishes its own wind and receives nothing."""
    own = station_wind_key(fleet, member.name)
    return [
        _allow_rule(f"{member.name}-measures", "ingress", ["put"], own),
        _allow_rule(
            "station-interest", "egress", ["declare_subscriber"], station_wind_key(fleet, "*")
        ),
    ]


def _monitor_rules(fleet: str) -> list[Rule]:
    """Monitoring members receive states, events and liveliness, and query missed events."""
    keys = VehicleKeys(fleet, "*")
    alive, stations = f"leeway/{fleet}/vehicle/*/alive/**", station_wind_key(fleet, "*")
    shown = [keys.state_key, keys.event_key, alive, stations, desk_key(fleet, "*")]
    requests = [
        "query",
        "declare_subscriber",
        "declare_liveliness_subscriber",
        "liveliness_query",
    ]
    incoming = ["put", "reply", "liveliness_token", "declare_queryable"]
    return [
        _allow_rule("looks-asks", "ingress", requests, *shown),
        _allow_rule("looks-hears", "egress", incoming, *shown),
    ]


def _commander_query_and_reply_rules(fleet: str) -> list[Rule]:
    """Commanding members query vehicles and receive their responses."""
    key = VehicleKeys(fleet, "*").command_key
    return [
        _allow_rule("commands", "ingress", ["query"], key),
        _allow_rule("commands-answered", "egress", ["reply", "declare_queryable"], key),
    ]


def _roster_rules(fleet: str) -> list[Rule]:
    requests, incoming = ["declare_subscriber", "query"], ["put", "reply", "declare_queryable"]
    return [
        _allow_rule("roster-asks", "ingress", requests, roster_key(fleet)),
        _allow_rule("roster-hears", "egress", incoming, roster_key(fleet)),
    ]
