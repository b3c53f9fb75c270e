"""Field-level fuzz of the byte path: whole flights, a real companion, an autopilot that lies.

Under arbitrary lies the vehicle need not come home. What must hold all the same is asked here.
"""

import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.adapters.logs.decision_log import read_log
from companion.core.base.errors import LeewayError
from sim_bridge.adapters.lockstep import Lockstep
from sim_bridge.app.faults.authority import TOLD_PILOT_S
from sim_bridge.app.faults.runner import printed_and_logged, write_flight
from sim_bridge.app.faults.verdict import BROKEN, TRACEBACK, USAGE
from sim_bridge.app.flight.companion_process import suite_forks
from sim_bridge.app.flight.fly import FlyOptions, Progress, fly
from sim_bridge.app.flight.record import COLUMNS
from sim_bridge.app.flight.vehicle_process import MISSION_CUSTOM_MODE, Craft
from sim_bridge.app.link.lies import DEEDS, Liar
from sim_bridge.app.link.tap import Tap
from sim_bridge.app.trials.trial import TrialRow
from sim_bridge.autopilot.mavlink.codec import Message

FLIGHT: dict[str, Any] = {
    "site": {"customer": {"east_m": -150.0, "north_m": -30.0, "up_m": 0.75}, "rally": []},
    "mission": {"cruise_height_m": 20.0, "leg_length_m": 60.0},
}
"""The suite's flight, shorter: two minutes, of which a third on the ground."""

UNTROUBLED_S = 115.0
"""So long it takes from power-up; lies begin before."""

LIMIT_S = 240.0
"""A flight that lies keep up is ended: twice the untroubled one."""

NEVER_LEFT_S = 90.0
"""Without take-off until then (untroubled 23 s) the lies have kept it on the ground."""

WATCHED_S = 10.0
"""After hands off, before the flight is ended: every retry of an order is due within 3 s."""

ANSWERS_S = 60.0
LIED_ABOUT = ("HEARTBEAT", "CURRENT_MODE", "ATTITUDE", "GLOBAL_POSITION_INT", "GPS_RAW_INT",
              "SYS_STATUS", "BATTERY_STATUS", "VFR_HUD", "MISSION_CURRENT", "MISSION_ITEM_REACHED",
              "EXTENDED_SYS_STATE", "SYSTEM_TIME", "HOME_POSITION", "COMMAND_ACK", "MISSION_ACK",
              "MISSION_COUNT", "MISSION_ITEM_INT", "PARAM_VALUE", "TIMESYNC")  # fmt: skip
"""What the companion listens to (docs/reference/mavlink.md)."""

MODE = ("HEARTBEAT", "CURRENT_MODE")
DOWN, LET_GO, TIME, NEVER_LEFT = "down", "let go", "time", "never left"
"""How a flight ended: it landed or fell, or was ended by us because nothing more was to be seen."""

ARM_DISARM = 400
HANDS_OFF = "hands off"
GIVEN_UP = "record given up"
ROUNDING_WH = 2e-5
PROMISES = ("p_home", "p_home_now", "p_success")
TOLD_PROMISES = ("LW_PHOME", "LW_PHNOW", "LW_PSUCC")
AIRBORNE = COLUMNS.index("airborne")


class FuzzCase(msgspec.Struct, frozen=True, kw_only=True):
    """All that decides one flight. `messages` empty: lies about every message."""

    autopilot: str
    seed: int
    share: float
    begins_s: float
    ends_s: float | None
    deeds: tuple[str, ...]
    messages: tuple[str, ...]
    takes_over_after_s: float | None
    """A pilot takes over so long after the lies began, in the air; null: nobody does."""

    @property
    def name(self) -> str:
        """Names run folder and case file."""
        return f"fuzz-{self.autopilot}-seed{self.seed}"


def drawn(seed: int, number: int) -> FuzzCase:
    """The case of this number, of a trial with this seed."""
    rng = np.random.default_rng([seed, number])
    deeds = rng.choice(DEEDS, rng.integers(1, len(DEEDS) + 1), replace=False)
    begins_s = float(rng.choice([0.0, rng.uniform(0.0, UNTROUBLED_S)], p=[0.2, 0.8]))
    lasts_s = float(rng.choice([2.0, 10.0, 40.0, math.inf]))
    return FuzzCase(
        autopilot=str(rng.choice(["px4", "ardupilot"])),
        seed=1000 * seed + number,
        share=round(float(10.0 ** rng.uniform(-2.0, 0.0)), 4),
        begins_s=round(begins_s, 1),
        ends_s=round(begins_s + lasts_s, 1) if math.isfinite(lasts_s) else None,
        deeds=tuple(sorted(map(str, deeds))),
        messages=_drawn_messages(rng),
        takes_over_after_s=round(rng.uniform(0.0, 30.0), 1) if rng.random() < 0.4 else None,
    )


