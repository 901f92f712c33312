"""A small map in the corner of a picture: the regions from above, with this start's ball and target."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from PIL import Image, ImageDraw

from kickbench.view.outline import Outlines

_FINE = 3
"""The map is drawn this much larger and scaled down: Pillow draws without anti-aliasing."""
_BORDER = 0.08
_BACKGROUND = (24, 34, 28, 150)
_BALL, _TARGET, _ROBOT = (120, 190, 255), (255, 214, 60), (255, 255, 255)


class MiniMap:
    """Regions from above, x up and y to the left, on a dark translucent square."""

    def __init__(self, regions: Outlines, size: int) -> None:
        """Sizes the map so that robot and regions fill it.

        Args:
            regions: The regions.
            size: Side of the map, pixels.
        """
        self._regions, self.size = regions, size
        corners = np.concatenate([regions.ball, regions.target, np.zeros((1, 2))])
        low, high = corners.min(axis=0), corners.max(axis=0)
        self._middle = (low + high) / 2.0
        self._scale = size * _FINE * (1.0 - 2.0 * _BORDER) / float((high - low).max())

    def place(self, points: np.ndarray) -> list[tuple[float, float]]:
        """Places of points [N, 2] on the fine map, pixels from its upper left corner."""
        offset = (np.atleast_2d(points) - self._middle) * self._scale
        middle = self.size * _FINE / 2.0
        return [(float(middle - y), float(middle - x)) for x, y in offset]

    @cached_property
    def _background(self) -> Image.Image:
        side = self.size * _FINE
        image = Image.new("RGBA", (side, side), (0, 0, 0, 0))
        draw = ImageDraw.Draw(image)
        draw.rounded_rectangle((0, 0, side - 1, side - 1), radius=side // 14, fill=_BACKGROUND)
        for outline, colour in ((self._regions.target, _TARGET), (self._regions.ball, _BALL)):
            # Width as well as area: a region may be a line or a point.
            draw.polygon(self.place(outline), fill=(*colour, 90), outline=(*colour, 200), width=_FINE)
        nose = side / 22.0
        ((x, y),) = self.place(np.zeros(2))
        draw.polygon([(x, y - 1.5 * nose), (x + nose, y + nose), (x - nose, y + nose)], fill=_ROBOT)
        return image

    def corner(self, width: int, height: int, subjects: np.ndarray) -> tuple[int, int]:
        """Where in a picture the map hides least: the place of its upper left corner, pixels.

        Args:
            width: Width of the picture, pixels.
            height: Its height, pixels.
            subjects: Places in the picture that should stay free [N, 2], from -1 to 1.
        """
        gap = max(self.size // 16, 4)
        right, bottom = width - self.size - gap, height - self.size - gap
        pixels = (subjects * [1.0, -1.0] + 1.0) / 2.0 * [width, height]

        def hidden(place: tuple[int, int]) -> int:
            inside = (pixels > np.array(place) - gap) & (pixels < np.array(place) + self.size + gap)
            return int(inside.all(axis=1).sum())

        return min([(gap, gap), (right, gap), (right, bottom), (gap, bottom)], key=hidden)

    def stamp(self, image: Image.Image, place: tuple[int, int], ball: np.ndarray, target: np.ndarray) -> None:
        """Draws the map into a picture.

        Args:
            image: The picture, changed in place.
            place: Upper left corner of the map in it, pixels.
            ball: Position of the ball [2], m.
            target: Position of the target [2], m.
        """
        fine = self._background.copy()
        draw, radius = ImageDraw.Draw(fine), self.size * _FINE / 30.0
        for point, colour in ((target, _TARGET), (ball, _BALL)):
            ((x, y),) = self.place(point)
            box = (x - radius, y - radius, x + radius, y + radius)
            draw.ellipse(box, fill=colour, outline=(20, 20, 20), width=_FINE)
        small = fine.resize((self.size, self.size), Image.Resampling.LANCZOS)
        image.paste(small, place, small)
