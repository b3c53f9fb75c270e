"""One run of `promise`: its winds, its missions, and how each rule flies them."""

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from companion.core.base.arrays import Ints
from companion.core.base.errors import LeewayError
from sim_bridge.research.promise.blocks import (
    BLOCK_S,
    TIERS,
    Block,
    DrawnMissions,
    blocks_of,
    draw_missions,
)
from sim_bridge.research.promise.recording import Stretch, WindRecording, read_recording
from sim_bridge.research.promise.rules import (
    THRESHOLDS,
    Ends,
    clairvoyant,
    px4_time,
    threshold,
)
from sim_bridge.research.promise.truth import Profile, TruePower
from sim_bridge.truth.params import AirframeTruth, load_airframe
from sim_bridge.truth.wind_days import DayProcess, day_of_wind, day_process

WIND_OVER_AIR = {"hard": 0.4, "easy": 0.4, "stress": 0.63}
DAY_S = 3600
SIMULATED_MEAN_MPS = 8.0
MOST_FOLDS = 8
UNIT_S = 300  # bootstrap unit on recordings

SLOWEST_MPS, FASTEST_MPS = 3.0, 30.0


@dataclass(frozen=True, slots=True)
class Setting:
    """Options of a run. With `files`, the recordings' digests, it identifies the run."""

    wind_logs: tuple[str, ...]
    files: tuple[str, ...]
    simulated_days: int
    airspeed_mps: float | None
    tier: str
    missions: int
    seed: int
    max_loss: float
    airframe: str
    truth_file: str
    wind_process: str
    pack_std_frac: float

    def check(self) -> None:
        """Check the options; raises LeewayError that names the invalid one."""
        if self.tier not in TIERS:
            raise LeewayError(f"--tier {self.tier}: expected {', '.join(TIERS)}")
        if self.missions < 1:
            raise LeewayError(f"--missions {self.missions}: expected 1 or more")
        if not 0.0 < self.max_loss < 1.0:
            raise LeewayError(f"--max-loss {self.max_loss:g}: expected more than 0, less than 1")
        if not 0.0 <= self.pack_std_frac <= 0.2:
            raise LeewayError(f"--pack-std {self.pack_std_frac:g}: expected 0 to 0.2")
        speed = self.airspeed_mps
        if speed is not None and not SLOWEST_MPS <= speed <= FASTEST_MPS:
            raise LeewayError(
                f"--airspeed {speed:g}: expected {SLOWEST_MPS:g} to {FASTEST_MPS:g} m/s"
            )
        if bool(self.wind_logs) == bool(self.simulated_days):
            raise LeewayError("expected either --wind-log or --simulated-days")


