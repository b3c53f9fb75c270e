"""Winds of a study: drawn true winds over a site, the drones in them, and their reports.

A true wind follows one half of a recording, or a synthetic field. The assumed wind process is
fitted to the other half, or to a draw that is not evaluated.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from companion.analysis.wind_fit.fit import average_wind_over_10_s, fit_wind_process_to_recordings
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.wind_reports import MemberWindReport
from sim_bridge.research.promise.recording import file_sha256_prefix, read_recording
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.fields.coherent_field import Coherence, CoherentField
from sim_bridge.truth.fields.computed_flow import ComputedFlows
from sim_bridge.truth.fields.field_file import (
    WindFieldParams,
    draw_free_wind_series,
    load_flows,
    load_wind_field,
)
from sim_bridge.truth.fields.front import LinearFront, draw_front
from sim_bridge.truth.fields.site_wind import SiteWind

SITE_M = 750.0
"""Half the side of the site: 1.5 km."""
HEIGHT_M = 40.0
GROUND_SPEED_MPS = 12.0
CUSTOMER_TIME_S = 40.0
DEPOT_TIME_S = 20.0
MIN_HALF_S = 1200
REPORT_INTERVAL_S = 10
REPORT_STD_MPS = 0.5
"""Error of a reported 10 s mean, independent per report and axis."""
RECORDING_COHERENCE, RECORDING_FRONT_MPS = Coherence(4.0, 13.0), (5.0, 10.0)
"""Coherence assumed of a recording, and wind change of the fronts added to it: least, most."""
FRONT_FROM_S, FRONT_UNTIL_S = 900.0, 700.0
"""Earliest arrival of a front at the site centre, and latest arrival before the end."""
_FITTING_DRAW = 1_000_000
"""Draw of a synthetic field that the estimator's process is fitted to; never evaluated."""


@dataclass(frozen=True, slots=True)
class FleetWindSetting:
    """Options of a study. With `file`, the digest of its wind, it identifies the run."""

    wind_log: str | None
    field: str | None
    file: str
    drones: int
    hovering: int
    seed: int


@dataclass(frozen=True, slots=True)
class Patrol:
    """Waypoints of a drone: times (n,), positions (n, 2). Outside these times it is stationary."""

    name: str
    t_s: Floats
    position_ne_m: Floats

    def positions_ne_m_at(self, t_s: Floats) -> Floats:
        """Return positions (m, 2) at times (m,)."""
        axes = [np.interp(t_s, self.t_s, self.position_ne_m[:, axis]) for axis in (0, 1)]
        return np.stack(axes, axis=-1)


def draw_patrols(
    drone_count: int, hovering_count: int, seconds: float, rng: np.random.Generator
) -> list[Patrol]:
    """Draw patrols: the last `hovering_count` hover at random positions, others fly orders."""
    found: list[Patrol] = []
    for number in range(drone_count):
        name = f"drone-{number + 1}"
        if number >= drone_count - hovering_count:
            position = rng.uniform(-SITE_M, SITE_M, 2)
            found.append(Patrol(name, np.zeros(1), position[None, :]))
        else:
            found.append(_draw_order_patrol(name, seconds, rng))
    return found


def _draw_order_patrol(name: str, seconds: float, rng: np.random.Generator) -> Patrol:
    """Fly repeatedly straight out to a random customer on the site and straight back."""
    depot = rng.uniform(-100.0, 100.0, 2)
    times, waypoints_ne_m = [0.0], [depot]
    wait_s = float(rng.uniform(0.0, 60.0))
    while times[-1] < seconds:
        customer = rng.uniform(-SITE_M, SITE_M, 2)
        flown_s = max(math.dist(depot, customer) / GROUND_SPEED_MPS, 1.0)
        for pause_s, position in ((wait_s, depot), (flown_s, customer), (CUSTOMER_TIME_S, customer),
                               (flown_s, depot)):  # fmt: skip
            times.append(times[-1] + max(pause_s, 1e-3))
            waypoints_ne_m.append(position)
        wait_s = DEPOT_TIME_S
    return Patrol(name, np.array(times), np.array(waypoints_ne_m))


