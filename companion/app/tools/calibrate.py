"""`companion calibrate`: an airframe file from one's own flight logs."""

import datetime
import json
from collections.abc import Callable
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
from companion.adapters.logs.calibration_logs import as_record, open_multirotor_log
from companion.adapters.logs.flight_table import payload_in_table_kg
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame
from companion.core.calibration.airframe_fit import Calibration, HeldOutFlight, calibrate, predict
from companion.core.calibration.drag import DRAG_KEYS, DragPriors
from companion.core.calibration.flight import (
    DISCHARGE_CHARGE_FRAC,
    DISCHARGE_HEIGHT_M,
    PlanOptions,
    calibration_items,
    discharge_items,
    discharge_stop_v,
    square_speeds_mps,
    with_room,
)
from companion.core.calibration.power import PowerPriors, power_keys
from companion.core.calibration.quantities import avionics_std_w
from companion.core.calibration.records import Blocks, prepare
from companion.core.calibration.standing import StandingPower, ground_test, told_of
from companion.core.calibration.trim import TRIM_KEYS
from companion.core.exports.qgc_plan import PlanItem
from companion.core.measured_energy.flown_track import FlownTrack, flown_track
from companion.core.measured_energy.identified_phases import identify_phases
from companion.core.measured_energy.track_power import (
    PHASES,
    phase_energy,
    track_power_w,
    with_flown,
)
from companion.core.replay.recorded_flight import sampled
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

NOT_IDENTIFIED = 3
TRACK_EVERY_S = 0.1


@dataclass(frozen=True, slots=True)
class CalibrateOptions:
    """What the command line asks: `payload_kg` and `holdouts` as typed there."""

    logs: tuple[Path, ...]
    airframe: str
    out: Path
    payload_kg: str
    holdouts: tuple[str, ...]
    temperature_c: float
    allow_priors: bool
    symmetric: bool
    json_out: Path | None
    plots: Path | None


def run_calibration(o: CalibrateOptions) -> None:
    """Read, fit, show and write; typer.Exit with 2 or 3 where that cannot be."""
    console = Console(highlight=False, soft_wrap=True)
    try:
        start = read_airframe(o.airframe)
        loads = _loads(o.payload_kg, o.logs)
        with console.status("reading") as status:
            logs = [
                _read(console, path, load, start, o.temperature_c)
                for path, load in zip(o.logs, loads, strict=True)
            ]
            kept = [
                _read(console, path, load, start, o.temperature_c)
                for path, load in map(_log_and_load, o.holdouts)
            ]
            ground = [log for log in logs if isinstance(log, StandingPower)]
            read = [log for log in logs if isinstance(log, _Log)]
            flights = [log.blocks for log in read]
            if not flights:
                raise LeewayError("no flight among the logs: they all stand on the ground")
            for words in told_of(ground, PowerPriors().current_offset_std_a):
                console.print(f"  {words}")
            priors = DragPriors.symmetric() if o.symmetric else None
            done = calibrate(
                flights,
                start,
                lambda words: status.update(f"fitting: {words}"),
                priors=priors,
                ground=ground,
            )
            done = _with_phases(done, read)
            unseen = [predict(log.blocks, done.airframe) for log in kept if isinstance(log, _Log)]
        _show(console, done, unseen)
        if o.plots is not None:
            _plot(o.plots, done, flights)
        if o.json_out is not None:
            o.json_out.write_text(json.dumps(_as_json(done, unseen), indent=1) + "\n")
        if done.missing and not o.allow_priors:
            raise typer.Exit(NOT_IDENTIFIED)
        _write(o.out, start, done, unseen, o.logs, loads, o.temperature_c)
        read_airframe(str(o.out))
        console.print(f"{o.out}: written; fly it with --airframe {o.out}")
    except LeewayError as error:
        typer.echo(f"companion: {error}", err=True)
        raise typer.Exit(2) from error


