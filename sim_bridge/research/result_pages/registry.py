"""Every page of docs/results that a command makes. Order: as the reader of the index meets them."""

from sim_bridge.research.result_pages import tables
from sim_bridge.research.result_pages.page import DATA, OUT, Page, PageCommand

COAST = f"{DATA}/wind/coast_2023_1hz.csv"
COAST_TAIL = f"{DATA}/wind/coast_2023_tail_1hz.csv"
ANEMOMETER = "estimator/anemometer_uav_5hz.csv"
M100_FLIGHTS = "m100_flights"
SIZES = ("50", "75", "100", "175", "250")
TSPD_ALPHA_1 = tuple(f"uniform-alpha_1-*-n{nodes}" for nodes in SIZES)
TSPD_ALPHA_2_3 = tuple(
    f"uniform-{alpha}*-n{nodes}" for alpha in ("[0-9]", "alpha_3-") for nodes in SIZES
)
"""Without the ten of 500 nodes, which take as long as all the others."""
NOTHING_DRAWN = "nothing is drawn"
FIXED = "fixed in the code"


def _research(*words: str) -> tuple[str, ...]:
    return ("sim-bridge", "research", *words)


def _bench(*words: str) -> tuple[str, ...]:
    return _research("bench", *words)


def _flight(gate: str) -> tuple[str, ...]:
    own = ("--gate", "off") if gate == "off" else ()
    json = f"{OUT}/{gate}.json"
    return ("sim-bridge", "fly", "--seed", "1", *own, "--json", json, "--runs", f"{OUT}/{gate}")


RECORDED = ("--wind-log", COAST, "--wind-log", COAST_TAIL)


def _promise(title: str, folder: str, *words: str) -> PageCommand:
    return PageCommand(_research("promise", *words, "--out", f"{OUT}/{folder}"), title=title)


def _fleet(title: str, *words: str) -> PageCommand:
    given = ("--vehicles", "1000", "--seed", "1", *words)
    return PageCommand(_research("bench-fleet", *given), show=tables.fleet, title=title)


def _fleet_wind(title: str, folder: str, *words: str) -> PageCommand:
    out = f"{OUT}/{folder}"
    files = ("--json", f"{OUT}/{folder}.json", "--out", out, "--jobs", "1")
    return PageCommand(_research("fleet-wind", *words, *files), title=title)


def _day(title: str, folder: str, *words: str) -> PageCommand:
    file = f"{folder}.json"
    files = ("--json", f"{OUT}/{file}", "--runs", f"{OUT}/{folder}")
    return PageCommand(("sim-bridge", "day", *words, *files), show=tables.days(file), title=title)


def _windbench(title: str, study: str) -> PageCommand:
    folders = (f"{DATA}/{M100_FLIGHTS}", f"{DATA}/estimator=generic")
    words = ("--symmetric", "--study", study, "--json", f"{OUT}/{study}.json", "--out", OUT)
    return PageCommand(
        _research("windbench", *folders, *words), "1, fixed in the code: the intervals", title=title
    )


def _avoid(policy: str) -> PageCommand:
    words = ("--policy", policy, "--agents", "8", "--episodes", "100", "--seed", "2", "--wind")
    return PageCommand(_research("avoid", *words, "--keep", f"{OUT}/kept"), show=tables.nothing)


