"""`companion certify`: what days of flights support of an airframe's draw."""

import datetime
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from rich.console import Console
from rich.table import Table

from companion.adapters.files.airframe_toml import fitted_logs
from companion.adapters.files.certificate_file import write_certificate
from companion.adapters.files.params import read_airframe
from companion.adapters.logs.calibration_logs import as_record, open_multirotor_log
from companion.adapters.logs.flight_table import row_of
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.calibration.drag import see_wind
from companion.core.calibration.power import air_speeds
from companion.core.calibration.records import BLOCK_S, prepare
from companion.core.calibration.standing import ground_test
from companion.core.certificate.certificate import Certificate, percent
from companion.core.certificate.certify import MeasuredFlight, Scatter, certify
from companion.core.certificate.support import CONFIDENCE, days_needed, days_needed_confidently
from companion.core.measured_energy.decision_points import decision_points
from companion.core.measured_energy.energy_scatter import charges_of, fit_scatter
from companion.core.measured_energy.flown_track import STEP_S, flown_track
from companion.core.measured_energy.track_power import track_power_w
from companion.core.replay.heard_wind import believed_wind
from companion.core.replay.recorded_flight import sampled
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

_T = TypeVar("_T")
UNSTATED_C = 20.0
"""Of the air's density, where no temperature is stated; the envelope then has none."""
MEAN_S = 10.0
SAMPLED_EVERY_S = 0.1


@dataclass(frozen=True, slots=True)
class CertifyOptions:
    """What the command line asks: `payload_kg` and `dates` as typed there."""

    logs: tuple[Path, ...]
    airframe: Path
    payload_kg: str
    dates: str
    temperature_c: float | None
    max_loss: float


@dataclass(frozen=True, slots=True)
class _Stated:
    """What is known of a log beside its content."""

    path: Path
    date: str
    hour: float
    payload_kg: float
    temperature_c: float | None


@dataclass(frozen=True, slots=True)
class _Flown:
    flight: MeasuredFlight
    hour: float
    start_v: float


def run_certify(o: CertifyOptions) -> None:
    """Read, judge, show and write; LeewayError for what cannot be used."""
    console = Console(highlight=False, soft_wrap=True)
    if o.airframe.suffix != ".toml" or not o.airframe.is_file():
        raise LeewayError(
            f"--airframe {o.airframe}: an airframe file (.toml) expected; the certificate is"
            " written beside it"
        )
    needed = days_needed(o.max_loss), days_needed_confidently(o.max_loss)
    airframe = read_airframe(str(o.airframe))
    stated, left_out = _unfitted(_stated(o), fitted_logs(o.airframe))
    flown: list[_Flown] = []
    with console.status("reading") as status:
        for log in stated:
            status.update(f"reading {log.path.name}")
            try:
                flown.append(_measured(log, airframe))
            except LeewayError as error:
                left_out.append(_named(log.path.name, str(error)))
    for words in left_out:
        console.print(f"  left out: {words}")
    flown.sort(key=lambda one: (one.flight.date, one.hour))
    flights = [one.flight for one in flown]
    done = certify(airframe, flights, _scatter(flown), left_out)
    _show(console, done, flights)
    missing = done.support_of(o.max_loss)
    console.print(f"certificate: {done.statement}")
    console.print(
        f"{percent(o.max_loss)} needs {needed[0]} days, and with {percent(CONFIDENCE)} confidence"
        f" {needed[1]} without a loss: {'not supported' if missing else 'the first is supported'}"
    )
    console.print(f"{write_certificate(o.airframe, done)}: written; flights with it watch it")


def _named(name: str, words: str) -> str:
    return words if words.startswith(name) else f"{name}: {words}"


def _stated(o: CertifyOptions) -> list[_Stated]:
    """Each log with its day, parcel and temperature: as typed, else of the table beside it."""
    loads = _typed(o.payload_kg, "--payload-kg", "loads in kg", len(o.logs), _load)
    dates = _typed(o.dates, "--dates", "days as YYYY-MM-DD", len(o.logs), _date)
    return list(_each(o, loads, dates))


def _each(o: CertifyOptions, loads: list[float], dates: list[str]) -> Iterator[_Stated]:
    for number, path in enumerate(o.logs):
        row = row_of(path)
        if row is None and not dates:
            raise LeewayError(
                f"{path}: its day is not known; expected --dates, or a parameters.csv beside it"
            )
        date = dates[number] if dates else row.date if row else ""
        load = loads[number] if loads else row.payload_kg if row else 0.0
        celsius = row.temperature_c if row and row.temperature_c is not None else o.temperature_c
        yield _Stated(path, date, row.hour if row else float(number), load, celsius)


def _typed(words: str, option: str, what: str, count: int, parse: Callable[[str], _T]) -> list[_T]:
    if not words:
        return []
    try:
        found = [parse(word.strip()) for word in words.split(",")]
    except ValueError as error:
        raise LeewayError(f"{option} {words}: {what} with commas expected") from error
    if len(found) != count:
        raise LeewayError(f"{option} {words}: {count} {what} expected, one for each log")
    return found


