"""The tables of commands that print for a terminal, again from the JSON that they write."""

import json
from collections.abc import Callable

import msgspec

from sim_bridge.research.result_pages.markdown import MarkdownConsole, plain, table_markdown
from sim_bridge.research.result_pages.page import DATA, CommandOutput


def flights(done: CommandOutput) -> str:
    """Of `sim-bridge fly --json {out}/on.json`."""
    return _flights(done, gate=True)


def flights_without_gate(done: CommandOutput) -> str:
    """Of `sim-bridge fly --gate off --json {out}/off.json`."""
    return _flights(done, gate=False)


def _flights(done: CommandOutput, *, gate: bool) -> str:
    from sim_bridge.app.flight.report import results_table

    console = MarkdownConsole()
    console.print(results_table(done.json("on.json" if gate else "off.json"), gate=gate))
    return console.markdown


def series(done: CommandOutput) -> str:
    """Of `sim-bridge series --json {out}/series.json`."""
    from sim_bridge.app.flight.series import summary

    return table_markdown(summary(done.json("series.json")["flights"]))


def crossings(done: CommandOutput) -> str:
    """Of `sim-bridge cross --json {out}/cross.json`."""
    from sim_bridge.app.crossing.report import seed_words, verdict_words

    rows = done.json("cross.json")["crossings"]
    lines = [f"{verdict_words(rows)}.", "", *(f"- {plain(seed_words(row))}" for row in rows)]
    return "\n".join(lines)


def days(file: str) -> Callable[[CommandOutput], str]:
    """Of `sim-bridge day --seeds ... --json {out}/FILE`."""

    def show(done: CommandOutput) -> str:
        from sim_bridge.app.day.report import print_days

        console = MarkdownConsole()
        print_days(console, done.json(file)["days"])
        return console.markdown

    return show


def nothing(_: CommandOutput) -> str:
    """Of a command that only prepares the next."""
    return ""


def makespans(done: CommandOutput) -> str:
    """Of `ground-station benchmark mfstsp DIR --json {out}/mfstsp.json`."""
    from ground_station.adapters.files.mfstsp_files import RESULTS, read_published
    from ground_station.app.benchmarks.mfstsp_report import print_report

    if done.data is None:
        raise ValueError(f"makespans: expected {DATA}")
    console = MarkdownConsole()
    heuristic, program = read_published(done.data / "mfstsp" / RESULTS)
    print_report(console, done.json("mfstsp.json")["rows"], heuristic, program)
    return console.markdown


def small_operations(done: CommandOutput) -> str:
    """Of `ground-station benchmark tspd DIR --json {out}/small.json`."""
    return _operations(done, "small.json")


def slow_drone_operations(done: CommandOutput) -> str:
    """Of `ground-station benchmark tspd DIR --json {out}/alpha_1.json`."""
    return _operations(done, "alpha_1.json")


def fast_drone_operations(done: CommandOutput) -> str:
    """Of `ground-station benchmark tspd DIR --json {out}/alpha_2_3.json`."""
    return _operations(done, "alpha_2_3.json")


def _operations(done: CommandOutput, file: str) -> str:
    from ground_station.adapters.files.tspd_files import (
        MEANS,
        instance_files,
        read_means,
        read_optimum,
    )
    from ground_station.app.benchmarks.tspd_report import print_tspd_report

    if done.data is None:
        raise ValueError(f"operations: expected {DATA}")
    console = MarkdownConsole()
    folder = done.data / "tspd"
    optima = {path.stem: read_optimum(path) for path in instance_files(folder)}
    known = {name: cost for name, cost in optima.items() if cost is not None}
    rows = done.json(file)["rows"]
    print_tspd_report(console, rows, read_means(folder / MEANS), known)
    return console.markdown


def speeds(done: CommandOutput) -> str:
    """Of `sim-bridge research bench flight --json {out}/bench.json`."""
    rows = done.json("bench.json")["rows"]
    lines = ["| what | values | goal |", "| --- | --- | --- |"]
    for row in rows:
        values = ", ".join(f"{value:.1f}" for value in row["values"])
        lines.append(f"| {row['what'].strip()} | {values} {row['unit']} | {row['goal']} |")
    return "\n".join(lines)


