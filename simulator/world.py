"""What one simulation works with: the scene, its flight, and the navigation's errors. Nothing is rendered or written here."""

from dataclasses import dataclass

from campaign.config import Config
from scenes.build import build_scene
from scenes.model import Scene, SunSky
from scenes.sunsky import sun_sky
from simulator.camera.ripple import require_no_fold
from simulator.faults import require_targets, with_panel_gains, with_true_lens
from simulator.flight.frames import SiteFrame
from simulator.flight.motion import Motion
from simulator.flight.navigation import estimate_motion
from simulator.flight.plan import Sortie, fly
from simulator.randomness import scene_seed
from simulator.render.scene import RenderScene, load_scene
from simulator.times import utc_from_gps_time


@dataclass(frozen=True, kw_only=True)
class Range:
    """What one simulation works with."""

    config: Config  # with the true lens in camera.lens
    frame: SiteFrame
    scene: Scene
    render_scene: RenderScene
    sorties: tuple[Sortie, ...]
    estimated: tuple[Motion, ...]


def prepare_range(config: Config) -> Range:
    """Build the scene, fly it, and draw the navigation's errors. Nothing is rendered or written.

    Layout and flight follow the lens that the configuration states: a fault of the true one changes pictures and nothing else.
    """
    fixed = config.model_copy(update={"seed": scene_seed(config)})
    scene = build_scene(fixed)
    require_targets(config, tuple(target.id for target in scene.targets))
    scene = with_panel_gains(config, scene)
    require_no_fold(config)
    sorties = fly(fixed, scene.layout)
    return Range(
        config=with_true_lens(config),
        frame=SiteFrame(config.site),
        scene=scene,
        render_scene=load_scene(scene),
        sorties=sorties,
        estimated=tuple(estimate_motion(config, sortie.motion, sortie.number) for sortie in sorties),
    )


def light_at(world: Range, gps_time_s: float) -> SunSky:
    """Sun and sky over the site."""
    return sun_sky(world.config.site, world.config.environment, utc_from_gps_time(gps_time_s))
