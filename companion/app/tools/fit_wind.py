"""`companion fit-wind`: fit a wind process to recordings and score it on held-out wind."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from companion.adapters.logs.wind_logs import read_wind_log
from companion.analysis.wind_fit.fit import MEAN_S, AveragedWind, WindFit, average_wind_over_10_s
from companion.analysis.wind_fit.holdout import (
    FITTED,
    GAUSSIAN,
    LONG_MEAN,
    PERSISTENCE,
    Holdout,
    cross_validate_wind_process,
    fit_wind_process_with_tail,
    headwind_change_quantile_by_horizon,
    process_headwind_change_std_mps,
)
from companion.analysis.wind_fit.score import COVERAGES
from companion.core.base.errors import LeewayError
from companion.core.wind.process import WindProcessParams

_NORMAL_QUANTILES = {0.95: 1.645, 0.99: 2.326}  # normal quantiles of a one-sided probability


@dataclass(frozen=True, slots=True)
class WindFitResult:
    """Result of the command."""

    fit: WindFit
    holdout: Holdout | None
    recordings: tuple[AveragedWind, ...]


def read_averaged_wind_recordings(
    log_paths: Sequence[Path], print_line: Callable[[str], None]
) -> tuple[AveragedWind, ...]:
    """Return the 10 s means of all logs; `print_line` reports excluded rows by file and line.

    A folder is one site; files given by themselves are one more.
    """
    recordings: list[AveragedWind] = []
    used_h: dict[str, float] = {}
    for path, site in _log_files_and_sites(log_paths, print_line):
        found = read_wind_log(path)
        for words in found.findings:
            print_line(f"{path}: {words}")
        averaged_segments = [
            m for r in found.segments for m in average_wind_over_10_s(r.t_s, r.wind_to_ne_mps, site)
        ]
        used_s = sum(m.t_s.size for m in averaged_segments) * MEAN_S
        print_line(
            f"{path}: {used_s:.0f} s of wind used, in {len(averaged_segments)} stretches without"
            " a gap"
        )
        recordings += averaged_segments
        used_h[site] = used_h.get(site, 0.0) + used_s / 3600.0
    for site, hours in used_h.items():
        print_line(f"{site}: {hours:.1f} h of wind")
    if len(used_h) > 1:
        print_line(f"{len(used_h)} sites: {sum(used_h.values()):.1f} h of wind")
    return tuple(recordings)


def _log_files_and_sites(
    log_paths: Sequence[Path], print_line: Callable[[str], None]
) -> list[tuple[Path, str]]:
    """Return each recording with its site; LeewayError for a folder without recordings, or for a
    recording given twice.
    """
    files: list[tuple[Path, str]] = []
    for path in log_paths:
        if not path.is_dir():
            files.append((path, "files given by name"))
            continue
        try:
            inside = sorted(path.iterdir())
        except OSError as error:
            raise LeewayError(f"{path}: {error.strerror}") from error
        logs = [p for p in inside if p.suffix.lower() == ".csv" and p.is_file()]
        if not logs:
            raise LeewayError(
                f"{path}: no *.csv among {len(inside)} entries: expected recordings of one site"
                " (a folder of sites: give its subfolders)"
            )
        if len(logs) < len(inside):
            print_line(f"{path}: {len(inside) - len(logs)} entries that are not *.csv: not read")
        files += [(p, str(path)) for p in logs]
    given: set[Path] = set()
    for path, _ in files:
        if path.resolve() in given:
            raise LeewayError(f"{path}: given twice: expected each recording once")
        given.add(path.resolve())
    return files


def fit_and_cross_validate_wind(
    recordings: tuple[AveragedWind, ...],
    process_name: str,
    component_count: int,
    compared_processes: Sequence[WindProcessParams],
    console: Console,
) -> WindFitResult:
    """Fit on all recordings, and score held-out fits; show progress."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("fitting", total=None)

        def advance_progress_bar() -> None:
            bar.advance(task)

        fit = fit_wind_process_with_tail(
            recordings, process_name, component_count, advance_progress_bar
        )
        bar.update(task, description="scoring on held-out wind")
        holdout = cross_validate_wind_process(
            recordings, component_count, compared_processes, advance_progress_bar
        )
    return WindFitResult(fit, holdout, recordings)


