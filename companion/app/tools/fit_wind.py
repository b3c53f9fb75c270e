"""`companion fit-wind`: recordings in, a wind process out, judged on wind that it did not see."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from companion.adapters.logs.wind_logs import read_wind_log
from companion.core.base.errors import LeewayError
from companion.core.wind.process import WindProcessParams
from companion.core.wind_fit.fit import MEAN_S, WindFit, WindMeans, ten_second_means
from companion.core.wind_fit.holdout import (
    FITTED,
    GAUSSIAN,
    LONG_MEAN,
    PERSISTENCE,
    Holdout,
    changes_mps,
    fit_with_tail,
    judge_held_out,
    stated_change_std_mps,
)
from companion.core.wind_fit.score import COVERAGES

_SAYS = {0.95: 1.645, 0.99: 2.326}  # normal quantiles of a one-sided probability


@dataclass(frozen=True, slots=True)
class Fitted:
    """What the command found."""

    fit: WindFit
    holdout: Holdout | None
    recordings: tuple[WindMeans, ...]


def read_recordings(paths: Sequence[Path], say: Callable[[str], None]) -> tuple[WindMeans, ...]:
    """The 10 s means of all logs; what was left out is said, by file and line."""
    recordings: list[WindMeans] = []
    for path in paths:
        found = read_wind_log(path)
        for words in found.findings:
            say(f"{path}: {words}")
        means = [m for r in found.runs for m in ten_second_means(r.t_s, r.wind_to_ne_mps)]
        used_s = sum(m.t_s.size for m in means) * MEAN_S
        say(f"{path}: {used_s:.0f} s of wind used, in {len(means)} stretches without a gap")
        recordings += means
    return tuple(recordings)


def fit_wind(
    recordings: tuple[WindMeans, ...],
    name: str,
    parts: int,
    others: Sequence[WindProcessParams],
    console: Console,
) -> Fitted:
    """Fit on everything, and judge fits on parts of it, showing progress."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("fitting", total=None)

        def step() -> None:
            bar.advance(task)

        fit = fit_with_tail(recordings, name, parts, step)
        bar.update(task, description="judging on wind that was held out")
        holdout = judge_held_out(recordings, parts, others, step)
    return Fitted(fit, holdout, recordings)


def show(found: Fitted, console: Console) -> None:
    """Print parameters, held-out scores and the changes of headwind."""
    console.print(_parameters(found.fit))
    if found.holdout is None:
        console.print("no held-out score: the recordings are too short to be divided")
    else:
        console.print(_scores(found.holdout))
    console.print(_changes(found))


def write_process(found: Fitted, sources: Sequence[Path], command: str, out: Path) -> None:
    """The params file, with where its numbers come from and how they fared."""
    try:
        out.write_text(_toml(found, [p.name for p in sources], command), encoding="utf-8")
    except OSError as error:
        raise LeewayError(f"{out}: {error.strerror}") from error


def _parameters(fit: WindFit) -> Table:
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
            _span(memory, float(fit.log_std[i]), 0),
            f"{variance:.2f}",
            _span(variance, float(fit.log_std[parts + i]), 2),
        )
    dof = process.tail_dof
    tails = "normal" if dof is None else f"Student's t, {dof:g} degrees"
    table.caption = (
        f"tails: {tails}; log likelihood {fit.log_likelihood:.1f} nats of {fit.means} means"
    )
    return table


def _span(value: float, log_std: float, digits: int) -> str:
    factor = 2.718281828**log_std
    return f"{value / factor:.{digits}f} to {value * factor:.{digits}f}"


def _scores(holdout: Holdout) -> Table:
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
            f"{s.stated_std_mps:.2f}",
            f"{s.kurtosis:.1f}",
            f"{s.nll:.3f}",
            *(f"{100 * c:.1f}" for c in s.coverage),
            f"{s.upper99_ratio:.2f}",
        )
    return table


