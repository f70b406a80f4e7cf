"""Commands that measure: error against run time, savings, costs of executors, numerical stability."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal
from zipfile import is_zipfile

from cyclopts import Parameter

from xfreqbench.cli.options import (
    FREQS,
    Output,
    Quiet,
    bench,
    example,
    flag,
    output_option,
    parse_carriers_hz,
    parse_whole_numbers,
    say,
)
from xfreqbench.errors import UnknownNameError, XFreqBenchError
from xfreqbench.system.bars import progress_bars

BenchOutput = Annotated[Path | None, output_option("File to append the tables to, as records for `xfreqbench report`.")]


def _bench(name: str, output: Path | None, *arguments: str, kind: str | None = None, **options: object) -> Any:
    """The object that prints a command's tables and appends them to `output`, with the command line that makes them.

    `kind` names the tables if a command makes several kinds. The command line has no options that are False or None.
    """
    import shlex

    from xfreqbench.bench.tables import Bench
    from xfreqbench.system.files import require_text

    words = ["xfreqbench", "bench", name, *arguments]
    for option, value in options.items():
        flag = f"--{option.replace('_', '-')}"
        words += [] if value is None or value is False else [flag] if value is True else [flag, str(value)]
    return Bench(kind or name, require_text(shlex.join(words)), say, output)


@bench.command(name="generate", help_epilogue=example("bench generate office --solvers image"))
def bench_generate(
    scene: str = "office",
    *,
    solvers: Annotated[str, Parameter(help="Comma-separated, of: image, sionna.")] = "image,sionna",
    against_plain: Annotated[
        bool, flag("Compare the full pipeline's rate with one public PathSolver call a sample.")
    ] = False,
    tx: Annotated[int | None, Parameter(help="Transmitters of the full pipeline; default all.")] = None,
    plain_tx: Annotated[int, Parameter(help="Transmitters of the PathSolver calls, 2 to 24.")] = 12,
    output: BenchOutput = None,
) -> None:
    """Print the error of generated maps against run time, relative to the stored reference."""
    from xfreqbench.bench import solvers as convergence

    of_plain = {"--tx": tx is not None, "--plain-tx": plain_tx != 12}
    given = {"--solvers": solvers != "image,sionna"} if against_plain else of_plain
    if unused := [option for option, is_given in given.items() if is_given]:
        raise XFreqBenchError(f"{unused[0]} has no meaning {'with' if against_plain else 'without'} --against-plain.")
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


@bench.command(name="render", help_epilogue=example("bench render --gaussians 1000,4000 --batch 8"))
def bench_render(
    *,
    gaussians: Annotated[str, Parameter(help="Numbers of Gaussians, up to 1000000.")] = "1000,4000,16000",
    batch: Annotated[str, Parameter(help="Samples a minibatch, comma-separated, up to 1000.")] = "1,8,32",
    step: Annotated[bool, Parameter(help="Also time the training steps of methods.")] = True,
    output: BenchOutput = None,
) -> None:
    """Print the speed of splatting and training, with errors, against dense rendering."""
    from xfreqbench.bench import rendering

    numbers = (
        parse_whole_numbers("--gaussians", gaussians, 1, 1_000_000),
        parse_whole_numbers("--batch", batch, 1, 1000),
    )
    bench = _bench("render", output, gaussians=gaussians, batch=batch, no_step=not step)
    rendering.bench_render(bench, *numbers, step)


@bench.command(name="savings", help_epilogue=example("bench savings -o records.jsonl"))
def bench_savings(*, output: BenchOutput = None) -> None:
    """Print the time with every saving of the generator off and on, and the change of the channels."""
    from xfreqbench.bench import savings as efficiency

    efficiency.bench_savings(_bench("savings", output))


@bench.command(name="scale-out", help_epilogue=example("bench scale-out --tx 64"))
def bench_scale_out(
    *, tx: Annotated[int, Parameter(help="Transmitters to generate, 16 or more.")] = 64, output: BenchOutput = None
) -> None:
    """Print the time of the same work in one process, on several processes, and on a Dask cluster."""
    from xfreqbench.bench import executors as scale_out

    scale_out.bench_scale_out(_bench("scale-out", output, tx=tx), tx)


@bench.command(name="peers", help_epilogue=example("bench peers --solvers sionna,PathSolver --orders 1,2"))
def bench_peers(
    *,
    solvers: Annotated[
        str | None, Parameter(help="Comma-separated; default all. Those of DiffeRT need the extra `peers`.")
    ] = None,
    orders: Annotated[str, Parameter(help="Numbers of reflections, 1 to 6.")] = "1,2,3,4",
    seconds: Annotated[float, Parameter(help="Seconds that a solver may run after its set-up.")] = 20.0,
    limit: Annotated[float, Parameter(help="Total seconds after which a solver is stopped.")] = 300.0,
    output: BenchOutput = None,
) -> None:
    """Compare paths, time and error of our solvers with those of Sionna RT and DiffeRT, in the same room."""
    from xfreqbench.bench.peers import run

    names = [name.strip() for name in solvers.split(",")] if solvers else run.installed_peers()
    bench = _bench("peers", output, solvers=",".join(names), orders=orders, seconds=seconds, limit=limit)
    run.bench_peers(bench, names, parse_whole_numbers("--orders", orders, 1, run.MAX_ORDER), seconds, limit)


@bench.command(name="stress", help_epilogue=example("bench stress --only phase"))
def bench_stress(
    *,
    only: Annotated[str | None, Parameter(help="Run only cases whose area or name contains this text.")] = None,
    output: BenchOutput = None,
) -> None:
    """Compare extreme cases of the numerics with independent references; exit code 1 if a case fails."""
    from xfreqbench.bench.stress import run

    if not run.bench_stress(_bench("stress", output, only=only), only):
        sys.exit(1)


@bench.command(name="measured", help_epilogue=example("bench measured flat MEASURED.csv --freqs 2.402,2.426,2.48"))
def bench_measured(
    scene: str,
    measured: Path,
    *,
    freqs: Annotated[str, Parameter(name=FREQS, help="Carriers in GHz, comma-separated, whose powers are averaged.")],
    height: Annotated[
        float | None, Parameter(help="z in metres of all positions, for a file without that column.")
    ] = None,
    every: Annotated[int, Parameter(help="Use every N-th line of the file.")] = 1,
    solver: Annotated[Literal["auto", "image", "sionna"], Parameter(help="As in `generate`.")] = "auto",
    max_depth: Annotated[int, Parameter(help="Maximum number of interactions of a path.")] = 6,
    seed: Annotated[int, Parameter(help="Seed that draws the tenth of the cells in which models are fitted.")] = 1,
    output: BenchOutput = None,
    quiet: Quiet = False,
) -> None:
    """Compare measured powers, or impulse responses, with those of a scene, and powers with fitted laws.

    Parameters
    ----------
    scene
        A shipped scene's name, or the path of a scene TOML. It may have several receivers.
    measured
        A CSV file with a line of names: x, y and z in metres, and for each receiver a power in dB or dBm, in a column
        with the receiver's name, or a name that ends in `_` and the receiver's. Or an `.npz` of impulse responses.
    """
    from xfreqbench.bench.measured import bench_measured, read_measurement
    from xfreqbench.bench.responses import bench_responses, read_responses
    from xfreqbench.scene.model import load_scene
    from xfreqbench.tracing.solvers import check_settings
    from xfreqbench.tracing.tracer import TraceSettings

    if every < 1 or seed < 0:
        raise XFreqBenchError(f"--every takes 1 or more and --seed 0 or more, but got {every} and {seed}.")
    carriers_hz = parse_carriers_hz(freqs)
    settings = TraceSettings(solver, max_depth=max_depth)
    check_settings(settings)
    loaded = load_scene(scene)
    has_responses = measured.is_file() and is_zipfile(measured)
    if has_responses and height is not None:
        raise XFreqBenchError("--height has no meaning for impulse responses, whose positions have three axes.")
    found: Any = read_responses(measured, every) if has_responses else None
    found = found or read_measurement(measured, loaded.receivers, height, every)
    options: dict[str, Any] = {"height": height, "every": every, "solver": solver, "max_depth": max_depth, "seed": seed}
    bench = _bench("measured", output, scene, str(measured), freqs=freqs, **options)
    with progress_bars("positions", [f"tracing {loaded.name}"], quiet) as (progress,):
        compare = bench_responses if has_responses else bench_measured
        compare(bench, loaded, found, carriers_hz, settings, seed, progress)


@bench.command(name="reference", help_epilogue=example("bench reference empty -o reference.npz"))
def bench_reference(scene: str = "office", *, output: Output | None = None, quiet: Quiet = False) -> None:
    """Compute the reference of a scene by plain PathSolver calls, in 20 minutes; a killed run continues.

    For a scene with meshes, solver `image` computes it with eight times the rays, in a minute or two. Without
    --output it is written to the installed package, next to the shipped scenes, where `bench generate` looks for it.
    """
    from xfreqbench.bench.reference import make_reference, reference_path
    from xfreqbench.scene.model import load_scene

    loaded = load_scene(scene)
    path = output or reference_path(loaded.name)
    with progress_bars("calls", [f"reference of {loaded.name}"], quiet) as (progress,):
        make_reference(loaded, path, progress)
    say(f"wrote {path}", quiet)


@bench.command(name="fingerprint", help_epilogue=example("bench fingerprint office -o office_fingerprint.npz"))
def bench_fingerprint(
    scene: str = "office",
    *,
    output: Output,
    interactions: Annotated[
        Sequence[str] | None,
        Parameter(
            help="Comma-separated, of: specular, refraction, diffraction, diffuse. Default: the first three if solver "
            "image traces them, otherwise the first two."
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Trace the fingerprint of a scene: the channels with which `info` and `run` compare its data sets.

    Fingerprints of the shipped scenes are in `scenes/`.

    Parameters
    ----------
    scene
        A shipped scene's name, or the path of a scene TOML.
    """
    from xfreqbench.bench.fingerprints import make_fingerprint
    from xfreqbench.scene.model import load_scene

    is_new = not output.exists()
    with progress_bars("transmitters", [f"fingerprint of {scene}"], quiet) as (progress,):
        make_fingerprint(load_scene(scene), output, progress, interactions)
    say(f"wrote {output}" if is_new else f"{output} already holds this fingerprint", quiet)