@dataclass(frozen=True, slots=True)
class FleetWorld:
    """One draw: the true wind, the drones, and their wind reports at 10 s intervals.

    `reported_ne_mps` (drones, reports, 2) at `report_times_s`: means over the preceding seconds,
    with noise.
    """

    truth: SiteWind
    seconds: int
    process: FieldProcess
    drones: list[Patrol]
    report_times_s: Floats
    reported_ne_mps: Floats

    def wind_report(self, drone_index: int, report_index: int) -> MemberWindReport:
        """Return one wind report of one drone."""
        t_s = float(self.report_times_s[report_index])
        north, east = self.drones[drone_index].positions_ne_m_at(np.array([t_s]))[0]
        wind = self.reported_ne_mps[drone_index, report_index]
        variance = REPORT_STD_MPS**2
        return MemberWindReport(
            self.drones[drone_index].name,
            t_s,
            (float(north), float(east)),
            HEIGHT_M,
            (float(wind[0]), float(wind[1])),
            (variance, 0.0, variance),
        )

    def true_mean_wind_ne_mps(self, position_ne_m: Floats, first_s: float, last_s: float) -> Floats:
        """Return the true mean wind (2,) at a position over a time interval."""
        count = max(math.ceil(last_s - first_s), 1)
        t_s = np.linspace(first_s, last_s, count, endpoint=False) + 0.5
        return self.truth.to_ne_mps(t_s, position_ne_m[0], position_ne_m[1], HEIGHT_M).mean(axis=0)


@dataclass(frozen=True)
class WindCase:
    """Evaluated wind: half of a recording (n, 2) at whole seconds, or draws of a synthetic field.

    `training_ne_mps`: the other half, or a draw that is not evaluated.
    """

    training_ne_mps: Floats
    half_ne_mps: Floats | None = None
    synthetic_field: WindFieldParams | None = None
    flows: ComputedFlows | None = None

    @cached_property
    def process(self) -> WindProcessParams:
        """Process fitted to the training wind, as `companion fit-wind` does."""
        seconds = np.arange(self.training_ne_mps.shape[0], dtype=np.float64)
        averages = average_wind_over_10_s(seconds, self.training_ne_mps)
        return fit_wind_process_to_recordings(averages, "other half").process

    @property
    def mean_mps(self) -> float:
        """Mean wind speed."""
        if self.synthetic_field is not None:
            return self.synthetic_field.mean_mps
        assert self.half_ne_mps is not None
        return float(np.hypot(*self.half_ne_mps.T).mean())

    @property
    def coherence(self) -> Coherence:
        """Coherence of the field."""
        field = self.synthetic_field
        return RECORDING_COHERENCE if field is None else field.coherence

    def draw_series_ne_mps(self, seed: int, draw_index: int) -> Floats:
        """Return the wind of one draw at whole seconds; a recording's is always the same."""
        if self.half_ne_mps is not None:
            return self.half_ne_mps
        assert self.synthetic_field is not None
        return draw_free_wind_series(
            self.synthetic_field, np.random.default_rng([seed, 7, draw_index])
        )


def split_recording_in_cross_fitted_halves(path: Path) -> tuple[WindCase, WindCase]:
    """Return both halves of a recording's longest stretch, each with the other to fit.

    Raises LeewayError if it is too short.
    """
    stretch = max(read_recording(path).stretches, key=lambda one: one.seconds)
    middle = stretch.wind_ne_mps.shape[0] // 2
    if middle < MIN_HALF_S:
        raise LeewayError(
            f"{path}: the longest stretch lasts {stretch.seconds} s:"
            f" expected {2 * MIN_HALF_S} s or more, one half to fit and one to evaluate"
        )
    first, second = stretch.wind_ne_mps[:middle], stretch.wind_ne_mps[middle:]
    return WindCase(second, first), WindCase(first, second)


