"""Scenario files: read back as written; errors name the location in one line."""

import json

import pytest

from companion.core.base.errors import LeewayError
from sim_bridge.research.planners.scenario import parse_scenario, scenario_json

CHAIN = {"kind": "chain", "states_en_mps": [[1, 2]], "rate_per_s": [[0]], "initial": [1]}
TWO_STATES = CHAIN | {"states_en_mps": [[0, 0], [1, 0]], "initial": [0.5, 0.5]}
LOG = {"kind": "log", "t_s": [0, 1], "wind_en_mps": [[1, 2], [2, 3]], "start_s": [0, 1]}
GOOD = {
    "format": "delivery-scenario/1",
    "name": "a",
    "vertices_m": [[0, 0, 0], [10, 20, 3], [5, 5, 5]],
    "edges": [[0, 1], [1, 0], [1, 2]],
    "depot": 0,
    "target": 1,
    "budget_wh": 100,
    "airspeed_mps": 15.0,
    "power_w": {"loaded": 2000.0, "empty": 1100.0},
    "wind": CHAIN,
}
NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize("wind", [CHAIN, LOG])
def test_a_scenario_is_read_back_as_it_was_written(wind):
    scenario = parse_scenario(json.dumps({**GOOD, "wind": wind}))
    assert parse_scenario(scenario_json(scenario)) == scenario


BROKEN = [
    ({"speed": 3}, "unknown field `speed`"),
    ({"format": "delivery-scenario/2"}, "format"),
    ({"depot": 7}, "depot"),
    ({"depot": True}, "depot"),
    ({"target": 0}, "target"),
    ({"target": -1}, "target"),
    ({"edges": [[0, 1], [1, 9]]}, "edges[1]"),
    ({"edges": [[0, 1, 2]]}, "edges[0]"),
    ({"edges": [[1, 0]]}, "target"),
    ({"edges": []}, "target"),
    ({"vertices_m": [[0, 0, 0], [NAN, 0, 0]], "edges": [[0, 1]]}, "vertices_m[1][0]"),
    ({"vertices_m": [[0, 0], [1, 0]]}, "vertices_m[0]"),
    ({"vertices_m": []}, "vertices_m"),
    ({"budget_wh": INF}, "budget_wh"),
    ({"budget_wh": -1.0}, "budget_wh"),
    ({"budget_wh": "100"}, "budget_wh"),
    ({"budget_wh": 10**400}, "budget_wh"),
    ({"airspeed_mps": 0.0}, "airspeed_mps"),
    ({"power_w": {"loaded": 1.0}}, "power_w"),
    ({"power_w": {"loaded": 1.0, "empty": 0.0}}, "power_w.empty"),
    ({"power_w": {"loaded": NAN, "empty": 1.0}}, "power_w.loaded"),
    ({"power_w": {"loaded": 1.0, "empty": 1.0, "hover": 1.0}}, "hover"),
    ({"airspeed_mps": NAN}, "airspeed_mps"),
    ({"wind": {"kind": "gale"}}, "wind.kind"),
    ({"wind": {**CHAIN, "gusts": 3}}, "gusts"),
    ({"wind": {**CHAIN, "rate_per_s": [[NAN]]}}, "wind.rate_per_s[0][0]"),
    ({"wind": {**CHAIN, "rate_per_s": []}}, "wind.rate_per_s"),
    ({"wind": {**CHAIN, "initial": [NAN]}}, "wind.initial[0]"),
    ({"wind": {**LOG, "t_s": [0, NAN]}}, "wind.t_s[1]"),
    ({"wind": {**LOG, "wind_en_mps": [[1, 2], [NAN, 3]]}}, "wind.wind_en_mps[1][0]"),
    ({"wind": {**LOG, "t_s": [], "wind_en_mps": []}}, "wind.t_s"),
    ({"wind": {**CHAIN, "rate_per_s": [[0.1]]}}, "wind.rate_per_s[0]"),
    ({"wind": {**CHAIN, "rate_per_s": [[0, 0]]}}, "wind.rate_per_s[0]"),
    ({"wind": {**CHAIN, "initial": [0.9]}}, "wind.initial"),
    ({"wind": {**CHAIN, "initial": [1.5, -0.5]}}, "wind.initial"),
    ({"wind": {**CHAIN, "states_en_mps": []}}, "wind.states_en_mps"),
    ({"wind": {**CHAIN, "states_en_mps": [[INF, 0]]}}, "wind.states_en_mps[0][0]"),
    ({"wind": {**LOG, "t_s": [1, 1]}}, "wind.t_s[1]"),
    ({"wind": {**LOG, "wind_en_mps": [[1, 2]]}}, "wind.wind_en_mps"),
    ({"wind": {**LOG, "start_s": [0, 5]}}, "wind.start_s"),
    ({"wind": {**LOG, "start_s": [1, 0]}}, "wind.start_s"),
    ({"wind": TWO_STATES | {"rate_per_s": [[0.1, -0.1], [0, 0]]}}, "wind.rate_per_s[0][1]"),
]


@pytest.mark.parametrize("key", GOOD)
def test_a_scenario_without_one_of_its_keys_is_refused_by_its_name(key):
    with pytest.raises(LeewayError, match=key):
        parse_scenario(json.dumps({k: v for k, v in GOOD.items() if k != key}))


@pytest.mark.parametrize(("change", "place"), BROKEN)
def test_a_broken_scenario_is_refused_in_one_line_that_names_the_place(change, place):
    with pytest.raises(LeewayError) as error:
        parse_scenario(json.dumps({**GOOD, **change}), "x.json")
    message = str(error.value)
    assert message.startswith("x.json: ")
    assert place in message
    assert "\n" not in message


@pytest.mark.parametrize("text", ["", "[1]", "{", '{"a": 1, "a": 2}', b"\xff\xfe", "[" * 100_000])
def test_what_is_not_a_scenario_at_all_is_refused_in_one_line(text):
    with pytest.raises(LeewayError) as error:
        parse_scenario(text)
    assert "\n" not in str(error.value)
