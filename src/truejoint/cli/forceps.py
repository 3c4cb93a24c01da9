"""`truejoint forceps`: the experiments of yan2020 on virtual forceps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

import truejoint
from truejoint.cli.console import out, progress, result_json, say
from truejoint.cli.options import Force, Json, Seed
from truejoint.errors import TruejointError

if TYPE_CHECKING:
    from truejoint.evaluation.forceps.tables import TextTable
    from truejoint.simulation.forceps_parameters import ForcepsParameters

app = typer.Typer(
    no_args_is_help=True,
    help="Estimate a cable-driven jaw: the experiments of yan2020 on virtual forceps, and past "
    "them. Results stand beside the paper's numbers.",
)

Specimen = Annotated[str, typer.Option("--specimen", help="Virtual forceps: nominal, A or B.")]
Parameters = Annotated[
    Path | None,
    typer.Option(
        "--parameters",
        help="TOML file of a forceps of your own, in place of --specimen; what it leaves out is "
        "nominal.",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="Folder for the table (.md), the numbers and the figure."),
]


class Result(Protocol):
    """What every experiment gives."""

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        ...

    def table(self) -> TextTable:
        """For a person."""
        ...


@app.command(epilog="Example: `truejoint forceps table2 --specimen A --out results/`")
def table2(
    specimen_name: Specimen = "A",
    parameters: Parameters = None,
    seed: Seed = 0,
    folder: Out = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Figure 6 and Table 2: calibrate on trajectory (27), verify on (28)."""
    forceps, name = _chosen(specimen_name, parameters)
    say(f"Calibrating on (27) and verifying on (28), specimen {name} ...")
    result = truejoint.evaluation.forceps.compare_unloaded(forceps, specimen=name, seed=seed)

    def draw(path: Path) -> None:
        from truejoint.evaluation.forceps.figures import plot_unloaded  # noqa: PLC0415

        plot_unloaded(result, path)

    _show(result, "table2", folder, draw, force=force, as_json=as_json)


