"""Batches of flyable paths: arcs and straights in the air frame, displaced by the wind."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats

PARTS = 4  # a leading arc if a climb needs a longer path, then the word's three


@dataclass(frozen=True, slots=True)
class AirPaths:
    """n paths, each of up to four parts of constant turn: +1 right, -1 left, 0 straight.

    `start` (n, 4): north, east, down m, AIR heading rad. `turn` (n, 4); `length_m` (n, 4):
    horizontal metres through the air; `radius_m`, `level_mps` (horizontal airspeed) and
    `climb_mps` (up) (n,); `wind_to_ne_mps` (n, 2). `word`: name of each path's Dubins word.
    """

    start: Floats
    turn: NDArray[np.int8]
    length_m: Floats
    radius_m: Floats
    level_mps: Floats
    climb_mps: Floats
    wind_to_ne_mps: Floats
    word: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.radius_m)

    @property
    def air_length_m(self) -> Floats:
        """Horizontal metres through the air; (n,)."""
        return self.length_m.sum(axis=1)

    @property
    def time_s(self) -> Floats:
        """Duration of each path; (n,)."""
        return self.air_length_m / self.level_mps

    @property
    def airspeed_mps(self) -> Floats:
        """Airspeed, climb included; (n,)."""
        return np.hypot(self.level_mps, self.climb_mps)

    @property
    def path_angle_rad(self) -> Floats:
        """Flight-path angle in the air frame, up positive; (n,)."""
        return np.arctan2(self.climb_mps, self.level_mps)

    @property
    def turning_rad(self) -> Floats:
        """Total absolute turn angle; (n,)."""
        return (np.abs(self.turn) * self.length_m).sum(axis=1) / self.radius_m

    def some(self, at: NDArray[np.int64]) -> "AirPaths":
        """The paths at these indices."""
        return AirPaths(
            self.start[at],
            self.turn[at],
            self.length_m[at],
            self.radius_m[at],
            self.level_mps[at],
            self.climb_mps[at],
            self.wind_to_ne_mps[at],
            tuple(self.word[i] for i in at),
        )

    def one(self, index: int) -> "AirPaths":
        """A batch of one path."""
        return self.some(np.array([index]))

    def at(self, time_s: Floats) -> Floats:
        """Pose at each time: `time_s` (n, k) gives (n, k, 4), north, east, down m, air heading."""
        flown_m = np.clip(time_s, 0.0, self.time_s[:, None]) * self.level_mps[:, None]
        heading = np.repeat(self.start[:, 3:4], time_s.shape[1], axis=1)
        north = np.repeat(self.start[:, 0:1], time_s.shape[1], axis=1)
        east = np.repeat(self.start[:, 1:2], time_s.shape[1], axis=1)
        begun_m = np.zeros((len(self), 1))
        for part in range(PARTS):
            length = self.length_m[:, part : part + 1]
            done_m = np.clip(flown_m - begun_m, 0.0, length)
            angle = self.turn[:, part : part + 1] * done_m / self.radius_m[:, None]
            # Chord of the arc: length 2 R sin(angle / 2), at half the angle from the heading.
            chord = done_m * np.sinc(angle / (2.0 * np.pi))
            north += chord * np.cos(heading + 0.5 * angle)
            east += chord * np.sin(heading + 0.5 * angle)
            heading += angle
            begun_m = begun_m + length
        seconds = flown_m / self.level_mps[:, None]
        north += self.wind_to_ne_mps[:, 0:1] * seconds
        east += self.wind_to_ne_mps[:, 1:2] * seconds
        down = self.start[:, 2:3] - self.climb_mps[:, None] * seconds
        return np.stack([north, east, down, heading], axis=2)

    def end(self) -> Floats:
        """Final pose of each path; (n, 4)."""
        return self.at(self.time_s[:, None])[:, 0]

    def ground_course_rad(self, time_s: Floats) -> Floats:
        """Course over the ground at each time; (n, k)."""
        heading = self.at(time_s)[..., 3]
        north = self.level_mps[:, None] * np.cos(heading) + self.wind_to_ne_mps[:, 0:1]
        east = self.level_mps[:, None] * np.sin(heading) + self.wind_to_ne_mps[:, 1:2]
        return np.arctan2(east, north)