def print_fit_and_scores(fit_result: WindFitResult, console: Console) -> None:
    """Print parameters, held-out scores and the changes of headwind."""
    console.print(_fitted_parameter_table(fit_result.fit))
    if fit_result.holdout is None:
        console.print("no held-out score: the recordings are too short to divide")
    else:
        console.print(_holdout_score_table(fit_result.holdout))
    console.print(_headwind_change_table(fit_result))


def write_wind_process_file(
    fit_result: WindFitResult, recording_paths: Sequence[Path], command_line: str, out_path: Path
) -> None:
    """Write the params file with sources and held-out scores as comments."""
    try:
        out_path.write_text(
            _wind_process_toml(fit_result, [p.name for p in recording_paths], command_line),
            encoding="utf-8",
        )
    except OSError as error:
        raise LeewayError(f"{out_path}: {error.strerror}") from error


def _fitted_parameter_table(fit: WindFit) -> Table:
    process = fit.process
    table = Table(title=f"wind process {process.name}, at {process.reference_wind_mps:.1f} m/s")
    for head in ("part", "memory s", "one sigma", "variance m2/s2", "one sigma"):
        table.add_column(head, justify="right")
    parts = len(process.memory_s)
    for i in range(parts):
        memory, variance = process.memory_s[i], process.variance_m2ps2[i]
        table.add_row(
            str(i + 1),
            f"{memory:.0f}",
            _one_sigma_range_text(memory, float(fit.log_std[i]), 0),
            f"{variance:.2f}",
            _one_sigma_range_text(variance, float(fit.log_std[parts + i]), 2),
        )
    dof = process.tail_dof
    tails = "normal" if dof is None else f"Student's t, {dof:g} degrees"
    table.caption = (
        f"tails: {tails}; log likelihood {fit.log_likelihood:.1f} nats of {fit.mean_count} means"
    )
    if process.independent_returns is not None:
        sites = "; ".join(f"{Path(s).name} {f:.2f}" for s, f in fit.site_factors.items())
        table.caption += (
            f"\nsquared error up to 300 s over the stated variance: {sites}"
            f"\n{process.independent_returns:.0f} independent returns"
        )
    return table


def _one_sigma_range_text(value: float, log_std: float, decimal_places: int) -> str:
    factor = 2.718281828**log_std
    return f"{value / factor:.{decimal_places}f} to {value * factor:.{decimal_places}f}"


def _holdout_score_table(holdout: Holdout) -> Table:
    title = f"held out: mean headwind over the next H s, {len(holdout.folds)} folds"
    table = Table(title=title)
    for head in ("H s", "forecast by", "moments", "error m/s", "stated", "kurtosis", "NLL nats"):
        table.add_column(head, justify="left" if head == "forecast by" else "right")
    for share in COVERAGES:
        table.add_column(f"in {100 * share:g} %", justify="right")
    table.add_column("99 % of |error| over stated", justify="right")
    for s in holdout.scores:
        table.add_row(
            f"{s.horizon_s:.0f}",
            s.method,
            str(s.count),
            f"{s.error_rms_mps:.2f}",
            f"{s.forecast_std_mps:.2f}",
            f"{s.kurtosis:.1f}",
            f"{s.nll:.3f}",
            *(f"{100 * c:.1f}" for c in s.coverage),
            f"{s.upper99_ratio:.2f}",
        )
    return table


def _headwind_change_table(fit_result: WindFitResult) -> Table:
    table = Table(title="headwind over the next H s less the last 30 s, m/s, worst of 8 directions")
    for head in ("H s", "95 %", "process", "99 %", "process"):
        table.add_column(head, justify="right")
    process = fit_result.fit.process
    seen = {
        p: dict(headwind_change_quantile_by_horizon(fit_result.recordings, p))
        for p in _NORMAL_QUANTILES
    }
    for horizon_s in seen[0.95]:
        std = process_headwind_change_std_mps(process, horizon_s, process.reference_wind_mps)
        cells = [
            f"+{value:.2f}"
            for p, z in _NORMAL_QUANTILES.items()
            for value in (seen[p][horizon_s], z * std)
        ]
        table.add_row(f"{horizon_s:.0f}", *cells)
    table.caption = "process columns: one direction, not the worst of eight"
    return table


