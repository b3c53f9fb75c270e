"""`companion calibrate`: fit an airframe file to flight logs."""

import datetime as dt
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from companion.adapters.files.airframe_toml import FITTED_TO, write_airframe
from companion.adapters.files.params import read_airframe
from companion.adapters.files.qgc_plan import write_plan
from companion.adapters.logs.flight_table import read_payload_kg_from_flight_table
from companion.adapters.logs.open_log import read_multirotor_log
from companion.analysis.calibration.airframe_fit import (
    Calibration,
    ValidationFlight,
    fit_airframe_to_flights,
    predict_flight_energy,
)
from companion.analysis.calibration.drag import DRAG_KEYS, DragPriors
from companion.analysis.calibration.flight import (
    DISCHARGE_CHARGE_FRAC,
    DISCHARGE_HEIGHT_M,
    PlanOptions,
    calibration_mission_items,
    discharge_mission_items,
    discharge_stop_voltage_v,
    square_speeds_mps,
    with_side_long_enough_for_fast_legs,
)
from companion.analysis.calibration.ground_power import StandingPower, describe_ground_tests
from companion.analysis.calibration.power import PowerPriors, power_parameter_table_keys
from companion.analysis.calibration.quantities import avionics_power_std_w
from companion.analysis.calibration.trim import TRIM_KEYS
from companion.analysis.measured_energy.flight_measurements import (
    FlightMeasurements,
    measure_recorded_flight,
)
from companion.analysis.measured_energy.identified_phases import (
    fit_phase_power_ratios,
)
from companion.analysis.measured_energy.track_power import (
    PHASES,
    energy_by_phase,
    modelled_track_power_w,
    wind_on_track_grid,
    with_flown_power_ratios,
)
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame
from companion.core.exports.qgc_plan import PlanItem
from companion.core.vehicle.airframe import Airframe

EXIT_UNIDENTIFIED = 3


@dataclass(frozen=True, slots=True)
class CalibrateOptions:
    """Options of the command line; `payload_kg` and `holdouts` are unparsed."""

    logs: tuple[Path, ...]
    airframe: str
    out: Path
    payload_kg: str
    holdouts: tuple[str, ...]
    temperature_c: float
    allow_priors: bool
    symmetric: bool
    json_out: Path | None


def fit_airframe_to_logs_and_write(options: CalibrateOptions) -> None:
    """Read, fit, print and write; raises LeewayError, or typer.Exit with code 3."""
    console = Console(highlight=False, soft_wrap=True)
    start = read_airframe(options.airframe)
    loads = _parse_payloads_kg(options.payload_kg, options.logs)
    with console.status("reading") as status:
        logs = [
            _read_flight_or_ground_test(console, path, load, start, options.temperature_c)
            for path, load in zip(options.logs, loads, strict=True)
        ]
        validation_logs = [
            _read_flight_or_ground_test(console, path, load, start, options.temperature_c)
            for path, load in map(_parse_holdout_log_and_payload_kg, options.holdouts)
        ]
        ground = [log for log in logs if isinstance(log, StandingPower)]
        read = [log for log in logs if isinstance(log, FlightMeasurements)]
        flights = [log.prepared.blocks for log in read]
        if not flights:
            raise LeewayError("all logs are on the ground; expected at least one flight")
        for words in describe_ground_tests(ground, PowerPriors().current_offset_std_a):
            console.print(f"  {words}")
        priors = DragPriors.for_symmetric_airframe() if options.symmetric else None
        calibration = fit_airframe_to_flights(
            flights,
            start,
            lambda words: status.update(f"fitting: {words}"),
            priors=priors,
            standing_power_tests=ground,
        )
        calibration = _with_power_ratio_by_phase(calibration, read)
        validation_flights = [
            predict_flight_energy(log.prepared.blocks, calibration.airframe)
            for log in validation_logs
            if isinstance(log, FlightMeasurements)
        ]
    _print_calibration(console, calibration, validation_flights)
    if options.json_out is not None:
        options.json_out.write_text(
            json.dumps(_calibration_to_json_dict(calibration, validation_flights), indent=1) + "\n"
        )
    if calibration.unidentified_required_quantities and not options.allow_priors:
        raise typer.Exit(EXIT_UNIDENTIFIED)
    _write_airframe_file(
        options.out,
        start,
        calibration,
        validation_flights,
        options.logs,
        loads,
        options.temperature_c,
    )
    read_airframe(str(options.out))
    console.print(f"{options.out}: written; fly it with --airframe {options.out}")


