"""Writes a family: DIR/members/NAME (campaign folders), DIR/expected/NAME.json, DIR/cards/NAME.md, DIR/truth/NAME, DIR/pairs,
DIR/family.json.

A part that several members share is simulated once and linked; renders are kept by content. A finished member is not made
again: its expected file is written last and states what it was made of.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from campaign.config import Config, Faults
from campaign.errors import CampaignError, TestrangeError
from campaign.load import dump_toml
from campaign.manifest import read_manifest, write_manifest
from campaign.progress import Report
from campaign.writing.atomic import complete_file, complete_folder
from simulator.release import release
from testrange.family.cards import card_text, readme_text
from testrange.family.design import designed
from testrange.family.edits import edit_records
from testrange.family.knobs import group_config
from testrange.family.model import INDEX, SCHEMA, Family, Member
from testrange.faults.cases import REACHES
from testrange.pairs.write import compute_pairs, write_pairs

WORK = ".work"
_FLIGHT_PARTS = {"camera": "sorties/*/images", "lidar": "sorties/*/lidar"}
_LEFT_OUT = ("_points.laz",)  # the same points once more, for other tools


@dataclass(frozen=True, kw_only=True)
class Made:
    """What became of the members."""

    names: tuple[str, ...]
    made: int  # now; the others were there
    failed: dict[str, str]  # name -> why


def make_family(family: Family, out: Path, progress: Report, only: Sequence[str] = ()) -> Made:
    """Make every member that is not there yet; `only` those whose name begins with one of these.

    Raises
    ------
    CampaignError
        `out` is something else than a family, or another one.
    ConfigError
        A configuration is wrong, or a value that cannot exist; nothing is made then.
    """
    _claim(family, out)
    chosen = designed(family, progress, only)
    failed: dict[str, str] = {}
    made = 0
    for done, member in enumerate(chosen):
        progress("members", done, len(chosen))
        try:
            made += _make(family, member, out)
        except TestrangeError as error:
            failed[member.name] = str(error)
    progress("members", len(chosen), len(chosen))
    if family.pairs and not only and not (out / "pairs").is_dir():
        write_pairs(compute_pairs(progress), out / "pairs")
    there = [m for m in chosen if (out / "expected" / f"{m.name}.json").is_file()]
    _write_index(family, there, out)
    if not only and len(there) == len(chosen):
        shutil.rmtree(out / WORK, ignore_errors=True)
    return Made(names=tuple(m.name for m in chosen), made=made, failed=failed)


def _claim(family: Family, out: Path) -> None:
    """The folder is empty, absent, or this family's."""
    mark = out / INDEX
    if mark.is_file():
        try:
            name = json.loads(mark.read_text(encoding="utf-8"))["family"]
        except (ValueError, KeyError, TypeError):
            name = None
        if name != family.name:
            raise CampaignError("holds another family", where=str(out), got=name, expected=family.name)
    elif out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise CampaignError("is not empty and no family", where=str(out), remedy="choose another place")
    else:
        _write_index(family, [], out)


def _write_index(family: Family, members: Sequence[Member], out: Path) -> None:
    entries = {e["name"]: e for e in _entries(out) if (out / "expected" / f"{e['name']}.json").is_file()}
    entries |= {m.name: {"name": m.name, "group": m.group, "purpose": m.purpose} for m in members}
    listed = [entries[name] for name in sorted(entries)]
    block = {
        "schema": SCHEMA,
        "family": family.name,
        "title": family.title,
        "licence": "CC-BY-4.0",
        "members": listed,
    }
    _write(out / INDEX, json.dumps(block, ensure_ascii=False, indent=1) + "\n")
    _write(out / "README.md", readme_text(family, {e["name"]: e["purpose"] for e in listed}))


def _entries(out: Path) -> list[dict[str, str]]:
    """Members that the index names already."""
    try:
        found = json.loads((out / INDEX).read_text(encoding="utf-8"))["members"]
        return [{key: str(entry[key]) for key in ("name", "group", "purpose")} for entry in found]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _write(path: Path, text: str) -> None:
    with complete_file(path) as work:
        work.write_text(text, encoding="utf-8", newline="\n")


def _digest(*of: object) -> str:
    return hashlib.sha256(repr((release(), *of)).encode()).hexdigest()


def member_config(family: Family, member: Member) -> Config:
    """As simulated."""
    config = group_config(family, member.group, member.settings)
    info = config.campaign.model_copy(update={"id": family.name, "title": family.title})
    return config.model_copy(update={"campaign": info})


def _make(family: Family, member: Member, out: Path) -> bool:
    """One member; False where it was there."""
    config = member_config(family, member)
    expected = member.expected.block()
    made_of = _digest(config.model_dump_json(), member.parts, member.edit, json.dumps(expected, sort_keys=True))
    mark = out / "expected" / f"{member.name}.json"
    folder = out / "members" / member.name
    if mark.is_file() and (folder / "manifest.json").is_file():
        try:
            if json.loads(mark.read_text(encoding="utf-8")).get("made_of") == made_of:
                return False
        except (ValueError, AttributeError):
            pass
    mark.unlink(missing_ok=True)
    cached = config.model_copy(
        update={"render": config.render.model_copy(update={"cache": str(out / WORK / "renders")})}
    )
    with complete_folder(folder, replace=True) as work:
        _assemble(cached, config, member, work, out / WORK)
    _write(out / "truth" / member.name / "campaign.toml", dump_toml(config))
    _write(out / "cards" / f"{member.name}.md", card_text(family, member, folder))
    _write(mark, json.dumps({**expected, "made_of": made_of}, ensure_ascii=False, indent=1) + "\n")
    return True


def _assemble(cached: Config, config: Config, member: Member, campaign: Path, work: Path) -> None:
    from simulator.simulate import simulate_campaign

    flies = bool(set(member.parts) & set(_FLIGHT_PARTS))
    if flies:
        simulate_campaign(cached, campaign, only=frozenset())
    for part in member.parts:
        source = _part(cached, config, part, work / "parts")
        _link(source, campaign, _FLIGHT_PARTS[part] if flies else "*")
    shutil.rmtree(campaign / "truth", ignore_errors=True)
    if member.edit is not None:
        edit_records(member.edit, campaign)
    manifest = read_manifest(campaign)
    write_manifest(campaign, manifest.model_copy(update={"campaign": member.name}))


def _part(cached: Config, config: Config, part: str, parts: Path) -> Path:
    """The folder of one part, simulated for this configuration or found."""
    from simulator.simulate import simulate_campaign

    of = "bench" if part in ("sphere", "chessboard") else part
    reached = {name: getattr(config.faults, name) for name in REACHES[of]}  # type: ignore[index]
    if part == "sphere":
        reached = {name: value for name, value in reached.items() if not name.startswith("image_ripple")}
    key = _digest(part, config.model_copy(update={"faults": Faults(**reached)}).model_dump_json())[:24]
    place = parts / f"{part}_{key}"
    if not (place / "manifest.json").is_file():
        with complete_folder(place, replace=True) as folder:
            simulate_campaign(cached, folder, only=frozenset({part}))
            shutil.rmtree(folder / "truth", ignore_errors=True)
    return place


def _link(source: Path, campaign: Path, pattern: str) -> None:
    """Hard links of the files of a part; a copy where the file system has none."""
    for found in sorted(source.glob(pattern)):
        for path in sorted(p for p in ([found] if found.is_file() else found.rglob("*")) if p.is_file()):
            if path.name.endswith(_LEFT_OUT):
                continue
            target = campaign / path.relative_to(source)
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(path, target)
            except OSError:
                shutil.copyfile(path, target)