@app.command(epilog="Example: `truejoint forceps table3 --specimen A --out results/`")
def table3(
    specimen_name: Specimen = "A",
    parameters: Parameters = None,
    seed: Seed = 0,
    folder: Out = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Table 3 and figure 9: weights of 30 to 250 g on the jaw, both ways."""
    forceps, name = _chosen(specimen_name, parameters)
    with progress(f"Hanging weights on specimen {name}") as done:
        result = truejoint.evaluation.forceps.compare_loaded(
            forceps, specimen=name, seed=seed, progress=done
        )

    def draw(path: Path) -> None:
        from truejoint.evaluation.forceps.figures import plot_loaded  # noqa: PLC0415

        plot_loaded(result, path)

    _show(result, "table3", folder, draw, force=force, as_json=as_json)


@app.command(epilog="Example: `truejoint forceps strategies --parameters mine.toml`")
def strategies(
    specimen_name: Specimen = "A",
    parameters: Parameters = None,
    seed: Seed = 0,
    folder: Out = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Which sensor buys which accuracy: none on the cables, one, or both."""
    forceps, name = _chosen(specimen_name, parameters)
    with progress(f"Comparing sensors on specimen {name}") as done:
        result = truejoint.evaluation.forceps.compare_strategies(
            forceps, specimen=name, seed=seed, progress=done
        )

    def draw(path: Path) -> None:
        from truejoint.evaluation.forceps.figures import plot_strategies  # noqa: PLC0415

        plot_strategies(result, path)

    _show(result, "strategies", folder, draw, force=force, as_json=as_json)


@app.command(epilog="Example: `truejoint forceps load --specimen B`")
def load(
    specimen_name: Specimen = "A",
    parameters: Parameters = None,
    seed: Seed = 0,
    folder: Out = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """External load in mNm and grams, its dead band, and the stiffness from one known weight."""
    forceps, name = _chosen(specimen_name, parameters)
    with progress(f"Weighing on specimen {name}") as done:
        result = truejoint.evaluation.forceps.compare_forces(
            forceps, specimen=name, seed=seed, progress=done
        )
    _show(result, "load", folder, None, force=force, as_json=as_json)


@app.command(epilog="Example: `truejoint forceps rezero --specimen B`")
def rezero(
    specimen_name: Specimen = "A",
    parameters: Parameters = None,
    seed: Seed = 0,
    folder: Out = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Home with a wrong zero of the reset encoder, and find it from one unloaded cycle."""
    forceps, name = _chosen(specimen_name, parameters)
    with progress(f"Homing specimen {name}") as done:
        result = truejoint.evaluation.forceps.compare_homing(
            forceps, specimen=name, seed=seed, progress=done
        )
    _show(result, "rezero", folder, None, force=force, as_json=as_json)


@app.command(
    epilog="Example: `truejoint forceps population --count 100 --keep population.jsonl -o results/`"
)
def population(
    count: Annotated[int, typer.Option(help="Virtual specimens.")] = 100,
    homing_um: Annotated[
        float,
        typer.Option(help="Standard deviation of the cable encoders' zeros between runs [um]."),
    ] = 0.0,
    keep: Annotated[
        Path | None,
        typer.Option(help="File that keeps each specimen's result, so that a study goes on."),
    ] = None,
    seed: Seed = 0,
    folder: Out = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Every method on many specimens: the distribution, and how often each ordering holds."""
    with progress(f"Calibrating and verifying {count} specimens") as done:
        result = truejoint.evaluation.forceps.study_population(
            count, seed=seed, homing_deviation=1e-6 * homing_um, keep=keep, progress=done
        )

    def draw(path: Path) -> None:
        from truejoint.evaluation.forceps.figures import plot_population  # noqa: PLC0415

        plot_population(result, path)

    _show(result, "population", folder, draw, force=force, as_json=as_json)


@app.command(epilog="Example: `truejoint forceps plant --motion verification -o run.parquet`")
def plant(
    output: Annotated[Path, typer.Option("--out", "-o", help="Parquet file to write.")],
    specimen_name: Specimen = "nominal",
    parameters: Parameters = None,
    motion: Annotated[
        str, typer.Option(help="calibration (27), verification (28), or load.")
    ] = "calibration",
    load_g: Annotated[float, typer.Option(help="Weight of the load motion [g].")] = 100.0,
    load_direction: Annotated[str, typer.Option(help="opposing or along.")] = "opposing",
    log_rate_hz: Annotated[float, typer.Option(help="Rows per second [Hz].")] = 200.0,
    seed: Seed = 0,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run the virtual forceps and keep the recording, for `truejoint calibrate` and `evaluate`."""
    from truejoint.evaluation.forceps.plant import record_motion  # noqa: PLC0415
    from truejoint.recordings import write_parquet  # noqa: PLC0415

    forceps, name = _chosen(specimen_name, parameters)
    recording = record_motion(
        forceps,
        motion,
        specimen=name,
        load=1e-3 * load_g,
        direction=load_direction,
        log_rate=log_rate_hz,
        seed=seed,
    )
    write_parquet(recording, output, overwrite=force)
    facts = {"file": str(output), "rows": len(recording), "duration": recording.duration}
    if as_json:
        result_json(facts)
    else:
        out.print(f"{output}: {facts['rows']} rows, {recording.duration:.1f} s", highlight=False)


def _chosen(name: str, parameters: Path | None) -> tuple[ForcepsParameters, str]:
    from truejoint.simulation.forceps_parameters import ForcepsParameters  # noqa: PLC0415
    from truejoint.simulation.forceps_specimens import specimen  # noqa: PLC0415

    if parameters is None:
        return specimen(name), name
    return ForcepsParameters.load(parameters), parameters.stem


def _show(
    result: Result,
    name: str,
    folder: Path | None,
    draw: Callable[[Path], None] | None,
    *,
    force: bool,
    as_json: bool,
) -> None:
    """Print an experiment's result, and write table, numbers and figure where asked."""
    table = result.table()
    if folder is not None:
        import json  # noqa: PLC0415

        suffixes = (".md", ".json") if draw is None else (".md", ".json", ".png")
        files = [folder / f"{name}{suffix}" for suffix in suffixes]
        there = [path for path in files if path.exists()]
        if there and not force:
            raise TruejointError(f"{there[0]}: is there already; choose another --out, or --force")
        folder.mkdir(parents=True, exist_ok=True)
        files[0].write_text(table.markdown(), encoding="utf-8")
        files[1].write_text(json.dumps(result.to_dict(), indent=2) + "\n", encoding="utf-8")
        if draw is not None:
            draw(files[2])
        say(f"Written: {', '.join(str(path) for path in files)}")
    if as_json:
        result_json(result.to_dict())
    else:
        out.print(table.rich())
