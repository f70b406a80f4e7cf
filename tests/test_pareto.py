from __future__ import annotations

import numpy as np

from xfreqbench.pareto import pareto_front


def test_the_front_is_what_a_literal_search_finds() -> None:
    points = [tuple(pair) for pair in np.random.default_rng(0).integers(0, 30, size=(200, 2)).tolist()]
    literal = {
        (x, y) for x, y in points if not any((a <= x and b > y) or (a < x and b >= y) for a, b in points)
    }
    front = pareto_front(points, cost=lambda each: each[0], score=lambda each: each[1])
    assert set(front) == literal
    assert len(front) == len(literal) > 1
    assert front == sorted(front)


def test_nothing_has_no_front() -> None:
    assert pareto_front([], cost=float, score=float) == []
