"""A campaign in the formats of other tools: COLMAP, OpenDroneMap, point clouds with image pairs, mcap.

`export_campaign` is the one verb; it writes the target complete or not at all. What is exported stands in `source`, one format
in each of the other rooms. docs/exports.md describes the files.
"""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Literal, cast, get_args

from campaign.errors import CampaignError
from campaign.progress import Report, silent
from campaign.threads import one_blas_thread
from campaign.writing.atomic import complete_file, complete_folder
from testrange.export.source import Source, open_source

Format = Literal["colmap", "odm", "clouds", "mcap"]
FORMATS: tuple[Format, ...] = get_args(Format)


@one_blas_thread()
def export_campaign(
    campaign: Path, out: Path, to: Format, progress: Report = silent, *, results: Path | None = None
) -> list[Path]:
    """Export a campaign folder, flown or simulated; truth/ is never opened.

    Parameters
    ----------
    campaign : Path
        The campaign folder.
    out : Path
        A folder that does not exist or is empty; for "mcap" also a file that ends in .mcap.
    to : {"colmap", "odm", "clouds", "mcap"}
    progress : callable
    results : Path, optional
        results.json, or the folder that holds it: mountings, clocks, lens and ranges are then the adjusted ones, else those
        of the sensors' sheets.

    Returns
    -------
    list of Path
        Every file written, sorted.

    Raises
    ------
    CampaignError
        The folder lacks what the format needs, `out` is occupied, lies in the campaign, or a package of an extra is not installed.
    EvaluationError
        results.json is of another campaign or cannot be read.
    """
    if to not in FORMATS:
        raise CampaignError("no such format", where="--to", got=to, expected=", ".join(FORMATS))
    if out.resolve().is_relative_to(campaign.resolve()):
        raise CampaignError("lies inside the campaign that is exported", where=str(out), remedy="choose another place")
    source = open_source(campaign, results)
    if to == "mcap" and out.suffix == ".mcap":
        from testrange.export.bag import write_bag

        if out.exists():
            raise CampaignError("already exists", where=str(out), remedy="choose another place or delete it")
        with complete_file(out) as work:
            write_bag(source, work, progress)
        return [out]
    with complete_folder(out) as work:
        room = "bag" if to == "mcap" else to
        write = cast(Callable[[Source, Path, Report], None], import_module(f"testrange.export.{room}").export)
        write(source, work, progress)
        names = sorted(path.relative_to(work) for path in work.rglob("*") if path.is_file())
    return [out / name for name in names]