def write_calibration_flight_plan(
    out_path: Path, home_lat_lon_alt: str, airframe_name: str, autopilot: str, options: PlanOptions
) -> None:
    """Write the calibration flight of an airframe as a QGroundControl plan."""
    prior_airframe = read_airframe(airframe_name)
    items = calibration_mission_items(prior_airframe, options)
    _write_plan(out_path, items, home_lat_lon_alt, prior_airframe, autopilot)
    options = with_side_long_enough_for_fast_legs(prior_airframe, options)
    typer.echo(
        f"{out_path}: written; it climbs to {options.height_m + 30.0:.0f} m within a"
        f" {options.side_m:.0f} m square"
    )


def write_discharge_hover_plan(
    out_path: Path, home_lat_lon_alt: str, airframe_name: str, autopilot: str, payload_kg: float
) -> None:
    """Write the hover that measures usable energy, and print the failsafe that must end it."""
    prior_airframe = read_airframe(airframe_name)
    items = discharge_mission_items(prior_airframe, payload_kg)
    _write_plan(out_path, items, home_lat_lon_alt, prior_airframe, autopilot)
    stop_v = discharge_stop_voltage_v(prior_airframe, payload_kg)
    typer.echo(
        f"{out_path}: written; it hovers at {DISCHARGE_HEIGHT_M:g} m until {stop_v:.1f} V under"
        f" load ({100.0 * DISCHARGE_CHARGE_FRAC:.0f} % estimated). Before take-off set"
        f" BATT_LOW_VOLT {stop_v:.1f}, BATT_LOW_TIMER 5, BATT_FS_LOW_ACT 1 (ArduPilot: it lands by"
        " itself); on PX4 be ready to switch to Land at that voltage"
    )


def _write_plan(
    out_path: Path,
    items: list[PlanItem],
    home_lat_lon_alt: str,
    prior_airframe: Airframe,
    autopilot: str,
) -> None:
    frame = _parse_home_frame(home_lat_lon_alt)
    if autopilot not in ("px4", "ardupilot"):
        raise LeewayError(f"--autopilot {autopilot}: px4 or ardupilot expected")
    write_plan(out_path, items, frame, autopilot, square_speeds_mps(prior_airframe)[1])


def _parse_home_frame(home_lat_lon_alt: str) -> LocalFrame:
    try:
        lat_deg, lon_deg, alt_m = map(float, home_lat_lon_alt.split(","))
    except ValueError as error:
        raise LeewayError(
            f"--home {home_lat_lon_alt}: LAT,LON,ALT in degrees and m expected"
        ) from error
    if not (abs(lat_deg) <= 85.0 and abs(lon_deg) <= 180.0 and -500.0 <= alt_m <= 6000.0):
        raise LeewayError(
            f"--home {home_lat_lon_alt}: expected latitude within 85 deg, alt -500 to 6000 m"
        )
    return LocalFrame(float(np.radians(lat_deg)), float(np.radians(lon_deg)), alt_m)


def _parse_payloads_kg(option_text: str, logs: tuple[Path, ...]) -> list[float]:
    """Return the payloads from the option, else from the table of each log, else 0."""
    if not option_text:
        return [read_payload_kg_from_flight_table(log) or 0.0 for log in logs]
    try:
        loads = [float(word) for word in option_text.split(",")]
    except ValueError as error:
        raise LeewayError(f"--payload-kg {option_text}: numbers with commas expected") from error
    if len(loads) != len(logs) or not all(0.0 <= load <= 500.0 for load in loads):
        raise LeewayError(
            f"--payload-kg {option_text}: {len(logs)} loads in kg expected, one for each log"
        )
    return loads


def _parse_holdout_log_and_payload_kg(holdout_text: str) -> tuple[Path, float]:
    name, colon, load = holdout_text.rpartition(":")
    if not colon:
        return Path(holdout_text), read_payload_kg_from_flight_table(Path(holdout_text)) or 0.0
    try:
        return Path(name), float(load)
    except ValueError as error:
        raise LeewayError(f"--holdout {holdout_text}: LOG or LOG:KG expected") from error


