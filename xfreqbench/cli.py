"""The command line. Every command imports what it needs when it runs, so that --help is quick."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, Parameter

from xfreqbench.errors import StorageError, UnknownNameError, XFreqBenchError
from xfreqbench.units import PAPER_CARRIERS_GHZ, ghz_to_hz

app = App(
    name="xfreqbench",
    help="How well does a radiance-field method predict channels at carriers it was never trained on?",
    suppress_keyboard_interrupt=False,
)
bench = App(name="bench", help="Measure accuracy against time; every table names its machine.")
app.command(bench)

Freqs = Annotated[
    str, Parameter(help="Carriers in GHz, comma-separated, as in 1,2.4,24.25; or `paper`, its ten.")
]
Quiet = Annotated[bool, Parameter(name=["--quiet", "-q"], negative="", help="Print errors only.")]
Output = Annotated[Path, Parameter(name=["--output", "-o"], help="File to write.")]
Solver = Annotated[
    Literal["auto", "image", "sionna"],
    Parameter(
        help="image: exact image method for planar facets; sionna: Sionna RT, every scene; auto: the first that serves."
    ),
]
Interactions = Annotated[
    str, Parameter(help="Comma-separated, of: specular, refraction, diffraction, diffuse.")
]
DEFAULT_INTERACTIONS = "specular,refraction"
_PIPED_WIDTH = 160  # of a table that no terminal bounds


def main() -> None:
    """Run the command line; exit code 2 for what a user can mend, 130 for an interrupted command."""
    try:
        app()
    except StorageError as error:
        print(f"xfreqbench: {error}", file=sys.stderr, flush=True)
        os._exit(2)  # HDF5 would write the failed file once more on the way out, and crash
    except XFreqBenchError as error:
        print(f"xfreqbench: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        _leave_interrupted()
    except SystemError as error:  # what Numba makes of Ctrl-C within a kernel
        if not _was_interrupted(error):
            raise
        _leave_interrupted()


def _was_interrupted(error: BaseException | None) -> bool:
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _leave_interrupted() -> None:
    print("\nxfreqbench: interrupted; the same command goes on where it stopped.", file=sys.stderr)
    sys.exit(130)


def parse_carriers_hz(freqs: str) -> list[float]:
    """Carriers in hertz from `1,2.4` (GHz) or `paper`; raises `XFreqBenchError`."""
    if freqs.strip() == "paper":
        return [ghz_to_hz(carrier) for carrier in PAPER_CARRIERS_GHZ]
    try:
        return [ghz_to_hz(float(part)) for part in freqs.split(",")]
    except (ValueError, OverflowError) as error:
        raise XFreqBenchError(
            f"--freqs takes carriers in GHz, comma-separated, as in 1,2.4,24.25, but got {freqs!r}."
        ) from error


@contextmanager
def progress_bars(unit: str, stages: list[str], quiet: bool) -> Iterator[list[Callable[[int, int], None]]]:
    """One bar a stage on stderr, with rate and remaining time, each driven by its callback(done, total)."""
    if quiet:
        yield [lambda done, total: None for _ in stages]
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as Remaining

    counts = (
        MofNCompleteColumn(),
        TextColumn(unit + " {task.fields[rate]}"),
        TimeElapsedColumn(),
        Remaining(),
    )
    columns = (TextColumn("{task.description}"), BarColumn(), *counts)
    with Progress(*columns, console=Console(stderr=True)) as progress:
        yield [_driver(progress, progress.add_task(stage, total=None, rate="")) for stage in stages]


def _driver(progress: Any, task: Any) -> Callable[[int, int], None]:
    def update(done: int, total: int) -> None:
        speed = progress.tasks[task].speed
        progress.update(task, completed=done, total=total, rate=f"{speed:.3g}/s" if speed else "")

    return update


def _say(text: str, quiet: bool = False) -> None:
    if not quiet:
        print(text, flush=True)


@app.command
def scenes(
    *,
    schema: Annotated[
        bool, Parameter(negative="", help="Print the JSON Schema of scene files, for editors.")
    ] = False,
) -> None:
    """List the scenes that ship with the toolkit."""
    import json

    from xfreqbench.scene import scene_schema, shipped_scenes

    if schema:
        print(json.dumps(scene_schema(), indent=2))
        return
    for name, description in shipped_scenes().items():
        print(f"{name:12} {description}")


@app.command
def methods() -> None:
    """List the installed methods."""
    from xfreqbench.method import method_summaries

    for name, summary in method_summaries().items():
        print(f"{name:22} {summary}")


@app.command(name="check-method")
def check_method(
    method: str,
    *,
    set_: Annotated[
        tuple[str, ...],
        Parameter(name="--set", help="Change a field of the method's config, as in hidden=128."),
    ] = (),
) -> None:
    """Try every part of a method's contract on a small data set, in seconds.

    Parameters
    ----------
    method
        An installed method's name, or package.module:Class.
    """
    from xfreqbench.errors import MethodError
    from xfreqbench.testing import check_method as findings_of

    findings = findings_of(method, set_)
    for finding in findings:
        print(finding)
    num_faults = sum(finding.is_fault for finding in findings)
    if num_faults:
        raise MethodError(f"Method {method!r} breaks its contract in {num_faults} of the points above.")


@app.command
def generate(
    scene: str = "office",
    *,
    output: Output,
    freqs: Freqs = "paper",
    tx: Annotated[
        int | None, Parameter(help="Number of transmitters, chosen by the seed; all if absent.")
    ] = None,
    tx_positions: Annotated[
        Path | None,
        Parameter(help="CSV of x,y,z in metres, one transmitter a line, instead of the scene's grid."),
    ] = None,
    solver: Solver = "auto",
    interactions: Interactions = DEFAULT_INTERACTIONS,
    rays: Annotated[int, Parameter(help="Rays that look for paths.")] = 500_000,
    max_depth: Annotated[
        int, Parameter(help="Interactions of a path, reflections and transmissions together.")
    ] = 6,
    seed: Annotated[int, Parameter(help="Seed of the rays and of the choice of transmitters.")] = 1,
    pas_kind: Annotated[str, Parameter(help="power, amplitude or phase-only.")] = "power",
    materials: Annotated[
        Literal["error", "extrapolate"], Parameter(help="What to do outside a material's P.2040 band.")
    ] = "error",
    maps: Annotated[bool, Parameter(help="Store the maps beside the channels they derive from.")] = True,
    dry_run: Annotated[
        bool, Parameter(negative="", help="Print counts, size and a time estimate; write nothing.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Trace a scene and write its channels and power angular spectra to an HDF5 file.

    Parameters
    ----------
    scene
        A shipped scene's name, or the path of a scene TOML.
    """
    from xfreqbench.generate import estimate_seconds, plan_generation
    from xfreqbench.generate import generate as run_plan
    from xfreqbench.scene import load_scene
    from xfreqbench.tracing import TraceSettings

    if tx is not None and tx_positions is not None:
        raise XFreqBenchError(
            "--tx chooses from the scene's grid and --tx-positions replaces it; give one of them."
        )
    settings = TraceSettings(
        solver=solver,
        interactions=_interactions(interactions),
        max_depth=max_depth,
        rays=rays,
        seed=seed,
        materials=materials,
    )
    plan = plan_generation(
        load_scene(scene),
        parse_carriers_hz(freqs),
        settings,
        num_transmitters=tx,
        tx_position_m=_read_positions(tx_positions),
        pas_kind=pas_kind,
        maps=maps,
    )
    _say(plan.summary, quiet)
    if dry_run:
        print(f"estimated time {estimate_seconds(plan):.0f} s on this machine; nothing was written")
        return
    is_there = output.exists()
    with progress_bars("transmitters", ["tracing", "writing"], quiet) as (tracing, writing):
        run_plan(plan, output, tracing, writing)
    size = f"{output.stat().st_size / 1e6:.1f} MB"
    _say(f"{output} already holds this data set" if is_there else f"wrote {output} ({size})", quiet)


