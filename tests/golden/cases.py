"""Cases that both sides run, and the files that are compared."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SIMULATOR, COMPANION = "sim_bridge.main", "companion.app.cli.main"
DESK = "ground_station.app.cli.main"


@dataclass(frozen=True, slots=True)
class Case:
    """One command. `{out}` is the side's own folder, `{base}` the base's, `{shared}` common input.

    `files`: JSON files and recordings (.tlog) that it writes to `{out}`. `after`: a case of the
    base that has to finish first.
    """

    name: str
    program: str
    arguments: tuple[str, ...]
    files: tuple[str, ...]
    after: str = ""


def flight(autopilot: str, gate: str, seed: int) -> Case:
    """Return a flight with the settings of `make fly`."""
    name = f"fly-{autopilot}-{gate}-{seed}"
    given = ("--autopilot", autopilot, "--gate", gate, "--seed", str(seed))
    written = ("--json", f"{{out}}/{name}.json", "--runs", f"{{out}}/{name}")
    files = (f"{name}.json", f"{name}/*/stream.tlog")
    return Case(name, SIMULATOR, ("fly", "--no-picture", *given, *written), files)


def replay(of: Case) -> Case:
    """Return the replay of a recording of the base through estimator and gate."""
    name = f"replay-{of.name}"
    given = ("{base}/" + of.files[1], "--airframe", "m100", "--json", f"{{out}}/{name}.json")
    return Case(name, COMPANION, ("replay", *given), (f"{name}.json",), after=of.name)


def day(name: str, seed: int) -> Case:
    """Return a simulated day."""
    out = f"day-{name}-{seed}"
    written = ("--json", f"{{out}}/{out}.json", "--runs", f"{{out}}/{out}")
    return Case(out, SIMULATOR, ("day", name, "--seed", str(seed), *written), (f"{out}.json",))


def plan(name: str, policy: str, seed: int) -> Case:
    """Return the planning of a day."""
    out = f"plan-{name}-{policy}-{seed}"
    given = ("--policy", policy, "--seed", str(seed), "--trials", "20000")
    written = ("--out", f"{{out}}/{out}.json")
    return Case(out, DESK, ("plan", name, *given, *written), (f"{out}.json",))


PLANNERS = ("ber", "ber-paper", "rer", "ser", "ger")
SCENARIOS = 4


def campaign() -> Case:
    """Return a campaign of twenty rows: four scenarios, five planners."""
    scenarios = tuple(f"{{shared}}/scenario-{number}.json" for number in range(SCENARIOS))
    planners = tuple(word for name in PLANNERS for word in ("--planner", name))
    given = ("--missions", "200", "--seed", "1", "--jobs", "1", "--json", "{out}/campaign.json")
    return Case(
        "campaign",
        SIMULATOR,
        ("research", "campaign", *scenarios, *planners, *given),
        ("campaign.json",),
    )


def write_scenarios(folder: Path) -> None:
    """Write delivery-scenario/1 files: random graphs in three winds."""
    for number in range(SCENARIOS):
        rng = np.random.default_rng(number)
        places = rng.uniform(0.0, 900.0, (14, 2)).round(1)
        edges = {(a, (a + step) % 14) for a in range(14) for step in (1, 13, 3, 11)}
        scenario = {
            "format": "delivery-scenario/1",
            "name": f"golden-{number}",
            "vertices_m": [[float(east), float(north), 40.0] for east, north in places],
            "edges": [list(edge) for edge in sorted(edges)],
            "depot": 0,
            "target": 7,
            "budget_wh": 120.0,
            "airspeed_mps": 15.0,
            "power_w": {"loaded": 1450.0, "empty": 1100.0},
            "wind": {
                "kind": "chain",
                "states_en_mps": [[6.0, 0.0], [-4.0, 5.0], [0.0, -9.0]],
                "rate_per_s": [
                    [-0.004, 0.002, 0.002],
                    [0.002, -0.004, 0.002],
                    [0.002, 0.002, -0.004],
                ],
                "initial": [0.4, 0.3, 0.3],
            },
        }
        (folder / f"scenario-{number}.json").write_text(json.dumps(scenario))


def chosen(size: str) -> list[Case]:
    """Return the cases of a set: `two`, `six` or `full`."""
    if size == "two":
        return [flight("px4", "on", 1), flight("ardupilot", "on", 1)]
    if size == "six":
        flights = [
            flight(autopilot, "on", seed)
            for autopilot in ("px4", "ardupilot")
            for seed in (1, 2, 3)
        ]
        return [*flights, replay(flights[0])]
    flights = [
        flight(autopilot, gate, seed)
        for autopilot in ("px4", "ardupilot")
        for gate in ("on", "off")
        for seed in range(1, 11)
    ]
    plans = [plan("harbour", policy, seed) for policy in ("search", "dynamic") for seed in (1, 2)]
    return [
        *flights,
        *(replay(one) for one in flights[::4]),
        day("harbour", 1),
        day("town", 2),
        campaign(),
        *plans,
        plan("town", "dynamic", 1),
    ]
