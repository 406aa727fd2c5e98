"""``fastcoil diagnose``, ``fit``, ``valve-test`` and ``join``: commands on trend logs, and the options they share."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import fastcoil as fc
from fastcoil.base.errors import InputError
from fastcoil.base.files import exists, has_mark, require_output_file, write_atomically
from fastcoil.base.text import align_columns
from fastcoil.cli.arguments import PATH, combine_options, parse_pairs
from fastcoil.cli.deliver import with_report, write_result
from fastcoil.cli.terminal import echo

if TYPE_CHECKING:
    import xarray as xr

    from fastcoil.measured.fit import Fit


_EXIT_FAULT_FOUND = 1  # exit code of ``diagnose --fail``
_MAX_LISTED = 10  # valves, and unread logs, in the output of ``--fleet``
_MAX_ROWS = 40  # findings in it


def _parse_pairs_option(ctx: click.Context, param: click.Parameter, value: Sequence[str]) -> dict[str, str] | None:
    return parse_pairs(param.opts[-1], value) or None


_TIME_FORMAT_HELP = "Format of the timestamps: '%d/%m/%Y %H:%M', excel or epoch; recognised by default."
_TIME_ZONE_HELP = "Zone of times without a UTC offset, such as America/New_York."
_add_reading_options = combine_options(
    click.option("--drop", is_flag=True, help="Drop bad values and count them, or bridge a single one."),
    click.option("--jumps", default="refuse", show_default=True,
                 help="Where time runs backwards: refuse the file, or split it there."),
    click.option("--max-gap", type=float, help="Longest gap to bridge, s; three median steps by default."),
    click.option("--time-format", metavar="PATTERN", help=_TIME_FORMAT_HELP),
    click.option("--time-zone", metavar="ZONE", help=_TIME_ZONE_HELP),
    click.option("--unit", "units", multiple=True, callback=_parse_pairs_option, metavar="NAME=UNIT",
                 help="Unit of a column whose header has none."),
    click.option("--column", "columns", multiple=True, callback=_parse_pairs_option, metavar="NAME=HEADER",
                 help="Header of the column for NAME, if it differs."),
    click.option("--ignore", multiple=True, metavar="NAME|HEADER", help="A column that is not read."),
    click.argument("data", type=PATH),
)  # fmt: skip
# of ``fc.read_log``
_READING_OPTIONS = ("drop", "jumps", "max_gap", "time_format", "time_zone", "units", "columns", "ignore")


def with_reading_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the argument DATA and the options of ``fc.read_log``, which the command receives as the mapping ``read``."""

    @functools.wraps(command)
    def bundle_reading_options(**options: Any) -> None:
        read = {name: options.pop(name) for name in _READING_OPTIONS}
        command(read=read, **options)

    return _add_reading_options(bundle_reading_options)


with_toml = click.option("-o", "--out", type=PATH, help="TOML file to write, and a figure beside it; none by default.")
with_stroke_time = click.option("--stroke-time", type=float,
                                help="Seconds the motor takes from closed to open; 90 by default.")  # fmt: skip
with_warm_up = click.option("--warm-up", type=float, default=1800.0, show_default=True,
                            help="Seconds excluded after each start.")  # fmt: skip


def require_fit_file(out: Path) -> None:
    """Refuse, before any work, a file that cannot be written, or exists and is no earlier fit."""
    require_output_file("-o", out, ".toml")
    figure, cure = out.with_suffix(".png"), "choose another name"
    if exists(out) and not has_mark(out, b" by fastcoil", 300):
        raise InputError(f"-o {out}: this file exists and is not a fit: {cure}", "-o", "path")
    if exists(figure) and not exists(out):
        raise InputError(f"-o {out}: {figure} exists and would be replaced: {cure}", "-o", "path")


@click.command()
@with_reading_options
@click.argument("other_logs", type=PATH, nargs=-1, metavar="[DATA]...")
@with_report
@with_toml
@click.option("--fleet", is_flag=True,
              help="DATA are logs of many valves or air handlers, or folders of logs: rank them.")  # fmt: skip
@click.option("--answers", type=PATH, metavar="FILE.toml",
              help="Columns and units of air handlers, as -o wrote them for another one.")  # fmt: skip