PAGES = (
    Page(
        "flight",
        "One flight",
        "What `make fly` flies: out with a tailwind that grows into a headwind too strong for the"
        " depot; the gate takes it to the rally point.",
        (
            PageCommand(_flight("on"), show=tables.flights, title="With the gate"),
            PageCommand(_flight("off"), show=tables.flights_without_gate, title="Without the gate"),
        ),
        0.7,
        pictures=(("on/*/flight.png", "flight.png"),),
    ),
    Page(
        "gate-worth",
        "What the gate is worth",
        "The same flight over ten seeds and both autopilots, with the gate and without.",
        (
            PageCommand(
                ("sim-bridge", "series", "--seeds", "1:10", "--json", f"{OUT}/series.json",
                 "--runs", f"{OUT}/runs"),
                show=tables.series,
            ),
        ),
        8.0,
    ),
    Page(
        "recorded-wind",
        "Flights on recorded wind",
        "Both autopilots, gate on and off, in 111 minutes of coastal wind: start and charge of the"
        " pack are drawn by the seed.",
        (
            PageCommand(
                ("sim-bridge", "series", "--seeds", "1:40", "--wind-log", COAST,
                 "--json", f"{OUT}/series.json", "--runs", f"{OUT}/runs"),
                show=tables.series,
            ),
        ),
        25.0,
        needs=("wind/coast_2023_1hz.csv",),
    ),
    Page(
        "promise",
        "Is the promise kept?",
        "Missions through recorded wind by the flight's gate, held to what it said, beside fixed"
        " rules and a clairvoyant.",
        (
            _promise("Hard", "hard", *RECORDED, "--seed", "41"),
            _promise("Easy", "easy", *RECORDED, "--seed", "42", "--tier", "easy"),
            _promise(
                "Wind at half the airspeed", "slow",
                *RECORDED, "--airspeed", "16.3", "--seed", "61",
            ),
            _promise(
                "Wind at 0.63 of the airspeed", "stress",
                *RECORDED, "--tier", "stress", "--seed", "51",
            ),
            _promise(
                "Hard, in simulated wind of 300 independent days", "days",
                "--simulated-days", "300", "--missions", "3000", "--seed", "7001",
            ),
        ),
        6.0,
        needs=("wind/coast_2023_1hz.csv", "wind/coast_2023_tail_1hz.csv"),
        pictures=(("hard/reliability.png", "reliability.png"),),
    ),
    Page(
        "rates",
        "Losses per flight hour",
        "What an accepted rate of losses per flight hour loses in simulation, and what it costs in"
        " deliveries; where nothing was lost, what can be excluded.",
        (
            PageCommand(
                _research("rates", "--samples", "200", "--repeats", "2", "--plain", "2000",
                          "--seed", "1", "--json", f"{OUT}/rates.json", "--out", OUT),
            ),
        ),
        4.0,
    ),
    Page(
        "monitor",
        "The monitor in service",
        "False alarms of the monitor over ten thousand services, flights until it finds what is"
        " wrong, and what an alarm is worth at the gate.",
        (PageCommand(_research("monitor", "--services", "10000", "--seed", "1", "--out", OUT)),),
        5.0,
        pictures=(("monitor.png", "monitor.png"),),
    ),
    Page(
        "real-flights",
        "Real delivery flights",
        "Energy and wind of 119 recorded flights on routes, each day predicted from the flights of"
        " ten others: with what error, and under which bound.",
        (
            PageCommand(
                _research("real-flights", f"{DATA}/{M100_FLIGHTS}",
                          "--json", f"{OUT}/real_flights.json", "--out", OUT),
                "1, fixed in the code: the intervals",
            ),
        ),
        3.0,
        needs=(M100_FLIGHTS,),
        pictures=(("real_flights.png", "real-flights.png"),),
    ),
    Page(
        "windbench",
        "Wind estimators on real flights",
        "Multirotor wind estimators by one open rule on other people's flights, each day from the"
        " others.",
        (
            _windbench("The leader board", "board"),
            _windbench("What each state is worth", "states"),
            _windbench("Cold starts", "cold-starts"),
        ),
        20.0,
        needs=(M100_FLIGHTS, ANEMOMETER),
    ),
    Page(
        "fleet-wind",
        "Wind that the fleet shares",
        "The wind known from one's own data against the wind known by eight drones, in fields that"
        " carry a recording's spectrum and lose coherence; fronts told ahead.",
        (
            _fleet_wind("Eight that fly orders", "flying", "--wind-log", COAST, "--seed", "1",
                        "--draws", "2", "--alert-draws", "0"),
            _fleet_wind("Fronts told", "fronts", "--wind-log", COAST, "--seed", "6",
                        "--draws", "0", "--alert-draws", "16", "--bound"),
            _fleet_wind("Missions at wind/air 0.63", "missions-63", "--wind-log", COAST,
                        "--seed", "1", "--draws", "0", "--alert-draws", "0", "--missions", "2000",
                        "--mission-draws", "10", "--wind-air", "0.63", "--lie", "2"),
            _fleet_wind("Missions at wind/air 0.4", "missions-40", "--wind-log", COAST,
                        "--seed", "1", "--draws", "0", "--alert-draws", "0", "--missions", "400",
                        "--mission-draws", "2", "--wind-air", "0.4"),
            _fleet_wind("Eight that hover", "hovering", "--wind-log", COAST, "--seed", "2",
                        "--hovering", "8", "--draws", "1", "--alert-draws", "0"),
            _fleet_wind("Less coherence: 5 along, 16 across", "loose", "--wind-log", COAST,
                        "--seed", "3", "--along", "5", "--across", "16", "--draws", "1",
                        "--alert-draws", "0"),
        ),
        20.0,
        needs=("wind/coast_2023_1hz.csv",),
        pictures=(("flying/fleet_wind.png", "fleet-wind.png"),),
    ),
    Page(
        "wind-over-lees",
        "The fleet's wind over a ridge and houses",
        "The same in made fields whose ground slows the wind behind a ridge and a dozen blocks of"
        " houses, at the height that is flown; and over flat ground, with the same winds.",
        (
            _fleet_wind("Over a ridge and houses", "lees", "--field", "params/fields/lees.toml",
                        "--seed", "8", "--draws", "3", "--alert-draws", "6"),
            _fleet_wind("Over flat ground", "flat", "--field", "params/fields/front.toml",
                        "--seed", "8", "--draws", "3", "--alert-draws", "6"),
        ),
        12.0,
    ),
    Page(
        "tight-packs",
        "P(home) where the model is wrong",
        "Faults whose physics the companion does not know, each pack's charge drawn from too little"
        " to plenty: what was promised at the last decision to go on, against what came of it.",
        (
            PageCommand(
                ("sim-bridge", "faults", "--tight", "--seeds", "31:32",
                 "--json", f"{OUT}/tight.json", "--runs", f"{OUT}/runs"),
                show=tables.tight_faults,
            ),
        ),
        20.0,
    ),
    Page(
        "frontier",
        "Distance from the frontier",
        "How far the router is below the best that any planner with the same information can do.",
        (PageCommand(_research("frontier", "--graphs", "20", "--seed", "2718", "--out", OUT)),),
        60.0,
    ),
    Page(
        "table1",
        "Table 1",
        "The paper's planners on random graphs with 4 and 8 wind classes, and the frontier.",
        (PageCommand(_research("table1", "--seed", "13", "--out", OUT)),),
        6.0,
        pictures=(("table1.png", "table1.png"),),
    ),
    Page(
        "table1-gusty",
        "Table 1, gusty set",
        "The same planners in wind near the airspeed that turns every 5 s; the set is ours.",
        (PageCommand(_research("table1", "--gusty", "--seed", "19", "--out", OUT)),),
        6.0,
    ),
    Page(
        "table2",
        "Table 2: what each part is worth",
        "Days of 20 customers, 4 drones and one truck, with one part left out at a time.",
        (PageCommand(_research("table2", "--trials", "10", "--seed", "2611", "--out", OUT)),),
        7.0,
    ),
    Page(
        "lambda-sweep",
        "Lambda and the battery",
        "Outcomes of the published planner against its weight on risk and the battery.",
        (PageCommand(_research("lambda-sweep", "--out", OUT), FIXED),),
        5.0,
        pictures=(("lambda_sweep.png", "lambda_sweep.png"),),
    ),
    Page(
        "towns",
        "Towns whose wind differs from edge to edge",
        "The planners in a hundred generated towns with wind around buildings.",
        (PageCommand(_research("towns", "--out", OUT), FIXED),),
        10.0,
        pictures=(("towns.png", "towns.png"),),
    ),
    Page(
        "energy-speed",
        "Energy against speed",
        "Energy per kilometre against airspeed by wind and payload, with both power models.",
        (PageCommand(_research("energy-speed", "--out", OUT), NOTHING_DRAWN),),
        0.2,
        pictures=(("energy_speed.png", "energy_speed.png"),),
    ),
    Page(
        "speed-to-fly",
        "Speed to fly",
        "The true Wh/km at the airspeed that the companion commands, over the least at any airspeed"
        " that tilt allows, by brute force; and the saving over a fixed cruise speed.",
        (
            PageCommand(
                _research("speed-to-fly", "--airframe", "m100", "--airframe", "octo8",
                          "--out", OUT),
                NOTHING_DRAWN,
            ),
        ),
        2.0,
        pictures=(("speed_to_fly_m100.png", "speed_to_fly.png"),),
    ),
    Page(
        "avoidance",
        "Avoidance in towns",
        "Collisions by truth among eight drones in towns, with the safety filter and without: going"
        " straight, ORCA and the learned policy.",
        (
            *(_avoid(policy) for policy in ("none", "none_filtered", "orca", "orca_filtered",
                                            "maddpg_bare", "maddpg")),
            PageCommand(_research("avoid-table", f"{OUT}/kept", "--out", OUT), "as above"),
        ),
        60.0,
        modules=("pyrvo",),
    ),
    Page(
        "crossing",
        "Eight drones that cross",
        "PX4 and ArduCopter in turn cross about one truck at one height; what keeps them apart are"
        " their companions.",
        (
            PageCommand(
                ("sim-bridge", "cross", "--vehicles", "8", "--seeds", "1:5",
                 "--json", f"{OUT}/cross.json", "--runs", f"{OUT}/runs"),
                show=tables.crossings,
            ),
        ),
        10.0,
    ),
    Page(
        "days",
        "Whole days",
        "Days in the town: one truck, eight drones, forty orders, from orders to report; on"
        " recorded wind, with faults, and with a front that nobody foresaw, with the fleet's wind"
        " and without.",
        (
            _day("On recorded wind", "town", "--wind-log", COAST, "--seeds", "11:12"),
            _day("With faults", "faults", "--wind-log", COAST, "--seeds", "21:22", "--loss", "0.2",
                 "--kill-companion", "1", "--kill-ground", "2", "--truck-late", "120"),
            _day("A front of 8 m/s", "front", "--seeds", "51:53", "--front", "8",
                 "--front-at", "15"),
            _day("The same, and no drone hears of another's wind", "front-alone", "--seeds",
                 "51:53", "--front", "8", "--front-at", "15", "--no-share-wind"),
        ),
        50.0,
        needs=("wind/coast_2023_1hz.csv",),
        pictures=(("town/*/day.png", "day.png"),),
    ),
    Page(
        "truck-and-drones",
        "Truck and drones",
        "Makespans of the planner against published ones: every third problem of Murray and Raj,"
        " none of those on which settings were chosen (0:3).",
        (
            PageCommand(
                ("ground-station", "benchmark", "mfstsp", f"{DATA}/mfstsp", "--problems", "1:3",
                 "--seed", "0", "--json", f"{OUT}/mfstsp.json"),
                show=tables.makespans,
            ),
        ),
        35.0,
        needs=("mfstsp",),
    ),
    Page(
        "stops",
        "One stop or several",
        "Where the drones of a day are launched and met: the plans that the search found, the one"
        " that is kept, a long search on driven plans with any stops, and a bound.",
        (
            PageCommand(
                ("ground-station", "benchmark", "day-plan", "--day", "town", "--seed", "0",
                 "--drives", "250", "--json", f"{OUT}/town.json"),
                show=tables.stops_of_the_town,
                title="The town",
            ),
            PageCommand(
                ("ground-station", "benchmark", "day-plan", "--day", "villages", "--seed", "0",
                 "--drives", "100", "--json", f"{OUT}/villages.json"),
                show=tables.stops_of_the_villages,
                title="Villages",
            ),
        ),
        8.0,
    ),
    Page(
        "tspd",
        "One truck, one drone",
        "Costs on instances of Agatz, Bouman and Schmidt against proven optima and against means"
        " of published solvers, in at most ten times the seconds of ICP. Alpha is the drone's speed"
        " over the truck's. Our seconds are of a processor.",
        (
            PageCommand(
                ("ground-station", "benchmark", "tspd", f"{DATA}/tspd",
                 "--instances", "uniform-*-n1[1-7]", "--seed", "0", "--json", f"{OUT}/small.json"),
                show=tables.small_operations,
                title="Proven optima, default trials",
            ),
            PageCommand(
                ("ground-station", "benchmark", "tspd", f"{DATA}/tspd", "--published-times", "10",
                 "--instances", ",".join(TSPD_ALPHA_1), "--seed", "0",
                 "--json", f"{OUT}/alpha_1.json"),
                show=tables.slow_drone_operations,
                title="Alpha 1, ten times the seconds",
            ),
            PageCommand(
                ("ground-station", "benchmark", "tspd", f"{DATA}/tspd", "--published-times", "2",
                 "--instances", ",".join(TSPD_ALPHA_2_3), "--seed", "0",
                 "--json", f"{OUT}/alpha_2_3.json"),
                show=tables.fast_drone_operations,
                title="Alpha 2 and 3, twice the seconds",
            ),
        ),
        20.0,
        needs=("tspd",),
    ),
    Page(
        "fleet-size",
        "A thousand vehicles on one machine",
        "Members, desk, store and routers of a fleet share two cores. Members are the companion's"
        " own network end, without a flight behind them.",
        (
            _fleet("One desk, SQLite", "--minutes", "3"),
            _fleet("With identities, TLS and signatures", "--minutes", "2", "--tls"),
            _fleet("5,000 orders", "--minutes", "10", "--order-every", "120"),
            _fleet("One desk, PostgreSQL", "--minutes", "2", "--store", "postgresql"),
        ),
        30.0,
    ),
    Page(
        "fleet-regions",
        "Ten thousand vehicles by region",
        "A desk for each thousand vehicles and as many routers, which they share, all on two cores"
        " with the vehicles; each tells its state every 4 s, not every second, and gets an order"
        " every half hour.",
        tuple(
            PageCommand(
                _research(
                    "bench-fleet", "--vehicles", str(1000 * regions), "--desks", str(regions),
                    "--routers", str(regions), "--states-every", "4", "--order-every", "1800",
                    "--join-apart", "1", "--minutes", "2", "--seed", "1",
                ),
                show=tables.fleet,
                title=f"{regions} region{'s' if regions > 1 else ''}",
            )
            for regions in (1, 4, 10)
        ),
        14.0,
    ),
    Page(
        "fleet-failures",
        "A thousand vehicles under faults",
        "A desk that is killed; and a router that is killed and begins anew a quarter through, both"
        " desks killed half way, the members of the other router cut off for 30 s behind.",
        (
            _fleet("One desk, killed half way", "--minutes", "2", "--kill-desk"),
            _fleet("Two desks and two routers", "--minutes", "5", "--desks", "2", "--routers", "2",
                   "--faults"),
        ),
        14.0,
    ),
    Page(
        "install",
        "What an install takes",
        "What each install adds to an empty environment, and whether all of it comes as wheels for"
        " 64 bit ARM, so that nothing is compiled on a Raspberry Pi.",
        (
            PageCommand(
                ("deploy/measure-sizes", "--json", f"{OUT}/sizes.json"),
                NOTHING_DRAWN,
                tables.sizes,
                "On disk",
            ),
            PageCommand(
                ("deploy/check-arm-wheels", "--json", f"{OUT}/wheels.json"),
                NOTHING_DRAWN,
                tables.arm_wheels,
                "Wheels for 64 bit ARM",
            ),
        ),
        10.0,
    ),
    Page(
        "speed-and-size",
        "Speed and size of vehicles and companions",
        "One vehicle on one core, a fleet, and a companion at real time.",
        (
            PageCommand(
                _bench("flight", "--rounds", "1", "--no-fresh-clone",
                          "--json", f"{OUT}/bench.json"),
                "1, 2, ... by round",
                tables.speeds,
            ),
        ),
        6.0,
    ),
)  # fmt: skip
"""All pages."""


def by_name(name: str) -> Page | None:
    """The page of this name."""
    return next((page for page in PAGES if page.name == name), None)