def _interactions(names: str) -> tuple[Literal["specular", "refraction", "diffraction", "diffuse"], ...]:
    """Checked later, where every setting is; here only split."""
    return tuple(name.strip() for name in names.split(",") if name.strip())  # type: ignore[misc]


def _read_positions(path: Path | None) -> Any:
    """Positions (T, 3) in metres, or None."""
    if path is None:
        return None
    import warnings

    import numpy as np

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an empty file, which is refused with the positions
            return np.loadtxt(path, delimiter=",", ndmin=2, usecols=(0, 1, 2)).reshape(-1, 3)
    except (OSError, ValueError) as error:
        raise XFreqBenchError(
            f"--tx-positions takes a CSV file of x,y,z in metres, one transmitter a line, but {path}: {error}"
        ) from error


@app.command(name="import")
def import_(
    folder: Path,
    *,
    output: Output,
    convention: Annotated[
        Literal["wideband3dgs"], Parameter(help="Whose angles, array and file names the folder follows.")
    ] = "wideband3dgs",
    quiet: Quiet = False,
) -> None:
    """Read a folder of PNG maps, as other groups publish theirs, into an HDF5 file without channels.

    Parameters
    ----------
    folder
        Holds spectrum/00001.png, …, tx_pos.csv, freq.txt and gateway_info.yml.
    """
    from xfreqbench.interchange import import_png_folder, read_png_folder

    source = read_png_folder(folder)
    if source.ignored:
        _say(f"{' and '.join(source.ignored)} ignored: protocols make the splits", quiet)
    is_new = import_png_folder(source, output)
    size = f"{output.stat().st_size / 1e6:.1f} MB"
    _say(f"wrote {output} ({size})" if is_new else f"{output} already holds this data set", quiet)