def _drawn_messages(rng: np.random.Generator) -> tuple[str, ...]:
    """One, some, all but those of the mode (at a wrong mode it lets go, and the rest is calm), or
    all of them."""
    match rng.integers(4):
        case 0:
            return (str(rng.choice(LIED_ABOUT)),)
        case 1:
            return tuple(sorted(map(str, rng.choice(LIED_ABOUT, 3, replace=False))))
        case 2:
            return tuple(name for name in LIED_ABOUT if name not in MODE)
        case _:
            return ()


@dataclass(slots=True)
class Witness:
    """Lies to the companion as its case says, and sees what it does (a `Script` of `fly`)."""

    case: FuzzCase
    liar: Liar
    craft: Craft | None = None
    hands_off_s: float | None = None
    """When the companion told that it lets go."""
    took_over_s: float | None = None
    knows_s: float | None = None
    """From then on it can know that a person has taken over: a true heartbeat has said so."""
    unanswered: bool = False
    wrong_promise: str | None = None
    ended: str = DOWN

    @classmethod
    def of(cls, case: FuzzCase) -> "Witness":
        """Lie by the case's seed."""
        rng = np.random.default_rng(case.seed)
        return cls(case, Liar(rng, case.share, case.deeds, case.messages))

    def end(self) -> None:
        """Nothing of its outlasts the flight."""

    def apply(self, crafts: list[Craft], t_s: float, lockstep: Lockstep) -> None:
        """One step of 0.1 s."""
        if self.craft is None:
            self.craft = crafts[0]
            self.craft.tap = Tap(to_companion=self.liar.change, to_autopilot=self._hear)
        over_s = math.inf if self.case.ends_s is None else self.case.ends_s
        self.liar.active = self.case.begins_s <= t_s < over_s
        self.unanswered |= self.craft.companion.running and not lockstep.live
        self._take_over(self.craft, t_s)

    def _take_over(self, craft: Craft, t_s: float) -> None:
        """The pilot's switch, while it flies; and when the companion can know of it."""
        if self.took_over_s is None:
            if self._is_due(craft, t_s):
                craft.pilot_takes_over()
                self.took_over_s = t_s
                self.liar.passed_mode = None
            return
        if self.knows_s is None and self.liar.passed_mode not in (None, self._mission(craft)):
            self.knows_s = t_s + TOLD_PILOT_S

    @staticmethod
    def _mission(craft: Craft) -> int:
        return MISSION_CUSTOM_MODE[craft.autopilot_kind]

    def _is_due(self, craft: Craft, t_s: float) -> bool:
        after_s, record = self.case.takes_over_after_s, craft.record
        flies = record.took_off_s is not None and record.landed_s is None
        return after_s is not None and flies and t_s >= self.case.begins_s + after_s

    def _hear(self, message: Message) -> list[Message] | None:
        told = message.msg_name == "NAMED_VALUE_FLOAT" and message.name in TOLD_PROMISES
        if told and not 0.0 <= message.value <= 1.0:  # NaN too
            self.wrong_promise = f"told {message.name} = {message.value}"
        lets_go = message.msg_name == "STATUSTEXT" and message.text.startswith(HANDS_OFF)
        if lets_go and self.hands_off_s is None and self.craft is not None:
            self.hands_off_s = self.craft.t_s
        return None

    def goes_on(self, t_s: float) -> bool:
        """False once there is nothing more to see."""
        if self.hands_off_s is not None and t_s > self.hands_off_s + WATCHED_S:
            self.ended = LET_GO
        elif t_s >= NEVER_LEFT_S and self.craft is not None:
            left = self.craft.record.took_off_s is not None
            self.ended = TIME if left and t_s >= LIMIT_S else DOWN if left else NEVER_LEFT
        return self.ended == DOWN


@dataclass(slots=True, kw_only=True)
class _Ending(Progress):
    witness: Witness

    def goes_on(self, t_s: float) -> bool:
        return self.witness.goes_on(t_s)


@dataclass(frozen=True, slots=True)
class Fuzzed:
    """A flight under lies that has ended: what truth, the wire and the companion's record show."""

    witness: Witness
    craft: Craft
    printed: str
    rows: list[tuple[str, dict[str, Any]]]
    """Of the decision log, in order: (topic, row)."""


Ask = Callable[[Fuzzed], str | None]


def raises_nothing(flown: Fuzzed) -> str | None:
    """No traceback in what it printed or logged, and no exit code of a crash."""
    code = flown.craft.companion.exit_code
    if TRACEBACK in flown.printed:
        return f"an exception: {flown.printed.strip().splitlines()[-1][:120]}"
    crashed = code is not None and (code < 0 or code in (BROKEN, USAGE))
    return f"exit code {code}" if crashed else None