@lru_cache(maxsize=1)
def read_cases(setting: FleetWindSetting) -> tuple[WindCase, ...]:
    """Return both halves of a recording, or one synthetic field; read once per process.

    Raises LeewayError if a file is invalid.
    """
    if setting.wind_log is not None:
        return split_recording_in_cross_fitted_halves(Path(setting.wind_log))
    path = Path(setting.field or "")
    try:
        synthetic_field = load_wind_field(path)
        flows = load_flows(synthetic_field, path)
    except TruthError as error:
        raise LeewayError(str(error)) from error
    fitting_rng = np.random.default_rng([setting.seed, 7, _FITTING_DRAW])
    training_ne_mps = draw_free_wind_series(synthetic_field, fitting_rng)
    return (WindCase(training_ne_mps, synthetic_field=synthetic_field, flows=flows),)


def create_validated_setting(
    wind_log: Path | None, field_file: Path | None, drones: int, hovering: int, seed: int
) -> FleetWindSetting:
    """Check the options and digest the files. Raises LeewayError before any field is drawn."""
    if (wind_log is None) == (field_file is None):
        raise LeewayError("expected either --wind-log or --field")
    if hovering > drones:
        raise LeewayError(f"--hovering {hovering}: expected at most --drones, {drones}")
    log, field = (None if path is None else str(path) for path in (wind_log, field_file))
    file = file_sha256_prefix(wind_log or field_file or Path())
    setting = FleetWindSetting(log, field, file, drones, hovering, seed)
    synthetic_field = read_cases(setting)[0].synthetic_field
    if synthetic_field is None or field_file is None:
        return setting
    flows = (file_sha256_prefix(field_file.parent / one.file) for one in synthetic_field.flows)
    return replace(setting, file=file + "".join(flows))


@dataclass(frozen=True, slots=True)
class DrawnField:
    """Wind and fleet of one draw of a case, with and without a front. `rng` draws the reports."""

    case: WindCase
    field: CoherentField
    patrol_list: list[Patrol]
    front: LinearFront
    rng: np.random.Generator

    @property
    def seconds(self) -> int:
        """Duration in s."""
        return self.field.seconds

    def true_wind(self, *, with_front: bool) -> SiteWind:
        """Return the wind, with or without the front."""
        fronts = [self.front] if with_front else []
        synthetic_field = self.case.synthetic_field
        obstacles = synthetic_field.obstacles if synthetic_field else ()
        return SiteWind(self.field, fronts, obstacles=obstacles, flows=self.case.flows)

    def draw_world_with_reports(self, rng: np.random.Generator, *, with_front: bool) -> FleetWorld:
        """Draw the wind reports of the drones, with or without the front."""
        truth = self.true_wind(with_front=with_front)
        report_seconds = np.arange(REPORT_INTERVAL_S, self.seconds + 1, REPORT_INTERVAL_S)
        within = np.arange(report_seconds[-1]) + 0.5
        reported_ne_mps = np.empty((len(self.patrol_list), report_seconds.size, 2))
        for number, patrol in enumerate(self.patrol_list):
            north, east = patrol.positions_ne_m_at(within).T
            wind = truth.to_ne_mps(within, north, east, HEIGHT_M)
            by_report = wind.reshape(report_seconds.size, REPORT_INTERVAL_S, 2)
            reported_ne_mps[number] = by_report.mean(axis=1)
        reported_ne_mps += REPORT_STD_MPS * rng.standard_normal(reported_ne_mps.shape)
        return FleetWorld(
            truth,
            self.seconds,
            FieldProcess(self.case.process),
            self.patrol_list,
            report_seconds.astype(float),
            reported_ne_mps,
        )


def draw_field(setting: FleetWindSetting, case_index: int, draw_index: int) -> DrawnField:
    """Return a draw of a case, identical in every process."""
    case = read_cases(setting)[case_index]
    change_mps = RECORDING_FRONT_MPS
    if case.synthetic_field is not None:
        change_mps = case.synthetic_field.front_least_mps, case.synthetic_field.front_most_mps
    rng = np.random.default_rng([setting.seed, case_index, draw_index])
    field = CoherentField(case.draw_series_ne_mps(setting.seed, draw_index), case.coherence, rng)
    patrol_list = draw_patrols(setting.drones, setting.hovering, field.seconds, rng)
    t_s = float(rng.uniform(FRONT_FROM_S, field.seconds - FRONT_UNTIL_S))
    front = draw_front(t_s, field.mean_ne_mps, *change_mps, rng)
    return DrawnField(case, field, patrol_list, front, rng)
