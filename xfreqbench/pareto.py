"""What no other is both cheaper and better than."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

Point = TypeVar("Point")


def pareto_front(
    points: Iterable[Point], cost: Callable[[Point], float], score: Callable[[Point], float]
) -> list[Point]:
    """Points that score more than everything as cheap or cheaper, from the cheapest on; of equal ones the first."""
    front: list[Point] = []
    for point in sorted(points, key=lambda each: (cost(each), -score(each))):
        if not front or score(point) > score(front[-1]):
            front.append(point)
    return front
