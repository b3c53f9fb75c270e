"""`companion certify`: the loss bound that recorded days support for an airframe's draw."""

import datetime
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from rich.console import Console
from rich.table import Table

from companion.adapters.files.airframe_toml import read_fitted_log_names
from companion.adapters.files.certificate_file import write_certificate
from companion.adapters.files.params import read_airframe, read_wind_process
from companion.adapters.logs.flight_table import find_flight_table_row
from companion.adapters.logs.open_log import read_multirotor_log
from companion.analysis.calibration.drag import estimate_wind
from companion.analysis.calibration.power import airspeed_and_lateral_part_mps
from companion.analysis.calibration.records import BLOCK_S
from companion.analysis.measured_energy.decision_points import remaining_energy_at_decision_points
from companion.analysis.measured_energy.energy_scatter import (
    charge_number_by_flight,
    fit_energy_ratio_scatter,
)
from companion.analysis.measured_energy.flight_measurements import (
    FlightMeasurements,
    measure_recorded_flight,
    replay_wind_estimator,
)
from companion.analysis.measured_energy.flown_track import STEP_S
from companion.analysis.measured_energy.track_power import (
    modelled_track_power_w,
    wind_on_track_grid,
)
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.certificate.certificate import Certificate, percent_text
from companion.core.certificate.certify import MeasuredFlight, Scatter, create_certificate
from companion.core.certificate.evidence import RiskEvidence
from companion.core.certificate.support import COVERAGE, days_needed_for_loss, loss_free_days_needed
from companion.core.vehicle.airframe import Airframe

_T = TypeVar("_T")
DEFAULT_TEMPERATURE_C = 20.0
"""Air temperature for the density if none is stated; the envelope then has no range."""
MEAN_S = 10.0


@dataclass(frozen=True, slots=True)
class CertifyOptions:
    """Options of the command line; `payload_kg` and `dates` are unparsed."""

    logs: tuple[Path, ...]
    airframe: Path
    payload_kg: str
    dates: str
    temperature_c: float | None
    max_loss: float
    wind_process: str


@dataclass(frozen=True, slots=True)
class _LogMetadata:
    """Metadata of a log."""

    path: Path
    date: str
    hour: float
    payload_kg: float
    temperature_c: float | None


@dataclass(frozen=True, slots=True)
class _EvaluatedFlight:
    flight: MeasuredFlight
    hour: float
    start_v: float


def evaluate_logs_and_write_certificate(options: CertifyOptions) -> None:
    """Read, evaluate, print and write; raises LeewayError for invalid input."""
    console = Console(highlight=False, soft_wrap=True)
    if options.airframe.suffix != ".toml" or not options.airframe.is_file():
        raise LeewayError(
            f"--airframe {options.airframe}: an airframe file (.toml) expected; the certificate is"
            " written next to it"
        )
    needed = days_needed_for_loss(options.max_loss), loss_free_days_needed(options.max_loss)
    airframe = read_airframe(str(options.airframe))
    log_metadata, left_out = _exclude_days_of_fitted_logs(
        _read_log_metadata(options), read_fitted_log_names(options.airframe)
    )
    flown: list[_EvaluatedFlight] = []
    with console.status("reading") as status:
        for log in log_metadata:
            status.update(f"reading {log.path.name}")
            try:
                flown.append(_measure_and_predict_flight(log, airframe))
            except LeewayError as error:
                name, text = log.path.name, str(error)
                left_out.append(text if text.startswith(name) else f"{name}: {text}")
    for words in left_out:
        console.print(f"  excluded: {words}")
    flown.sort(key=lambda one: (one.flight.date, one.hour))
    flights = [one.flight for one in flown]
    certificate = create_certificate(airframe, flights, _fit_log_ratio_scatter(flown), left_out)
    _print_certificate(console, certificate, flights)
    is_supported = certificate.supported_loss_probability <= options.max_loss
    console.print(f"certificate: {certificate.summary_text}")
    evidence = RiskEvidence(read_wind_process(options.wind_process), certificate)
    console.print(f"evidence: {evidence.summary_text}")
    console.print(
        f"{percent_text(options.max_loss)} needs {needed[0]} days, and with"
        f" {percent_text(COVERAGE)} confidence {needed[1]} without a loss:"
        f" {'the first is supported' if is_supported else 'not supported'}"
    )
    console.print(
        f"{write_certificate(options.airframe, certificate)}: written; flights with it are checked"
    )


def _read_log_metadata(options: CertifyOptions) -> list[_LogMetadata]:
    """Return each log with day, payload and temperature: from the options, else from the table."""
    loads = _parse_comma_separated_option(
        options.payload_kg, "--payload-kg", "loads in kg", len(options.logs), _parse_payload_kg
    )
    dates = _parse_comma_separated_option(
        options.dates, "--dates", "days as YYYY-MM-DD", len(options.logs), _parse_date
    )
    return list(_iterate_log_metadata(options, loads, dates))


def _iterate_log_metadata(
    options: CertifyOptions, payloads_kg: list[float], dates: list[str]
) -> Iterator[_LogMetadata]:
    for number, path in enumerate(options.logs):
        row = find_flight_table_row(path)
        if row is None and not dates:
            raise LeewayError(
                f"{path}: unknown day; expected --dates, or a parameters.csv next to it"
            )
        date = dates[number] if dates else row.date if row else ""
        load = payloads_kg[number] if payloads_kg else row.payload_kg if row else 0.0
        celsius = (
            row.temperature_c if row and row.temperature_c is not None else options.temperature_c
        )
        yield _LogMetadata(path, date, row.hour if row else float(number), load, celsius)


