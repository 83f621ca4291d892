"""The fault matrix."""

from pathlib import Path

from testrange.commands.options import Json, Quiet, Replace, Settings, print_json


def faults(
    study: str = "faults",
    /,
    *,
    out: Path = Path("out/faults"),
    workers: int | None = None,
    set_: Settings = (),
    replace: Replace = False,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Inject one fault at a time and print which parameters show it: matrix.json, its drawing, and results.json of every case.

    A command that was stopped goes on where it was: cases that were evaluated are not run again.

    Parameters
    ----------
    study
        A TOML file, or the name of one in configs/studies.
    out
        Output folder.
    workers
        Processes on this machine, one thread each; by default as many as there are cores.
    """
    from testrange import pipeline, tables
    from testrange.faults.matrix import matrix_block
    from testrange.faults.study import load_study
    from testrange.progress import display

    loaded = load_study(study)
    with display(quiet=quiet) as progress:
        matrix = pipeline.faults(loaded, out, progress, set_, replace=replace, workers=workers)
    if json:
        print_json(matrix_block(matrix))
    else:
        tables.print_faults(matrix, tables.console())
        print(f"matrix: {out / 'matrix.json'}, {out / 'matrix.png'}")
    return 0 if matrix.right == len(matrix.results) else 1
