"""Where each file of a campaign folder stands, and whether a path stays in it. Opens nothing. Layout: docs/campaign_folder.md."""

from dataclasses import dataclass
from pathlib import Path

from campaign.errors import CampaignError


@dataclass(frozen=True)
class SortieFolder:
    """One flight: sorties/NN."""

    root: Path
    number: int

    @property
    def trajectory_sbet(self) -> Path:
        return self.root / "trajectory.out"

    @property
    def trajectory_rms(self) -> Path:
        return self.root / "smrmsg.out"

    @property
    def trajectory_csv(self) -> Path:
        return self.root / "trajectory.csv"

    @property
    def images(self) -> Path:
        return self.root / "images"

    @property
    def exposures(self) -> Path:
        return self.images / "exposures.csv"

    @property
    def lidar(self) -> Path:
        return self.root / "lidar"

    @property
    def environment(self) -> Path:
        return self.root / "environment.csv"

    @property
    def observations_camera(self) -> Path:
        return self.root / "observations_camera.csv"

    @property
    def observations_lidar(self) -> Path:
        return self.root / "observations_lidar.csv"

    def strip_las(self, strip: int) -> Path:
        """Waveform records of one strip (PDRF 9); the packets stand beside it with the suffix .wdp."""
        return self.lidar / f"strip_{strip:02d}.las"

    def strip_points(self, strip: int) -> Path:
        """The same returns without waveforms (PDRF 6, LAZ)."""
        return self.lidar / f"strip_{strip:02d}_points.laz"


@dataclass(frozen=True)
class CampaignFolder:
    """Paths inside one campaign folder."""

    root: Path

    def holds(self, path: Path) -> bool:
        """Whether a path of this folder, links resolved, stays in it."""
        try:
            return path.resolve().is_relative_to(self.root.resolve())
        except (OSError, RuntimeError):
            return False

    def held(self, path: Path) -> Path:
        """The path itself; raises CampaignError where a link leads out of the folder."""
        if not self.holds(path):
            raise CampaignError(
                "a link leads out of the campaign folder",
                where=str(path),
                remedy="copy what it leads to into the folder",
            )
        return path

    @property
    def manifest(self) -> Path:
        return self.root / "manifest.json"

    @property
    def plan(self) -> Path:
        return self.root / "plan.json"

    @property
    def targets(self) -> Path:
        return self.root / "survey" / "targets.csv"

    @property
    def gcp_list(self) -> Path:
        return self.root / "survey" / "gcp_list.txt"

    @property
    def spectra(self) -> Path:
        return self.root / "survey" / "spectra.csv"

    @property
    def camera(self) -> Path:
        return self.root / "sensors" / "camera.json"

    @property
    def lidar(self) -> Path:
        return self.root / "sensors" / "lidar.json"

    @property
    def rig(self) -> Path:
        return self.root / "sensors" / "rig.json"

    @property
    def sphere_stability(self) -> Path:
        """Images and log.csv of 8.2.2.1."""
        return self.root / "bench" / "sphere_stability"

    @property
    def sphere_repeatability(self) -> Path:
        """Images and log.csv of 8.2.2.2."""
        return self.root / "bench" / "sphere_repeatability"

    @property
    def chessboard(self) -> Path:
        """board.json, images and log.csv of 9.2.2."""
        return self.root / "bench" / "chessboard"

    @property
    def room(self) -> Path:
        """The benches' room and instruments (6.3)."""
        return self.root / "bench" / "room.json"

    @property
    def ranging(self) -> Path:
        """line.json, total_station.csv and scans/ of 9.1.2."""
        return self.root / "ranging"

    @property
    def truth(self) -> Path:
        return self.root / "truth"

    def sortie(self, number: int) -> SortieFolder:
        return SortieFolder(self.root / "sorties" / f"{number:02d}", number)

    def sorties(self) -> list[SortieFolder]:
        """Every sortie on disk, in order of its number."""
        parent = self.root / "sorties"
        if not parent.is_dir():
            return []
        names = (p.name for p in parent.iterdir() if p.is_dir() and p.name.isascii() and p.name.isdigit())
        numbers = sorted({int(name) for name in names if len(name) <= 4 and name == f"{int(name):02d}"})
        return [SortieFolder(parent / f"{n:02d}", n) for n in numbers]
