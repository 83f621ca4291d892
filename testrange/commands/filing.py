"""What is handed on: archive, export, view, picture."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from testrange.commands.options import Json, OneLanguage, Quiet, counted, print_json


def archive(
    campaign: Path,
    /,
    *,
    out: Path,
    results: Path | None = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Package a campaign and its results for filing (10.3): one BagIt package that `testrange check` verifies.

    Parameters
    ----------
    campaign
        A campaign folder, or what testrange run wrote.
    out
        A name that ends in .zip, or a new folder.
    results
        Its results folder; results/ beside the campaign where testrange run wrote both.
    """
    from testrange import pipeline
    from testrange.progress import display

    with display(quiet=quiet) as progress:
        pipeline.archive(campaign, results, out, progress)
    if json:
        print_json({"archive": str(out), "bytes": out.stat().st_size if out.is_file() else None})
    else:
        print(f"archive: {out}")


def export(
    campaign: Path,
    /,
    *,
    to: Literal["colmap", "odm", "clouds", "mcap"],
    out: Path,
    results: Path | None = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a campaign in the formats of other tools; docs/exports.md describes the files.

    Parameters
    ----------
    campaign
        A campaign folder, or what testrange run wrote.
    to
        colmap: images and model; odm: images with GPS tags and gcp_list.txt; clouds: PLY and PCD with image pairs;
        mcap: a recording (extra `mcap`).
    out
        A new folder; for mcap also a file that ends in .mcap.
    results
        results.json: the adjusted mountings are used instead of the data sheets'; results/ beside the campaign where
        testrange run wrote both.
    """
    from testrange import pipeline
    from testrange.progress import display

    with display(quiet=quiet) as progress:
        files = pipeline.export(campaign, out, to, results, progress)
    if json:
        print_json({"files": [str(f) for f in files]})
    else:
        print(f"{counted(len(files), 'file')}: {out}")


def view(
    place: Path,
    /,
    *,
    port: Annotated[int, Parameter(help="0 takes a free one.")] = 8041,
    rerun: Path | None = None,
    out: Path | None = None,
    language: OneLanguage = "zh",
    quiet: Quiet = False,
) -> None:
    """Show the range in 3D: serves view.html to this machine only, until Ctrl-C.

    Parameters
    ----------
    place
        What testrange run or evaluate wrote, a page, or a campaign folder, which is then evaluated.
    rerun
        Write a recording with a time line to this .rrd file instead (extra `rerun`).
    out
        Write the page to this file and do not serve it.
    """
    from testrange import pipeline
    from testrange.progress import display
    from testrange.viewing import serve

    with display(quiet=quiet) as progress:
        if rerun is not None:
            left_out = pipeline.record(place, rerun, progress)
        else:
            page = pipeline.view(place, out, progress, language)
    if rerun is not None:
        for line in left_out:
            print(f"not shown: {line}")
        print(f"recording: {rerun}")
    elif out is not None:
        print(f"3D page: {page}")
    else:
        serve(page, port)


def picture(run_folder: Path, /, *, out: Path, quiet: Quiet = False) -> None:
    """One picture of a run: an image with its targets, waveforms and grades. Evaluates the campaign again.

    Parameters
    ----------
    run_folder
        What testrange run wrote, or a campaign folder.
    out
        A .png or .jpg file.
    """
    from testrange import pipeline
    from testrange.progress import display

    with display(quiet=quiet) as progress:
        pipeline.picture(run_folder, out, progress)
    print(f"picture: {out}")
