"""Civil time and GPS time. In memory and in CSV files a time is *adjusted standard GPS time*: GPS seconds - 1e9."""

from datetime import UTC, datetime, timedelta, timezone

GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
GPS_MINUS_UTC_S = 18
ADJUSTED_OFFSET_S = 1_000_000_000
WEEK_S = 604_800
BEIJING = timezone(timedelta(hours=8))


def gps_time_from_iso(text: str) -> float:
    """Adjusted standard GPS time of an ISO 8601 instant with UTC offset. [s]"""
    return (datetime.fromisoformat(text) - GPS_EPOCH).total_seconds() + GPS_MINUS_UTC_S - ADJUSTED_OFFSET_S


def utc_from_gps_time(gps_time_s: float) -> datetime:
    """UTC of an adjusted standard GPS time."""
    return GPS_EPOCH + timedelta(seconds=gps_time_s + ADJUSTED_OFFSET_S - GPS_MINUS_UTC_S)


def gps_week(gps_time_s: float) -> int:
    """Full GPS week number (no roll-over)."""
    return int((gps_time_s + ADJUSTED_OFFSET_S) // WEEK_S)
