"""A small, complete configuration for the scenes' tests: the quickstart's camera and LiDAR, no file read."""

from collections.abc import Callable
from typing import Any

import pytest

from campaign.config import Band, Camera, CampaignInfo, Config, Lens, Lidar, Scanner

CAMERA = Camera(
    width_px=3072,
    height_px=2048,
    pixel_size_um=4.5,
    nominal_focal_length_mm=13.5,
    lens=Lens(fx_px=3000.0, fy_px=3000.0, cx_px=1536.0, cy_px=1024.0),
    bands=(
        Band(name="red", centre_nm=620.0, fwhm_nm=70.0),
        Band(name="green", centre_nm=540.0, fwhm_nm=75.0),
        Band(name="blue", centre_nm=465.0, fwhm_nm=70.0),
    ),
)


@pytest.fixture
def make_config() -> Callable[..., Config]:
    """Config with any part replaced by keyword."""

    def make(**parts: Any) -> Config:
        given = {
            "campaign": CampaignInfo(id="scenes"),
            "camera": CAMERA,
            "lidar": Lidar(scanner=Scanner(sector_deg=(-35.0, 35.0))),
        }
        return Config(**(given | parts))

    return make