def _changes(found: Fitted) -> Table:
    table = Table(title="headwind over the next H s less the last 30 s, m/s, worst of 8 directions")
    for head in ("H s", "95 %", "process", "99 %", "process"):
        table.add_column(head, justify="right")
    process = found.fit.process
    seen = {p: dict(changes_mps(found.recordings, p)) for p in _SAYS}
    for horizon_s in seen[0.95]:
        std = stated_change_std_mps(process, horizon_s, process.reference_wind_mps)
        cells = [
            f"+{value:.2f}" for p, z in _SAYS.items() for value in (seen[p][horizon_s], z * std)
        ]
        table.add_row(f"{horizon_s:.0f}", *cells)
    table.caption = "the process's are of one direction, not of the worst of eight"
    return table


def _toml(found: Fitted, sources: Sequence[str], command: str) -> str:
    process, fit = found.fit.process, found.fit
    parts = len(process.memory_s)
    spans = [_span(m, float(s), 0) for m, s in zip(process.memory_s, fit.log_std, strict=False)]
    widths = [
        _span(v, float(s), 2)
        for v, s in zip(process.variance_m2ps2, fit.log_std[parts:], strict=True)
    ]
    lines = [
        f"# How wind changes, fitted to {', '.join(map(_one_line, sources))} by",
        f"#   {_one_line(command)}",
        f"# {fit.means} means of 10 s, by their likelihood. One sigma of each:",
        f"#   memories {'; '.join(spans)} s",
        f"#   variances {'; '.join(widths)} m2/s2",
        *_holdout_comment(found.holdout),
        'format = "wind-process/1"',
        f"name = {_toml_string(process.name)}",
        f"memory_s = [{', '.join(f'{m:.4g}' for m in process.memory_s)}] # [fit]",
        f"variance_m2ps2 = [{', '.join(f'{v:.4g}' for v in process.variance_m2ps2)}] # [fit]",
        f"reference_wind_mps = {process.reference_wind_mps:.4g} # mean wind of the recordings",
        f"least_scale = {process.least_scale:g} # [est] light wind is no steadier than this share",
        f"most_scale = {process.most_scale:g}",
        f"level_std_mps = {process.level_std_mps:g} # any wind",
        f"seen_noise_std_mps = {process.seen_noise_std_mps:g} # [est] of a vehicle's estimate",
    ]
    if process.tail_dof is not None:
        lines.append(f"tail_dof = {process.tail_dof:g} # [fit] forecast errors up to 300 s ahead")
    return "\n".join(lines) + "\n"


def _one_line(words: str) -> str:
    """As it may stand in a comment: a name with a control character in it is spelt out."""
    return words if words.isprintable() else ascii(words)


def _toml_string(words: str) -> str:
    """A basic string; its escapes are JSON's, but for DEL (TOML 1.0)."""
    return json.dumps(words, ensure_ascii=False).replace("\x7f", "\\u007f")


def _holdout_comment(holdout: Holdout | None) -> list[str]:
    if holdout is None:
        return ["# Not judged on held-out wind: the recordings are too short to be divided."]
    lines = [
        f"# Held out ({len(holdout.folds)} folds of 40-minute stretches): error of the forecast",
        "# headwind, m/s (mean of the last 30 s, of the last 300 s); errors within 90/98/99 %:",
    ]
    for horizon_s in sorted({s.horizon_s for s in holdout.scores}):
        by = {s.method: s for s in holdout.scores if s.horizon_s == horizon_s}
        if FITTED in by and PERSISTENCE in by and LONG_MEAN in by:
            ours = by[FITTED]
            inside = " / ".join(f"{100 * c:.1f}" for c in ours.coverage)
            lines.append(
                f"#   {horizon_s:4.0f} s: {ours.error_rms_mps:.2f}"
                f" ({by[PERSISTENCE].error_rms_mps:.2f}, {by[LONG_MEAN].error_rms_mps:.2f});"
                f" {inside}"
            )
    if any(s.method == GAUSSIAN for s in holdout.scores):
        lines.append("# With normal tails fewer lie within; see docs/explanation/wind-process.md.")
    return lines