@click.option("-j", "--jobs", type=int, help="With --fleet: processes; all cores by default.")
@click.option(
    "--fail", is_flag=True,
    help="Exit code 1 if a valve hunts or has a gap of more than 1 %, or an air handler has a finding.",
)  # fmt: skip
@with_stroke_time
@click.option("--sample-time", type=float, help="Sample time of the controller, s; estimated by default.")
@click.option("--lag", type=float, help="Seconds by which T_sup is logged after the command; estimated by default.")
@click.option("--kp", type=float, help="Gain of the controller, 1/K, with --ti; found by default.")
@click.option("--ti", type=float, help="Integral time of the controller, s, with --kp; found by default.")
def diagnose(
    data: Path, other_logs: tuple[Path, ...], read: dict[str, Any], out: Path | None, report: Path | None, fleet: bool,
    answers: Path | None, jobs: int | None, fail: bool, **options: Any,
) -> None:  # fmt: skip
    """Find the backlash of a valve in a trend log, and why its loop hunts.

    DATA is a CSV file with the columns command and T_sup (optionally T_set, m_a, T_a_in and enabled), or the usual
    names of these points, and a column elapsed_time or timestamp; files with one row per value are read as well.  To
    show the backlash, log two hours or more, a row every 30 s or faster, with set-point changes; a row every 15 min is
    enough for the state of each hour.  Several files are days of one valve or air handler.

    A log with a cooling and a heating valve is that of an air handler: both are judged together, the worst finding
    first, and each valve below; units that headers lack are proposed from the numbers.

    With --fleet, DATA are files of many valves or air handlers, or folders of them; -o then names FILE.html, FILE.csv
    or a folder.
    """
    from fastcoil.deliver.report.units import require_no_valve_options
    from fastcoil.logs.air_handler import count_valves
    from fastcoil.measured.identify import GOOD_BACKLASH

    if fleet:
        _diagnose_fleet([data, *other_logs], out, report, jobs, fail, options | {"read": read, "answers": answers})
        return
    if jobs is not None:
        raise InputError("--jobs works only with --fleet: leave it out", "--jobs", "conflict")
    if out is not None:
        require_fit_file(out)
    logs = [fc.read_log(path, **read) for path in (data, *other_logs)]
    if answers is not None or ("command" not in (read["columns"] or {}) and count_valves(logs[0]) > 1):
        require_no_valve_options(options)
        _inspect_air_handler(logs, answers, out, report, fail)
        return
    diagnosis = fc.diagnose(logs if other_logs else logs[0], **options)
    logs[0].require_options_used()
    echo(*diagnosis.summary())
    write_result(diagnosis, out, report)
    if fail and (diagnosis.hunts or (diagnosis.identified and diagnosis.backlash > GOOD_BACKLASH)):
        sys.exit(_EXIT_FAULT_FOUND)


def _inspect_air_handler(
    logs: list[fc.Log], answers: Path | None, out: Path | None, report: Path | None, fail: bool
) -> None:
    """Print the findings of an air handler, and below them what each valve's own log says."""
    unit = fc.inspect(logs, answers=answers)
    echo(*unit.summary())
    for coil, diagnosis in unit.valves.items():
        # what the valve does is in the findings, which know of the other one
        lines = [line for line in diagnosis.summary() if line.startswith(("Controller: ", "Gap: "))]
        echo("", f"{coil[0].upper()}{coil[1:]} valve:", *(f"  {line}" for line in lines))
    write_result(unit, out, report)
    if fail and unit.findings:
        sys.exit(_EXIT_FAULT_FOUND)


def _diagnose_fleet(
    logs: Sequence[Path], out: Path | None, report: Path | None, jobs: int | None, fail: bool, options: dict[str, Any]
) -> None:
    from fastcoil.deliver.report.survey import AT_FAULT, RANKING_HEADER, describe_counts, ranked_rows, state_counts

    if report is not None:
        sentence = "--report does not work with --fleet: write the page with -o FILE.html"
        raise InputError(sentence, "--report", "conflict")
    ds = fc.survey(logs, out, n_jobs=jobs, **options)
    if "air_handler" in ds:
        _print_air_handlers(ds, out, fail)
        return
    rows = ranked_rows(ds)[:_MAX_LISTED]
    echo(describe_counts(ds), *(align_columns([RANKING_HEADER, *rows], right=(1, 2)) if rows else ()))
    warnings = zip(ds["valve"].values, ds["warnings"].values[: len(rows)], strict=False)
    echo(*(f"{valve}: {warning}" for valve, warning in warnings if warning))
    valves_by_problem: dict[str, list[str]] = {}
    for valve, log, problem in zip(ds["valve"].values, ds["log"].values, ds["problem"].values, strict=True):
        if problem:
            valves_by_problem.setdefault(problem.replace(f"{Path(log).name}: ", ""), []).append(valve)
    failures = [
        f"Not read: {valves[0]}{f' and {len(valves) - 1:,} more' if valves[1:] else ''}: {problem}"
        for problem, valves in valves_by_problem.items()
    ]
    echo(*failures[:_MAX_LISTED], *[f"… and {len(failures) - _MAX_LISTED:,} more"] * (len(failures) > _MAX_LISTED))
    _end_survey(out, rows, fail and bool(state_counts(ds)[AT_FAULT]))


