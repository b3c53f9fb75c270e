"""What a process of the benchmark does: `members`, `tracks`, `desk` or `router`."""

import os
import sys
from pathlib import Path


def main() -> None:
    """As the command line says; never returns."""
    match sys.argv[1:]:
        case [
            "members",
            fleet,
            first,
            count,
            config,
            folder,
            seed,
            least_s,
            most_s,
            every_s,
            *stands,
        ]:
            from sim_bridge.research.benchmarks.fleet_bench import members

            members.serve(
                fleet, range(int(first), int(first) + int(count)), Path(config), Path(folder),
                members.AirTimes(int(seed), float(least_s), float(most_s)), float(every_s),
                members.read_stands(stands[0] if stands else None),
            )  # fmt: skip
        case ["desk", fleet, vehicles, order_every_s, config, url]:
            from sim_bridge.research.benchmarks.fleet_bench import desk_process

            desk_process.serve(fleet, int(vehicles), float(order_every_s), Path(config), url)
        case ["router", config]:
            _route(Path(config))
        case other:
            raise SystemExit(f"expected members, desk or router, got {other}")


def _route(config_file: Path) -> None:
    """A router: zenoh's own, until standard input ends."""
    import zenoh

    from companion.fleet.zenoh_config import read_config

    with zenoh.open(read_config(config_file)):
        sys.stdin.read()
    os._exit(0)