@app.command
def info(file: Path) -> None:
    """Say what a data set holds and verify every byte of it against its hashes."""
    from xfreqbench.dataset import verify
    from xfreqbench.inspection import describe

    print(describe(file))
    verify(file)
    print("every hash holds")


@app.command
def run(
    *,
    data: Annotated[Path, Parameter(help="Data set written by `generate`.")],
    results: Annotated[Path, Parameter(help="Folder for records, predictions and checkpoints.")],
    method: Annotated[
        str, Parameter(help="Names or package.module:Class, comma-separated; `all` for every installed one.")
    ] = "all",
    protocol: Annotated[
        str,
        Parameter(
            help="lofo: leave one frequency out; sparse: the paper's three training sets; held-out-tx: unseen "
            "transmitters; lofo-unseen-tx: both unseen."
        ),
    ] = "lofo",
    targets: Annotated[
        str | None,
        Parameter(
            help="Held-out carriers of lofo and lofo-unseen-tx in GHz, comma-separated, or `all`; default "
            "2.4,24.25,77."
        ),
    ] = None,
    seed: Annotated[str, Parameter(help="Seeds of the methods, comma-separated: one run each.")] = "0",
    budget: Annotated[str, Parameter(help="Fitting budget of every run: 300s, 5m, or 2000steps.")] = "5m",
    device: Annotated[
        Literal["cpu", "cuda"], Parameter(help="Where methods that have the choice compute.")
    ] = "cpu",
    set_: Annotated[
        tuple[str, ...],
        Parameter(name="--set", help="Change a field of the method's config, as in hidden=128."),
    ] = (),
    quiet: Quiet = False,
) -> None:
    """Fit methods on a protocol's training rows, store their predictions and score them.

    A killed run goes on where it stopped, in mid-fit too.
    """
    from xfreqbench.dataset import open_dataset
    from xfreqbench.method import device_option, method_names, parse_budget
    from xfreqbench.protocols import make_splits
    from xfreqbench.report import leaderboard_summary
    from xfreqbench.run import Job, run_all

    dataset = open_dataset(data)
    names = method_names() if method == "all" else [name.strip() for name in method.split(",")]
    splits = make_splits(dataset, protocol, _target_carriers_hz(targets))
    overrides = {name: (*set_, *device_option(name, device)) for name in names}
    jobs = [
        Job(str(data), name, protocol, split.name, overrides[name], number, parse_budget(budget))
        for name in names
        for number in _seeds(seed)
        for split in splits
    ]
    with _run_bars(f"{protocol} on {data.name}", quiet) as (progress, fitting):
        records = run_all(jobs, results, progress, fitting)
    _say(f"{leaderboard_summary(records)}\n\nEvery metric: xfreqbench report {results}", quiet)