def write_calibration_plan(
    out: Path, home: str, airframe: str, autopilot: str, options: PlanOptions
) -> None:
    """Write the flight that identifies an airframe as a QGroundControl plan."""
    believed = _write_plan(out, home, airframe, autopilot, lambda a: calibration_items(a, options))
    options = with_room(believed, options)
    typer.echo(
        f"{out}: written; it climbs to {options.height_m + 30.0:.0f} m within a"
        f" {options.side_m:.0f} m square"
    )


def write_discharge_plan(
    out: Path, home: str, airframe: str, autopilot: str, payload_kg: float
) -> None:
    """Write the hover that measures usable energy, and say what has to end it."""
    believed = _write_plan(out, home, airframe, autopilot, lambda a: discharge_items(a, payload_kg))
    stop_v = discharge_stop_v(believed, payload_kg)
    typer.echo(
        f"{out}: written; it hovers at {DISCHARGE_HEIGHT_M:g} m until {stop_v:.1f} V under load"
        f" ({100.0 * DISCHARGE_CHARGE_FRAC:.0f} % as believed). Before you take off set"
        f" BATT_LOW_VOLT {stop_v:.1f}, BATT_LOW_TIMER 5, BATT_FS_LOW_ACT 1 (ArduPilot: it lands by"
        " itself); on PX4 be ready to switch to Land at that voltage"
    )


def _write_plan(
    out: Path,
    home: str,
    airframe: str,
    autopilot: str,
    items: Callable[[Airframe], list[PlanItem]],
) -> Airframe:
    try:
        frame = _frame(home)
        if autopilot not in ("px4", "ardupilot"):
            raise LeewayError(f"--autopilot {autopilot}: px4 or ardupilot expected")
        believed = read_airframe(airframe)
        write_plan(out, items(believed), frame, autopilot, square_speeds_mps(believed)[1])
    except LeewayError as error:
        typer.echo(f"companion: {error}", err=True)
        raise typer.Exit(2) from error
    return believed


def _frame(words: str) -> LocalFrame:
    try:
        lat_deg, lon_deg, alt_m = map(float, words.split(","))
    except ValueError as error:
        raise LeewayError(f"--home {words}: LAT,LON,ALT in degrees and m expected") from error
    if not (abs(lat_deg) <= 85.0 and abs(lon_deg) <= 180.0 and -500.0 <= alt_m <= 6000.0):
        raise LeewayError(f"--home {words}: not a place to fly from")
    return LocalFrame(float(np.radians(lat_deg)), float(np.radians(lon_deg)), alt_m)


def _loads(words: str, logs: tuple[Path, ...]) -> list[float]:
    """As typed; else of the table beside each log, where there is one; else nothing."""
    if not words:
        return [payload_in_table_kg(log) or 0.0 for log in logs]
    try:
        loads = [float(word) for word in words.split(",")]
    except ValueError as error:
        raise LeewayError(f"--payload-kg {words}: numbers with commas expected") from error
    if len(loads) != len(logs) or not all(0.0 <= load <= 500.0 for load in loads):
        raise LeewayError(
            f"--payload-kg {words}: {len(logs)} loads in kg expected, one for each log"
        )
    return loads


def _log_and_load(words: str) -> tuple[Path, float]:
    name, colon, load = words.rpartition(":")
    if not colon:
        return Path(words), payload_in_table_kg(Path(words)) or 0.0
    try:
        return Path(name), float(load)
    except ValueError as error:
        raise LeewayError(f"--holdout {words}: LOG or LOG:KG expected") from error


@dataclass(frozen=True, slots=True)
class _Log:
    """`track` is `None`, and `untracked` says why, where the log has no positions."""

    blocks: Blocks
    track: FlownTrack | None
    untracked: str = ""


