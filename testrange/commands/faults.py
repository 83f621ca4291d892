"""The fault matrix."""

from pathlib import Path

from testrange.commands.options import Json, Quiet, Replace, Settings, print_json


def faults(
    study: str = "faults",
    /,
    *,
    out: Path = Path("out/faults"),
    set_: Settings = (),
    replace: Replace = False,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Inject one fault at a time and print which parameters show it: matrix.json, and results.json of every case.

    Parameters
    ----------
    study
        A TOML file, or the name of one in configs/studies.
    out
        Output folder.
    """
    from testrange import pipeline, tables
    from testrange.faults import load_study, matrix_block
    from testrange.progress import display

    loaded = load_study(study)
    with display(quiet=quiet) as progress:
        matrix = pipeline.faults(loaded, out, progress, set_, replace=replace)
    if json:
        print_json(matrix_block(matrix))
    else:
        tables.print_faults(matrix, tables.console())
        print(f"matrix: {out / 'matrix.json'}")
    return 0 if matrix.right == len(matrix.results) else 1
