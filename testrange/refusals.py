"""What a simulation would only meet when hours have gone, refused before anything is begun: places, addresses, contradictions."""

import os
from pathlib import Path

from campaign.config import Config
from campaign.errors import ConfigError
from campaign.writing.atomic import check_target

CACHE = "--cache, render.cache"


def refuse_at_once(
    config: Config, out: Path, *, replace: bool = False, workers: int | None = None, scheduler: str | None = None
) -> None:
    """All that can be known of a simulation into `out` beforehand; the cache's folder is made.

    Raises
    ------
    ConfigError
        Workers beside a scheduler, an address that is none, a cache that is not apart from `out`.
    CampaignError
        `out` is occupied, or the cache cannot be written.
    """
    refuse_workers(workers)
    refuse_scheduler(scheduler, workers)
    target = Path(os.path.abspath(out))
    check_target(target, replace)
    if config.render.cache is not None:
        from simulator.kept import make_folder

        refuse_cache_in(Path(config.render.cache), target)
        make_folder(Path(config.render.cache), to_write=True)


def refuse_workers(workers: int | None) -> None:
    """At least one."""
    if workers is not None and workers < 1:
        raise ConfigError("is no number of workers", where=f"--workers {workers}", expected="1 or more")


def refuse_scheduler(scheduler: str | None, workers: int | None) -> None:
    """Processes here and a cluster exclude each other, and the cluster's address is one."""
    if scheduler is None:
        return
    if workers is not None:
        raise ConfigError(
            "exclude each other",
            where="--workers and --scheduler",
            got=f"{workers} and {scheduler!r}",
            expected="one of them",
            remedy="leave out --workers: the cluster's own workers do the work",
        )
    from testrange.study.execution.cluster import check_address

    check_address(scheduler)


def refuse_cache_in(cache: Path, target: Path) -> None:
    """Renders inside the output folder would occupy or disturb it, and --replace would delete them; an output folder among the
    renders is no better."""
    kept, end = Path(os.path.realpath(cache)), Path(os.path.realpath(target))
    for place in (end, end.with_name(f".{end.name}.part")):
        if kept.is_relative_to(place) or place.is_relative_to(kept):
            where = "lies inside" if kept.is_relative_to(place) else "holds"
            raise ConfigError(
                f"the folder that keeps renders {'is' if kept == place else where} the output folder",
                where=CACHE,
                got=f"{cache} with --out {target}",
                expected="two folders apart from each other",
                remedy="choose another place for one of them",
            )