def _read(
    console: Console, path: Path, payload_kg: float, start: Airframe, temperature_c: float
) -> _Log | StandingPower:
    """A flight, or a test on the ground."""
    flight = open_multirotor_log(path)
    record = as_record(flight, path.name, payload_kg, temperature_c)
    hover_w = float(multirotor_power_w(start, start.mass_kg(payload_kg), 0.0))
    standing = ground_test(record, hover_w)
    if standing is not None:
        return standing
    prepared = prepare(record, hover_w, start.battery.cells)
    for words in (*(f"{path.name}: {finding}" for finding in flight.findings), *prepared.notes):
        console.print(f"  {words}")
    try:
        track = flown_track(path.name, sampled(flight, TRACK_EVERY_S), payload_kg)
    except LeewayError as error:
        return _Log(prepared.blocks, None, str(error))
    return _Log(prepared.blocks, track)


def _with_phases(done: Calibration, logs: list[_Log]) -> Calibration:
    """The calibration with the power of each phase over its model's, where the tracks tell it."""
    energies, notes = [], list(done.notes)
    for log, wind in zip(logs, done.drag.winds, strict=True):
        if log.track is None:
            notes.append(f"power by phase: left out: {log.untracked}")
            continue
        mean = np.array([wind.to_north_mps.mean(), wind.to_east_mps.mean()])
        power = track_power_w(done.airframe, log.track, mean, log.blocks.density_kgpm3)
        energies.append(phase_energy(log.track, power))
    phases = identify_phases(energies)
    start = "the power model" if phases.table is None else "level flight"
    notes += [
        f"{q.name}: not identified, priced as {start} is; what would: {q.flight}"
        for q in phases.quantities
        if not q.identified
    ]
    return replace(
        done,
        airframe=with_flown(done.airframe, phases.table),
        quantities=(*done.quantities, *phases.quantities),
        notes=tuple(notes),
    )


def _show(console: Console, done: Calibration, unseen: list[HeldOutFlight]) -> None:
    table = Table(title="What the logs say")
    for name in ("", "value", "± std", "believed before ±", "unit", ""):
        table.add_column(name, justify="left" if not name or name == "unit" else "right")
    for q in done.quantities:
        unknown = "NOT IDENTIFIED" if q.needed else "mostly belief"
        verdict = "identified" if q.identified else unknown
        table.add_row(
            q.name, f"{q.value:.4g}", f"{q.std:.2g}", f"{q.prior_std:.2g}", q.unit, verdict
        )
    console.print(table)
    energy = Table(title="Energy of flights that the fit had not seen")
    for name in ("flight", "wind m/s", "load kg", "measured Wh", "predicted Wh", "error"):
        energy.add_column(name, justify="left" if name == "flight" else "right")
    for kind, rows in (("left out", done.holdouts), ("--holdout", unseen)):
        for h in rows:
            energy.add_row(
                f"{h.name} ({kind})",
                f"{h.wind_mps:.1f}",
                f"{h.payload_kg:g}",
                f"{h.measured_wh:.1f}",
                f"{h.predicted_wh:.1f}",
                f"{100.0 * h.error_frac:+.1f} %",
            )
    console.print(energy)
    for words in done.notes:
        console.print(words)
    for q in done.missing:
        console.print(
            f"not identified: {q.name} is {q.value:.3g} ± {q.std:.2g} {q.unit}, and"
            f" {100.0 * q.limit_frac:.0f} % or better is needed: {q.flight}"
        )


def _write(
    out: Path,
    start: Airframe,
    done: Calibration,
    unseen: list[HeldOutFlight],
    logs: tuple[Path, ...],
    loads: list[float],
    temperature_c: float,
) -> None:
    fitted = msgspec.structs.replace(done.airframe, name=out.stem)
    flown = ", ".join(f"{p.name} ({_day(p)}, {kg:g} kg)" for p, kg in zip(logs, loads, strict=True))
    header = [
        f"{FITTED_TO}{flown}; air at {temperature_c:g} C. Start and prior:"
        f" {start.name}; numbers without a comment are as there.",
    ]
    header += [f"Predicted unseen: {_words(h)}" for h in (*done.holdouts, *unseen)]
    header += done.notes
    if done.missing:
        header.append(
            "NOT IDENTIFIED, as believed before: " + ", ".join(q.name for q in done.missing)
        )
    write_airframe(out, fitted, header, _sources(done))


