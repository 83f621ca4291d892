"""README.md of an export: a table of files in Chinese and English, frames and conventions, the commands that take them."""

from collections.abc import Sequence

from testrange.export.source import Source


def page(
    source: Source, tool: str, summary: str, files: Sequence[tuple[str, str, str]], notes: str, commands: str = ""
) -> str:
    """Markdown of one export.

    Parameters
    ----------
    source : Source
    tool : str
        Whom it is for.
    summary : str
        Numbers of images, points ...
    files : sequence of (name, Chinese, English)
    notes : str
        Frames and conventions; lines are joined to paragraphs where they are not separated by an empty line.
    commands : str
        As typed in a shell.
    """
    m = source.data.manifest
    out = [f"# {m.campaign}: {tool}", ""]
    if m.synthetic:
        out += ["虚拟检测场仿真数据 / synthetic data of a virtual range", ""]
    out += [f"{summary}. {source.basis}.", "", "| 文件 / file | 内容 | content |", "|---|---|---|"]
    out += [f"| `{name}` | {zh} | {en} |" for name, zh, en in files]
    out += ["", notes.strip(), ""]
    if commands:
        out += [*(f"    {line}" for line in commands.strip().splitlines()), ""]
    return "\n".join(out)


def world_frame(source: Source) -> str:
    """One sentence in two languages that says where the world frame stands."""
    m = source.data.manifest
    at = f"{m.latitude_deg!r}°, {m.longitude_deg!r}°, {m.ellipsoid_height_m!r} m"
    return (
        f"世界坐标系:以纬度、经度、大地高 {at} (CGCS2000) 为原点的站心坐标系,东、北、天 [m]。\n"
        f"World frame: topocentric, east, north, up [m] at latitude, longitude, ellipsoidal height {at} (CGCS2000)."
    )