def _wind_process_toml(
    fit_result: WindFitResult, recording_names: Sequence[str], command_line: str
) -> str:
    process, fit = fit_result.fit.process, fit_result.fit
    parts = len(process.memory_s)
    spans = [
        _one_sigma_range_text(m, float(s), 0)
        for m, s in zip(process.memory_s, fit.log_std, strict=False)
    ]
    widths = [
        _one_sigma_range_text(v, float(s), 2)
        for v, s in zip(process.variance_m2ps2, fit.log_std[parts:], strict=True)
    ]
    lines = [
        f"# How wind changes, fitted to {', '.join(map(_escape_for_comment, recording_names))} by",
        f"#   {_escape_for_comment(command_line)}",
        f"# {fit.mean_count} means of 10 s, by their likelihood. One sigma of each:",
        f"#   memories {'; '.join(spans)} s",
        f"#   variances {'; '.join(widths)} m2/s2",
        *_holdout_comment_lines(fit_result.holdout, len(fit.site_factors)),
        'format = "wind-process/1"',
        f"name = {_quote_toml_string(process.name)}",
        f"memory_s = [{', '.join(f'{m:.4g}' for m in process.memory_s)}] # [fit]",
        f"variance_m2ps2 = [{', '.join(f'{v:.4g}' for v in process.variance_m2ps2)}] # [fit]",
        f"reference_wind_mps = {process.reference_wind_mps:.4g} # mean wind of the (windiest) site",
        f"least_scale = {process.least_scale:g} # [est] light wind is no steadier than this share",
        f"most_scale = {process.most_scale:g}",
        f"level_std_mps = {process.level_std_mps:g} # any wind",
        f"seen_noise_std_mps = {process.seen_noise_std_mps:g} # [est] of a vehicle's estimate",
    ]
    if process.recorded_s is not None:
        lines.append(f"recorded_s = {process.recorded_s:g} # behind these parameters")
    if process.independent_returns is not None:
        sites = ", ".join(f"{f:.2f}" for f in fit.site_factors.values())
        lines.append(
            f"independent_returns = {process.independent_returns:.3g}"
            f" # the sites' variances differ: {sites}"
        )
    if process.tail_dof is not None:
        lines.append(f"tail_dof = {process.tail_dof:g} # [fit] forecast errors up to 300 s ahead")
    return "\n".join(lines) + "\n"


def _escape_for_comment(text: str) -> str:
    """Escape a text with control characters, so that it fits in a comment line."""
    return text if text.isprintable() else ascii(text)


def _quote_toml_string(text: str) -> str:
    """Return a TOML basic string; its escapes equal JSON's except for DEL (TOML 1.0)."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _holdout_comment_lines(holdout: Holdout | None, site_count: int) -> list[str]:
    if holdout is None:
        return ["# Not scored on held-out wind: the recordings are too short to divide."]
    held_out = "whole sites" if site_count > 1 else "40-minute stretches"
    lines = [
        f"# Held out ({len(holdout.folds)} folds of {held_out}): error of the forecast",
        "# headwind, m/s (mean of the last 30 s, of the last 300 s); errors within"
        f" {'/'.join(f'{100 * c:g}' for c in COVERAGES)} %:",
    ]
    for horizon_s in sorted({s.horizon_s for s in holdout.scores}):
        by = {s.method: s for s in holdout.scores if s.horizon_s == horizon_s}
        if FITTED in by and PERSISTENCE in by and LONG_MEAN in by:
            fitted_score = by[FITTED]
            inside = " / ".join(f"{100 * c:.1f}" for c in fitted_score.coverage)
            lines.append(
                f"#   {horizon_s:4.0f} s: {fitted_score.error_rms_mps:.2f}"
                f" ({by[PERSISTENCE].error_rms_mps:.2f}, {by[LONG_MEAN].error_rms_mps:.2f});"
                f" {inside}"
            )
    if any(s.method == GAUSSIAN for s in holdout.scores):
        lines.append("# With normal tails fewer lie within; see docs/explanation/wind-process.md.")
    return lines
