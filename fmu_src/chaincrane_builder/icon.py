"""model.png, the FMU's icon: a trolley, a bent chain, a payload; drawn, so that no file is kept."""

from __future__ import annotations

import struct
import zlib
from itertools import pairwise

import numpy as np

SIZE = 128  # pixels
WHITE, STEEL, ORANGE = (255, 255, 255), (40, 50, 60), (213, 94, 0)
CHAIN = ((64, 26), (72, 44), (76, 62), (84, 78), (98, 92))  # trolley to payload, pixels


def _near_segment(a: tuple[float, float], b: tuple[float, float]) -> np.ndarray:
    """Distance of every pixel from the segment a-b, pixels, shape (SIZE, SIZE)."""
    y, x = np.mgrid[0:SIZE, 0:SIZE].astype(float)
    dx, dy = b[0] - a[0], b[1] - a[1]
    along = np.clip(((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
    return np.asarray(np.hypot(x - a[0] - along * dx, y - a[1] - along * dy))


def draw() -> np.ndarray:
    """The icon, shape (SIZE, SIZE, 3), 8 bit RGB."""
    image = np.empty((SIZE, SIZE, 3))
    image[:] = WHITE

    def stroke(distance: np.ndarray, width: float, colour: tuple[int, int, int]) -> None:
        cover = np.clip(width - distance + 0.5, 0.0, 1.0)[:, :, None]
        image[:] = image * (1.0 - cover) + np.array(colour) * cover

    stroke(_near_segment((8, 12), (120, 12)), 2.0, STEEL)  # rail
    stroke(_near_segment((48, 20), (80, 20)), 7.0, STEEL)  # trolley
    for a, b in pairwise(CHAIN):
        stroke(_near_segment(a, b), 1.8, STEEL)
    stroke(_near_segment(CHAIN[-1], (CHAIN[-1][0] + 3.0, CHAIN[-1][1] + 8.0)), 11.0, ORANGE)
    return np.round(image).astype(np.uint8)


def png(image: np.ndarray) -> bytes:
    """An 8 bit RGB image as a PNG file's bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        checksum = zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)

    height, width, _ = image.shape
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    lines = b"".join(b"\0" + row.tobytes() for row in image)
    parts = chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(lines, 9)), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)
