"""TIFF directories as bytes: tags of IFD 0, EXIF and GPS for TIFF files and for the EXIF segment of a JPEG; the XMP packet.

Little-endian. No pixel passes here.
"""

import struct
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

SHORT, LONG, RATIONAL, ASCII, BYTE, UNDEFINED = 3, 4, 5, 2, 1, 7
_FORMATS = {SHORT: ("H", 2), LONG: ("I", 4), BYTE: ("B", 1), UNDEFINED: ("B", 1)}

MAKE, MODEL, ORIENTATION, SOFTWARE, DATE_TIME, XMP, EXIF_IFD, GPS_IFD = 271, 272, 274, 305, 306, 700, 34665, 34853
STRIP_OFFSETS = 273


@dataclass(frozen=True)
class Tag:
    """One entry of a directory. Values: numbers for numeric types, str for ASCII, bytes for BYTE and UNDEFINED."""

    code: int
    kind: int
    value: Any

    def packed(self) -> tuple[int, bytes]:
        """(count, bytes of the value)"""
        if self.kind == ASCII:
            raw = self.value.encode("ascii", "replace") + b"\0"
            return len(raw), raw
        if isinstance(self.value, bytes):
            return len(self.value), self.value
        values = self.value if isinstance(self.value, tuple | list) else (self.value,)
        if self.kind == RATIONAL:
            return len(values), b"".join(struct.pack("<II", *_rational(v)) for v in values)
        form, _ = _FORMATS[self.kind]
        return len(values), struct.pack(f"<{len(values)}{form}", *values)


def _rational(value: float) -> tuple[int, int]:
    """The nearest fraction of two 32-bit numbers, denominator at most a million."""
    fraction = Fraction(value).limit_denominator(1_000_000)
    return fraction.numerator, fraction.denominator


def directory(tags: list[Tag], at: int) -> bytes:
    """One IFD that stands at byte `at`, its long values behind it. The length is even."""
    tags = sorted(tags, key=lambda t: t.code)
    values_at = at + 2 + 12 * len(tags) + 4
    entries, values = b"", b""
    for tag in tags:
        count, raw = tag.packed()
        if len(raw) <= 4:
            inline = raw.ljust(4, b"\0")
        else:
            inline = struct.pack("<I", values_at + len(values))
            values += raw + b"\0" * (len(raw) % 2)
        entries += struct.pack("<HHI", tag.code, tag.kind, count) + inline
    return struct.pack("<H", len(tags)) + entries + struct.pack("<I", 0) + values


def tiff_structure(tags: list[Tag], exif: list[Tag], gps: list[Tag], data_tag: int | None = None) -> bytes:
    """TIFF header, IFD 0 with the given tags, EXIF and GPS directories. `data_tag` names the tag of IFD 0 that is to hold
    the byte just behind the structure, where the pixels go."""

    def first(exif_at: int, gps_at: int, data_at: int) -> bytes:
        links = [Tag(EXIF_IFD, LONG, exif_at), Tag(GPS_IFD, LONG, gps_at)]
        links += [] if data_tag is None else [Tag(data_tag, LONG, data_at)]
        return directory(tags + links, 8)

    exif_at = 8 + len(first(0, 0, 0))
    gps_at = exif_at + len(directory(exif, exif_at))
    end = gps_at + len(directory(gps, gps_at))
    data_at = -(-end // 16) * 16
    out = (
        b"II*\0"
        + struct.pack("<I", 8)
        + first(exif_at, gps_at, data_at)
        + directory(exif, exif_at)
        + directory(gps, gps_at)
    )
    return out.ljust(data_at, b"\0") if data_tag is not None else out


def xmp_packet(attributes: dict[str, str]) -> bytes:
    """An XMP packet; every value an attribute of one Description, as DJI and Pix4D write them."""
    spaces = {
        "drone-dji": "http://www.dji.com/drone-dji/1.0/",
        "Camera": "http://pix4d.com/camera/1.0/",
    }
    lines = [f'xmlns:{prefix}="{uri}"' for prefix, uri in spaces.items()]
    lines += [f'{name}="{value}"' for name, value in attributes.items()]
    text = (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>\n<x:xmpmeta xmlns:x="adobe:ns:meta/">\n'
        ' <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">\n  <rdf:Description rdf:about=""\n    '
        + "\n    ".join(lines)
        + '/>\n </rdf:RDF>\n</x:xmpmeta>\n<?xpacket end="w"?>'
    )
    return text.encode("utf-8")


def jpeg_segment(marker: int, payload: bytes) -> bytes:
    """One JPEG segment."""
    return struct.pack(">BBH", 0xFF, marker, len(payload) + 2) + payload


def jpeg_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) that a JPEG's frame header states; None where there is none."""
    frame = jpeg_frame(data)
    return None if frame is None else frame[:2]


def jpeg_frame(data: bytes) -> tuple[int, int, int] | None:
    """(width, height, bands) that a JPEG's frame header states; None where there is none."""
    for marker, at, _ in _segments(data):
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            if at + 6 > len(data):
                return None
            height, width, bands = struct.unpack_from(">HHB", data, at + 1)
            return width, height, bands
    return None


def jpeg_exif(data: bytes) -> tuple[bytes | None, bytes | None]:
    """(EXIF structure, XMP packet) of a JPEG."""
    exif = xmp = None
    for marker, at, end in _segments(data):
        if marker == 0xE1 and data[at : at + 6] == b"Exif\0\0":
            exif = data[at + 6 : end]
        elif marker == 0xE1 and data[at : at + 29] == b"http://ns.adobe.com/xap/1.0/\0":
            xmp = data[at + 29 : end]
    return exif, xmp


def _segments(data: bytes) -> list[tuple[int, int, int]]:
    """(marker, first byte, end) of the segments before the picture's data."""
    out = []
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], struct.unpack_from(">H", data, at + 2)[0]
        if marker == 0xDA or length < 2:
            break
        out.append((marker, at + 4, at + 2 + length))
        at += 2 + length
    return out