def _parse_comma_separated_option(
    option_text: str,
    option_name: str,
    value_name: str,
    expected_count: int,
    parse_item: Callable[[str], _T],
) -> list[_T]:
    if not option_text:
        return []
    try:
        found = [parse_item(word.strip()) for word in option_text.split(",")]
    except ValueError as error:
        raise LeewayError(
            f"{option_name} {option_text}: {value_name} with commas expected"
        ) from error
    if len(found) != expected_count:
        raise LeewayError(
            f"{option_name} {option_text}: {expected_count} {value_name} expected, one for each log"
        )
    return found


def _parse_payload_kg(text: str) -> float:
    load = float(text)
    if not 0.0 <= load <= 500.0:
        raise ValueError(text)
    return load


def _parse_date(text: str) -> str:
    return datetime.date.fromisoformat(text).isoformat()


def _exclude_days_of_fitted_logs(
    logs: list[_LogMetadata], fitted_log_names: frozenset[str]
) -> tuple[list[_LogMetadata], list[str]]:
    """Exclude days of logs that the airframe was fitted to: they are no independent test."""
    days = {log.date for log in logs if log.path.name in fitted_log_names}
    left_out = [
        f"{log.path.name}: the airframe was fitted to flights of {log.date}"
        for log in logs
        if log.date in days
    ]
    return [log for log in logs if log.date not in days], left_out


def _measure_and_predict_flight(log: _LogMetadata, airframe: Airframe) -> _EvaluatedFlight:
    """Measure a complete flight and predict its energy; raises LeewayError if incomplete."""
    name = log.path.name
    celsius = DEFAULT_TEMPERATURE_C if log.temperature_c is None else log.temperature_c
    recorded = read_multirotor_log(log.path)
    measured = measure_recorded_flight(recorded, name, log.payload_kg, celsius, airframe)
    if not isinstance(measured, FlightMeasurements):
        raise LeewayError(f"{name}: on the ground throughout; expected a flight")
    track, blocks = measured.track, measured.prepared.blocks
    if measured.prepared.ends_in_flight or track.ends_in_flight:
        raise LeewayError(
            f"{name}: cut off in flight at {blocks.t_s[-1]:.0f} s; not a whole flight"
        )
    wind = estimate_wind(blocks, airframe)
    density = measured.density_kgpm3
    along_track = wind_on_track_grid(track, blocks, wind)
    power = modelled_track_power_w(airframe, track, along_track, density)
    estimated_wind = replay_wind_estimator(measured, airframe).mean_ne_mps
    points = remaining_energy_at_decision_points(airframe, track, estimated_wind, density)
    flight = MeasuredFlight(
        name=name,
        date=log.date,
        measured_wh=track.energy_wh,
        predicted_wh=float(power.sum()) * STEP_S / 3600.0,
        decision_points=len(points),
        worst_ratio=max(point.measured_to_predicted_ratio for point in points),
        wind_mps=_max_10_s_mean(np.hypot(wind.to_north_mps, wind.to_east_mps)),
        airspeed_mps=_max_10_s_mean(airspeed_and_lateral_part_mps(blocks, wind)[0]),
        payload_kg=log.payload_kg,
        air_temperature_c=log.temperature_c,
    )
    return _EvaluatedFlight(flight, log.hour, measured.resting_voltage_v)


def _max_10_s_mean(block_values: Floats) -> float:
    """Return the largest mean over MEAN_S."""
    width = min(round(MEAN_S / BLOCK_S), len(block_values))
    return float(np.convolve(block_values, np.full(width, 1.0 / width), "valid").max())


def _fit_log_ratio_scatter(evaluated_flights: list[_EvaluatedFlight]) -> Scatter:
    """Fit the scatter for a new day; the voltage before take-off identifies pack charges."""
    days = [one.flight.date for one in evaluated_flights]
    logs = np.array([one.flight.log_measured_to_predicted_ratio for one in evaluated_flights])
    charge_labels = charge_number_by_flight(days, [one.start_v for one in evaluated_flights])
    found = fit_energy_ratio_scatter(logs, days, charge_labels)
    return Scatter(found.mean, found.std)


def _print_certificate(
    console: Console, certificate: Certificate, flights: list[MeasuredFlight]
) -> None:
    table = Table(
        title=f"Draw of {certificate.airframe} by day, measured over predicted: whole flights,"
        " and the"
        " worst return"
    )
    for name in ("day", "flights", "decision points", "mean", "worst"):
        table.add_column(name, justify="left" if name == "day" else "right")
    for day in certificate.days:
        mean = float(
            np.exp(
                np.mean([f.log_measured_to_predicted_ratio for f in flights if f.date == day.date])
            )
        )
        points = f"{day.decision_points:,}"
        table.add_row(day.date, str(day.flights), points, f"{mean:.3f}", f"{day.worst_ratio:.3f}")
    console.print(table)
    envelope = certificate.envelope
    air = envelope.air_temperature_c
    console.print(
        f"envelope (two days or more): wind to {envelope.wind_mps:.1f} m/s, airspeed to"
        f" {envelope.airspeed_mps:.1f} m/s, parcel to {envelope.payload_kg:g} kg, air"
        f" {'of unknown temperature' if air is None else f'{air[0]:.0f} to {air[1]:.0f} C'};"
        f" pack {certificate.pack}"
    )
    console.print(
        f"a flight on a new day: {certificate.draw_factor:.3f} of what is predicted,"
        f" +- {100.0 * certificate.draw_std_frac:.1f} %"
    )