def _print_air_handlers(ds: xr.Dataset, out: Path | None, fail: bool) -> None:
    from fastcoil.deliver.report.units import RANKING_HEADER, describe_units, ranked_findings

    rows = ranked_findings(ds)
    echo(describe_units(ds), *(align_columns([RANKING_HEADER, *rows[:_MAX_ROWS]], right=(3, 4, 5)) if rows else ()))
    echo(*[f"… and {len(rows) - _MAX_ROWS:,} more"] * (len(rows) > _MAX_ROWS))
    unread = zip(ds["unread"].values, ds["problem"].values, strict=True)
    echo(*[f"Not read: {name}: {problem}" for name, problem in unread][:_MAX_LISTED])
    _end_survey(out, rows, fail and bool((ds["kind"] != "none").any()))


def _end_survey(out: Path | None, rows: Sequence[object], fails: bool) -> None:
    if out is not None:
        echo(f"Written: {out}")
    if not rows:
        raise InputError("no log could be read: see the reasons above", "DATA", "data")
    if fails:
        sys.exit(_EXIT_FAULT_FOUND)


@click.group("valve-test")
def valve_test() -> None:
    """Plan a valve test, which shows the gap in twenty minutes, and read its log."""


@valve_test.command("plan")
@click.option("--gentle", is_flag=True, help="45 minutes within 1 K.")
@click.option("--heating", is_flag=True, help="30 minutes within 3 K, for a heating coil.")
@click.option("--minutes", type=float, help="How long it takes.")
@click.option("--excursion", type=float, help="Error at which to stop, K.")
@click.option("--rate", type=float, help="Rate of the first ramp, strokes per second.")
@click.option("--threshold", type=float, help="Error at which a ramp ends, K.")
@click.option("--settle", type=float,
              help="Wait before the first ramp, s; 900 also detects swings from outside the loop.")  # fmt: skip
@click.option("--hold", type=float, help="Wait after each ramp, s.")
def plan_test(gentle: bool, heating: bool, **settings: float | None) -> None:
    """Print the steps for a technician with a stop-watch."""
    if gentle and heating:
        raise InputError("--gentle and --heating: give one of them", "--gentle", "conflict")
    make_test = fc.ValveTest.gentle if gentle else fc.ValveTest.heating if heating else fc.ValveTest
    echo(*make_test(**{name: value for name, value in settings.items() if value is not None}).instructions())


@valve_test.command("read")
@with_reading_options
@with_toml
@with_stroke_time
@click.option("--between", type=float, nargs=2, metavar="START END", help="Start and end of the test, s, if the log "
              "has no column test.")  # fmt: skip
def read_test_command(data: Path, read: dict[str, Any], out: Path | None, **options: Any) -> None:
    """Read the backlash of a valve from the log of a valve test, DATA.

    DATA is a CSV file with a row every 15 s or faster and the columns command, T_sup and elapsed_time or timestamp;
    test, which is 1 while the test runs; and, where there are any, T_set, m_a, T_a_in, T_w_in and enabled.
    """
    if out is not None:
        require_fit_file(out)
    test_result = fc.read_test(log := fc.read_log(data, **read), **options)
    log.require_options_used()
    echo(*test_result.summary())
    write_result(test_result, out)


@click.command()
@click.argument("files", type=PATH, nargs=-1)
@click.option("-o", "--out", type=PATH, default="log.csv", show_default=True, help="CSV file to write; a new one.")
@click.option("--column", "columns", multiple=True, metavar="NAME=FILE",
              help="File of the point NAME (or header, or FILE:HEADER), if neither header nor file name is "
              "NAME.")  # fmt: skip
