"""The only room that imports Mitsuba and Dr.Jit. `start()` chooses the variant once for the process.

One variant serves camera and LiDAR: Mitsuba builds the scene and traces the rays; reflectances come from our own tables, already
averaged over a band or taken at the laser line, so no variant's spectral limits apply.
"""

from campaign.threads import thread_count
from simulator.render.native import prepare

VARIANT = "llvm_ad_rgb"


def start(threads: int | None = None) -> None:
    """Load Mitsuba once and set the number of Dr.Jit's worker threads (default: `campaign.threads.thread_count`)."""
    prepare()
    import drjit as dr
    import mitsuba as mi

    if mi.variant() != VARIANT:
        mi.set_variant(VARIANT)
    mi.set_log_level(mi.LogLevel.Warn)
    dr.set_thread_count(threads if threads is not None else thread_count())