FLEET_ROWS = (
    ("time to acknowledgement, median", "ack_ms_p50", "ms", "200"),
    ("time to acknowledgement, p99", "ack_ms_p99", "ms", "500"),
    ("commands", "commands", "", ""),
    ("of them unanswered", "unanswered", "", "0"),
    ("members falsely gone", "false_gone", "", "0"),
    ("members told as gone, the cut off among them", "gone_under_faults", "", ""),
    ("a desk's share of a core", "desk_cpu_frac", "", "0.30"),
    ("all desks' share of a core", "desks_cpu_frac", "", ""),
    ("a desk's memory, the most seen", "desk_rss_mb", "MB", "300"),
    ("all routers' share of a core", "routers_cpu_frac", "", ""),
    ("a router's memory, the most", "router_rss_mb", "MB", ""),
    ("all members' share of a core", "members_cpu_frac", "", ""),
    ("all members' memory", "members_rss_mb", "MB", ""),
    ("store grows", "store_mb_per_hour", "MB/h", ""),
    ("all had joined after", "joined_s", "s", "30"),
    ("killed, a desk heard all again after", "desk_back_s", "s", "10"),
    ("members heard at the end", "present_at_end", "", ""),
    ("orders", "orders", "", ""),
    ("delivered", "delivered", "", ""),
    ("flown twice", "twice", "", "0"),
    ("lost", "lost", "", "0"),
)
"""What is shown, its key, its unit, and the goal."""

WAITS = ("ack_ms_p50", "ack_ms_p99")
"""An answer waits for a desk that is dead and for a member that is cut off: there is no goal."""


def fleet(done: CommandOutput) -> str:
    """Of `sim-bridge research bench-fleet`."""
    figures = json.loads(done.printed)
    load = ", ".join(map(str, figures["load_of_machine"]))
    lines = ["| what | value | goal |", "| --- | --- | --- |"]
    waits = figures.get("desk_back_s") is not None
    for what, key, unit, goal in FLEET_ROWS:
        value = figures.get(key)
        if value is not None:
            stated = "" if waits and key in WAITS else goal
            lines.append(f"| {what} | {f'{value:,} {unit}'.strip()} | {stated} |")
    never = "" if figures["joined_s"] is not None else " Not all members had joined in time."
    return "\n".join([*lines, "", f"Load of the machine before, 1 and 5 minutes: {load}.{never}"])


def tight_faults(done: CommandOutput) -> str:
    """Of `sim-bridge faults --tight --json {out}/tight.json`."""
    from sim_bridge.app.fault_suite.promises import reliability
    from sim_bridge.app.fault_suite.report import promises
    from sim_bridge.app.faults.fault_row import FaultRow

    rows = msgspec.convert(done.json("tight.json")["rows"], list[FaultRow])
    lines = ["| P(home) said | flights | mean of it | came home |", "| --- | --- | --- | --- |"]
    for each in reliability(rows):
        shares = f"{each.flights} | {each.p_home:.4f} | {each.home:.4f}"
        lines.append(f"| {each.from_p:g} to {each.to_p:g} | {shares} |")
    flown = sum(row.p_home_last_go is not None for row in rows)
    words = f"{len(rows)} flights, of which {flown} had energy enough to be begun."
    parts = map(table_markdown, promises(rows, by_fault=True))
    return "\n\n".join([words, "\n".join(lines), *parts])


def stops_of_the_town(done: CommandOutput) -> str:
    """Of `ground-station benchmark day-plan --day town --json {out}/town.json`."""
    return _stops(done, "town.json")


def stops_of_the_villages(done: CommandOutput) -> str:
    """Of `ground-station benchmark day-plan --day villages --json {out}/villages.json`."""
    return _stops(done, "villages.json")


def _stops(done: CommandOutput, name: str) -> str:
    from ground_station.app.benchmarks.day_bench import DayPromises, print_promises

    console = MarkdownConsole()
    print_promises(console, msgspec.convert(done.json(name), DayPromises))
    return console.markdown


def sizes(done: CommandOutput) -> str:
    """Of `deploy/measure-sizes --json {out}/sizes.json`."""
    figures = done.json("sizes.json")
    lines = ["| install | GB | what draws the map, of it, MB |", "| --- | --- | --- |"]
    for row in figures["sizes"]:
        assets = f"{row['map_assets_mb']:.1f}" if row["map_assets_mb"] else "not fetched"
        lines.append(f"| `{row['install']}` | {row['held_gb']:.2f} | {assets} |")
    return "\n".join([*lines, "", f"{figures['python']}. GB: 1,000,000,000 bytes."])


def arm_wheels(done: CommandOutput) -> str:
    """Of `deploy/check-arm-wheels --json {out}/wheels.json`: wheels by install and Python."""
    rows = done.json("wheels.json")["rows"]
    pythons = list(dict.fromkeys(row["python"] for row in rows))
    lines = [f"| install | {' | '.join(f'Python {python}' for python in pythons)} |"]
    lines.append(f"| --- |{' --- |' * len(pythons)}")
    for install in dict.fromkeys(row["install"] for row in rows):
        cells = [_wheels(row) for row in rows if row["install"] == install]
        lines.append(f"| `{install}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def _wheels(row: dict[str, str | int | None]) -> str:
    return plain(str(row["why"])) if row["wheels"] is None else f"{row['wheels']} wheels"


"""Frames a second of the live map's page, in software rendering."""