@click.option("--unit", "units", multiple=True, metavar="NAME=UNIT", help="Unit of a point whose header has none.")
@click.option("--ignore", multiple=True, metavar="NAME|HEADER", help="A column that is not read.")
@click.option("--step", type=float, help="Time step of the joined log, s; that of the fastest point by default.")
@click.option("--max-gap", type=float, help="Longest gap over which a point is held or interpolated, s.")
@click.option("--time-format", metavar="PATTERN", help=_TIME_FORMAT_HELP)
@click.option("--time-zone", metavar="ZONE", help=_TIME_ZONE_HELP)
def join(
    files: Sequence[Path], out: Path, columns: Sequence[str], units: Sequence[str], ignore: Sequence[str],
    step: float | None, max_gap: float | None, time_format: str | None, time_zone: str | None,
) -> None:  # fmt: skip
    """Join the points in FILES into one log with a common time step, for diagnose and the fits.

    A file has a column of times and one or more columns of values.  The header of a column names the point and its
    unit (command [%]); for a single column the file name may (command.csv).
    """
    from fastcoil.base.arguments import argument_checks, require_number
    from fastcoil.logs.columns import MAX_GAP_CURE
    from fastcoil.logs.join import join_points
    from fastcoil.logs.timestamps import require_time_format, require_time_zone

    if not files:
        raise InputError("give the files to join, such as command.csv T_sup.csv", "FILES", "missing")
    with argument_checks() as check:
        cure = "give seconds, from 1 to 86400"
        step = check.unless_none(require_number, "--step", step, cure, least=1.0, most=86400.0)
        check.unless_none(require_number, "max_gap", max_gap, MAX_GAP_CURE, least=1.0)
        time_format = check.unless_none(require_time_format, "--time-format", time_format)
        time_zone = check.unless_none(require_time_zone, "--time-zone", time_zone)
        check(_require_new_csv, out)
    text, notes = join_points(
        files, columns=parse_pairs("--column", columns), units=parse_pairs("--unit", units), time_format=time_format,
        time_zone=time_zone, step=step, max_gap=max_gap, ignore=ignore,
    )  # fmt: skip
    _require_new_csv(out)
    write_atomically(out, text.encode())
    echo(*notes, f"Joined:  {out}")


def _require_new_csv(out: Path) -> None:
    require_output_file("-o", out, ".csv")
    if exists(out):
        raise InputError(f"-o {out}: this file exists: choose another name", "-o", "path")


@click.group()
def fit() -> None:
    """Fit a valve or a coil to a trend log (CSV); write TOML to include in a study, and a figure."""


with_common_options = combine_options(
    click.option("--split", type=float, help="Share of the log to fit, in whole batches or pieces if there are four or "
                 "more; 0.7 by default."),
    with_reading_options,
)  # fmt: skip
"""The options that all fits have."""


def run_fit(fit_function: Callable[..., Fit], out: Path, data: Path, read: Mapping[str, Any], **options: Any) -> None:
    """Run a fit of the package, print its summary, and write TOML and figure."""
    require_fit_file(out)
    log = fc.read_log(data, **read, constants=options.pop("constants", None))
    result = fit_function(log, **options)
    log.require_options_used()
    echo(*result.summary())
    write_result(result, out, label="Fitted")


def _parse_constants_option(ctx: click.Context, param: click.Parameter, value: Sequence[str]) -> dict[str, float]:
    constants = {}
    for name, text in parse_pairs("--constant", value).items():
        try:
            constants[name] = float(text)
        except ValueError:
            raise InputError(f"--constant {name}={text}: give a number", "--constant", "value") from None
    return constants


with_constants = click.option(
    "--constant", "constants", multiple=True, metavar="NAME=NUMBER", callback=_parse_constants_option,
    help="Constant value of a series not in the log.",
)  # fmt: skip


@fit.command("valve")
@with_common_options
@click.option("-o", "--out", type=PATH, default="valve.toml", show_default=True, help="TOML file to write.")
@click.option("--m-max", type=float, help="Asymptotic flow, kg/s; fitted by default.")
@click.option("--lag", type=float, default=0.0, show_default=True, metavar="SECONDS",
              help="Delay of the logged flow behind the command.")  # fmt: skip
@click.option("--hold", "holds", metavar="command",
              help="The command is constant between rows; by default it may move between them.")  # fmt: skip
def fit_valve_command(data: Path, read: dict[str, Any], out: Path, **options: Any) -> None:
    """Fit backlash and flow curve to the columns command and m_w of DATA.

    Time is elapsed_time or timestamp.  The optional column batch numbers the experiments in the log; the optional
    column enabled is 0 while the pump is off.
    """
    run_fit(fc.fit_valve, out, data, read, **options)


@fit.command("coil")
@with_common_options
@click.option("-o", "--out", type=PATH, default="coil.toml", show_default=True, help="TOML file to write.")
@with_constants
@with_warm_up
@click.option("--pressure", type=float, default=101325.0, show_default=True, help="Barometric pressure, Pa.")
@click.option("--hold", "holds", multiple=True, metavar="NAME", help="An input that is constant until the next sample.")
def fit_coil_command(data: Path, read: dict[str, Any], out: Path, **options: Any) -> None:
    """Fit the coil to m_w, m_a, T_w_in, T_a_in, W_a_in (or RH_a_in, T_dp_in) and T_sup of DATA.

    T_w_out is compared if present.  Time is elapsed_time or timestamp.  The model restarts after a gap, and after a
    time without air flow (or with 0 in the optional column enabled).
    """
    run_fit(fc.fit_coil, out, data, read, **options)