def _read_flight_or_ground_test(
    console: Console,
    log_path: Path,
    payload_kg: float,
    prior_airframe: Airframe,
    temperature_c: float,
) -> FlightMeasurements | StandingPower:
    """Read a log: a flight, or a test on the ground."""
    flight = read_multirotor_log(log_path)
    name = log_path.name
    measured = measure_recorded_flight(flight, name, payload_kg, temperature_c, prior_airframe)
    if isinstance(measured, FlightMeasurements):
        for words in (*(f"{name}: {issue}" for issue in flight.findings), *measured.prepared.notes):
            console.print(f"  {words}")
    return measured


def _with_power_ratio_by_phase(
    calibration: Calibration, logs: list[FlightMeasurements]
) -> Calibration:
    """Add the ratio of measured to modelled power in each phase, from logs with a track."""
    energies, notes = [], list(calibration.notes)
    for log, wind in zip(logs, calibration.drag.winds, strict=True):
        try:
            track = log.track
        except LeewayError as error:
            notes.append(f"power by phase: excluded: {error}")
            continue
        along_track = wind_on_track_grid(track, log.prepared.blocks, wind)
        power = modelled_track_power_w(calibration.airframe, track, along_track, log.density_kgpm3)
        energies.append(energy_by_phase(track, power))
    phases = fit_phase_power_ratios(energies)
    start = "the power model" if phases.table is None else "level flight"
    notes += [
        f"{q.name}: not identified, uses {start}; to identify it: {q.flight}"
        for q in phases.quantities
        if not q.is_identifiable
    ]
    return replace(
        calibration,
        airframe=with_flown_power_ratios(calibration.airframe, phases.table),
        quantities=(*calibration.quantities, *phases.quantities),
        notes=tuple(notes),
    )


def _print_calibration(
    console: Console, calibration: Calibration, validation_flights: list[ValidationFlight]
) -> None:
    table = Table(title="Fitted quantities")
    for name in ("", "value", "± std", "prior ±", "unit", ""):
        table.add_column(name, justify="left" if not name or name == "unit" else "right")
    for q in calibration.quantities:
        unknown = "NOT IDENTIFIED" if q.needed else "mostly prior"
        verdict = "identified" if q.is_identifiable else unknown
        table.add_row(
            q.name, f"{q.value:.4g}", f"{q.std:.2g}", f"{q.prior_std:.2g}", q.unit, verdict
        )
    console.print(table)
    energy = Table(title="Energy of held-out flights")
    for name in ("flight", "wind m/s", "load kg", "measured Wh", "predicted Wh", "error"):
        energy.add_column(name, justify="left" if name == "flight" else "right")
    for kind, rows in (("left out", calibration.holdouts), ("--holdout", validation_flights)):
        for h in rows:
            energy.add_row(
                f"{h.name} ({kind})",
                f"{h.wind_mps:.1f}",
                f"{h.payload_kg:g}",
                f"{h.measured_wh:.1f}",
                f"{h.predicted_wh:.1f}",
                f"{100.0 * h.relative_energy_error:+.1f} %",
            )
    console.print(energy)
    for words in calibration.notes:
        console.print(words)
    for q in calibration.unidentified_required_quantities:
        console.print(
            f"not identified: {q.name} is {q.value:.3g} ± {q.std:.2g} {q.unit}, and"
            f" {100.0 * q.limit_frac:.0f} % or better is needed: {q.flight}"
        )


