"""What a member, and a family, says of itself: Markdown for people. The files' checksums are in each member's manifest.json."""

from collections.abc import Mapping
from pathlib import Path

from campaign.manifest import read_manifest
from testrange.family.model import ACCEPTED, Expected, Family, Member

LICENCE = "CC BY 4.0 (https://creativecommons.org/licenses/by/4.0/)"


def card_text(family: Family, member: Member, folder: Path) -> str:
    """One card."""
    files = read_manifest(folder).files
    size = sum(f.bytes for f in files) / 1e6
    settings = [*family.set, *getattr(family, member.group).set, *member.settings]
    lines = [
        f"# {member.name}",
        "",
        f"{member.purpose}.",
        "",
        f"* family: {family.name}, {family.title}",
        f"* holds: {', '.join(member.parts)}; {len(files)} files, {size:.1f} MB",
        f"* licence: {LICENCE}",
        "* checksums: SHA-256 of every file in manifest.json; `testrange check` compares them",
        f"* what is expected: ../expected/{member.name}.json",
        "* synthetic: no field was flown",
        "",
        "## How it was made",
        "",
        f"`testrange family make {family.name} --out DIR`, from `{Path(family.base).name}` with",
        "",
        *(f"    {s}" for s in settings),
        "",
    ]
    if member.edit is not None:
        lines += [f"and this change of the records afterwards: {member.edit}.", ""]
    return "\n".join([*lines, *_told(member.expected)]) + "\n"


def _told(expected: Expected) -> list[str]:
    lines = ["## What is true", ""]
    if expected.indicators:
        lines += ["| indicator | true | one tolerance | grades accepted |", "|---|---|---|---|"]
        lines += [
            f"| `{name}` | {v.value:.5g} {v.unit} | {v.tolerance:.2g} | {', '.join(v.grades)} |"
            for name, v in expected.indicators.items()
        ]
        lines += ["", f"A result within {ACCEPTED:g} tolerances of the true value is right.", ""]
    for clause, statuses in expected.clauses.items():
        lines += [f"Clause {clause} must be found: {' or '.join(statuses)}.", ""]
    if not expected.clauses:
        lines += ["No clause is violated.", ""]
    if expected.may_fail:
        lines += [f"Not judged: {', '.join(expected.may_fail)}.", ""]
    return lines


def readme_text(family: Family, members: Mapping[str, str]) -> str:
    """README.md of a family's folder; `members`: name -> purpose."""
    rows = [f"| [{name}](cards/{name}.md) | {purpose} |" for name, purpose in members.items()]
    return "\n".join(
        [
            f"# {family.title}",
            "",
            "Synthetic campaigns after GB/T 41450-2022 whose indicators are known. Evaluate each folder of `members/` blind;",
            f"`expected/` says what is true. Licence of the data: {LICENCE}.",
            "",
            "    testrange family evaluate DIR --out RESULTS",
            "    testrange family verify DIR RESULTS",
            "",
            "| member | what it is |",
            "|---|---|",
            *rows,
            "",
        ]
    )