def keeps_its_record(flown: Fuzzed) -> str | None:
    """No record is given up: the disk is sound, and every number can be written."""
    given_up = [line for line in flown.printed.splitlines() if GIVEN_UP in line]
    return given_up[0].strip()[:160] if given_up else None


def answers_always(flown: Fuzzed) -> str | None:
    """It never stands still."""
    return "no answer within a minute" if flown.witness.unanswered else None


def energy_never_rises(flown: Fuzzed) -> str | None:
    """From take-off on, as it believes."""
    flying, before = False, math.inf
    for topic, row in flown.rows:
        flying |= topic == "decision" and row["kind"] == "take_off"
        if not flying or topic != "energy":
            continue
        left_wh = row["left_wh"]
        if not math.isfinite(left_wh) or left_wh > before + ROUNDING_WH:
            return f"energy left rose from {before:.2f} to {left_wh:.2f} Wh at {row['t_s']:.1f} s"
        before = left_wh
    return None


def lets_go(flown: Fuzzed) -> str | None:
    """Not one command after it said hands off, or could know of a take-over."""
    moments = [s for s in (flown.witness.hands_off_s, flown.witness.knows_s) if s is not None]
    if not moments:
        return None
    sent = [c for c in flown.craft.commands if c[0] > min(moments)]
    return f"{len(sent)} commands after hands off, {_shown(sent[0])}" if sent else None


def configures_nothing_in_the_air(flown: Fuzzed) -> str | None:
    """Nothing is armed, disarmed or set while it flies, by truth."""
    times = np.array([row[0] for row in flown.craft.record.rows])
    airborne = np.array([row[AIRBORNE] for row in flown.craft.record.rows]) > 0.0
    for command in flown.craft.commands:
        if command[1] == "PARAM_SET" or command[2] == ARM_DISARM:
            near = np.abs(times - command[0]) <= 0.5
            if near.any() and airborne[near].all():
                return f"in the air: {_shown(command)}"
    return None


def promises_are_probabilities(flown: Fuzzed) -> str | None:
    """Each P that it told or recorded is within 0 and 1; a NaN is recorded as nothing."""
    if flown.witness.wrong_promise is not None:
        return flown.witness.wrong_promise
    for topic, row in flown.rows:
        for key in PROMISES:
            value, needed = row.get(key), topic == "assessment"
            if (value is None and needed) or (value is not None and not 0.0 <= value <= 1.0):
                return f"{topic}: {key} = {value}"
    return None


ASKS: tuple[Ask, ...] = (
    raises_nothing,
    keeps_its_record,
    answers_always,
    energy_never_rises,
    lets_go,
    configures_nothing_in_the_air,
    promises_are_probabilities,
)


def _shown(command: tuple[float, str, int]) -> str:
    t_s, name, number = command
    return f"{name} {number or ''} at {t_s:.1f} s".replace("  ", " ")


@dataclass(frozen=True, slots=True)
class FuzzFlyer:
    """Flies cases, each in a folder of its own under `run_root`."""

    run_root: Path

    def __call__(self, case: FuzzCase) -> list[TrialRow]:
        """Fly one."""
        return [attempt(case, self.run_root)]


def attempt(case: FuzzCase, run_root: Path) -> TrialRow:
    """Fly one case and judge it; of a flight that held, no folder is left."""
    folder = run_root / case.name
    folder.mkdir(parents=True, exist_ok=True)
    witness = Witness.of(case)
    options = FlyOptions(
        flight_file=write_flight(folder / "flight.toml", FLIGHT),
        autopilot=case.autopilot,
        seed=case.seed,
        run_root=folder,
        picture=False,
        lockstep_limit_s=ANSWERS_S,
        forks=suite_forks(),
    )
    (row,) = fly(options, _Ending(witness=witness), witness)["flights"]
    craft = witness.craft
    assert craft is not None
    wrong = _wrong(Fuzzed(witness, craft, printed_and_logged(craft.run_dir), _logged(craft)))
    if not wrong:
        shutil.rmtree(folder)
    ended = NEVER_LEFT if craft.record.took_off_s is None else witness.ended
    told = {
        "ended": ended,
        "home": row["home"] if ended == DOWN else None,
        "hands_off_s": witness.hands_off_s,
        "took_over_s": witness.took_over_s,
        "lies": witness.liar.told,
        "commands": len(craft.commands),
        "flown_s": round(craft.t_s, 1),
    }
    return TrialRow(name=case.name, held=not wrong, why="; ".join(wrong), told=told, case=case)


def _wrong(flown: Fuzzed) -> list[str]:
    return [words for words in (ask(flown) for ask in ASKS) if words]


def _logged(craft: Craft) -> list[tuple[str, dict[str, Any]]]:
    return list(_logs(craft.run_dir))


def _logs(run_dir: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    for path in sorted(run_dir.glob("decisions*.mcap")):
        try:
            yield from read_log(path).rows
        except LeewayError:
            return  # ended before it wrote anything