def _words(h: HeldOutFlight) -> str:
    return (
        f"{h.name}: {h.predicted_wh:.1f} Wh of {h.measured_wh:.1f} measured"
        f" ({100.0 * h.error_frac:+.1f} %), {h.wind_mps:.1f} m/s of wind, {h.payload_kg:g} kg"
    )


def _day(path: Path) -> str:
    stamp = datetime.datetime.fromtimestamp(path.stat().st_mtime, datetime.UTC)
    return stamp.strftime("file of %Y-%m-%d")


def _sources(done: Calibration) -> dict[tuple[str, str], str]:
    found = {}
    drag = [("drag", key) for key in DRAG_KEYS]
    for keys, fit in ((drag, done.drag), (power_keys(done.airframe), done.power)):
        for key, std in zip(keys, np.sqrt(np.diag(fit.cov)), strict=True):
            found[key] = f"fitted, ± {std:.2g}"
    found["power_rotor", "avionics_w"] = f"fitted, ± {avionics_std_w(done.power):.2g}"
    found["drag", "gain_std_frac"] = "of that fit at the airspeed flown, at least the air's density"
    found["drag", "axis_gain_std_frac"] = "of that fit at the airspeed flown"
    found["drag", "model_std_frac"] = "what two coefficients an axis leave over on real vehicles"
    found["power_rotor", "model_std_frac"] = (
        "rms over two-minute pieces of flights left out, or 0.03"
    )
    for q in done.quantities:
        if q.name in TRIM_KEYS and q.identified:
            found["drag", TRIM_KEYS[q.name]] = f"mean over flights, ± {q.std:.2g}"
    for phase, q in zip(PHASES, done.quantities[-len(PHASES) :], strict=True):
        words = f"measured over flights, ± {q.std:.2g}" if q.identified else "as level flight"
        found["power_flown", f"{phase}_frac"] = words
    battery = done.battery
    if any(q.name == "pack's resistance" and q.identified for q in done.quantities):
        found["battery", "resistance_ohm"] = f"fitted, ± {battery.resistance_std_ohm:.2g}"
    usable = battery.usable
    if usable is not None:
        found["battery", "usable_frac"] = (
            f"discharged in {', '.join(usable.logs)}, ± {usable.std_frac:.2g}; the last"
            f" {100.0 * usable.extrapolated_frac:.1f} % by the believed curve"
        )
        found["battery", "usable_at_w"] = "mean draw of the lightest discharge"
        found["battery", "usable_std_frac"] = "of that fit"
        if len(usable.logs) > 1:
            found["battery", "usable_loss_per_w"] = f"fitted, ± {usable.loss_std_per_w:.2g}"
    return found


def _plot(folder: Path, done: Calibration, flights: list[Blocks]) -> None:
    try:
        from companion.app.tools.calibration_plots import plot_residuals
    except ImportError as error:
        raise LeewayError("--plots: needs matplotlib: pip install 'leeway-uas[sim]'") from error
    plot_residuals(folder, done, flights)


def _as_json(done: Calibration, unseen: list[HeldOutFlight]) -> dict[str, Any]:
    def row(h: HeldOutFlight, kind: str) -> dict[str, Any]:
        return {**msgspec.to_builtins(h), "kind": kind, "error_frac": h.error_frac}

    return {
        "format": "calibration/1",
        "quantities": [
            {**msgspec.to_builtins(q), "identified": q.identified} for q in done.quantities
        ],
        "holdouts": [
            *(row(h, "left out") for h in done.holdouts),
            *(row(h, "holdout") for h in unseen),
        ],
        "standing": msgspec.to_builtins(done.power.standing),
        "airframe": msgspec.to_builtins(done.airframe),
        "drag": {"keys": DRAG_KEYS, "std": np.sqrt(np.diag(done.drag.cov)).tolist()},
        "power": {
            "keys": [key for _, key in power_keys(done.airframe)],
            "std": np.sqrt(np.diag(done.power.cov)).tolist(),
        },
        "notes": list(done.notes),
    }