def _seeds(text: str) -> list[int]:
    """Distinct seeds from `0,1,2`; raises `XFreqBenchError`."""
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() for part in parts):
        raise XFreqBenchError(
            f"--seed takes whole numbers from 0, comma-separated, as in 0,1,2, but got {text!r}."
        )
    return list(dict.fromkeys(map(int, parts)))


@contextmanager
def _run_bars(title: str, quiet: bool) -> Iterator[tuple[Callable[..., None], Callable[..., None]]]:
    """A bar of the runs and one of the fit at hand, driven by `run_all`'s two callbacks."""
    if quiet:
        yield (lambda done, total, record: None), (lambda job, fit: None)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[state]}")
    with Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True)) as progress:
        runs = progress.add_task(title, total=None, state="")
        steps = progress.add_task("fitting", total=None, state="")

        def finished(done: int, total: int, record: Any) -> None:
            progress.update(runs, completed=done, total=total, state=f"{done}/{total} runs")

        def fitting(job: Any, fit: Any) -> None:
            state = (
                f"step {fit.step:,}, loss {fit.loss:.4g}, {fit.seconds:.0f} s, {fit.share:.0%} of the budget"
            )
            progress.update(
                steps,
                description=f"fitting {job.method} {job.split}",
                completed=fit.share,
                total=1 if fit.share else None,  # without a budget nobody knows when it ends
                state=state if fit.share else state.rpartition(", ")[0],
            )

        yield finished, fitting


@app.command
def benchmark(
    *,
    preset: Annotated[
        str, Parameter(help="quick: minutes; standard: as in BENCHMARK.md; full: days, or many cores.")
    ] = "standard",
    data: Annotated[Path, Parameter(help="Folder of the data sets; those missing are generated.")] = Path(
        "data"
    ),
    results: Annotated[
        Path | None, Parameter(help="Folder for all results; results/PRESET if absent.")
    ] = None,
    device: Annotated[
        Literal["cpu", "cuda"], Parameter(help="cpu: one run a core; cuda: one run after the other.")
    ] = "cpu",
    dry_run: Annotated[bool, Parameter(negative="", help="Print what it would take; write nothing.")] = False,
    quiet: Quiet = False,
) -> None:
    """Run a whole benchmark: data sets, every run side by side, measurements, report.

    It prints what it takes before it starts; interrupted or killed, the same command goes on.
    """
    from xfreqbench import benchmark as benchmarks

    planned = benchmarks.plan_benchmark(preset, data, results or Path("results") / preset, device)
    _say(benchmarks.cost(planned), quiet and not dry_run)
    if dry_run:
        return
    with progress_bars("done", [*planned.scenes, "runs"], quiet) as (*tracing, runs):
        by_scene = dict(zip(planned.scenes, tracing, strict=True))
        benchmarks.generate_data(planned, lambda scene, done, total: by_scene[scene](done, total))
        failures = benchmarks.run_benchmark(planned, lambda done, total, job: runs(done, total))
    for name in planned.missing_benches():
        failures += benchmarks.measure(planned, name)
    if not failures:
        benchmarks.record_contents(planned)
    folder = planned.results_dir
    report(folder, output=folder / "BENCHMARK.md", html=folder / "benchmark.html", quiet=quiet)
    if failures:
        raise XFreqBenchError(
            "\n".join([f"{len(failures)} of its parts failed; the same command tries them again.", *failures])
        )


def _target_carriers_hz(targets: str | None) -> list[float] | Literal["all"] | None:
    return "all" if targets == "all" else parse_carriers_hz(targets) if targets else None