def _write_airframe_file(
    out_path: Path,
    prior_airframe: Airframe,
    calibration: Calibration,
    validation_flights: list[ValidationFlight],
    log_paths: tuple[Path, ...],
    payloads_kg: list[float],
    temperature_c: float,
) -> None:
    fitted = msgspec.structs.replace(calibration.airframe, name=out_path.stem)
    flown = ", ".join(
        f"{p.name} ({dt.datetime.fromtimestamp(p.stat().st_mtime, dt.UTC):file of %Y-%m-%d},"
        f" {kg:g} kg)"
        for p, kg in zip(log_paths, payloads_kg, strict=True)
    )
    header = [
        f"{FITTED_TO}{flown}; air at {temperature_c:g} C. Start and prior:"
        f" {prior_airframe.name}; numbers without a comment are unchanged.",
    ]
    header += [
        f"Predicted unseen: {h.name}: {h.predicted_wh:.1f} Wh of {h.measured_wh:.1f} measured"
        f" ({100.0 * h.relative_energy_error:+.1f} %), {h.wind_mps:.1f} m/s of wind,"
        f" {h.payload_kg:g} kg"
        for h in (*calibration.holdouts, *validation_flights)
    ]
    header += calibration.notes
    if calibration.unidentified_required_quantities:
        header.append(
            "NOT IDENTIFIED, prior values: "
            + ", ".join(q.name for q in calibration.unidentified_required_quantities)
        )
    write_airframe(out_path, fitted, header, _source_comment_by_parameter(calibration))


def _source_comment_by_parameter(calibration: Calibration) -> dict[tuple[str, str], str]:
    found = {}
    drag = [("drag", key) for key in DRAG_KEYS]
    for keys, fit in (
        (drag, calibration.drag),
        (power_parameter_table_keys(calibration.airframe), calibration.power),
    ):
        for key, std in zip(keys, np.sqrt(np.diag(fit.cov)), strict=True):
            found[key] = f"fitted, ± {std:.2g}"
    found["power_rotor", "avionics_w"] = f"fitted, ± {avionics_power_std_w(calibration.power):.2g}"
    found["drag", "gain_std_frac"] = "of that fit at the airspeed flown, at least the air's density"
    found["drag", "axis_gain_std_frac"] = "of that fit at the airspeed flown"
    found["drag", "model_std_frac"] = "residual of two coefficients per axis on real vehicles"
    found["power_rotor", "model_std_frac"] = (
        "rms over two-minute segments of held-out flights, or 0.03"
    )
    for q in calibration.quantities:
        if q.name in TRIM_KEYS and q.is_identifiable:
            found["drag", TRIM_KEYS[q.name]] = f"mean over flights, ± {q.std:.2g}"
    for phase, q in zip(PHASES, calibration.quantities[-len(PHASES) :], strict=True):
        words = f"measured over flights, ± {q.std:.2g}" if q.is_identifiable else "as level flight"
        found["power_flown", f"{phase}_frac"] = words
    battery = calibration.battery
    if any(q.name == "pack's resistance" and q.is_identifiable for q in calibration.quantities):
        found["battery", "resistance_ohm"] = f"fitted, ± {battery.resistance_std_ohm:.2g}"
    usable = battery.usable
    if usable is not None:
        found["battery", "usable_frac"] = (
            f"discharged in {', '.join(usable.logs)}, ± {usable.std_frac:.2g}; the last"
            f" {100.0 * usable.extrapolated_frac:.1f} % by the prior curve"
        )
        found["battery", "usable_at_w"] = "mean draw of the lightest discharge"
        found["battery", "usable_std_frac"] = "of that fit"
        if len(usable.logs) > 1:
            found["battery", "usable_loss_per_w"] = f"fitted, ± {usable.loss_std_per_w:.2g}"
    return found


def _calibration_to_json_dict(
    calibration: Calibration, validation_flights: list[ValidationFlight]
) -> dict[str, Any]:
    def flight_row(validation_flight: ValidationFlight, kind: str) -> dict[str, Any]:
        return {
            **msgspec.to_builtins(validation_flight),
            "kind": kind,
            "error_frac": validation_flight.relative_energy_error,
        }

    return {
        "format": "calibration/1",
        "quantities": [
            {**msgspec.to_builtins(q), "identified": q.is_identifiable}
            for q in calibration.quantities
        ],
        "holdouts": [
            *(flight_row(h, "left out") for h in calibration.holdouts),
            *(flight_row(h, "holdout") for h in validation_flights),
        ],
        "standing": msgspec.to_builtins(calibration.power.standing),
        "airframe": msgspec.to_builtins(calibration.airframe),
        "drag": {"keys": DRAG_KEYS, "std": np.sqrt(np.diag(calibration.drag.cov)).tolist()},
        "power": {
            "keys": [key for _, key in power_parameter_table_keys(calibration.airframe)],
            "std": np.sqrt(np.diag(calibration.power.cov)).tolist(),
        },
        "notes": list(calibration.notes),
    }