def _load(word: str) -> float:
    load = float(word)
    if not 0.0 <= load <= 500.0:
        raise ValueError(word)
    return load


def _date(word: str) -> str:
    return datetime.date.fromisoformat(word).isoformat()


def _unfitted(logs: list[_Stated], fitted: frozenset[str]) -> tuple[list[_Stated], list[str]]:
    """Without the days of logs that the airframe was fitted to: they tell nothing of a new day."""
    days = {log.date for log in logs if log.path.name in fitted}
    left_out = [
        f"{log.path.name}: the airframe was fitted to flights of {log.date}"
        for log in logs
        if log.date in days
    ]
    return [log for log in logs if log.date not in days], left_out


def _measured(log: _Stated, airframe: Airframe) -> _Flown:
    """A whole flight with what the airframe predicts for its track; LeewayError where not one."""
    name = log.path.name
    celsius = UNSTATED_C if log.temperature_c is None else log.temperature_c
    recorded = open_multirotor_log(log.path)
    record = as_record(recorded, name, log.payload_kg, celsius)
    hover_w = float(multirotor_power_w(airframe, airframe.mass_kg(log.payload_kg), 0.0))
    if ground_test(record, hover_w) is not None:
        raise LeewayError(f"{name}: stands on the ground throughout: not a flight")
    prepared = prepare(record, hover_w, airframe.battery.cells)
    samples = sampled(recorded, SAMPLED_EVERY_S)
    track = flown_track(name, samples, log.payload_kg)
    blocks = prepared.blocks
    if prepared.cut_short or track.cut_short:
        raise LeewayError(
            f"{name}: cut off in flight at {blocks.t_s[-1]:.0f} s; not a whole flight"
        )
    wind = see_wind(blocks, airframe)
    mean = np.array([wind.to_north_mps.mean(), wind.to_east_mps.mean()])
    density = blocks.density_kgpm3
    power = track_power_w(airframe, track, mean, density)
    mass_kg = airframe.mass_kg(log.payload_kg)
    believed = believed_wind(samples, airframe, mass_kg, density, track.t_s)
    points = decision_points(airframe, track, believed, density)
    known_v = samples.voltage_v[np.isfinite(samples.voltage_v)]
    flight = MeasuredFlight(
        name=name,
        date=log.date,
        measured_wh=track.energy_wh,
        predicted_wh=float(power.sum()) * STEP_S / 3600.0,
        decision_points=len(points),
        worst_ratio=max(point.ratio for point in points),
        wind_mps=_largest_mean(np.hypot(wind.to_north_mps, wind.to_east_mps)),
        airspeed_mps=_largest_mean(air_speeds(blocks, wind)[0]),
        payload_kg=log.payload_kg,
        air_temperature_c=log.temperature_c,
    )
    return _Flown(flight, log.hour, float(np.median(known_v[:8])))


def _largest_mean(of_blocks: Floats) -> float:
    """Largest mean over MEAN_S."""
    width = min(round(MEAN_S / BLOCK_S), len(of_blocks))
    return float(np.convolve(of_blocks, np.full(width, 1.0 / width), "valid").max())


def _scatter(flown: list[_Flown]) -> Scatter:
    """For a flight on a new day, the packs' charges told by their voltage before take-off."""
    days = [one.flight.date for one in flown]
    logs = np.array([one.flight.log_ratio for one in flown])
    charges = charges_of(days, [one.start_v for one in flown])
    found = fit_scatter(logs, days, charges)
    return Scatter(found.mean, found.std)


def _show(console: Console, done: Certificate, flights: list[MeasuredFlight]) -> None:
    table = Table(
        title=f"Draw of {done.airframe} by day, measured over predicted: whole flights, and the"
        " worst way home"
    )
    for name in ("day", "flights", "decision points", "mean", "worst"):
        table.add_column(name, justify="left" if name == "day" else "right")
    for day in done.days:
        mean = float(np.exp(np.mean([f.log_ratio for f in flights if f.date == day.date])))
        points = f"{day.decision_points:,}"
        table.add_row(day.date, str(day.flights), points, f"{mean:.3f}", f"{day.worst_ratio:.3f}")
    console.print(table)
    envelope = done.envelope
    air = envelope.air_temperature_c
    console.print(
        f"envelope (two days or more): wind to {envelope.wind_mps:.1f} m/s, airspeed to"
        f" {envelope.airspeed_mps:.1f} m/s, parcel to {envelope.payload_kg:g} kg, air"
        f" {'of unknown temperature' if air is None else f'{air[0]:.0f} to {air[1]:.0f} C'};"
        f" pack {done.pack}"
    )
    console.print(
        f"a flight on a new day: {done.draw_factor:.3f} of what is predicted,"
        f" +- {100.0 * done.draw_std_frac:.1f} %"
    )