@app.command
def report(
    results: Path,
    *,
    output: Output = Path("BENCHMARK.md"),
    html: Annotated[
        Path | None, Parameter(help="Write one web page with charts and maps too, a single file.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Rebuild the leaderboard from the records of a results folder, offline."""
    from xfreqbench.report import write_report

    written = write_report(results, output)
    for path in written.paths:
        _say(f"wrote {path}", quiet)
    if written.num_truncated:
        _say("the last line of the records is cut off, as a killed run leaves it; it was not read", quiet)
    if html is not None:
        from xfreqbench.page import write_page

        _say(f"wrote {write_page(results, html)}", quiet)


@app.command
def plot(
    file: Path,
    *,
    output: Output,
    tx: Annotated[int, Parameter(help="Index of the transmitter in the data set.")] = 0,
) -> None:
    """Draw the power angular spectra of one transmitter at every carrier, as a PNG."""
    import numpy as np

    from xfreqbench.dataset import open_dataset
    from xfreqbench.pas import power_of
    from xfreqbench.plots import plot_pas_maps
    from xfreqbench.units import format_ghz

    if output.suffix != ".png":
        raise XFreqBenchError(f"The figure is a PNG, but {output} is to be written; end its name in .png.")
    dataset = open_dataset(file)
    if not 0 <= tx < dataset.header.num_tx:
        raise XFreqBenchError(
            f"{file} holds transmitters 0 to {dataset.header.num_tx - 1}, but {tx} is asked for."
        )
    rows = np.flatnonzero(dataset.tx_index == tx)
    titles = [format_ghz(carrier) for carrier in dataset.carrier_hz[rows]]
    plot_pas_maps(power_of(dataset.pas(rows), dataset.header.pas_kind), dataset.grid, titles, output)
    _say(f"wrote {output}")


RunData = Annotated[Path, Parameter(name="--data", help="The data set that the run was on.")]
RecordId = Annotated[
    str | None, Parameter(name="--id", help="How the record's id begins; the newest record if absent.")
]
RecordSplit = Annotated[str | None, Parameter(help="Only runs on this split, as in lofo-24.25GHz.")]
RecordSeed = Annotated[int | None, Parameter(help="Only runs of this seed.")]


@app.command
def findings(
    results: Path,
    *,
    data: RunData,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder for tables, figures and model.")],
    id_: RecordId = None,
    split: RecordSplit = None,
    seed: RecordSeed = None,
    quiet: Quiet = False,
) -> None:
    """Compare the planes, materials and images that a run found with the scene of its data.

    Parameters
    ----------
    results
        Folder of `run`, or its file of records.
    """
    from xfreqbench.dataset import open_dataset
    from xfreqbench.findings_record import ComparedFindings, choose_record
    from xfreqbench.findings_report import missing_rows, plane_rows, small_missing, title, write_findings

    record = choose_record(results, id_, split, seed)
    compared = ComparedFindings.of(record, open_dataset(data))
    paths = write_findings(compared, output)
    if not quiet:
        _print_table(title(compared), *plane_rows(compared))
        _print_table("Planes of the scene that were not found", *missing_rows(compared))
    _say(small_missing(compared), quiet)
    for path in paths:
        _say(f"wrote {path}", quiet)


@app.command
def residual(
    results: Path,
    *,
    data: RunData,
    output: Output,
    id_: RecordId = None,
    split: RecordSplit = None,
    seed: RecordSeed = None,
    tx: Annotated[
        int, Parameter(help="Tested transmitters, drawn at random; all where there are fewer.")
    ] = 60,
    quiet: Quiet = False,
) -> None:
    """Say whether a run lacks paths off planes that it did not find, or gains of paths off those it did.

    Parameters
    ----------
    results
        Folder of `run`, or its file of records; the predictions lie beside the records.
    """
    from xfreqbench import residual as residuals
    from xfreqbench.dataset import open_dataset
    from xfreqbench.findings_record import ComparedFindings, choose_record
    from xfreqbench.findings_report import title

    record = choose_record(results, id_, split, seed)
    compared = ComparedFindings.of(record, open_dataset(data))
    plan = residuals.plan_residual(results, compared, tx)
    residuals.claim(output, record.id)
    with progress_bars("transmitters", ["tracing", "scoring"], quiet) as (tracing, scoring):
        found = residuals.take_apart(plan, tracing, scoring)
    residuals.write_residual(found, output)
    if not quiet:
        _print_table(title(compared), *residuals.score_rows(found))
        _print_table("Where the findings leave gaps", *residuals.group_rows(found))
    _say(f"{residuals.note(found)}\nwrote {output}", quiet)


def _print_table(title: str, header: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left")
    for name in header:
        table.add_column(Text(name))
    for row in rows:
        table.add_row(*map(Text, row))
    Console(width=None if sys.stdout.isatty() else _PIPED_WIDTH).print(table)


BenchOutput = Annotated[
    Path | None,
    Parameter(
        name=["--output", "-o"], help="File to append the tables to, as records for `xfreqbench report`."
    ),
]


def _bench(
    name: str, output: Path | None, *arguments: str, kind: str | None = None, **options: object
) -> Any:
    """What prints and keeps a command's tables, of a `kind` where it has several.

    Options that are False or absent are not part of the command.
    """
    import shlex

    from xfreqbench.tables import Bench

    words = ["xfreqbench", "bench", name, *arguments]
    for option, value in options.items():
        flag = f"--{option.replace('_', '-')}"
        words += [] if value is None or value is False else [flag] if value is True else [flag, str(value)]
    return Bench(kind or name, shlex.join(words), _say, output)


@app.command
def stress(
    *,
    only: Annotated[str | None, Parameter(help="Cases whose area or name holds this text.")] = None,
    output: Annotated[
        Path | None, Parameter(name=["--output", "-o"], help="Records file that the table is appended to.")
    ] = None,
) -> None:
    """Compare the numerics with independent references where they are at their edges; exit code 1 for a failed case."""
    from xfreqbench.stress import stress as run_stress

    if not run_stress(only, output, _say):
        sys.exit(1)


@bench.command(name="generate")
def bench_generate(
    scene: str = "office",
    *,
    solvers: Annotated[str, Parameter(help="Comma-separated, of: image, sionna.")] = "image,sionna",
    against_plain: Annotated[
        bool,
        Parameter(negative="", help="The full pipeline's rate against one public PathSolver call a sample."),
    ] = False,
    tx: Annotated[int | None, Parameter(help="Transmitters of the full pipeline; all if absent.")] = None,
    plain_tx: Annotated[int, Parameter(help="Transmitters of the plain way, 2 to 24.")] = 12,
    output: BenchOutput = None,
) -> None:
    """Print the error of generated maps against run time, relative to the stored reference."""
    from xfreqbench import convergence

    if against_plain:
        bench = _bench("generate", output, scene, kind="plain", against_plain=True, tx=tx, plain_tx=plain_tx)
        convergence.bench_against_plain(bench, scene, tx, plain_tx)
    else:
        names = [name.strip() for name in solvers.split(",")]
        for name in names:
            if name not in ("image", "sionna"):
                raise UnknownNameError("solver", name, ("image", "sionna"))
        bench = _bench("generate", output, scene, solvers=",".join(names))
        convergence.bench_generate(bench, scene, names)


@bench.command(name="render")
def bench_render(
    *,
    gaussians: Annotated[str, Parameter(help="Numbers of Gaussians, comma-separated.")] = "1000,4000,16000",
    batch: Annotated[str, Parameter(help="Samples a minibatch, comma-separated.")] = "1,8,32",
    step: Annotated[bool, Parameter(help="Also take the training step of xfreq-gs apart.")] = True,
    output: BenchOutput = None,
) -> None:
    """Print the speed of splatting and training, with errors, against dense rendering."""
    from xfreqbench import rendering

    numbers = _counts("--gaussians", gaussians), _counts("--batch", batch)
    bench = _bench("render", output, gaussians=gaussians, batch=batch, no_step=not step)
    rendering.bench_render(bench, *numbers, step)


@bench.command(name="savings")
def bench_savings(*, output: BenchOutput = None) -> None:
    """Print every saving of generator, renderer and training off and on: its time, and what it changes."""
    from xfreqbench import efficiency

    efficiency.bench_savings(_bench("savings", output))


def _counts(option: str, text: str) -> list[int]:
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and int(part) > 0 for part in parts):
        raise XFreqBenchError(f"{option} takes whole numbers from 1 on, as in 1,8,32, but got {text!r}.")
    return [int(part) for part in parts]


@bench.command(name="reference")
def bench_reference(scene: str = "office", *, output: Output | None = None, quiet: Quiet = False) -> None:
    """Compute the reference of a scene by the plain way: 20 minutes; a killed run goes on."""
    from xfreqbench.reference import make_reference, reference_path
    from xfreqbench.scene import load_scene

    path = output or reference_path(scene)
    with progress_bars("calls", [f"reference of {scene}"], quiet) as (progress,):
        make_reference(load_scene(scene), path, progress)
    _say(f"wrote {path}", quiet)


if __name__ == "__main__":
    main()