def digest(path: Path) -> str:
    """The first 16 hex digits of a file's SHA-256; raises LeewayError if it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    except OSError as error:
        raise LeewayError(f"{path}: cannot be read ({error.strerror})") from None


class PromiseWorld:
    """Winds, missions and their true ends; identical in every process for the same setting."""

    def __init__(self, setting: Setting) -> None:
        setting.check()
        self.setting = setting
        self.recordings: tuple[WindRecording, ...] = tuple(
            read_recording(Path(name)) for name in setting.wind_logs
        )
        self.days, simulated = simulated_days(
            setting.simulated_days, setting.seed, SIMULATED_MEAN_MPS
        )
        """The process of each simulated day; empty for recordings."""
        self.stretches = simulated or tuple(s for r in self.recordings for s in r.stretches)
        speeds = [np.hypot(s.wind_ne_mps[:, 0], s.wind_ne_mps[:, 1]) for s in self.stretches]
        self.mean_wind_mps = float(np.concatenate(speeds).mean())
        self.profile = Profile(setting.airspeed_mps or self._derived_airspeed_mps())
        self.truth: AirframeTruth = load_airframe(Path(setting.truth_file))
        self.power = TruePower(self.truth, self.profile)
        self.blocks = blocks_of(self.stretches, self.power.endurance_s)
        self.drawn: DrawnMissions = draw_missions(
            self.stretches,
            self.blocks,
            self.power,
            self.profile,
            setting.tier,
            setting.missions,
            np.random.default_rng([setting.seed, 1]),
        )
        self._draw_packs()

    def _derived_airspeed_mps(self) -> float:
        wanted = self.mean_wind_mps / WIND_OVER_AIR[self.setting.tier]
        return min(max(wanted, SLOWEST_MPS), FASTEST_MPS)

    def _draw_packs(self) -> None:
        """Draw each pack's true energy relative to the believed budget."""
        std_wh = self.setting.pack_std_frac * self.power.budget_wh
        rng = np.random.default_rng([self.setting.seed, 2])
        self.drawn.flown.pack_wh = std_wh * rng.standard_normal(self.setting.missions)

    @property
    def wind_over_air(self) -> float:
        """Mean wind speed over airspeed."""
        return self.mean_wind_mps / self.profile.airspeed_mps

    @cached_property
    def folds(self) -> tuple[tuple[int, ...], ...]:
        """Block indices of each fold: one block each, or at most MOST_FOLDS groups of blocks."""
        count = len(self.blocks)
        if count <= MOST_FOLDS:
            return tuple((k,) for k in range(count))
        groups = np.arange(count) * MOST_FOLDS // count
        return tuple(tuple(np.nonzero(groups == g)[0].tolist()) for g in range(MOST_FOLDS))

    @cached_property
    def fold_of_mission(self) -> Ints:
        """The fold that judges each mission."""
        of_block = np.empty(len(self.blocks), np.int64)
        for fold, blocks in enumerate(self.folds):
            of_block[list(blocks)] = fold
        return of_block[self.drawn.block]

    def judged(self, fold: int) -> tuple[Block, ...]:
        """The blocks of a fold."""
        return tuple(self.blocks[k] for k in self.folds[fold])

    @cached_property
    def unit_of_mission(self) -> Ints:
        """Bootstrap unit of each mission: 300 s of a recording, or a simulated day, as a number."""
        stretch = np.array([self.blocks[k].stretch for k in self.drawn.block])
        if not self.recordings:
            return stretch
        part = self.drawn.flown.missions.start // UNIT_S
        return stretch * (1 + int(part.max())) + part

    @cached_property
    def rules(self) -> dict[str, Ends]:
        """Mission ends under every fixed rule and under the clairvoyant."""
        flown = self.drawn.flown
        fixed = {name: threshold(flown, frac) for name, frac in THRESHOLDS.items()}
        return {"px4_time": px4_time(flown), **fixed, "clairvoyant": clairvoyant(flown)}

    @cached_property
    def accepted_losses(self) -> dict[str, float]:
        """Accepted loss of each gate policy: the requested one, and each fixed rule's own loss."""
        own = {
            name: float(ends.lost.sum()) / max(int(ends.go.sum()), 1)
            for name, ends in self.rules.items()
            if name != "clairvoyant"
        }
        least = 0.5 / self.setting.missions
        return {
            "gate": self.setting.max_loss,
            **{name: min(max(loss, least), 0.999) for name, loss in own.items()},
        }


def simulated_days(
    count: int, seed: int, mean_mps: float
) -> tuple[tuple[DayProcess, ...], tuple[Stretch, ...]]:
    """Independent days about a mean wind, and the process that each was drawn from."""
    processes: list[DayProcess] = []
    days: list[Stretch] = []
    for day in range(count):
        rng = np.random.default_rng([seed, 3, day])
        processes.append(day_process(mean_mps, rng))
        days.append(Stretch(f"day {day + 1}", 0.0, day_of_wind(processes[-1], DAY_S, rng)))
    return tuple(processes), tuple(days)


def seconds_of(stretches: tuple[Stretch, ...]) -> int:
    """Total duration in s."""
    return sum(s.seconds for s in stretches)


def block_words(world: PromiseWorld) -> str:
    """Summary of stretches and judged blocks, in words."""
    count, minutes = len(world.blocks), BLOCK_S // 60
    return (
        f"{len(world.stretches)} stretch{'es' if len(world.stretches) > 1 else ''},"
        f" {seconds_of(world.stretches) / 60.0:.0f} min;"
        f" {count} judged block{'s' if count > 1 else ''} of about {minutes} min,"
        f" longest mission {math.ceil(world.power.endurance_s)} s"
    )
