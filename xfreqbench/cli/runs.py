"""Commands that run methods and report on them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from xfreqbench.cli.options import (
    RESULTS,
    RUN,
    SEEDS,
    TARGETS,
    Hidden,
    Quiet,
    app,
    as_typed,
    example,
    flag,
    output_option,
    parse_targets_ghz,
    parse_whole_numbers,
    print_table,
    say,
    with_help,
)
from xfreqbench.errors import XFreqBenchError
from xfreqbench.runs.options import RunOptions
from xfreqbench.system.bars import progress_bars

Overrides = Annotated[
    tuple[str, ...],
    Parameter(name="--set", help="Change an option of the method, as in num_gaussians=512; `methods NAME` lists them."),
]


@app.command(group=RUN, help_epilogue=example("methods xfreq-gs"))
def methods(method: str | None = None) -> None:
    """List the installed methods, or describe one with its options: default, what each takes, and what it means.

    Parameters
    ----------
    method
        An installed method's name, or package.module:Class. Without one, no plug-in is imported.
    """
    from xfreqbench.methods.registry import method_description, method_summaries

    if method is not None:
        said, options = method_description(method)
        print(said)
        if options:
            print()
            print_table("options of --set", ("option", "default", "takes", "meaning"), list(options))
        return
    for name, summary in method_summaries().items():
        print(f"{name:22} {summary}")


@app.command(
    name="check-method", group=RUN, help_epilogue=example("check-method your_module:YourMethod --set width=32")
)
def check_method(method: str, *, set_: Overrides = ()) -> None:
    """Try every part of a method's contract on a small data set, in seconds.

    Parameters
    ----------
    method
        An installed method's name, or package.module:Class.
    """
    from xfreqbench.errors import MethodError
    from xfreqbench.methods.check import check_method as results_of
    from xfreqbench.system.processes import LocalProcesses, all_cores

    with LocalProcesses(all_cores(), is_fresh=True) as own:  # which the method may end
        results = own.submit(partial(results_of, method), set_).result()
    for result in results:
        say(result)
    num_faults = sum(result.is_fault for result in results)
    if num_faults:
        raise MethodError(f"Method {method!r} breaks its contract in {num_faults} of the points above.")


@app.command(name="new-method", group=RUN, help_epilogue=example("new-method my-method --rooms"))
def new_method(
    name: str,
    *,
    rooms: Annotated[
        bool, flag("A method that learns across rooms, for unseen-rooms; otherwise for one room.")
    ] = False,
    output: Annotated[Path | None, output_option("Folder to write, new or empty; default: the method's name.")] = None,
    quiet: Quiet = False,
) -> None:
    """Write a package with a method that learns and its tests, for you to change.

    Parameters
    ----------
    name
        Of the package and of the method on the leaderboard: words with hyphens, as in my-method.
    """
    from xfreqbench.methods.template import write_method_package

    folder = output or Path(name)
    for path in write_method_package(name, folder, rooms):
        say(f"wrote {path}", quiet)
    say(
        f"next: pip install --editable '{folder}[dev]'; python -m pytest {folder}; xfreqbench check-method {name}",
        quiet,
    )


@with_help
@dataclass(frozen=True, kw_only=True)
class RunArguments(RunOptions):
    """The options of `run` as a command line gives them."""

    results: Path = field()
    targets_ghz: Annotated[str | None, Parameter(name=TARGETS)] = None  # type: ignore[assignment]
    seeds: Annotated[str, Parameter(name=SEEDS)] = "0"  # type: ignore[assignment]
    budget: str = "quick"
    executor: str | None = None  # type: ignore[assignment]
    progress: Hidden = "auto"


@app.command(
    group=RUN,
    help_epilogue=example(
        "run --data office.h5 --method nearest,aperture-gs --targets 24.25 --budget 60s --results results"
    ),
)
def run(
    *,
    data: Annotated[Path, Parameter(help="Data set, or for unseen-rooms a collection, written by `generate`.")],
    method: Annotated[
        str,
        Parameter(
            name=["--methods", "--method"],
            help="Names or package.module:Class, comma-separated; `all` for every installed one. Methods that learn "
            "across rooms run only on protocols of rooms.",
        ),
    ],
    options: Annotated[RunArguments, Parameter(name="*")],
    set_: Overrides = (),
    dry_run: Annotated[bool, flag("Print how many runs there are and their time; run none.")] = False,
    quiet: Quiet = False,
) -> None:
    """Fit methods on a protocol's training rows, store their predictions and score them.

    The same command continues a killed run where it stopped, also in the middle of a fit.
    """
    from xfreqbench.data.unseen_rooms import ROOM_PROTOCOLS
    from xfreqbench.runs.estimate import estimate_runs
    from xfreqbench.runs.run import asked_tasks, run_shown, usual_executor
    from xfreqbench.system.processes import SERIAL, require_executor

    require_executor(options.executor or SERIAL)
    asked: dict[str, Any] = vars(options) | {
        "targets_ghz": parse_targets_ghz(options.targets_ghz),
        "seeds": parse_whole_numbers(as_typed(SEEDS), options.seeds, 0, 10**18 - 1),
        "executor": options.executor or SERIAL,
    }
    tasks = asked_tasks(data, dict.fromkeys(map(str.strip, method.split(",")), set_), RunOptions(**asked))
    executor = options.executor or usual_executor(tasks)
    if dry_run:
        print(f"{options.protocol} on {data.name}: {estimate_runs(tasks, options.results, executor)}; nothing was run")
        return
    records = run_shown(tasks, options.results, executor, not quiet)
    from xfreqbench.report.leaderboard.tables import Leaderboard  # after the refusals, which it would delay

    more = "Tables by carrier, type of room and sight" if options.protocol in ROOM_PROTOCOLS else "Every metric"
    say(f"{Leaderboard.beside(options.results, records)}\n\n{more}: xfreqbench report {options.results}", quiet)


@app.command(group=RUN, help_epilogue=example("benchmark --preset quick"))
def benchmark(
    *,
    preset: Annotated[
        str,
        Parameter(
            help="quick: a short look; standard: as in BENCHMARK.md; ablations: methods without each of their parts; "
            "converged: longer fits; carrier: whether xfreq-gs gains from knowing the carrier; rooms: unseen rooms; "
            "paper: the paper's experiments; paper-lofo, paper-sparse, paper-ablation, paper-maps: one of these; "
            "paper-size: the paper's method as published; equal-terms: its method and its two reductions, with and "
            "without aids."
        ),
    ] = "standard",
    data: Annotated[Path, Parameter(help="Folder of the data sets; those missing are generated.")] = Path("data"),
    results: Annotated[Path | None, Parameter(help="Folder for all results; default: results/PRESET.")] = None,
    device: Annotated[
        Literal["cpu", "cuda"], Parameter(help="cpu: one run per core; cuda: one run after the other.")
    ] = "cpu",
    executor: Annotated[
        str | None,
        Parameter(
            help="serial: one run after the other; 4: that many processes here; dask://host:8786: workers of a "
            "cluster, which also generate the data. Default: one process per core, or one for a GPU."
        ),
    ] = None,
    predictions: Annotated[
        Literal["all", "shown"],
        Parameter(
            help="Which predictions are kept after scoring: all, or those of the first seed in the first scene, whose "
            "maps reports show. Records keep the hash of those that were removed."
        ),
    ] = "all",
    dry_run: Annotated[bool, flag("Print the cost; write nothing.")] = False,
    quiet: Quiet = False,
) -> None:
    """Run a whole benchmark: data sets, every run side by side, measurements, report.

    It prints the cost before it starts. If it is interrupted or killed, the same command continues.
    """
    from xfreqbench.runs import benchmark as benchmarks
    from xfreqbench.runs.progress import run_bars
    from xfreqbench.system.processes import open_workers

    planned = benchmarks.Benchmark(preset, data, results or Path("results") / preset, device, predictions)
    with benchmarks.run_workers(planned, executor) as workers:
        say(benchmarks.cost(planned, workers.num_places), quiet and not dry_run)
    if dry_run:
        return
    with planned.results.alone():
        named, unit = [*planned.scenes, *planned.rooms_plans], "transmitters" if planned.scenes else "rooms"
        with progress_bars(unit, named, quiet) as tracing, open_workers(executor or "serial") as workers:
            by_scene = dict(zip(named, tracing, strict=True))
            benchmarks.generate_data(planned, by_scene, workers)
        with run_bars(quiet, shows_fit=False) as (ended, _):
            failures = benchmarks.run_benchmark(planned, ended, executor)
        for name in planned.missing_benches():
            failures += benchmarks.measure(planned, name)
        if not failures:
            benchmarks.record_contents(planned)
    folder = planned.results_dir
    pages = folder / "pages" if preset.startswith("paper") else None  # that of the paper's tables among them
    page = folder / "benchmark.html" if planned.scenes else None  # it shows boards, which rooms have not
    report([str(folder)], output=folder / "BENCHMARK.md", html=page, details=pages, quiet=quiet)
    if failures:
        number = f"{len(failures)} of its parts failed; the same command tries them again."
        raise XFreqBenchError("\n".join([number, *failures]))


@app.command(group=RESULTS, help_epilogue=example("report results -o BENCHMARK.md --html page.html"))
def report(
    results: list[str],
    *,
    output: Annotated[
        Path | None,
        output_option(
            "Write the report here, with figures and CSV tables next to it. Without it the report is printed, "
            "with every metric."
        ),
    ] = None,
    html: Annotated[
        Path | None,
        Parameter(
            help="Also write a web page with charts and maps, in a single file, and its tables as CSV and Parquet next "
            "to it."
        ),
    ] = None,
    details: Annotated[
        Path | None, Parameter(help="Keep the report short; write a page for each scene and for the measurements here.")
    ] = None,
    since: Annotated[
        str | None, Parameter(help="Earlier results, such as v2: print which methods got worse since, and what is new.")
    ] = None,
    maps: Annotated[
        Path | None,
        Parameter(
            help="Write maps of a dozen test samples of each board here, from stored predictions. If the file is named "
            "X_maps.jsonl, next to records X.jsonl, reports without predictions show these maps."
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Print or write the leaderboard, made from records of results folders; only addresses need a network.

    Only files that this command wrote are replaced.

    Parameters
    ----------
    results
        Results folder, file of records, its address (https), or a frozen version of the reference board (v2); those of
        several are ranked together.
    """
    from xfreqbench.report.leaderboard.maps import require_own_maps
    from xfreqbench.report.leaderboard.page import require_page, write_page
    from xfreqbench.report.leaderboard.paper import ship_maps
    from xfreqbench.report.leaderboard.report import report_text, write_report
    from xfreqbench.report.leaderboard.results import read_results, results_at

    found = read_results([*map(results_at, results)])
    earlier = None if since is None else results_at(since)
    if html is not None:
        require_page(found, html)
    if maps is not None:
        require_own_maps(maps)
    written = write_report(found, output, details, earlier)
    if output is None:
        say(report_text(found, details, earlier), quiet)
    for path in written:
        say(f"wrote {path}", quiet)
    if found.num_truncated:
        say("the last line of the records is cut off, as a killed run leaves it; it was not read", quiet)
    if maps is not None:
        say(f"wrote {ship_maps(found, maps)}", quiet)
    if output is not None and details is None:
        say("for a page of each scene, and the paper's tables beside ours, add --details FOLDER", quiet)
    if html is not None:
        say(f"wrote {write_page(found, html, earlier)} and its tables next to it", quiet)


@app.command(group=RESULTS, help_epilogue=example("compare results/before results/after"))
def compare(a: str, b: str) -> None:
    """Set two results side by side, paired by transmitters: what differs, with its 95 % interval.

    Rows of the same method, options and budget are paired, then rows that are the only ones of their method in A and in
    B, the only row left in A with the only one in B, and what is left in A with the newest version of its method in B.
    If A is one row, as in `compare results/nearest results`, every other row of B is compared with it.

    Parameters
    ----------
    a
        Results folder, file of records, FOLDER/METHOD for those of one method, FOLDER/METHOD@CODE for one version of
        it, FOLDER/ID for one record, the address of a file (https), or a frozen version of the reference board (v2).
    b
        The same, to be compared with A.
    """
    from xfreqbench.report.leaderboard.results import results_at
    from xfreqbench.report.leaderboard.side_by_side import compare_results

    say(compare_results(results_at(a), results_at(b)))
